"""A simulated vehicle, target and payload that speak MAVLink over UDP; shares no code with what it tests."""

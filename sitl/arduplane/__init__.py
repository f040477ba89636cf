"""A simulated ArduPlane: modes, mission, navigation, parameters and telemetry."""

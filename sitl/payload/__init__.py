"""The simulated laser and gimbal, on the vehicle or as a component of its own."""

"""A simulated PX4 fixed wing: modes, mission, navigation, parameters and telemetry."""

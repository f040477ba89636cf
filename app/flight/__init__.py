"""One live flight: checks before it, the control loop, displays and sharing."""

"""What each autopilot does differently, one module each."""

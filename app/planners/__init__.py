"""The planners that can be configured, one module each."""

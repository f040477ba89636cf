"""Outputs of target and aircraft to other systems, and input from a beacon on the target."""

"""A route that the target is expected to follow, and the target's progress along it."""

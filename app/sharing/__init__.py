"""Who else is told of target and aircraft, and what a target that co-operates tells itself."""

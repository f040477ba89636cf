"""The words everything in ``mission`` is said in: circle, path, plan, requirement, events."""

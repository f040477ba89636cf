"""The types that all of ``mission`` uses: circle, path, plan, requirement, events."""

"""The default planner: moves rolled out against the estimate, scored with a value table."""

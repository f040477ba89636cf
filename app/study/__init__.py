"""Planners compared over many random targets, without MAVLink: ``sidelong study``.

One run is a truth target, a kinematic aircraft, noisy sensors, the real filter and the real planner; a study is many
runs for each planner, over the same targets and the same noise.
"""

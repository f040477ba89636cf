"""What exists around the autopilot: airframe, ground, targets and the record of the truth."""

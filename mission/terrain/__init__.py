"""What the ground asks of a plan: clearance, heights, and places from where the target is seen."""

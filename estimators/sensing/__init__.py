"""What the sensors deliver: readings, clocks, the aircraft pose, lines of sight and sightings."""

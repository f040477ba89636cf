"""Plans as mission items: waypoints laid out for the autopilot's line tracking, fences, files."""

"""The optional layer of a fleet: its file, coordinator, flight, displays, replay and report, above single flights."""

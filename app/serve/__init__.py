"""The resident form of ``launch``: waits for vehicle and payload, and watches on request."""

"""What is kept of a flight and read again: telemetry logs, the journal, truth tracks, run folders, exports."""

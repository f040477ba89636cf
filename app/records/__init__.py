"""Records of a flight, written and read: telemetry logs, the journal, truth tracks, run folders, exports."""

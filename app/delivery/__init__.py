"""Bringing plans to the autopilot."""

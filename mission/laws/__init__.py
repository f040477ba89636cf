"""Guidance laws of the literature, for comparison."""

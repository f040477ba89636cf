"""Planners compared over many targets with the same noise: ``sidelong study``."""

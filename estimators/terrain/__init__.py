"""Terrain from elevation data: heights, slopes, ray intersection and visibility."""

"""Elevation data on disk: SRTM tiles and GeoTIFF files, a window of them about home, what they cover."""

"""The ground as elevation data tells it: heights, slopes, where a ray meets it, what it hides."""

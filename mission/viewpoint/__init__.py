"""From where the target is watched, and how places are described to people."""

"""The control step: one event in, commands out."""

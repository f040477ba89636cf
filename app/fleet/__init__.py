"""The file of a fleet, and what coordinates its aircraft put together from it."""

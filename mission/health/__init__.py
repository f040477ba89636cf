"""Whether every input is there, is fresh, and agrees with the others."""

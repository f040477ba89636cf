"""Lines an aircraft can fly, in still air and in wind."""

"""Ray intersection."""

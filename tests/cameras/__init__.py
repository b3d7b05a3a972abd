"""Sensors: the rays that they send, the images that they make."""

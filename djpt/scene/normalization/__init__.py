"""Scenes that are very small, very large or far away, rendered at unit size about the origin."""

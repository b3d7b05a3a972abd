"""Renders that are too large or too long for one image in memory at the end."""

"""Renders that are too large for one image in memory at the end, or so long that they show what exists and go on."""

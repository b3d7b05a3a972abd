"""Finished images: files, colour, tone mapping."""

"""Textures, the files that they read, and colours."""

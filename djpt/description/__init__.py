"""Scene descriptions, and their conversion to a tree of plugins with checked properties."""

"""From a scene description to a tree of plugins whose properties were checked."""

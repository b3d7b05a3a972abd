"""Calling plugins per lane: an index, the values behind it, the call."""

"""Images without noise: surface properties that guide a filter, and two filters."""

"""The construction of trees by compiled functions."""

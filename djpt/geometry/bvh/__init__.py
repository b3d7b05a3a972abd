"""Bounding volume hierarchies: built and kept up to date on the host, searched in kernels."""

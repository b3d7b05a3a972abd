"""Shapes, meshes, instances and what rays find of them."""

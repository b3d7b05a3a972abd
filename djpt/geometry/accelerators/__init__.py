"""Acceleration structures to compare: their common contract, a grid, a k-d tree, brute force, and the BVH."""

"""The construction of a BVH by NumPy and kernels, level by level."""

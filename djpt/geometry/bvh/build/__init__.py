"""The construction of BVHs: by compiled functions, or by NumPy where nothing can be compiled."""

"""Curves: the pieces that stand in a BVH, how rays meet them, and the surface at a hit."""

"""Shapes of many pieces, curves and ellipsoids: how they are cut, how rays meet them, and the surface at a hit."""

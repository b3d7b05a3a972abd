"""Transforms: those of scene descriptions, on the host, and those that scripts compute with, on lanes.

`djpt.core.transforms.host` has the first, in double precision, which the renderer uses; `djpt.core.transforms.lanes`
has the second, of Dr.Jit matrices, which is imported when it is first needed. Each converts the other.
"""

from __future__ import annotations

from djpt.core.transforms.base import Transform, matrix_of
from djpt.core.transforms.host import ScalarTransform3f, ScalarTransform4f, as_transform

__all__ = ["ScalarTransform3f", "ScalarTransform4f", "Transform", "as_transform", "matrix_of"]

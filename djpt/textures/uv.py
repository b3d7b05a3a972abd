"""Textures with a `to_uv` of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import as_array, describe
from djpt.core.transforms import ScalarTransform3f, ScalarTransform4f, matrix_of
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.errors import SceneError
from djpt.jit.kernels import as_vector
from djpt.jit.types import Float, Point2f, Vector2f, Vector3f
from djpt.textures.base import Texture

__all__ = ["UVTexture"]


class UVTexture(Texture):
    """A texture that is looked up at `to_uv` (u, v, 1).

    Parameters: `to_uv`, an affine map of the plane: a 3x3 matrix, or a transform of space, of which x and y
    count (`ScalarTransform4f().scale([4, 4, 1])` repeats the texture four times). Default: the identity.
    It may be singular.
    """

    values: ClassVar[Mapping[str, ParamFlags]] = dict.fromkeys(("to_u", "to_v"), ParamFlags.NonDifferentiable)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        with props.naming("to_uv"):
            self.to_uv = as_uv_transform(props.raw("to_uv", ScalarTransform3f()))
        self._place()

    def _place(self) -> None:
        """Compute the rows of `to_uv` that kernels read."""
        matrix = self.to_uv.matrix
        self.to_u, self.to_v = (as_vector(matrix[i]) for i in range(2))

    def traverse(self, callback: TraversalCallback) -> None:
        for name, flags in self.tables.items():
            callback.put(name, getattr(self, name), flags)
        callback.put("to_uv", self.to_uv)
        for name in self.children:
            if isinstance(child := getattr(self, name), Texture):
                callback.put(name, child)

    def check_parameter(self, name: str, value: Any) -> Any:
        if name != "to_uv":
            return value
        return as_uv_transform(value)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        if "to_uv" in keys:
            self._place()

    def uv(self, si: Any) -> Point2f:
        """The place of the lookup: the surface's uv, mapped by `to_uv`."""
        u, v = si.uv.x, si.uv.y
        return Point2f(affine(self.to_u, u, v), affine(self.to_v, u, v))

    def chain(self, gradient: Vector2f) -> Vector2f:
        """A gradient with respect to the result of `uv`, converted to one by the surface's uv (the chain rule)."""
        return Vector2f(
            gradient.x * self.to_u.x + gradient.y * self.to_v.x,
            gradient.x * self.to_u.y + gradient.y * self.to_v.y,
        )


def affine(row: Vector3f, u: Float, v: Float) -> Float:
    """One coordinate of the mapped point: the product of a row with (u, v, 1)."""
    return row.x * u + (row.y * v + row.z)


def as_uv_transform(value: Any) -> ScalarTransform3f:
    """A map of uv from any accepted form; what a transform of space does with z is dropped.

    Raises:
        SceneError: not an affine 3x3 or 4x4 matrix.
    """
    if isinstance(value, ScalarTransform3f):
        return value
    matrix: NDArray[np.float64] = value.matrix if isinstance(value, ScalarTransform4f) else as_array(matrix_of(value))
    if matrix.shape == (4, 4):
        return ScalarTransform4f(matrix).extract()
    if matrix.shape != (3, 3):
        raise SceneError(f"must be a 3x3 or 4x4 matrix, found {describe(value)}")
    return ScalarTransform3f(matrix)

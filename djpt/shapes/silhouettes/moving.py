"""The parameters by which shapes move: the attached value of each, and values that stand in for it for a while."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import drjit as dr

from djpt.core.transforms.host import ScalarTransform4f
from djpt.jit.types import Float

__all__ = ["AttachedTransform", "attached_place", "exchanged", "exchanged_value", "motion_name", "own_place"]


class AttachedTransform(ScalarTransform4f):
    """A transform on the host that knows the Dr.Jit transform, attached to gradients, that it was made from."""

    __slots__ = ("lanes",)

    def __init__(self, lanes: Any) -> None:
        """Read a `Transform4f`."""
        super().__init__(dr.detach(lanes.matrix))
        self.lanes = lanes

    def __matmul__(self, other: Any) -> Any:
        """The product of the values."""
        return ScalarTransform4f(self.matrix) @ other

    def __eq__(self, other: object) -> bool:
        return self is other

    __hash__ = None  # type: ignore[assignment]


_exchanged: ContextVar[Mapping[tuple[int, str], Any] | None] = ContextVar("exchanged", default=None)


@contextmanager
def exchanged(values: Mapping[tuple[int, str], Any]) -> Iterator[None]:
    """Let shapes move by other variables within a `with` block: fresh leaves in place of the parameters.

    Args:
        values: the variables by the id of the shape and its attribute, `motion_name`.
    """
    token = _exchanged.set(values)
    try:
        yield
    finally:
        _exchanged.reset(token)


def exchanged_value(shape: Any, name: str) -> Any:
    """The variable that stands in for an attribute of a shape; None if there is none."""
    return (_exchanged.get() or {}).get((id(shape), name))


def motion_name(shape: Any) -> str:
    """The attribute that holds the variable by which a shape moves: a matrix, or points in memory."""
    return shape.points_parameter or "attached_matrix"


def own_place(shape: Any) -> Any:
    """The variable by which a shape moves, whether it has gradients or not; None if there is none, or not yet."""
    return shape.__dict__.get(shape.points_parameter) if shape.points_parameter else shape.attached_matrix


def attached_place(shape: Any) -> Any:
    """The variable by which a shape moves: a `Matrix4f`, or the `Float` of its points; None if it stays.

    While images are differentiated, both are in memory: a `Float64` (`djpt.shapes.silhouettes.normals`).
    """
    name = motion_name(shape)
    value = exchanged_value(shape, name)
    if value is None:
        value = own_place(shape)
    if value is None or not dr.grad_enabled(value):
        return None
    moved: Float = value
    return moved

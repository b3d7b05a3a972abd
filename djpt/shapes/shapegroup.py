"""Groups of shapes that are seen only through their instances."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from djpt.description.plugin import Plugin, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_shape
from djpt.errors import SceneError
from djpt.jit.types import Float
from djpt.shapes.axes import AxisPool
from djpt.shapes.base import Shape

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["ShapeGroup"]


class ShapeGroup(Shape):
    """Shapes that are stored once and placed many times, each time by an `instance`.

    The nested shapes may have BSDFs but no emitters, and can't be instances or groups. A group itself is
    invisible.
    """

    def __init__(self, props: Properties) -> None:
        from djpt.shapes.instance import Instance

        # Not `Shape.__init__`: a group has no BSDF, emitter, sensor or place of its own.
        Plugin.__init__(self, props)
        self.named: list[tuple[str, Shape]] = props.children("shape")
        if not self.named:
            raise SceneError(f"{props.node}: the 'shapegroup' is empty; nest the shapes to be instanced in it")
        for key, shape in self.named:
            if isinstance(shape, (ShapeGroup, Instance)):
                raise SceneError(f"{props.node}: '{key}' is itself a group or an instance, which can't be instanced")
            if shape.emitter() is not None:
                raise SceneError(f"{props.node}: '{key}' has an emitter; instanced shapes can't emit light")
            if shape.moves:
                raise SceneError(f"{props.node}: '{key}' is animated; in a group only whole instances move")
            if shape.priority is not None:
                raise SceneError(f"{props.node}: '{key}' has a 'priority'; bodies that overlap can't be instanced")
            shape.in_group = True

    @property
    def shapes(self) -> list[Shape]:
        """The shapes of the group, in its own space."""
        return [shape for _, shape in self.named]

    def traverse(self, callback: TraversalCallback) -> None:
        for key, shape in self.named:
            callback.put(key, shape)

    def bsdf(self) -> None:
        """None: BSDFs belong to the shapes of the group."""

    def surface_area(self) -> Float:
        """0, as in Mitsuba: a group itself is invisible."""
        return Float(0)

    def primitive_count(self) -> int:
        return sum(shape.primitive_count() for shape in self.shapes)

    def effective_primitive_count(self) -> int:
        return 0

    def move_into(self, frame: Frame) -> None:
        """The group keeps its own space: only instances move. But what covers the shapes is seen from the frame."""
        self.leave()
        self.named = [(key, frame.copied(shape)) for key, shape in self.named]
        for shape in self.shapes:
            shape.leave()
            shape.move_nested(frame)

    def place(self, pool: AxisPool) -> None:
        for shape in self.shapes:
            shape.place(pool)

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        """The extent of the whole group in its own space."""
        intervals = [shape.interval(direction) for shape in self.shapes]
        return min(low for low, _ in intervals), max(high for _, high in intervals)


register_shape("shapegroup", ShapeGroup)

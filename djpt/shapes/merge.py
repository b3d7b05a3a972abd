"""Several meshes merged into one."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.description.plugin import Plugin, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_shape
from djpt.errors import SceneError
from djpt.shapes.axes import AxisPool
from djpt.shapes.base import Shape
from djpt.shapes.mesh import Mesh
from djpt.shapes.numbering import likeness, merged_last

__all__ = ["Merge"]


class Merge(Shape):
    """Shapes of which those that can are merged: a description of meshes, which itself never stands in a scene.

    Merged are meshes that have the same BSDF, emitter, sensor and media (those that a reference names, for instance),
    that agree in having vertex normals, texture coordinates, `face_normals` and `flip_normals`, and that have no
    attributes. All others stay as they are, and so do shapes that aren't meshes. A shape that is referred to several
    times counts once. If all meshes become one, it gets the
    name of this node; else merged meshes have the name of the first among them. The order is Mitsuba's: see
    `djpt.shapes.numbering`.
    """

    in_any_frame = True

    def __init__(self, props: Properties) -> None:
        # Not `Shape.__init__`: there is no BSDF, emitter, sensor or place of its own.
        Plugin.__init__(self, props)
        named = props.children("shape")
        if not named:
            raise SceneError(f"{props.node}: nothing to merge; nest shapes in it")
        for key, shape in named:
            if shape.id() == f"{props.id()}.{key}":
                shape.set_id(key)
        self.parts = merged([shape for _, shape in named])
        meshes = [shape for shape in self.parts if mergeable(shape)]
        # What stands alone, outside of a scene, has no name to give.
        if len(meshes) == 1 and props.node != props.plugin_name():
            meshes[0].set_id(props.id())

    def expand(self) -> list[Plugin]:
        """The shapes that stand in the place of this one."""
        return list(self.parts)

    def traverse(self, callback: TraversalCallback) -> None:
        for shape in self.parts:
            callback.put(shape.id(), shape)

    def place(self, pool: AxisPool) -> None:
        for shape in self.parts:
            shape.place(pool)

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        intervals = [shape.interval(direction) for shape in self.parts]
        return min(low for low, _ in intervals), max(high for _, high in intervals)


def mergeable(shape: Shape) -> bool:
    """Whether a shape is a mesh without attributes."""
    return isinstance(shape, Mesh) and not shape.attributes


def merged(shapes: Sequence[Shape]) -> list[Shape]:
    """The shapes, each once, in Mitsuba's order, with like meshes merged."""
    groups: dict[Hashable, list[Any]] = {}
    for shape in merged_last({id(shape): shape for shape in shapes}.values()):
        key = (likeness(shape), shape.flip_normals) if mergeable(shape) else id(shape)
        groups.setdefault(key, []).append(shape)
    return [group[0] if len(group) == 1 else joined(group) for group in groups.values()]


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of the triangles of several that are alike."""
    first = meshes[0]
    starts = np.cumsum([0, *(len(mesh.positions) for mesh in meshes)]).astype(np.uint32)
    indices = np.concatenate([mesh.indices + start for mesh, start in zip(meshes, starts, strict=False)])
    normals, texcoords = (
        None if getattr(first, name) is None else np.concatenate([getattr(mesh, name) for mesh in meshes])
        for name in ("normals", "texcoords")
    )
    nested = {"bsdf": first._bsdf, "emitter": first.emitter(), "sensor": first.sensor()}
    media = {"interior": first._interior, "exterior": first._exterior}
    keys = {key: plugin for key, plugin in {**nested, **media}.items() if plugin is not None}
    own = {**keys, "flip_normals": first.flip_normals, "face_normals": first.flat}
    return Mesh(first.id(), np.concatenate([mesh.positions for mesh in meshes]), indices, normals, texcoords, own)


register_shape("merge", Merge)

"""The order in which Mitsuba numbers what stands in a scene, once its loader has merged meshes.

The loader puts everything that stands in a scene through `merge`, which hands on what isn't a mesh, and after it the
meshes, in groups of those that can be one. The groups come out of a hash table of the C++ library, in the order of its
buckets. Their numbers are made of addresses in memory, so where two groups share a bucket, Mitsuba's order differs from
run to run; where none do, as for few groups, it is `in_buckets`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any, TypeVar

from djpt.description.plugin import Plugin
from djpt.shapes.base import Shape
from djpt.shapes.mitsuba_api import ShapeType

__all__ = ["in_buckets", "likeness", "merged_last"]

AnyPlugin = TypeVar("AnyPlugin", bound=Plugin)
Group = TypeVar("Group")

SIZES = (13, 29, 59, 127, 257, 541, 1109, 2357, 5087, 10273, 20753, 42043, 85229, 172933, 351061, 712697, 1447153)
"""The numbers of buckets that GNU's `std::unordered_map` grows through; it is full with as many entries."""


def likeness(plugin: Any, alike: Callable[[Any], int] = id) -> Hashable | None:
    """A key that those shapes share which Mitsuba makes one mesh; None of plugins that it never merges.

    Rectangles and cubes are meshes in Mitsuba. A mesh with attributes stays apart. `alike` gives a number that plugins
    share which count as one.
    """
    if not (isinstance(plugin, Shape) and plugin.shape_kind & ShapeType.Mesh):
        return None
    nested = plugin._bsdf or plugin, plugin.emitter(), plugin.sensor(), plugin._interior, plugin._exterior
    return None if (data := mesh_data(plugin)) is None else (*map(alike, nested), *data)


def mesh_data(shape: Any) -> tuple[bool, bool, bool] | None:
    """Whether a mesh lacks normals, lacks texture coordinates, and has `face_normals`; None if it has attributes."""
    if not shape.of_triangles:  # rectangles and cubes, which aren't meshes here
        return False, False, False
    return None if shape.attributes else (shape.normals is None, shape.texcoords is None, shape.flat)


def merged_last(plugins: Iterable[AnyPlugin], alike: Callable[[Any], int] = id) -> list[AnyPlugin]:
    """`plugins` in the order in which Mitsuba's loader leaves them: the groups of meshes that it merges are last."""
    others: list[AnyPlugin] = []
    groups: dict[Hashable, list[AnyPlugin]] = {}
    for plugin in plugins:
        key = likeness(plugin, alike)
        (others if key is None else groups.setdefault(key, [])).append(plugin)
    return [*others, *(plugin for group in in_buckets(list(groups.values())) for plugin in group)]


def in_buckets(groups: Sequence[Group]) -> list[Group]:
    """`groups`, which were added in this order, in that of a `std::unordered_map` where each has a bucket of its own.

    A new entry comes first, and growing turns the order around.
    """
    order: deque[Group] = deque()
    for count, group in enumerate(groups):
        if count in SIZES:
            order.reverse()
        order.appendleft(group)
    return list(order)

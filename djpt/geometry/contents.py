"""The sorting of a scene's shapes: which are unrolled, which stand in the BVH, which are seen through instances."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from djpt.core.lookup import Numbers
from djpt.shapes.axes import AxisPool
from djpt.shapes.base import Shape
from djpt.shapes.instance import Instance
from djpt.shapes.shapegroup import ShapeGroup

if TYPE_CHECKING:
    from djpt.geometry.triangles import Triangles
    from djpt.shapes.mesh import Mesh

__all__ = ["NO_INSTANCE", "Contents", "unseen"]

MAX_UNROLLED = 24
"""Most analytic shapes that are unrolled; if there are more they stand in the BVH (docs/performance.md)."""

LARGE, MAX_LARGE = 0.5, 6
"""In a scene of many shapes, up to `MAX_LARGE` larger than `LARGE` times the largest are unrolled."""


NO_INSTANCE = 0xFFFFFFFF
"""A number that no instance has."""


class Contents:
    """The shapes of a scene and of its groups.

    `shapes` are those of the scene, then the meshes of groups, then a copy of each analytic shape of a
    group for every instance: such a shape needs no tree, and moving it is exact.
    """

    def __init__(self, shapes: Sequence[Shape]) -> None:
        self._own = tuple(shapes)
        self._instances = [s for s in shapes if isinstance(s, Instance)]
        # Groups without meshes need no tree, nor do those without instances.
        self._groups: list[ShapeGroup] = []
        for instance in self._instances:
            if instance.group not in self._groups and any(s.of_triangles for s in instance.group.shapes):
                self._groups.append(instance.group)
        inner = [mesh for group in self._groups for mesh in group.shapes if mesh.of_triangles]
        copies = [(i, s) for i in self._instances for s in i.group.shapes if not s.of_triangles]
        for _, original in copies:
            # Rays hit the copies; of the originals only the extent counts.
            original.place(AxisPool())
        self._copied = [(instance, original, placed(instance, original)) for instance, original in copies]
        self.shapes: list[Shape] = [*shapes, *inner, *(copied for _, _, copied in self._copied)]
        analytic = [i for i, s in enumerate(self.shapes) if not unseen(s) and not s.of_triangles]
        self._solids = self._for_tree(analytic) + [i for i in analytic if self.shapes[i].in_pieces]
        self.analytic = [i for i in analytic if i not in set(self._solids)]
        """Indices of the shapes to be unrolled."""
        self._meshes = [i for i, s in enumerate(self.shapes) if s.of_triangles]
        self._placed = [i for i in self._instances if i.group in self._groups]
        solids = [self.shapes[i] for i in self._solids]
        self.bounding = [*(s for s in shapes if s.of_triangles or isinstance(s, Instance)), *solids]
        """The shapes beside the unrolled ones that make up the scene's extent."""

    def triangles(self) -> Triangles | None:
        """All meshes, and the instances of those in groups; None if there are none."""
        meshes: list[Any] = [s for s in self.shapes if s.of_triangles]
        solids = [self.shapes[i] for i in self._solids]
        if not meshes and not solids:
            return None
        # Scenes without meshes need no trees, and don't import what builds and searches them.
        from djpt.geometry.triangles import Triangles
        from djpt.geometry.two_level_bvh import Forest, Placement
        from djpt.shapes.meshes.mesh_set import MeshSet

        mesh_set = MeshSet(meshes)
        world = sum(s.of_triangles for s in self._own)
        parts = [world, *(sum(s.of_triangles for s in group.shapes) for group in self._groups)]
        placements = [Placement(self._groups.index(i.group) + 1, i.to_world.matrix) for i in self._placed]
        self._forest = Forest(mesh_set, parts, solids, placements)
        return Triangles(mesh_set, [*self._meshes, *self._solids], self._forest)

    @cached_property
    def instances(self) -> tuple[Numbers, Numbers] | None:
        """Two tables of indices of instances (NO_INSTANCE: none); None in scenes without instances.

        The first is by shape, for the copies of analytic shapes, the second by the number of a placement in the trees.
        """
        if not self._instances:
            return None
        place = {id(shape): i for i, shape in enumerate(self._own)}
        of_copy = {id(copied): place[id(instance)] for instance, _, copied in self._copied}
        by_shape = Numbers([of_copy.get(id(shape), NO_INSTANCE) for shape in self.shapes])
        return by_shape, Numbers([place[id(instance)] for instance in self._placed])

    def _for_tree(self, analytic: Sequence[int]) -> list[int]:
        """The analytic shapes that stand in the BVH, by index: none of a few, most of many.

        Large ones stay unrolled: most rays come near them, and they often share axes.
        """
        analytic = [i for i in analytic if not self.shapes[i].in_pieces]
        if len(analytic) <= MAX_UNROLLED:
            return []
        sizes = {i: size(self.shapes[i]) for i in analytic}
        largest = max(sizes.values())
        large = sorted((i for i in analytic if sizes[i] > LARGE * largest), key=lambda i: -sizes[i])[:MAX_LARGE]
        return [i for i in analytic if i not in large and self.shapes[i].canonical is not None]

    # ---- edits -----------------------------------------------------------------------

    def moved_meshes(self, changed: Sequence[Shape]) -> list[Mesh]:
        """The meshes among the changed shapes."""
        meshes: list[Any] = [s for s in changed if s.of_triangles]
        return meshes

    def moved_instances(self, changed: Sequence[Shape]) -> bool:
        """Tell the trees where the changed instances are; true if one of them has changed."""
        moved = [s for s in changed if isinstance(s, Instance) and s in self._placed]
        for instance in moved:
            self._forest.place(self._placed.index(instance), instance.to_world.matrix)
        return bool(moved)

    def moved_solids(self, changed: Sequence[Shape]) -> bool:
        """Whether an analytic shape in the BVH has moved."""
        solids = [self.shapes[i] for i in self._solids]
        return any(shape in solids for shape in changed)

    def renewed(self, changed: Sequence[Shape]) -> list[Shape]:
        """The shapes that the unrolled set must place again: changed ones, and copies of what has changed."""
        result = list(changed)
        for instance, original, copied in self._copied:
            if instance in changed or original in changed:
                original.place(AxisPool())
                # The copy keeps its axes, which belong to the unrolled set.
                copied.__dict__.update(placed(instance, original).__dict__ | {"_axes": copied._axes})
                result.append(copied)
        return result


def size(shape: Shape) -> float:
    """The diagonal of a shape's bounding box."""
    # Measured on a copy: the first `place` of a shape decides which axes it shares.
    copied = copy.copy(shape)
    copied.place(AxisPool())
    intervals = np.array([copied.interval(unit) for unit in np.eye(3)])
    return float(np.linalg.norm(intervals[:, 1] - intervals[:, 0]))


def unseen(shape: Shape) -> bool:
    """Whether rays never hit the shape itself: true for groups and instances."""
    return isinstance(shape, (ShapeGroup, Instance))


def placed(instance: Instance, original: Shape) -> Shape:
    """A copy of an analytic shape where an instance puts it."""
    copied = copy.copy(original)
    copied.to_world = copied.check_parameter("to_world", instance.to_world @ original.to_world)
    return copied

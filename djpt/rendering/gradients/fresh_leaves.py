"""AD leaves that stand in for the parameters of a scene while an image is differentiated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import drjit as dr

from djpt.dispatch.ensemble import Attached
from djpt.jit.kernels import opaque
from djpt.rendering.gradients.leaves import Parameter
from djpt.scene.scene import Scene
from djpt.shapes.silhouettes.moving import exchanged
from djpt.shapes.silhouettes.normals import with_normals

__all__ = ["FreshLeaves", "attached_view", "spread"]

Places = dict[tuple[int, str], Any]
"""Variables by the id of a plugin and the attribute that they stand in for."""


class FreshLeaves:
    """Leaves with the values that parameters have when this is made: later edits don't change what is differentiated.

    Their graph is their own, whatever clears it. Numbers that were written into a script don't get into kernels.
    """

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        self._places = [(id(p.owner), p.attribute) for p in parameters]
        self._values = [opaque(p.value) for p in parameters]

    def made(self, tangents: Sequence[Any] | None = None) -> tuple[list[Any], Places]:
        """New leaves, in the order of the parameters, and by their places; in forward mode with `tangents`."""
        fresh = [type(value)(value) for value in self._values]
        dr.enable_grad(fresh)
        if tangents is not None:
            for leaf, tangent in zip(fresh, tangents, strict=True):
                dr.set_grad(leaf, opaque(tangent))
        return fresh, dict(zip(self._places, fresh, strict=True))

    @contextmanager
    def attached(self, scene: Scene, tangents: Sequence[Any] | None = None) -> Iterator[tuple[list[Any], Scene]]:
        """Within a `with` block, new leaves and a view of the scene that reads them, and whose shapes move by them."""
        with dr.resume_grad():
            fresh, places = self.made(tangents)
            with exchanged(with_normals(places, scene.shapes())):
                yield fresh, attached_view(scene, places)


def attached_view(scene: Scene, values: Places) -> Scene:
    """A view of the scene that reads AD variables in place of copies.

    All tables are made at once: none may be made within a loop that Dr.Jit records.
    """
    lookup = Attached(values)
    lookup.prepare(leaf for ensemble in scene.ensembles() for leaf in ensemble.leaves())
    return scene.replace(lookup=lookup)


def spread(fresh: list[Any]) -> None:
    """Propagate the tangents of leaves to the tables that kernels read: loops can't do it from within."""
    with dr.resume_grad():
        dr.enqueue(dr.ADMode.Forward, fresh)
        dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearEdges)

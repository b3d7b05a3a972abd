"""Meshes that cut themselves: curves in which light jumps, and which derivatives don't follow."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from djpt.core.records import Ray3f
from djpt.integrators.base import warn
from djpt.jit.types import Float, Point3f

__all__ = ["cuts_itself", "warn_of_self_intersections"]

MOST_EDGES = 1 << 16
"""The edges that are tried at most."""

INSET = 1e-3
"""The part of an edge that is left out at either end."""


def cuts_itself(scene: Any, mesh: Any) -> bool:
    """Whether an edge of a mesh pierces a triangle of it that shares no corner with the edge.

    Of triangles that cut each other one has an edge that pierces the other. Edges are followed by rays to the first hit
    alone, and of large meshes some edges: what is found is true, but not all is found.
    """
    with dr.suspend_grad():
        points = np.array(dr.detach(mesh.vertex_positions), np.float32).reshape(-1, 3)
        faces = np.array(mesh.faces_parameter, np.int64).reshape(-1, 3)
        # Vertices at one place count as one.
        _, place = np.unique(points, axis=0, return_inverse=True)
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        _, first = np.unique(np.sort(place.ravel()[edges], axis=1), axis=0, return_index=True)
        edges = edges[first[:: -(-len(first) // MOST_EDGES)]]
        start, way = points[edges[:, 0]], points[edges[:, 1]] - points[edges[:, 0]]
        edges, start, way = (v[np.any(way != 0, axis=1)] for v in (edges, start, way))
        if not len(edges):
            return False
        origin = Point3f(np.ascontiguousarray((start + INSET * way).T))
        ray = Ray3f(origin, Point3f(np.ascontiguousarray(way.T)), maxt=Float(1 - 2 * INSET))
        si = scene.ray_intersect(ray)
        hit = np.broadcast_to(np.array(si.is_valid() & (si.shape == mesh)), len(edges))
        struck = np.broadcast_to(np.array(si.prim_index, np.int64), len(edges))[hit]
        corners, ends = place.ravel()[faces[struck]], place.ravel()[edges[hit]]
        return bool(np.any(~np.any(corners[:, :, None] == ends[:, None, :], axis=(1, 2))))


def warn_of_self_intersections(scene: Any) -> None:
    """Warn of meshes that move and cut themselves; each is looked at once, when it is first differentiated."""
    for mesh in scene.shapes():
        if mesh.of_triangles and mesh.parameters_grad_enabled() and not mesh.__dict__.get("_looked_for_cuts"):
            mesh.__dict__["_looked_for_cuts"] = True
            if cuts_itself(scene, mesh):
                warn(
                    f"'{mesh.id()}' cuts itself, and moves with parameters that have gradients: how the curves in "
                    "which it does so move isn't followed. Possible: make a shape of each part, with 'max_depth' 2"
                )

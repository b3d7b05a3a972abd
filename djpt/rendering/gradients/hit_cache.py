"""What rays have hit on the first walk of a sample, kept for the second, which then needn't search again.

A search of a tree takes longer than all else at a vertex. Both walks of a replay follow the same rays, so a lane keeps
the results for the first `CACHED_VERTICES` vertices in its local memory: five words or six per vertex. Tests of shapes
outside of the tree are as cheap as reading them there, and are made again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.geometry.query import NONE, Found
from djpt.geometry.triangles import Triangles
from djpt.integrators.base import PathIntegrator
from djpt.jit.types import Bool, Float, Point2f, UInt32
from djpt.scene.scene import Scene

__all__ = ["CachedTriangles", "HitCache", "empty_hit_cache"]

CACHED_VERTICES = 8
"""The largest number of vertices of a sample that are cached; beyond them the second walk searches again."""

FLOATS = 3
"""Numbers of a vertex: the distance, and the weights of two corners."""


@dataclass
class HitCache:
    """The hits of each lane, in local memory: loop state."""

    places: Any
    """`FLOATS` numbers per vertex."""
    records: Any
    """The record that was hit, and the instance that it belongs to in scenes with instances."""
    blocked: Any
    """Whether the shadow ray was blocked, as 0 or 1."""

    def for_vertex(self, number: UInt32, again: Bool) -> CacheEntry:
        """The entry of a vertex; lanes are on the second walk where `again`."""
        fits = number < CACHED_VERTICES
        return CacheEntry(self, dr.select(fits, number, 0), fits & ~again, fits & again)


def empty_hit_cache(integrator: PathIntegrator, scene: Scene, lanes: int) -> tuple[HitCache, ...]:
    """An empty cache for a loop's lanes; none where a path may make several searches for a vertex, or cheap ones."""
    triangles, kind = scene.geometry.triangles, type(integrator)
    one_each = (
        kind.trace is PathIntegrator.trace and kind.transmittance is PathIntegrator.transmittance and not scene.media
    )
    if triangles is None or triangles.tree.stepwise or not one_each:
        return ()
    words = 2 if triangles.tree.instanced else 1
    places, records, blocked = (
        dr.alloc_local(kind, CACHED_VERTICES * count) for kind, count in ((Float, FLOATS), (UInt32, words), (UInt32, 1))
    )
    # Loop state must have full width from the start.
    places.write(dr.zeros(Float, lanes), UInt32(0))
    records.write(dr.zeros(UInt32, lanes), UInt32(0))
    blocked.write(dr.zeros(UInt32, lanes), UInt32(0))
    return (HitCache(places, records, blocked),)


@dataclass
class CacheEntry:
    """The cached hits of one vertex."""

    cache: HitCache
    number: UInt32
    storing: Bool
    """True where results are stored."""
    known: Bool
    """True where they were stored before."""

    def in_scene(self, scene: Scene) -> Scene:
        """A view of a scene whose searches are answered by the cache: one for a hit, and one for a shadow ray."""
        triangles = scene.geometry.triangles
        assert triangles is not None
        return scene.replace(geometry=scene.geometry.with_triangles(CachedTriangles(triangles, self)))

    def hit(self, found: Found) -> Found:
        """The result of a search: what is known of it, else what was `found`, which is stored."""
        numbers = [found.near_t] if found.b is None else [found.near_t, found.b.x, found.b.y]
        records = [found.record] if found.inside is None else [found.record, found.inside]
        t, *b = self._cached(self.cache.places, FLOATS, numbers)
        record, *inside = self._cached(self.cache.records, len(records), records)
        return Found(found.origin, found.entry, t, record, inside[0] if inside else None, Point2f(*b) if b else None)

    def shadow(self, blocked: Bool) -> Bool:
        """The same for a shadow ray."""
        (word,) = self._cached(self.cache.blocked, 1, [dr.select(blocked, UInt32(1), 0)])
        return word != 0

    def _cached(self, memory: Any, words: int, values: list[Any]) -> list[Any]:
        """What the memory of a vertex holds where it is known, else the `values`, which are written there."""
        result = []
        for k, value in enumerate(values):
            address = self.number * words + k
            result.append(dr.select(self.known, memory.read(address, self.known), value))
            memory.write(value, address, self.storing)
        return result


class CachedTriangles(Triangles):
    """Triangles whose searches are answered by the cache of a vertex where it is known."""

    def __init__(self, triangles: Triangles, entry: CacheEntry) -> None:
        """A view of `triangles`."""
        vars(self).update(vars(triangles))
        self._entry = entry

    def search(self, ray: Ray3f, through_lights: Bool | None) -> Found:
        through_lights = through_lights if self.emit else None
        return self._entry.hit(self.tree.search(ray, False, ~self._entry.known, through_lights))

    def occluded(self, ray: Ray3f, active: Bool | bool) -> Bool:
        return self._entry.shadow(self.tree.search(ray, True, ~self._entry.known & active).record != NONE)

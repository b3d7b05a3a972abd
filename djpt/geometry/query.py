"""Ray queries: the contract of the trees that answer them, their results, and a ray on its way through a tree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr

from djpt.core.records import Ray3f
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f

__all__ = [
    "ANALYTIC",
    "DETAIL",
    "FACE",
    "LABEL",
    "NONE",
    "NORMAL",
    "RADII",
    "Cursor",
    "Found",
    "Hit",
    "Near",
    "Query",
    "RayTree",
    "enter",
    "recentre",
]

NONE = 0
"""The record number that means "nothing was hit"."""

NORMAL, LABEL, DETAIL, RADII = 1, 4, 5, 6
"""Words of a record's row: the first of the normal, the label, the face or what a placed primitive is, and the first
radius of a piece."""

ANALYTIC = 0x80000000
"""A bit of `Query.cursor.hit`: set where the rest is the number of an unrolled face, not of a record."""

FACE = 0x7FFFFFFF
"""The bits of `Query.cursor.hit` that hold the number of an unrolled face."""


class RayTree(Protocol):
    """Triangles, solids and instances in memory, and the search for what rays hit.

    Each has a *record*, a number that isn't 0, and a *row* of eight words: way through, unit normal, label, face,
    direction of dp/du. Instances and solids have another row before: see `map_rows`. Labels are
    explained in `djpt.geometry.bvh.steps.records`. Coordinates are relative to `center`.
    """

    center: Point3f
    radius: Float
    """The radius of a sphere about `center` that holds everything."""
    extent: float
    """The diagonal of the bounding box."""
    instanced: bool
    """Whether there are instances."""
    kinds: tuple[int, ...]
    """The analytic shapes among the leaves: numbers into `canonical.KINDS`."""

    @property
    def bytes(self) -> int:
        """The memory that searches and shading read."""

    stepwise: bool
    """Whether a search is a sequence of steps that all lanes take together, and not a call."""

    def search(
        self, ray: Ray3f, any_hit: bool, active: Bool | bool = True, through_lights: Bool | None = None
    ) -> Found:
        """Find the first hit with 0 < t < maxt, or with `any_hit` any one.

        Where `through_lights`, shapes that emit aren't hit.
        """

    def start(
        self, o: Point3f, d: Vector3f, maxt: Float, active: Bool | bool, hit: UInt32 | int, weights: bool
    ) -> Cursor:
        """Begin a search where `active`; `hit` was hit before, at `maxt`.

        With `weights` the cursor keeps barycentric weights.
        """

    def turn(self, cursor: Any, o: Point3f, d: Vector3f, any_hit: Bool, through_lights: Bool | None) -> Cursor:
        """Go on with a search, for a number of steps or to its end."""

    def row(self, record: UInt32) -> list[UInt32]:
        """The row of a record."""

    def word(self, record: UInt32, index: int, active: Bool | bool = True) -> UInt32:
        """One word of the row of a record."""

    def map_rows(self, record: UInt32) -> list[UInt32]:
        """Both rows of an instance or solid: the map into its space, 3 x 4; label, detail, side, unused."""

    def corners(self, record: UInt32) -> tuple[Point3f, Point3f, Point3f] | None:
        """The corners of a triangle, relative to the centre of its tree; None: records don't hold them."""


class Cursor(Protocol):
    """The progress of a search."""

    t: Float
    """The distance of the closest hit so far, or of the ray's end."""
    hit: UInt32
    """The record that was hit, or NONE."""
    b: Point2f | None
    """Barycentric weights of the second and third corner at the hit; None if they aren't needed."""

    @property
    def ended(self) -> Bool:
        """True where the search has come to its end."""

    @property
    def inside(self) -> UInt32 | None:
        """The record of the instance that the hit belongs to, or NONE; None in scenes without instances."""


@dataclass
class Found:
    """The result of a search."""

    origin: Point3f
    """The ray's origin, moved near the triangles: see `djpt.geometry.query.enter`."""
    entry: Float
    """The distance that the origin was moved, in units of the ray's `d`."""
    near_t: Float
    """The distance of the hit from `origin`."""
    record: UInt32
    """The record that was hit, or NONE."""
    inside: UInt32 | None
    """The record of the instance that the hit belongs to, or NONE; None in scenes without instances."""
    b: Point2f | None = None
    """Barycentric weights of the second and third corner, if the search provides them."""

    @property
    def t(self) -> Float:
        """The distance of the hit from the ray's own origin; unspecified on a miss."""
        return self.near_t + self.entry


@dataclass
class Near:
    """A hit as the search for triangles gives it."""

    origin: Point3f
    """The ray's origin, moved near the triangles: see `djpt.geometry.query.enter`."""
    t: Float
    """The distance from `origin`: exact also where the distance from a far origin would be rounded."""
    entry: Float | None
    """The distance that the origin was moved, in units of the ray's `d`; None: not at all."""
    b: Point2f | None
    """Barycentric weights of the second and third corner, if they are known."""
    inside: UInt32 | None
    """The record of the instance that the triangle belongs to; None in scenes without instances."""


@dataclass
class Hit:
    """The first hit of a ray, as loops carry it: what `PreliminaryIntersection3f` is made of."""

    t: Float
    """The distance; infinity on a miss."""
    face: UInt32
    near: Near


@dataclass
class Query:
    """A ray that has been tested against the unrolled shapes, and its progress in the BVH."""

    o: Point3f
    """The origin, near the triangles, as seen from the centre of the BVH."""
    d: Vector3f
    entry: Float | None
    """The distance of `o` from the ray's own origin, in units of `d`; None: the origin wasn't moved."""
    cursor: Cursor


def recentre(ray: Ray3f, low: Point3f, high: Point3f) -> tuple[Ray3f, Float]:
    """Start a ray where it comes near the box from `low` to `high`; return it and the distance, in units of `d`.

    Intersections subtract coordinates of the origin: from 10^4 sizes away 4 of 7 digits are lost, and rays miss what
    they should hit. A ray that starts outside of the sphere around the box begins at that sphere instead (or beside it,
    at the point closest to its centre, if it passes by); all others stay as they are. The new origin is o + t0 d
    rounded once, whatever t0 is, so nothing is lost on the way. Distances count from there: t = t0 + t'. `maxt`
    becomes maxt - t0. An infinite or empty box changes nothing.
    """
    to_center = 0.5 * (low + high) - ray.o
    radius = 0.5 * dr.norm(high - low)
    inv = dr.rsqrt(dr.squared_norm(ray.d))
    t0 = (dr.dot(to_center, ray.d) * inv - radius) * inv
    t0 = dr.select((t0 > 0) & (t0 < ray.maxt) & dr.isfinite(t0), t0, 0)
    return ray.replaced(o=dr.fma(ray.d, t0, ray.o), maxt=ray.maxt - t0), t0


# ---- trees -------------------------------------------------------------------------------------------------------


class Sphere(Protocol):
    """A sphere that holds everything."""

    center: Point3f
    radius: Float


def enter(tree: Sphere, ray: Ray3f) -> tuple[Point3f, Float]:
    """Move a ray's origin near the triangles: the new origin, relative to the tree's centre, and the distance moved.

    A ray that starts within the sphere about all triangles keeps its origin. Other origins are moved without
    loss: the errors of all sums and products are carried along, so that from far away triangles are hit
    as precisely as from nearby (T. Ogita, S. Rump and S. Oishi, "Accurate Sum and Dot Product", 2005).
    """
    from_center, lost = two_sum(ray.o, -tree.center)
    inv = dr.rsqrt(dr.squared_norm(ray.d))
    t = -dr.dot(from_center, ray.d) * dr.square(inv) - tree.radius * inv
    t = dr.select(t > 0, t, 0)
    step = ray.d * t
    moved, also_lost = two_sum(from_center, step)
    return moved + (lost + also_lost + dr.fma(ray.d, t, -step)), t


def two_sum(a: Point3f, b: Point3f) -> tuple[Point3f, Point3f]:
    """The rounded sum, and its rounding error (D. Knuth, TAOCP vol. 2, 4.2.2)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)

"""Seams of smooth meshes: curves inside the outline at which interpolated normals turn away from the viewer.

A triangle may face a viewer whom its interpolated normals don't see. There the surface is dark, up to the curve

    F(p) = <n(p), p - o> = 0,    n: the interpolated normal, not normalized, o: the viewer.

Both factors are linear on a triangle, so the curve is part of a conic. Mostly it parts one corner from the other two,
and each line from this corner to the opposite edge meets it once; now and then it only cuts off a part of an edge, and
a line may meet it twice. As the triangle or the viewer moves, so does F, and a point of the curve moves by
-dF / abs(grad F) along grad F in the plane of the triangle, more than it does with the surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import BSDFFlags, DiscontinuityFlags, has_flag
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.silhouettes.base import IN_FRONT, edge_normal, of_three
from djpt.shapes.silhouettes.normals import attached_normals
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

if TYPE_CHECKING:
    from djpt.shapes.silhouettes.mesh import MeshSilhouette

__all__ = ["Seams", "turns_dark"]

THROUGH = BSDFFlags.DiffuseTransmission | BSDFFlags.GlossyTransmission | BSDFFlags.DeltaTransmission


def turns_dark(shape: Any) -> bool:
    """Whether a shape is a mesh with seams: its normals are interpolated, and light doesn't come through it."""
    smooth: bool = shape.of_triangles and shape.has_vertex_normals()
    return smooth and not has_flag(shape.bsdf().flags(), THROUGH)


@dataclass(frozen=True)
class Corners:
    """The corners of triangles, and the normals there."""

    p: list[Vector3f]
    n: list[Vector3f]

    def rotated(self, first: UInt32) -> Corners:
        """The same, from another corner on."""
        return Corners(*([of_three((first + k) % 3, values) for k in range(3)] for values in (self.p, self.n)))

    def at(self, weights: tuple[Float, Float, Float]) -> tuple[Point3f, Vector3f]:
        """The point with barycentric weights, and the normal there, not normalized."""
        a, b, c = weights
        return tuple(dr.fma(x[0], a, dr.fma(x[1], b, x[2] * c)) for x in (self.p, self.n))  # type: ignore[return-value]


class Seams:
    """The seams of a mesh.

    Args:
        silhouette: The silhouettes of the mesh.
    """

    def __init__(self, silhouette: MeshSilhouette) -> None:
        self._silhouette = silhouette

    def precompute(self, viewpoint: Point3f) -> tuple[UInt32, Float]:
        """The triangles that have a seam, and about the angles in which it is seen."""
        mesh = self._silhouette.shape
        corners = self._corners(dr.arange(UInt32, len(mesh.indices)), True)
        apex, parted, crossed = apex_of(corners, viewpoint)
        if not has_flag(mesh.bsdf().flags(), BSDFFlags.BackSide):
            facing = facing_of(corners, viewpoint)
            crossed &= (facing > 0) if mesh.flip_normals else (facing < 0)
        corners = corners.rotated(apex)
        ends = [corners.at(meeting(corners, viewpoint, Float(s), Bool(False)).weights)[0] for s in (0, 1)]
        a, b = (dr.normalize(dr.select(parted, p, q) - viewpoint) for p, q in zip(ends, corners.p[1:], strict=True))
        part: Any = dr.compress(crossed)
        return part, dr.gather(Float, dr.norm(b - a), part)

    def sample(self, viewpoint: Point3f, face: UInt32, along: Float, active: Bool | bool) -> SilhouetteSample3f:
        """A point of a seam; `pdf` is per unit length. Its normal points to where the surface is dark."""
        corners = self._corners(face, active)
        first = apex_of(corners, viewpoint)[0]
        turned, second = corners.rotated(first), along >= 0.5
        along = 2 * along - dr.select(second, 1, 0)
        met = meeting(turned, viewpoint, along, second)
        weights, t = met.weights, met.place
        p, n = turned.at(weights)
        # The curve, by the fraction of the opposite edge.
        end_p, end_n = turned.at((Float(0), 1 - along, along))
        by_t, n_by_t = end_p - turned.p[0], end_n - turned.n[0]
        by_s, n_by_s = t * (turned.p[2] - turned.p[1]), t * (turned.n[2] - turned.n[1])
        to_p = p - viewpoint
        change_t, change_s = (dr.dot(dn, to_p) + dr.dot(n, dp) for dn, dp in ((n_by_t, by_t), (n_by_s, by_s)))
        curve = dr.fma(by_t, -change_s * dr.rcp(change_t), by_s)
        length = dr.norm(curve)
        valid = Bool(active) & (met.count > 0) & (length > 0) & dr.isfinite(length)
        d, tangent = dr.normalize(to_p), curve / length
        # Bright is the side on which F has the sign of a face that is seen from there.
        rises = dr.mulsign(Float(1), change_t) * dr.mulsign(Float(1), facing_of(corners, viewpoint))
        uv = Point2f(*(of_three((k - first) % 3, weights) for k in (4, 5)))
        ss = self._silhouette.sample_of(
            p=p,
            n=edge_normal(d, tangent, by_t * rises),
            uv=uv,
            discontinuity_type=dr.select(valid, UInt32(int(DiscontinuityFlags.InteriorType)), 0),
            d=d,
            silhouette_d=tangent,
            prim_index=face,
        )
        ss.pdf, ss.offset = dr.rcp(length * met.count), Float(IN_FRONT)
        return ss

    def slide(self, ss: SilhouetteSample3f, viewpoint: Point3f, active: Bool | bool) -> Vector3f:
        """How far points of seams move within their triangles: 0, attached to the mesh and to the viewpoint."""
        still = self._corners(ss.prim_index, active)
        corners, positions = still, self._silhouette.attached()
        if positions is not None:
            at_corners = self._silhouette.at_corners
            normals = attached_normals(self._silhouette.shape)
            corners = Corners(*(at_corners(values, ss.prim_index, active) for values in (positions, normals)))
        u, v = dr.detach(ss.uv.x), dr.detach(ss.uv.y)
        p, n = corners.at((1 - u - v, u, v))
        change = dr.dot(n, p - viewpoint)
        a, b = still.p[1] - still.p[0], still.p[2] - still.p[0]
        to_p, n = dr.detach(p - viewpoint), dr.detach(n)
        by_u = dr.dot(still.n[1] - still.n[0], to_p) + dr.dot(n, a)
        by_v = dr.dot(still.n[2] - still.n[0], to_p) + dr.dot(n, b)
        # The gradient g in the plane: <g, a> = by_u and <g, b> = by_v.
        aa, ab, bb = dr.squared_norm(a), dr.dot(a, b), dr.squared_norm(b)
        gradient = (a * (bb * by_u - ab * by_v) + b * (aa * by_v - ab * by_u)) * dr.rcp(aa * bb - dr.square(ab))
        return dr.select(active, gradient * ((dr.detach(change) - change) * dr.rcp(dr.squared_norm(gradient))), 0)

    def _corners(self, face: UInt32, active: Bool | bool) -> Corners:
        """The corners of triangles where they lie now."""
        values = self._silhouette.place(), dr.detach(self._silhouette.shape.vertex_normals)
        return Corners(*(self._silhouette.at_corners(x, face, active) for x in values))


def facing_of(corners: Corners, viewpoint: Point3f) -> Float:
    """Positive where triangles are seen from behind, negative where they are seen from the front."""
    a, b, c = corners.p
    return dr.dot(dr.cross(b - a, c - a), a - viewpoint)


def apex_of(corners: Corners, viewpoint: Point3f) -> tuple[UInt32, Bool, Bool]:
    """The corner that the seam parts from the others, whether there is one, and whether there is a seam.

    If there is none, it is the corner opposite to the edge of which the seam cuts off the most.
    """
    f = [dr.dot(n, p - viewpoint) for n, p in zip(corners.n, corners.p, strict=True)]
    behind = [x > 0 for x in f]
    alone = dr.select(behind[1] == behind[2], UInt32(0), dr.select(behind[0] == behind[2], UInt32(1), 2))
    parted = ~((behind[0] == behind[1]) & (behind[1] == behind[2]))
    deepest, opposite = Float(0), UInt32(0)
    for k in range(3):
        (a, b), (m, n) = ((values[(k + 1) % 3], values[(k + 2) % 3]) for values in (corners.p, corners.n))
        # The extreme value of F on an edge, if it is there, where it has the other sign than at the corners.
        start, end, mixed = f[(k + 1) % 3], f[(k + 2) % 3], dr.dot(m, b - viewpoint) + dr.dot(n, a - viewpoint)
        bend = start - mixed + end
        place = (start - 0.5 * mixed) * dr.rcp(bend)
        value = dr.select((place > 0) & (place < 1), start - bend * dr.square(place), 0)
        depth = dr.mulsign(-value, f[0])
        opposite = dr.select(depth > deepest, UInt32(k), opposite)
        deepest = dr.maximum(deepest, depth)
    return dr.select(parted, alone, opposite), parted, parted | (deepest > 0)


@dataclass(frozen=True)
class Meeting:
    """A point at which a line from a corner meets the seam."""

    weights: tuple[Float, Float, Float]
    """The barycentric weights."""
    place: Float
    """The fraction of the line."""
    count: Float
    """The number of such points on the line."""


def meeting(corners: Corners, viewpoint: Point3f, along: Float, second: Bool) -> Meeting:
    """A point where the line from the first corner to a fraction of the opposite edge meets the seam.

    F along it is a (1 - t)^2 + b t (1 - t) + c t^2.

    Args:
        corners: The corners.
        viewpoint: The viewer.
        along: The fraction.
        second: Which of two points, if there are two.
    """
    end_p, end_n = corners.at((Float(0), 1 - along, along))
    p, n = corners.p[0], corners.n[0]
    a, c = dr.dot(n, p - viewpoint), dr.dot(end_n, end_p - viewpoint)
    b = dr.dot(n, end_p - viewpoint) + dr.dot(end_n, p - viewpoint)
    # The positive roots of c x^2 + b x + a, with x = t / (1 - t).
    square = dr.fma(b, b, -4 * a * c)
    q = -0.5 * (b + dr.mulsign(dr.safe_sqrt(square), b))
    x, y = q * dr.rcp(c), a * dr.rcp(q)
    both = (x > 0) & (y > 0)
    positive = dr.select((both & second) | ~(x > 0), y, x)
    count = dr.select(square >= 0, dr.select(x > 0, Float(1), 0) + dr.select(y > 0, Float(1), 0), 0)
    t = positive * dr.rcp(1 + positive)
    return Meeting((1 - t, t * (1 - along), t * along), t, count)

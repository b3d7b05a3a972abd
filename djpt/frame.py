"""Orthonormal frames: maps to and from the local space of a surface point."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr

from djpt.types import Float, Normal3f, Vector3f

__all__ = ["Frame3f", "coordinate_system"]


def coordinate_system(n: Vector3f) -> tuple[Vector3f, Vector3f]:
    """Two tangents `s`, `t` such that (s, t, n) is a right-handed orthonormal basis.

    `n` must have unit length. Branchless and continuous except across z = 0: T. Duff et
    al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
    """
    sign = dr.sign(n.z)
    a = -dr.rcp(sign + n.z)
    b = n.x * n.y * a
    s = Vector3f(dr.mulsign(dr.square(n.x) * a, n.z) + 1, dr.mulsign(b, n.z), -dr.mulsign(n.x, n.z))
    t = Vector3f(b, dr.fma(n.y, n.y * a, sign), -n.y)
    return s, t


@dataclass
class Frame3f:
    """A right-handed orthonormal frame; `n` is its third axis (the normal)."""

    s: Vector3f
    t: Vector3f
    n: Normal3f

    @staticmethod
    def from_normal(n: Normal3f) -> Frame3f:
        """The frame of `coordinate_system(n)`."""
        s, t = coordinate_system(n)
        return Frame3f(s, t, n)

    def to_local(self, v: Vector3f) -> Vector3f:
        """Map a world vector to local coordinates: (v.s, v.t, v.n)."""
        return Vector3f(dr.dot(v, self.s), dr.dot(v, self.t), dr.dot(v, self.n))

    def to_world(self, v: Vector3f) -> Vector3f:
        """Map a local vector to world space: s v.x + t v.y + n v.z."""
        return dr.fma(self.n, v.z, dr.fma(self.t, v.y, self.s * v.x))

    @staticmethod
    def cos_theta(v: Vector3f) -> Float:
        """The cosine between a local direction and the normal."""
        return v.z

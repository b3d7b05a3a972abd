"""Orthonormal frames: maps to and from the local space of a surface point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.numeric import as_type
from djpt.errors import SceneError
from djpt.jit.types import Float, Normal3f, Vector3f

__all__ = ["Frame3f", "coordinate_system"]

UPRIGHT = 2.0**-22
"""The squared sine up to which a direction counts as the normal: four times the precision of float32."""


def coordinate_system(n: Vector3f) -> tuple[Vector3f, Vector3f]:
    """Two tangents `s`, `t` such that (s, t, n) is a right-handed orthonormal basis.

    `n` must have unit length; three numbers in any form. Branchless and continuous except across z = 0:
    T. Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
    """
    n = as_vector(n)
    sign = dr.sign(n.z)
    a = -dr.rcp(sign + n.z)
    b = n.x * n.y * a
    s = Vector3f(dr.mulsign(dr.square(n.x) * a, n.z) + 1, dr.mulsign(b, n.z), -dr.mulsign(n.x, n.z))
    t = Vector3f(b, dr.fma(n.y, n.y * a, sign), -n.y)
    return s, t


def as_vector(v: Any) -> Vector3f:
    """`v` itself if it has lanes, else three numbers in any form as an array."""
    return v if dr.is_jit_v(v) else as_type(Vector3f, v)


@dataclass(init=False, eq=False)
class Frame3f:
    """A right-handed orthonormal frame; `n` is its third axis (the normal).

    ``Frame3f(s, t, n)`` takes three axes as they are, ``Frame3f(n)`` completes a unit vector with
    `coordinate_system`, ``Frame3f(frame)`` copies, and ``Frame3f()`` has axes of zeros, to be assigned. Axes are three
    numbers in any form.

    The static methods are functions of a unit vector in local coordinates: theta is its angle to the normal, phi the
    azimuth of its projection, counted from `s`. On the normal phi is 0.
    """

    s: Vector3f
    t: Vector3f
    n: Normal3f

    def __init__(self, s: Any = None, t: Any = None, n: Any = None) -> None:
        if isinstance(s, Frame3f):
            s, t, n = Vector3f(s.s), Vector3f(s.t), Normal3f(s.n)
        elif s is None and t is None and n is None:
            s, t, n = (Vector3f(0) for _ in range(3))
        elif t is None and n is None:
            n = as_vector(s)
            s, t = coordinate_system(n)
        elif s is None or t is None or n is None:
            raise SceneError("Frame3f: takes no axis, the normal, or all three axes")
        self.s, self.t, self.n = as_vector(s), as_vector(t), as_vector(n)

    def assign(self, other: Frame3f) -> None:
        """Take over the axes of another frame."""
        self.s, self.t, self.n = other.s, other.t, other.n

    @staticmethod
    def from_normal(n: Normal3f) -> Frame3f:
        """The frame of `coordinate_system(n)`."""
        s, t = coordinate_system(n)
        return Frame3f(s, t, n)

    def to_local(self, v: Vector3f) -> Vector3f:
        """Map a world vector to local coordinates: (v.s, v.t, v.n)."""
        v = as_vector(v)
        return Vector3f(dr.dot(v, self.s), dr.dot(v, self.t), dr.dot(v, self.n))

    def to_world(self, v: Vector3f) -> Vector3f:
        """Map a local vector to world space: s v.x + t v.y + n v.z."""
        v = as_vector(v)
        return dr.fma(self.n, v.z, dr.fma(self.t, v.y, self.s * v.x))

    def __eq__(self, other: object) -> Any:
        """The lanes on which all axes are equal."""
        if not isinstance(other, Frame3f):
            return NotImplemented
        return dr.all((self.s == other.s) & (self.t == other.t) & (self.n == other.n))

    def __ne__(self, other: object) -> Any:
        """The lanes on which some axes differ."""
        return ~(self == other) if isinstance(other, Frame3f) else NotImplemented

    __hash__ = None  # type: ignore[assignment]

    # ---- angles of local directions ----------------------------------------------------

    @staticmethod
    def cos_theta(v: Vector3f) -> Float:
        """The cosine between a local direction and the normal."""
        return as_vector(v).z

    @staticmethod
    def cos_theta_2(v: Vector3f) -> Float:
        """The square of `cos_theta`."""
        return dr.square(as_vector(v).z)

    @staticmethod
    def sin_theta(v: Vector3f) -> Float:
        """The sine between a local direction and the normal."""
        return dr.safe_sqrt(Frame3f.sin_theta_2(v))

    @staticmethod
    def sin_theta_2(v: Vector3f) -> Float:
        """The square of `sin_theta`."""
        v = as_vector(v)
        return dr.fma(v.x, v.x, dr.square(v.y))

    @staticmethod
    def tan_theta(v: Vector3f) -> Float:
        """The tangent between a local direction and the normal, with the sign of the cosine."""
        v = as_vector(v)
        return dr.safe_sqrt(dr.fma(-v.z, v.z, 1)) / v.z

    @staticmethod
    def tan_theta_2(v: Vector3f) -> Float:
        """The square of `tan_theta`."""
        v = as_vector(v)
        squared: Float = dr.fma(-v.z, v.z, Float(1))
        return dr.maximum(squared, 0) / dr.square(v.z)

    @staticmethod
    def sin_phi(v: Vector3f) -> Float:
        """The sine of the azimuth."""
        return Frame3f.sincos_phi(v)[0]

    @staticmethod
    def cos_phi(v: Vector3f) -> Float:
        """The cosine of the azimuth."""
        return Frame3f.sincos_phi(v)[1]

    @staticmethod
    def sincos_phi(v: Vector3f) -> tuple[Float, Float]:
        """Sine and cosine of the azimuth."""
        v = as_vector(v)
        squared = Frame3f.sin_theta_2(v)
        inverse = dr.rsqrt(squared)
        upright = squared <= UPRIGHT
        return (
            dr.select(upright, Float(0), dr.clip(v.y * inverse, -1, 1)),
            dr.select(upright, Float(1), dr.clip(v.x * inverse, -1, 1)),
        )

    @staticmethod
    def sin_phi_2(v: Vector3f) -> Float:
        """The square of the sine of the azimuth."""
        return Frame3f.sincos_phi_2(v)[0]

    @staticmethod
    def cos_phi_2(v: Vector3f) -> Float:
        """The square of the cosine of the azimuth."""
        return Frame3f.sincos_phi_2(v)[1]

    @staticmethod
    def sincos_phi_2(v: Vector3f) -> tuple[Float, Float]:
        """The squares of sine and cosine of the azimuth."""
        v = as_vector(v)
        squared = Frame3f.sin_theta_2(v)
        upright = squared <= UPRIGHT
        return (
            dr.select(upright, Float(0), dr.minimum(dr.square(v.y) / squared, 1)),
            dr.select(upright, Float(1), dr.minimum(dr.square(v.x) / squared, 1)),
        )

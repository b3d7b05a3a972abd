"""Keyframes: transforms at some times, and their interpolation in kernels and on the host.

A keyframe is taken apart into x -> R S x + T: S scales along the axes, R turns, T moves. Between keyframes scale and
translation are linear, and the rotation follows the shortest way at constant speed (K. Shoemake, "Animating Rotation
with Quaternion Curves", SIGGRAPH 1985). Before the first keyframe and after the last one nothing moves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms.host import ScalarTransform4f
from djpt.errors import SceneError
from djpt.jit.kernels import as_float, float_in, own_copy
from djpt.jit.types import ArrayXu, Float, Matrix4f, Point3f, UInt32, Vector3f

__all__ = ["Keyframes", "MotionTable", "Placement"]

Doubles = NDArray[np.float64]

SHEAR = 1e-4
"""The largest cosine between axes that are taken for perpendicular."""
SLICES = 16
"""The parts of the time between two keyframes for which bounds are computed."""
WORDS = 32
"""The words of a segment in the table of kernels: a power of two, so that one load reads them."""


@dataclass
class Placement:
    """The map x -> R S x + T from the own space of what moves to the world at a time; one per lane."""

    x: Vector3f
    """The image of the x axis under R: the first column."""
    y: Vector3f
    z: Vector3f
    scale: Vector3f
    """The diagonal of S."""
    origin: Point3f
    """T."""

    def point(self, p: Any) -> Point3f:
        """A point of the own space in the world."""
        return self.vector(p) + self.origin

    def vector(self, v: Any) -> Vector3f:
        """A vector of the own space in the world."""
        s = self.scale
        return dr.fma(self.x, v.x * s.x, dr.fma(self.y, v.y * s.y, self.z * (v.z * s.z)))

    def normal(self, n: Any) -> Vector3f:
        """The unit normal in the world."""
        s = self.scale
        turned = dr.fma(self.x, n.x / s.x, dr.fma(self.y, n.y / s.y, self.z * (n.z / s.z)))
        return turned * dr.rsqrt(dr.squared_norm(turned))

    def own_point(self, p: Any) -> Point3f:
        """A point of the world in the own space."""
        return self.own_vector(p - self.origin)

    def own_vector(self, v: Any) -> Vector3f:
        """A vector of the world in the own space."""
        return Vector3f(dr.dot(self.x, v), dr.dot(self.y, v), dr.dot(self.z, v)) / self.scale

    def own_normal(self, n: Any) -> Vector3f:
        """The unit normal in the own space."""
        turned = Vector3f(dr.dot(self.x, n), dr.dot(self.y, n), dr.dot(self.z, n)) * self.scale
        return turned * dr.rsqrt(dr.squared_norm(turned))

    @classmethod
    def identity(cls) -> Placement:
        """The placement of what stays."""
        x, y, z = (Vector3f(*(float(i == k) for k in range(3))) for i in range(3))
        return cls(x, y, z, Vector3f(1), Point3f(0))

    def turned(self) -> Placement:
        """The placement about the origin: of what is infinitely far away."""
        return Placement(self.x, self.y, self.z, self.scale, Point3f(0))

    def matrix(self) -> Matrix4f:
        """The map as a matrix."""
        columns = (self.x * self.scale.x, self.y * self.scale.y, self.z * self.scale.z, self.origin)
        return Matrix4f([[column[i] for column in columns] for i in range(3)] + [[0, 0, 0, 1]])


def placement_of(quaternion: Sequence[Float], scale: Vector3f, origin: Point3f) -> Placement:
    """The placement that turns by a unit quaternion (x, y, z, w)."""
    a, b, c, w = quaternion
    return Placement(
        Vector3f(1 - 2 * (b * b + c * c), 2 * (a * b + c * w), 2 * (a * c - b * w)),
        Vector3f(2 * (a * b - c * w), 1 - 2 * (a * a + c * c), 2 * (b * c + a * w)),
        Vector3f(2 * (a * c + b * w), 2 * (b * c - a * w), 1 - 2 * (a * a + b * b)),
        scale,
        origin,
    )


@dataclass(frozen=True)
class Keyframes:
    """Transforms at some times, taken apart: arrays of doubles on the host."""

    times: Doubles
    """(N,), ascending, N >= 2."""
    scale: Doubles
    """(N, 3)."""
    rotation: Doubles
    """(N, 4): unit quaternions (x, y, z, w), each on the side of the one before."""
    translation: Doubles
    """(N, 3)."""

    @classmethod
    def of(cls, pairs: Sequence[tuple[float, ScalarTransform4f]]) -> Keyframes:
        """The keyframes of transforms at times, in any order.

        Raises:
            SceneError: There are fewer than two, two of one time, or a transform shears.
        """
        pairs = sorted(pairs, key=lambda pair: pair[0])
        parts = [decomposed(transform.matrix, time) for time, transform in pairs]
        times = np.array([time for time, _ in pairs], np.float64)
        rows = [np.array(column, np.float64) for column in zip(*parts, strict=True)] or [np.zeros(0)] * 3
        return cls.checked(times, rows[0], rows[1], rows[2])

    @classmethod
    def checked(cls, times: Doubles, scale: Doubles, rotation: Doubles, translation: Doubles) -> Keyframes:
        """The keyframes of parts, which are sorted by time; quaternions are normalised.

        Raises:
            SceneError: The parts don't fit together, or can't be interpolated.
        """
        count = len(times)
        if count < 2:
            raise SceneError(f"an animation needs at least two keyframes, found {count}")
        for name, part, width in (("scale", scale, 3), ("rotation", rotation, 4), ("translation", translation, 3)):
            if part.shape != (count, width):
                raise SceneError(f"{count} keyframes need {count} x {width} numbers of '{name}', found {part.shape}")
        order = np.argsort(times, kind="stable")
        times, scale, rotation, translation = times[order], scale[order], rotation[order], translation[order]
        if not (np.diff(times) > 0).all():
            found = float(times[int(np.argmin(np.diff(times)))])
            raise SceneError(f"two keyframes have the same time {found:g}")
        lengths = np.linalg.norm(rotation, axis=1)
        if not (lengths > 1e-6).all():
            raise SceneError("a rotation is a quaternion (x, y, z, w) that isn't 0")
        if (scale == 0).any() or (np.sign(scale) != np.sign(scale[0])).any():
            raise SceneError("scales of keyframes must not be 0, nor change their sign on the way")
        rotation = rotation / lengths[:, None]
        for i in range(1, count):
            if rotation[i] @ rotation[i - 1] < 0:
                rotation[i] = -rotation[i]
        return cls(times, scale, rotation, translation)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Keyframes):
            return NotImplemented
        mine, theirs = ((k.times, k.scale, k.rotation, k.translation) for k in (self, other))
        return all(np.array_equal(a, b) for a, b in zip(mine, theirs, strict=True))

    __hash__ = None  # type: ignore[assignment]

    # ---- on the host -------------------------------------------------------------------

    def at(self, time: float) -> ScalarTransform4f:
        """The transform at a time."""
        k = int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 2))
        u = float(np.clip((time - self.times[k]) / (self.times[k + 1] - self.times[k]), 0, 1))
        first, onward, angle = self._arc(k)
        matrix = np.eye(4)
        turn = rotation_matrix(np.cos(u * angle) * first + np.sin(u * angle) * onward)
        matrix[:3, :3] = turn * ((1 - u) * self.scale[k] + u * self.scale[k + 1])
        matrix[:3, 3] = (1 - u) * self.translation[k] + u * self.translation[k + 1]
        return ScalarTransform4f(matrix)

    def _arc(self, k: int) -> tuple[Doubles, Doubles, float]:
        """The quaternions q, r and the angle a of a segment, whose rotation at u is q cos(u a) + r sin(u a)."""
        first, last = self.rotation[k], self.rotation[k + 1]
        rest = last - (last @ first) * first
        sine = float(np.linalg.norm(rest))
        angle = float(np.arctan2(sine, last @ first))
        return first, rest / sine if sine > 1e-12 else np.zeros(4), angle

    @property
    def is_rigid(self) -> bool:
        """Whether no keyframe scales."""
        return bool((np.abs(np.abs(self.scale) - 1) < 1e-3).all())

    @property
    def is_similar(self) -> bool:
        """Whether all keyframes scale alike along all axes."""
        return bool((np.ptp(self.scale, axis=1) <= 1e-4 * np.abs(self.scale).max(axis=1)).all())

    @property
    def is_unmirrored(self) -> bool:
        """Whether no keyframe mirrors."""
        return bool((self.scale > 0).all())

    @property
    def turns(self) -> bool:
        """Whether the rotation changes."""
        return bool((np.abs(self.rotation - self.rotation[0]) > 1e-7).any())

    def box(self, low: Doubles, high: Doubles) -> tuple[Doubles, Doubles]:
        """The corners of a box that holds a box of the own space at all times.

        Between two moments a corner p(u), u from 0 to 1, leaves its chord by at most the maximum of `|p''| / 8`, and
        `|p''| <= a^2 |S x| + 2 a |S' x|`, with the angle a that the rotation turns by.
        """
        corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        least, most = np.full(3, np.inf), np.full(3, -np.inf)
        for k in range(len(self.times) - 1):
            at = np.linspace(self.times[k], self.times[k + 1], SLICES + 1)
            placed = np.array([self.at(float(time)).transform_point(corners) for time in at])
            angle = 2 * self._arc(k)[2] / SLICES
            sizes = np.abs(corners) * np.maximum(np.abs(self.scale[k]), np.abs(self.scale[k + 1]))
            growth = np.abs(corners * (self.scale[k + 1] - self.scale[k])) / SLICES
            beyond = np.linalg.norm(sizes, axis=1) * angle**2 / 8 + np.linalg.norm(growth, axis=1) * angle / 4
            least = np.minimum(least, (placed - beyond[:, None]).min(axis=(0, 1)))
            most = np.maximum(most, (placed + beyond[:, None]).max(axis=(0, 1)))
        return least, most

    def moments(self) -> Doubles:
        """Times at which to look where things are: several between keyframes."""
        steps = [np.linspace(a, b, 5)[:-1] for a, b in zip(self.times, self.times[1:], strict=False)]
        return np.append(np.concatenate(steps), self.times[-1])

    # ---- for kernels -------------------------------------------------------------------

    def rows(self) -> Doubles:
        """The segments for kernels, (N - 1, 23): start, inverse duration, q, r, a, and S, dS, T, dT."""
        rows = []
        for k in range(len(self.times) - 1):
            first, onward, angle = self._arc(k)
            rows.append(
                [
                    *(self.times[k], 1 / (self.times[k + 1] - self.times[k]), *first, *onward, angle),
                    *(*self.scale[k], *(self.scale[k + 1] - self.scale[k])),
                    *(*self.translation[k], *(self.translation[k + 1] - self.translation[k])),
                ]
            )
        return np.array(rows)


class MotionTable:
    """Keyframes as kernels read them: inputs of width 1 of one segment, a table of several."""

    def __init__(self, *motions: Keyframes) -> None:
        """The table of one motion, or of several, which are asked for by number."""
        parts = [keyframes.rows() for keyframes in motions]
        rows, counts = np.concatenate(parts), [len(part) for part in parts]
        self._count, self._is_one = max(counts), len(rows) == 1
        if self._is_one:
            self._row = [as_float(number) for number in rows[0]]
            return
        padded = np.zeros((len(rows), WORDS), np.float32)
        padded[:, : rows.shape[1]] = rows
        ends = np.cumsum(counts).astype(np.uint32)
        self._table, self._last = own_copy(padded), own_copy(ends - 1)
        self._first = None if len(motions) == 1 else own_copy(ends - np.array(counts, np.uint32))
        self._starts = Float(rows[:, 0].astype(np.float32))
        dr.make_opaque(self._starts)

    def at(self, time: Float, number: UInt32 | None = None) -> Placement:
        """The placement at a time, per lane, by the motion of a number if there are several."""
        row = self._row if self._is_one else self._found(time, number)
        start, inverse, angle = row[0], row[1], row[10]
        u = dr.clip((time - start) * inverse, 0, 1)
        sine, cosine = dr.sincos(u * angle)
        quaternion = [dr.fma(q, cosine, r * sine) for q, r in zip(row[2:6], row[6:10], strict=True)]
        s, ds, t, dt = (row[k : k + 3] for k in (11, 14, 17, 20))
        scale = Vector3f(*(dr.fma(b, u, a) for a, b in zip(s, ds, strict=True)))
        origin = Point3f(*(dr.fma(b, u, a) for a, b in zip(t, dt, strict=True)))
        return placement_of(quaternion, scale, origin)

    def _found(self, time: Float, number: UInt32 | None) -> list[Float]:
        """The row of the segment that a time lies in."""
        # The first segment counts also before it begins.
        steps = (self._count - 1).bit_length()
        below, last = UInt32(0), self._last
        if self._first is not None and number is not None:
            below, last = (dr.gather(UInt32, numbers, number) for numbers in (self._first, self._last))
        for k in reversed(range(steps)):
            probe = below + (1 << k)
            inside = probe <= last
            start = dr.gather(Float, self._starts, probe, inside)
            below = dr.select(inside & (start <= time), probe, below)
        half = WORDS // 2
        words: list[Any] = []
        for part in (0, 1):
            words += list(dr.gather(ArrayXu, self._table, 2 * below + part, shape=(half, 1)))
        return [float_in(word) for word in words]


def attached_placement(
    time: float, times: Sequence[float], part: Callable[[str, int], list[Float]], moment: Float | None = None
) -> Placement:
    """The placement at one moment, attached to the keyframes around it, and to the time if `moment` gives it.

    `part(name, k)` are the numbers of a part (`times`, `scale`, `rotation`, `translation`) at keyframe k.
    """
    k = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2))
    (start,), (end,) = part("times", k), part("times", k + 1)
    u = dr.clip(((Float(time) if moment is None else moment) - start) / (end - start), 0, 1)
    q, r = part("rotation", k), part("rotation", k + 1)
    q, r = ([x * dr.rsqrt(sum(y * y for y in p)) for x in p] for p in (q, r))
    cosine = sum(a * b for a, b in zip(q, r, strict=True))
    sign = dr.select(dr.detach(cosine) < 0, Float(-1), 1)
    r, cosine = [sign * x for x in r], sign * cosine
    # By the chord: asin is smooth where the angle is 0, acos isn't.
    chord = [b - a for a, b in zip(q, r, strict=True)]
    half = 0.5 * dr.safe_sqrt(sum(c * c for c in chord) + 1e-24)
    angle = 2 * dr.safe_asin(half)
    inverse = dr.rcp(dr.sin(angle))
    apart = dr.detach(angle) > 1e-4
    first, last = (
        dr.select(apart, dr.sin((1 - u) * angle) * inverse, 1 - u),
        dr.select(apart, dr.sin(u * angle) * inverse, u),
    )
    mixed = [first * a + last * b for a, b in zip(q, r, strict=True)]
    length = dr.rsqrt(sum(x * x for x in mixed))

    def between(name: str) -> Vector3f:
        a, b = (Vector3f(*part(name, i)) for i in (k, k + 1))
        return a + (b - a) * u

    return placement_of([x * length for x in mixed], between("scale"), Point3f(between("translation")))


# ---- matrices and their parts --------------------------------------------------------------------------------------


def decomposed(matrix: Doubles, time: float) -> tuple[Doubles, Doubles, Doubles]:
    """Scale, quaternion and translation of a matrix; a mirroring one scales by negative numbers.

    Raises:
        SceneError: It shears.
    """
    linear = matrix[:3, :3]
    scale = np.linalg.norm(linear, axis=0)
    if not (scale > 0).all():
        raise SceneError(f"the keyframe at {time:g} is singular: it flattens what it moves")
    axes = linear / scale
    if (np.abs(axes.T @ axes - np.eye(3)) > SHEAR).any():
        raise SceneError(f"the keyframe at {time:g} must not contain shear: its axes aren't perpendicular")
    if np.linalg.det(axes) < 0:
        scale, axes = -scale, -axes
    return scale, quaternion_of(axes), matrix[:3, 3].copy()


def quaternion_of(turn: Doubles) -> Doubles:
    """The unit quaternion (x, y, z, w) of a rotation matrix: the eigenvector of K for the eigenvalue 1.

    (I. Bar-Itzhack, "New Method for Extracting the Quaternion from a Rotation Matrix", 2000.)
    """
    (a, b, c), (d, e, f), (g, h, i) = turn
    k = np.array(
        [
            [a - e - i, b + d, c + g, h - f],
            [b + d, e - a - i, f + h, c - g],
            [c + g, f + h, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    _, vectors = np.linalg.eigh(k / 3)
    q: Doubles = vectors[:, -1]
    return q if q[3] >= 0 else -q


def rotation_matrix(q: Doubles) -> Doubles:
    """The rotation matrix of a unit quaternion (x, y, z, w)."""
    a, b, c, w = q
    return np.array(
        [
            [1 - 2 * (b * b + c * c), 2 * (a * b - c * w), 2 * (a * c + b * w)],
            [2 * (a * b + c * w), 1 - 2 * (a * a + c * c), 2 * (b * c - a * w)],
            [2 * (a * c - b * w), 2 * (b * c + a * w), 1 - 2 * (a * a + b * b)],
        ]
    )

"""Tracks: the value of a parameter at each moment of an animation, interpolated between given values."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.apps.orbit import OrbitCamera
from djpt.core.transforms import ScalarTransform4f
from djpt.core.transforms.base import about_axis
from djpt.errors import ParameterError

__all__ = ["Track", "TurningCamera"]

Doubles = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Track:
    """The values of a parameter at some frames, its keyframes: interpolated between them, constant beyond them.

    Numbers and vectors are interpolated linearly, transforms by their parts: translation and stretch linearly, rotation
    at constant speed along the shortest way (K. Shoemake, "Animating Rotation with Quaternion Curves", 1985), the parts
    by polar decomposition (Shoemake and Duff, "Matrix Animation and Polar Decomposition", 1992).
    """

    frames: tuple[float, ...]
    """Frames in ascending order, counted from 0; they need not be whole."""
    values: Doubles
    """The values there: (keyframes, n) for n numbers, (keyframes, 4, 4) for transforms."""

    @classmethod
    def of(cls, keyframes: Mapping[float, Any]) -> Track:
        """The track through values by frame: numbers, lists of numbers, or transforms.

        Raises:
            ParameterError: There are no keyframes, or their values can't be interpolated.
        """
        frames = sorted(keyframes)
        values = [getattr(keyframes[frame], "matrix", keyframes[frame]) for frame in frames]
        try:
            rows = np.array([np.atleast_1d(np.asarray(value, np.float64)) for value in values])
        except (TypeError, ValueError):
            rows = np.zeros((0,))
        if rows.shape[1:] == (16,):
            rows = rows.reshape(-1, 4, 4)
        if not frames or not (rows.ndim == 2 or rows.shape[1:] == (4, 4)) or not np.isfinite(rows).all():
            raise ParameterError(
                "keyframes must be one number, several, or the 16 of a transform, the same count at each frame; found "
                f"{dict(keyframes)!r}"
            )
        if not all(math.isfinite(frame) for frame in frames):
            raise ParameterError(f"keyframes must be at finite frames, found {frames}")
        if rows.ndim == 3 and np.any(np.linalg.det(rows[:, :3, :3]) * np.linalg.det(rows[0, :3, :3]) <= 0):
            raise ParameterError("transforms of a track must be invertible, and either all or none of them mirrored")
        return cls(tuple(float(frame) for frame in frames), rows)

    @classmethod
    def parse(cls, text: str) -> Track:
        """The track of a text ``FRAME:VALUE;FRAME:VALUE;...``, each value one number or several, separated by commas.

        Raises:
            ParameterError: The text isn't such a list.
        """
        keyframes: dict[float, list[float]] = {}
        for part in filter(None, re.split(r"\s*;\s*", text.strip())):
            frame, colon, value = part.partition(":")
            try:
                at, numbers = float(frame), [float(x) for x in value.split(",")]
            except ValueError:
                colon = ""
            if not colon or at in keyframes:
                raise ParameterError(
                    f"keyframes are FRAME:VALUE;FRAME:VALUE, such as 0:0.5;30:1 or 0:1,0,0;30:0,0,1; found '{text}'"
                )
            keyframes[at] = numbers
        return cls.of(keyframes)

    def at(self, frame: float) -> float | list[float] | ScalarTransform4f:
        """The parameter's value at a frame, whole or not."""
        after = int(np.searchsorted(self.frames, frame, side="right"))
        if after == 0 or after == len(self.frames):
            value = self.values[0 if after == 0 else -1]
        else:
            start, end = self.frames[after - 1], self.frames[after]
            value = between(self.values[after - 1], self.values[after], (frame - start) / (end - start))
        if value.ndim == 2:
            return ScalarTransform4f(value)
        return float(value[0]) if len(value) == 1 else [float(x) for x in value]


@dataclass(frozen=True)
class TurningCamera:
    """A camera that orbits its target at constant speed: the track of its transform."""

    camera: OrbitCamera
    """The camera at frame 0."""
    degrees: float
    """The angle from frame to frame, to the right as seen through the camera, in degrees."""

    def at(self, frame: float) -> ScalarTransform4f:
        """The camera's transform at a frame."""
        return ScalarTransform4f(self.camera.turned(math.radians(self.degrees * frame), 0.0).to_world)


# ---- between two values -----------------------------------------------------------------------


def between(a: Doubles, b: Doubles, share: float) -> Doubles:
    """The interpolated value: `a` for a share of 0, `b` for 1."""
    if a.ndim == 1:
        return (1 - share) * a + share * b
    (turn_a, stretch_a), (turn_b, stretch_b) = polar(a[:3, :3]), polar(b[:3, :3])
    result = (1 - share) * a + share * b
    turn = turn_a @ turned_part(turn_a.T @ turn_b, share)
    result[:3, :3] = turn @ ((1 - share) * stretch_a + share * stretch_b)
    return result


def polar(matrix: Doubles) -> tuple[Doubles, Doubles]:
    """A matrix as rotation times stretch; a reflection becomes part of the stretch."""
    u, s, v = np.linalg.svd(matrix)
    sign = np.sign(np.linalg.det(u @ v))
    return sign * (u @ v), sign * (v.T @ np.diag(s) @ v)


def turned_part(rotation: Doubles, share: float) -> Doubles:
    """The rotation by a fraction of a rotation's angle, about the same axis."""
    angle = math.acos(float(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))
    if angle < 1e-9:
        return np.eye(3)
    if angle > math.pi - 1e-6:
        # Half a turn: the axis is the eigenvector of 1.
        values, vectors = np.linalg.eigh((rotation + rotation.T) / 2)
        axis = vectors[:, int(np.argmax(values))]
    else:
        swirl = np.array(
            [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
        )
        axis = swirl / np.linalg.norm(swirl)
    return about_axis(axis, share * angle)

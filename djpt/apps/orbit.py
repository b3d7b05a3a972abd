"""A camera that moves about what it looks at: around it, sideways, to and fro."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.core.records import Ray3f
from djpt.core.transforms.base import about_axis
from djpt.jit.types import Point3f, Vector3f

if TYPE_CHECKING:
    from djpt.scene.scene import Scene
    from djpt.sensors.base import Sensor

__all__ = ["OrbitCamera"]

Matrix = npt.NDArray[np.float64]

STEEPEST = math.radians(89)
"""The angle to the horizon up to which a camera can be turned; beyond it the picture would tip over."""


@dataclass(frozen=True)
class OrbitCamera:
    """The place of a camera, and the point about which it turns.

    Movements are rigid motions of the matrix that the scene gave, so a mirrored picture stays mirrored.
    """

    to_world: Matrix
    """From camera space, which looks along +z with +y up, to world space, (4, 4)."""
    target: Matrix
    """The point about which the camera turns, (3,)."""
    up: Matrix
    """The unit vector of the world that stands upright in pictures, (3,)."""

    @classmethod
    def facing(cls, to_world: npt.ArrayLike, distance: float) -> OrbitCamera:
        """The camera at `to_world`, which turns about a point ahead; the axis of the world nearest to its up is up."""
        matrix = np.array(to_world, np.float64)
        upward = matrix[:3, 1]
        axis = int(np.argmax(np.abs(upward)))
        up = np.zeros(3)
        up[axis] = math.copysign(1.0, upward[axis])
        return cls(matrix, matrix[:3, 3] + distance * unit(matrix[:3, 2]), up)

    @classmethod
    def of(cls, scene: Scene, sensor: Sensor) -> OrbitCamera:
        """A camera of a scene; it turns about what is in the middle of its picture, or else of the scene."""
        to_world = np.array(sensor.world_transform().matrix, np.float64)
        origin, ahead = to_world[:3, 3], unit(to_world[:3, 2])
        hit = scene.ray_intersect(Ray3f(Point3f(origin.tolist()), Vector3f(ahead.tolist())))
        distance = float(dr.select(hit.is_valid(), hit.t, 0)[0])
        if not distance:
            center, radius = scene.bounding_sphere()
            distance = max(float((np.asarray(center) - origin) @ ahead), 0.1 * float(radius)) or 1.0
        return cls.facing(to_world, distance)

    @property
    def distance(self) -> float:
        """The distance from the camera to the point about which it turns."""
        return float(np.linalg.norm(self.target - self.to_world[:3, 3]))

    def turned(self, yaw: float, pitch: float) -> OrbitCamera:
        """The camera after a turn about its target: about the upright axis, then up or down, in radians."""
        ahead = unit(self.to_world[:3, 2])
        elevation = math.asin(float(np.clip(ahead @ self.up, -1, 1)))
        limit = max(STEEPEST, abs(elevation))
        pitch = float(np.clip(elevation + pitch, -limit, limit)) - elevation
        # The axis of a rotation that lifts the view by a positive angle.
        side = np.cross(ahead, self.up)
        if np.linalg.norm(side) < 1e-6:
            side = self.to_world[:3, 0]
        return self.moved(about(self.target, self.up, yaw) @ about(self.target, unit(side), pitch))

    def shifted(self, right: float, upward: float) -> OrbitCamera:
        """The camera and its target moved in the plane of the picture, in units of the scene."""
        across, ahead = unit(self.to_world[:3, 1]), unit(self.to_world[:3, 2])
        offset = right * np.cross(ahead, across) + upward * across
        motion = np.eye(4)
        motion[:3, 3] = offset
        return replace(self.moved(motion), target=self.target + offset)

    def approached(self, factor: float) -> OrbitCamera:
        """The camera at `factor` times the distance to its target."""
        motion = np.eye(4)
        motion[:3, 3] = (1 - factor) * (self.target - self.to_world[:3, 3])
        return self.moved(motion)

    def scaled(self, factor: float) -> OrbitCamera:
        """The camera with a picture of `factor` times the width and height, for cameras without perspective."""
        return replace(self, to_world=self.to_world @ np.diag([factor, factor, 1.0, 1.0]))

    def moved(self, motion: Matrix) -> OrbitCamera:
        """The camera after a motion of the world's points, about the same target."""
        return replace(self, to_world=motion @ self.to_world)


def unit(v: Matrix) -> Matrix:
    """The vector of length 1 in the direction of `v`."""
    return v / np.linalg.norm(v)


def about(point: Matrix, axis: Matrix, angle: float) -> Matrix:
    """The rotation by `angle` radians about an axis of length 1 through a point, (4, 4)."""
    result = np.eye(4)
    result[:3, :3] = about_axis(axis, angle)
    result[:3, 3] = point - result[:3, :3] @ point
    return result

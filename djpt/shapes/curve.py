"""The base of curves: files of control points, parameters, extent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import as_array
from djpt.core.transforms import ScalarTransform4f
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.errors import ParameterError, SceneError
from djpt.jit.kernels import own_copy, own_floats
from djpt.shapes.base import Shape
from djpt.shapes.curve_segments import CurveSegments
from djpt.shapes.mesh import MeshFile

__all__ = ["Curves"]


class Curves(Shape):
    """Many curves with a radius along them, which stand in the scene's BVH piece by piece.

    They are visible only from outside: rays pass through their surface from within. They can't shine, since no points
    can be drawn on them. A file has a control point per line, x y z and a radius; empty lines are between curves.
    `to_world` moves the points as the file is read and leaves the radii as they are.
    """

    has_area = False
    in_pieces = True
    canonical = "piece"
    points_parameter = "control_points"
    least_points: ClassVar[int]
    """The fewest control points of a curve, whose first segment they are."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        if self.flip_normals:
            raise props.error("flip_normals", "can't be true: curves are visible only from outside")
        if self._emitter is not None:
            raise SceneError(f"{props.node}: curves can't emit light: points can't be sampled on them")
        path = MeshFile.find(props)
        where = f"{props.node}: {path.name}"
        points, lengths = read_curves(MeshFile.load(props, path), where)
        for curve, length in enumerate(lengths):
            if length < self.least_points:
                raise SceneError(f"{where}: curve {curve} has {length} control points; {self.least_points} are needed")
        matrix = self.to_world.matrix
        points[:, :3] = points[:, :3] @ matrix[:3, :3].T + matrix[:3, 3]
        # Instances of curves set this for copies: a map from the space of the points, radii included.
        self.to_world = ScalarTransform4f()
        self.points = points.astype(np.float32)
        """The control points, (N, 4) float32: place in world space, and radius."""
        ends = np.cumsum(lengths)
        own = [np.arange(end - length, end - self.least_points + 1) for end, length in zip(ends, lengths, strict=True)]
        self.segments = np.concatenate(own).astype(np.uint32)
        """The first control point of each segment."""
        self.begins = np.cumsum([0, *(len(segments) for segments in own)]).astype(np.uint32)
        """The first segment of each curve, and the number of all."""
        self.curve_count = len(own)
        self.control_point_count = len(self.points)
        self.tabulate()

    def tabulate(self) -> None:
        """Make the arrays that kernels read, from the points on the host."""
        self.control_points: Any = own_floats(self.points)
        self.segment_indices: Any = own_copy(self.segments)
        self.first_segments: Any = own_copy(self.begins)

    # ---- parameters ------------------------------------------------------------------

    def traverse_geometry(self, callback: TraversalCallback) -> None:
        callback.put(
            "control_point_count", self.control_point_count, ParamFlags.ReadOnly | ParamFlags.NonDifferentiable
        )
        callback.put("segment_indices", self.segment_indices, ParamFlags.ReadOnly | ParamFlags.NonDifferentiable)
        callback.put("control_points", self.control_points, self.motion_flags())

    def parameters_changed(self, keys: Sequence[str]) -> None:
        if "control_points" not in keys:
            return
        try:
            found = as_array(np.array(dr.detach(self.control_points))).reshape(-1, 4)
        except (SceneError, ValueError):
            raise ParameterError(f"{self.id()}.control_points: must be numbers, four for each point") from None
        if len(found) != self.control_point_count:
            raise ParameterError(
                f"{self.id()}.control_points: must be {self.control_point_count} points, found {len(found)}"
            )
        if (found[:, 3] < 0).any():
            raise ParameterError(f"{self.id()}.control_points: radii must be at least 0, found {found[:, 3].min():g}")
        self.points = found.astype(np.float32)

    def attached_parameter(self, name: str, value: Any) -> Any:
        if name != "control_points" or not self.can_be_followed():
            raise ParameterError(f"{self.id()}.{name}: gradients with respect to this parameter aren't available")
        return value

    # ---- on the host -----------------------------------------------------------------

    def placed_points(self) -> NDArray[np.float64]:
        """The control points in world space, (N, 4)."""
        points, linear = self.points.astype(np.float64), self.to_world.matrix[:3, :3]
        points[:, :3] = points[:, :3] @ linear.T + self.to_world.matrix[:3, 3]
        points[:, 3] *= abs(np.linalg.det(linear)) ** (1 / 3)
        return points

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        points = self.placed_points()
        along, reach = points[:, :3] @ direction, points[:, 3] * np.linalg.norm(direction)
        return float((along - reach).min()), float((along + reach).max())

    def pieces(self) -> CurveSegments:
        """The pieces that the curves are cut into, in world space."""
        raise NotImplementedError

    def primitive_count(self) -> int:
        return len(self.segments)


def read_curves(data: bytes, where: str) -> tuple[NDArray[np.float64], list[int]]:
    """The control points (N, 4) in a file, and how many each curve has; `where` names the file in messages.

    Raises:
        SceneError: a line isn't four finite numbers, a radius is negative, or there are no lines.
    """
    points: list[list[float]] = []
    lengths: list[int] = []
    inside = False
    for number, line in enumerate(data.decode(errors="replace").split("\n"), 1):
        words = line.split()
        if not words:
            inside = False
            continue
        try:
            point = [float(word) for word in words[:4]]
        except ValueError:
            point = []
        if len(point) != 4 or not all(np.isfinite(point)) or point[3] < 0:
            # Not what was found: the file may be anything that its owner can read, and the scene a stranger's.
            negative = len(point) == 4 and point[3] < 0
            found = "fewer words" if len(words) < 4 else "a negative radius" if negative else "other words"
            raise SceneError(f"{where}, line {number}: must be x y z and a radius of at least 0, found {found}")
        if not inside:
            lengths.append(0)
            inside = True
        points.append(point)
        lengths[-1] += 1
    if not points:
        raise SceneError(f"{where}: no control points in the file")
    return np.array(points), lengths

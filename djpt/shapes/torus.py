"""The torus."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from djpt.core.warp import turns
from djpt.description.plugin import HIDDEN, ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_shape
from djpt.errors import ParameterError
from djpt.jit.kernels import as_float, as_vector
from djpt.jit.types import Float, Point2f, Point3f, Vector3f
from djpt.shapes.axes import AxisPool
from djpt.shapes.level_set import PLACE, LevelSet

if TYPE_CHECKING:
    from djpt.shapes.silhouettes.base import Silhouette

__all__ = ["Torus"]


class Torus(LevelSet):
    """All points at distance `minor` from a circle of radius `major` around the local z axis.

    Parameters: `major` (default 1), `minor` (default 0.25, less than `major`), `to_world` (affine), `flip_normals`.
    uv = (phi / 2 pi, psi / 2 pi): phi is the angle around the axis, psi that around the circle, from the outermost
    points (psi = 0) to those farthest up the axis (psi = pi / 2).
    """

    in_any_frame = True
    values = dict.fromkeys((*PLACE, "edge_x", "edge_y", "edge_z", "major", "minor"), HIDDEN)
    statics = ("flip_normals",)
    slope = 1.0

    edge_x: Vector3f
    """Where `to_world` takes the x axis."""
    edge_y: Vector3f
    edge_z: Vector3f

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.major = as_float(props.float("major", 1.0, low=0.0, low_open=True))
        self.minor = as_float(props.float("minor", 0.25, low=0.0, low_open=True))
        major, minor = self._radii()
        if minor >= major:
            raise props.error("minor", f"must be less than 'major', found {minor:g} and {major:g}")

    def _radii(self) -> tuple[float, float]:
        return float(self.major[0]), float(self.minor[0])

    def traverse_geometry(self, callback: TraversalCallback) -> None:
        callback.put("major", self.major, ParamFlags.NonDifferentiable)
        callback.put("minor", self.minor, ParamFlags.NonDifferentiable)
        super().traverse_geometry(callback)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        major, minor = self._radii()
        if not 0 < minor < major:
            raise ParameterError(f"{self.id()}: needs 0 < minor < major, found minor {minor:g}, major {major:g}")

    # ---- on the host ---------------------------------------------------------------

    def place(self, pool: AxisPool) -> None:
        major, minor = self._radii()
        # A margin, so that rounding of the box doesn't cut the surface.
        high = 1.0001 * np.array([major + minor, major + minor, minor])
        self.box, self.reach = (-high, high), float(high[0])
        self.edge_x, self.edge_y, self.edge_z = (as_vector(edge) for edge in self.to_world.matrix[:3, :3].T)
        super().place(pool)

    # ---- in kernels ----------------------------------------------------------------

    def field(self, p: Point3f) -> Float:
        around = dr.sqrt(dr.fma(p.x, p.x, dr.square(p.y))) - self.major
        return dr.sqrt(dr.fma(around, around, dr.square(p.z))) - self.minor

    def normal_at(self, p: Point3f) -> Vector3f:
        local = self.local_point(p)
        across = 1 - self.major * dr.rsqrt(dr.fma(local.x, local.x, dr.square(local.y)))
        n = dr.normalize(self.normal_to_world(Vector3f(local.x * across, local.y * across, local.z)))
        return -n if self.flip_normals else n

    def uv(self, p: Point3f) -> Point2f:
        return self.local_uv(self.local_point(p))

    def local_uv(self, p: Point3f) -> Point2f:
        """The texture coordinates of a local point."""
        return Point2f(turns(p.y, p.x), turns(p.z, dr.norm(Point2f(p.x, p.y)) - self.major))

    def partials(self, p: Point3f) -> tuple[Vector3f, Vector3f]:
        local = self.local_point(p)
        rim = dr.norm(Point2f(local.x, local.y))
        rise = local.z * dr.rcp(rim)
        du, dv = Vector3f(-local.y, local.x, 0), Vector3f(-local.x * rise, -local.y * rise, rim - self.major)
        return 2 * math.pi * self.to_world_vector(du), 2 * math.pi * self.to_world_vector(dv)

    def to_world_vector(self, v: Vector3f) -> Vector3f:
        """Map a local vector to the world."""
        return self.edge_x * v.x + self.edge_y * v.y + self.edge_z * v.z

    def silhouette_class(self) -> type[Silhouette] | None:
        from djpt.shapes.silhouettes.torus import TorusSilhouette

        return TorusSilhouette


register_shape("torus", Torus)

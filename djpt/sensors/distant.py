"""The distant sensor: light that leaves the scene in one direction."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import Ray3f
from djpt.core.warp import square_to_uniform_disk_concentric
from djpt.description.plugin import ParamFlags, Plugin, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_sensor
from djpt.jit.kernels import as_vector
from djpt.jit.types import Bool, Point2f
from djpt.sensors.base import Sensor
from djpt.sensors.placement import look_along, placed_apart, require_area

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["Distant"]


class Distant(Sensor):
    """A meter of the radiance that leaves the scene against `direction`, averaged over the target: a satellite's view.

    Rays are parallel and start outside of the scene, c and r being the centre and radius of its bounding sphere:

        no target:  o = c - r d + r (offset on the unit disk across d)    the cross-section of the sphere
        a target:   o = p - 2 r d                                         p: the point, or one drawn on the shape

    Rays that miss everything count, too: without a target the mean is over the whole cross-section.

    Parameters, besides those of all sensors: `to_world` (it looks along +z; its place doesn't matter), or else
    `direction` (of the rays: towards the scene); `target` (a point, or a nested shape, which needn't be part of
    the scene; default: none). The film has one pixel.
    """

    one_pixel = True
    uses_aperture = True
    can_move = False
    values: ClassVar[Mapping[str, ParamFlags]] = dict.fromkeys(
        ("direction", "origin", "side_x", "side_y"), ParamFlags.NonDifferentiable
    )
    children = ("target",)
    statics = ("on_disk", "meshes")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        if "direction" in props:
            if "to_world" in props:
                raise props.error("direction", "can't be given together with 'to_world'")
            self.to_world = look_along(props, np.zeros(3))
        self._shape: Any = None
        self._point: NDArray[np.float64] | None = None
        if "target" in props:
            if isinstance(props.raw("target"), Plugin):
                self._shape = props.plugin("target", "shape")
                require_area(self._shape, "distant")
            else:
                self._point = props.vector("target")
        self.on_disk = "target" not in props
        self.target: Any = None
        self._center, self._radius = np.zeros(3), 1.0
        self.set_bounds(self._center, self._radius)

    @property
    def meshes(self) -> Hashable:
        """The tables that a mesh is drawn from: instances with different ones are traced apart."""
        return id(self.target.set) if self.target is not None and self.target.of_triangles else None

    def traverse(self, callback: TraversalCallback) -> None:
        super().traverse(callback)
        callback.put("to_world", self.to_world)

    def viewpoint(self) -> None:
        return None

    def move_into(self, frame: Frame) -> None:
        self.move_nested(frame)
        self._shape = frame.copy_of(self._shape)
        if self._point is not None:
            self._point = frame.point(self._point)
        # What is nested follows as soon as the sensor is told how large the scene is.

    def set_bounds(self, center: NDArray[np.float64], radius: float) -> None:
        self._center, self._radius = center, radius
        # The scene calls this whenever shapes have moved, and the target may be one of them.
        if self._shape is not None:
            self.target = placed_apart(self._shape)
        self.parameters_changed(())

    def parameters_changed(self, keys: Sequence[str]) -> None:
        x, y, z = self.to_world.matrix[:3, :3].T
        r = self._radius
        if self.on_disk:
            origin = self._center - r * z
        else:
            origin = (np.zeros(3) if self._point is None else self._point) - 2 * r * z
        self.origin, self.direction = as_vector(origin), as_vector(z)
        self.side_x, self.side_y = as_vector(r * x), as_vector(r * y)

    def ray_through(self, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True) -> Ray3f:
        o = self.origin
        if self.target is not None:
            o = o + self.target.draw_point(aperture_sample).p
        elif self.on_disk:
            offset = square_to_uniform_disk_concentric(aperture_sample)
            o = dr.fma(self.side_x, offset.x, dr.fma(self.side_y, offset.y, o))
        return Ray3f(o, self.direction)


register_sensor("distant", Distant)

"""The distant sensor: light that leaves the scene in one direction."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import Ray3f
from djpt.core.transforms.keyframes import Placement
from djpt.core.warp import square_to_uniform_disk_concentric
from djpt.description.plugin import ParamFlags, Plugin, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_sensor
from djpt.jit.kernels import as_float, as_vector
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

    Parameters, besides those of all sensors: `to_world` (it looks along +z; its place doesn't matter, so that of an
    animated one only the rotation counts), or else `direction` (of the rays: towards the scene); `target` (a point, or
    a nested shape, which needn't be part of the scene, and may move; default: none). The film has one pixel.
    """

    one_pixel = True
    uses_aperture = True
    values: ClassVar[Mapping[str, ParamFlags]] = dict.fromkeys(
        ("direction", "origin", "side_x", "side_y", "reach"), ParamFlags.NonDifferentiable
    )
    children = ("target",)
    statics = ("on_disk", "meshes", "target_motion")

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
                self._check_motion(props)
            else:
                self._point = props.vector("target")
        self.on_disk = "target" not in props
        self.target: Any = None
        self._center, self._radius = np.zeros(3), 1.0
        self.set_bounds(self._center, self._radius)

    def _check_motion(self, props: Properties) -> None:
        """Require of a target that moves that points which are uniform by area stay so."""
        if self._shape.deforms:
            raise props.error("target", f"'{self._shape.id()}' deforms: points on it can't be drawn by area")
        if self._shape.motion is not None:
            with props.naming("target"):
                self._shape.motion.demand("similar", "must scale uniformly: the sensor draws points by area")

    @property
    def moves(self) -> bool:
        return self.motion is not None or self.target_motion is not None

    @property
    def target_motion(self) -> Any:
        """The animated transform of the target; None if it stays."""
        return None if self._shape is None else self._shape.motion

    @property
    def meshes(self) -> Hashable:
        """The tables that a mesh is drawn from: instances with different ones are traced apart."""
        return id(self.target.set) if self.target is not None and self.target.of_triangles else None

    def traverse(self, callback: TraversalCallback) -> None:
        super().traverse(callback)
        callback.put("to_world", self.placing)

    def viewpoint(self) -> None:
        return None

    def move_into(self, frame: Frame) -> None:
        self.move_nested(frame)
        self._shape = frame.copy_of(self._shape)
        if self._point is not None:
            self._point = frame.point(self._point)
        # What is nested follows as soon as the sensor is told how large the scene is.

    def hold_copies(self, copy_of: Callable[[Any], Any]) -> None:
        self._shape = copy_of(self._shape)

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
        self.reach = as_float(r if self.on_disk else 2 * r)

    def ray_through(self, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True) -> Ray3f:
        o = self.origin
        if self.target is not None:
            o = o + self.target.draw_point(aperture_sample).p
        elif self.on_disk:
            offset = square_to_uniform_disk_concentric(aperture_sample)
            o = dr.fma(self.side_x, offset.x, dr.fma(self.side_y, offset.y, o))
        return Ray3f(o, self.direction)

    def placed(self, ray: Ray3f, placement: Placement) -> Ray3f:
        # What a ray aims at stays, or moves with the target; only the disk across the rays turns about the centre.
        aim = dr.fma(ray.d, self.reach, ray.o)
        if self.on_disk:
            center = dr.fma(self.direction, self.reach, self.origin)
            aim = placement.vector(aim - center) + center
        elif self.target_motion is not None:
            aim = self.target_motion.placement(ray.time).point(aim)
        d = placement.vector(ray.d)
        result: Ray3f = ray.replaced(o=dr.fma(d, -self.reach, aim), d=d)
        return result


register_sensor("distant", Distant)

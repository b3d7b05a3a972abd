"""The irradiance meter: all light that arrives on a shape."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.frame import Frame3f
from djpt.core.records import RAY_EPSILON, DirectionSample3f, Ray3f
from djpt.core.warp import square_to_cosine_hemisphere
from djpt.description.properties import Properties
from djpt.description.registry import register_sensor
from djpt.jit.types import Bool, Color3f, Float, Point2f
from djpt.sensors.base import Sensor
from djpt.sensors.placement import require_area

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["IrradianceMeter"]


class IrradianceMeter(Sensor):
    """A meter of the irradiance on the shape that it is nested in, averaged over its area A.

        E = 1 / A  int_A int_hemisphere L(p, w) cos(theta) dw dA    (W m^-2)

    The film position draws the point and the aperture sample the direction, by its cosine about the shading
    normal: then every ray counts pi L. Usually the film has one pixel; each of several sees its own part of the
    shape. Use a box filter: wider ones weigh points by where they fall on the film.

    Parameters: those of all sensors but `to_world`, which is the shape's.
    """

    children = ("shape",)
    on_shape = True
    uses_aperture = True
    weight = math.pi

    def __init__(self, props: Properties) -> None:
        if "to_world" in props:
            raise props.error("to_world", "can't be given: move the shape that carries the irradiance meter")
        super().__init__(props)
        if self.film().filters:
            warnings.warn(f"{self.id()}: an irradiance meter needs a film with a box filter", stacklevel=2)

    def move_into(self, frame: Frame) -> None:
        """It has no place or length but the shape's."""
        self.move_nested(frame)

    def viewpoint(self) -> None:
        return None

    def set_bounds(self, center: NDArray[np.float64], radius: float) -> None:
        if self.shape is not None:
            require_area(self.shape, "irradiancemeter")

    def ray_through(self, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True) -> Ray3f:
        ps = self.shape.draw_point(film_position)
        d = Frame3f.from_normal(ps.n).to_world(square_to_cosine_hemisphere(aperture_sample))
        return Ray3f(dr.fma(d, RAY_EPSILON, ps.p), d)

    # ---- for scripts --------------------------------------------------------------------

    def sample_direction(
        self, it: Any, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        """Sample a direction from `it` towards the shape; the weight is pi, of radiance from everywhere."""
        return self.shape.sample_direction(it, sample, active), Color3f(dr.select(active, Float(self.weight), 0))

    def pdf_direction(self, it: Any, ds: DirectionSample3f, active: Bool | bool = True) -> Float:
        """The density of `sample_direction` at `ds`, per unit solid angle at `it`."""
        return self.shape.pdf_direction(it, ds, active)

    def eval(self, si: Any, active: Bool | bool = True) -> Color3f:
        """The importance pi / A of light that arrives on the shape, whose area is A."""
        return Color3f(dr.select(active, self.weight * dr.rcp(self.shape.surface_area()), 0))


register_sensor("irradiancemeter", IrradianceMeter)

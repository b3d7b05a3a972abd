"""The sensor of each lane, for scripts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import DirectionSample3f, Observer, PositionSample3f, Ray3f, SurfaceInteraction3f
from djpt.core.records.record import Wavelengths
from djpt.dispatch.family import Pointer, filled
from djpt.jit.types import Bool, Color3f, Float
from djpt.sensors.base import Sensor

if TYPE_CHECKING:
    from djpt.shapes.pointer import ShapePtr

__all__ = ["SensorPtr"]


class SensorPtr(Pointer[Sensor]):
    """The sensor of each lane, or none. Methods as in `djpt.sensors.base.Sensor`.

    Each asks one sensor after the other; numbers are 0 where there is none.
    """

    member_kind = "sensor"

    def get_shape(self) -> ShapePtr:
        """The shapes that the sensors stand in; none for those that stand alone."""
        from djpt.shapes.pointer import ShapePtr  # which knows the sensors of shapes

        return self.related(ShapePtr, lambda sensor: sensor.get_shape())

    def sample_ray(
        self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Bool | bool = True
    ) -> tuple[Ray3f, Color3f]:
        """Sample a ray of the sensor, and its weight: see `djpt.Sensor.sample_ray`."""
        return self.each(
            lambda sensor, mine: filled(sensor.sample_ray(time, sample1, sample2, sample3, active & mine), time),
            filled((dr.zeros(Ray3f), Color3f(0)), time),
        )

    def sample_ray_differential(
        self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Bool | bool = True
    ) -> tuple[Any, Color3f]:
        """The same with the rays through the next pixels: see `djpt.Sensor.sample_ray_differential`."""

        def asked(sensor: Sensor, mine: Bool) -> Any:
            return filled(sensor.sample_ray_differential(time, sample1, sample2, sample3, active & mine), time)

        present = self.present()
        if not present:
            return self.sample_ray(time, sample1, sample2, sample3, active)
        first, weight = asked(self.plugins[present[0]], Bool(True))
        ray, weight = self.each(asked, (first, dr.select(self.is_valid(), weight, 0)))
        ray.has_differentials = True
        return ray, weight

    def sample_direction(self, it: Observer, sample: Any, active: Bool | bool = True) -> tuple[Any, Color3f]:
        """Sample the way from `it` to the sensor, with its importance: see `djpt.Sensor.sample_direction`."""
        return self.each(
            lambda sensor, mine: filled(sensor.sample_direction(it, sample, active & mine)),
            filled((DirectionSample3f(), Color3f(0))),
        )

    def pdf_direction(self, it: Observer, ds: DirectionSample3f, active: Bool | bool = True) -> Float:
        """The density of `sample_direction`, per unit solid angle at `it`."""
        return self.each(lambda sensor, mine: sensor.pdf_direction(it, ds, active & mine), Float(0))

    def eval_direction(self, it: Observer, ds: DirectionSample3f, active: Bool | bool = True) -> Color3f:
        """The importance that `sample_direction` returns for `ds`."""
        return self.each(lambda sensor, mine: sensor.eval_direction(it, ds, active & mine), Color3f(0))

    def sample_position(self, time: Any, sample: Any, active: Bool | bool = True) -> tuple[PositionSample3f, Float]:
        """Sample a point of the sensor's surface, with 1 / density."""
        return self.each(
            lambda sensor, mine: filled(sensor.sample_position(time, sample, active & mine)),
            filled((dr.zeros(PositionSample3f), Float(0))),
        )

    def pdf_position(self, ps: PositionSample3f, active: Bool | bool = True) -> Float:
        """The density of `sample_position`, per unit area."""
        return self.each(lambda sensor, mine: sensor.pdf_position(ps, active & mine), Float(0))

    def eval(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The importance of light that arrives at `si`: see `djpt.Sensor.eval`."""
        return self.each(lambda sensor, mine: sensor.eval(si, active & mine), Color3f(0))

    def sample_wavelengths(
        self, si: SurfaceInteraction3f, sample: Any, active: Bool | bool = True
    ) -> tuple[Any, Color3f]:
        """No wavelengths, since light is RGB, with weight 1; 0 where there is no sensor."""
        return Wavelengths(), Color3f(dr.select(self.is_valid() & active, Float(1), 0))

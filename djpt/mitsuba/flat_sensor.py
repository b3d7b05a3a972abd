"""A sensor whose pixels are any pixels of other sensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.description.properties import Properties
from djpt.errors import ArgumentError, RenderError
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32
from djpt.sensors.base import Sensor
from djpt.sensors.group import SensorGroup

__all__ = ["FlatSensor"]


class FlatSensor(SensorGroup):
    """The sensor of a `RayDataLoader`: a row of pixels, each of which is a pixel of one of several sensors.

    `pixel_idx` holds the numbers of those pixels: sensor by sensor, and row by row.

    Parameters: those of all sensors. It has no rays before `initialize`.
    """

    in_any_frame = True
    by_pixel = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.sensors: list[Sensor] = []
        self.pixel_idx = UInt32(0)
        self.num_sensors = self.source_film_width = self.source_film_height = self.pixels_per_batch = 0

    def initialize(self, sensors: Sequence[Sensor], pixels_per_batch: int) -> None:
        """Look through these sensors, whose films have one size."""
        self.hold(sensors, [sensor.id() for sensor in sensors], [sensor.get_shape() for sensor in sensors])
        self.num_sensors = len(sensors)
        self.source_film_width, self.source_film_height = (int(n) for n in sensors[0].film().size())
        self.pixels_per_batch = pixels_per_batch
        self.pixel_idx = dr.zeros(UInt32, pixels_per_batch)

    def to_string(self) -> str:
        """A line about the sensors."""
        size = f"{self.source_film_width} x {self.source_film_height}"
        return f"{type(self).__name__}[num_sensors = {self.num_sensors}, size = {size}]"

    def __repr__(self) -> str:
        return self.to_string()

    def prepare(self) -> None:
        if not self.sensors:
            raise RenderError(f"{self.id()}: has no sensors to look through; call 'initialize' first")
        dr.eval(self.pixel_idx)
        super().prepare()

    # ---- in kernels --------------------------------------------------------------------

    def ray_of_pixel(self, pixel: UInt32, offset: Point2f, aperture_sample: Point2f) -> Ray3f:
        return self._ray(dr.gather(UInt32, self.pixel_idx, pixel), offset, aperture_sample, True)

    def _ray(self, source: UInt32, offset: Point2f, aperture_sample: Point2f, active: Bool | bool) -> Ray3f:
        """The ray through a place on a pixel of one of the sensors."""
        width, height = (dr.opaque(UInt32, n) for n in (self.source_film_width, self.source_film_height))
        row = source // width
        number = row // height
        corner = Point2f(Float(source - row * width), Float(row - number * height))
        position = (corner + offset) * dr.rcp(Point2f(Float(width), Float(height)))
        return self.ray_of(number, position, aperture_sample, active)

    def sample_ray(
        self,
        time: Float | float,
        sample1: Float | float,
        sample2: Point2f,
        sample3: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Ray3f, Color3f]:
        """Sample a ray of each lane; neighbouring lanes belong to one pixel, as many as there are samples of it.

        Of the position `sample2` in [0, 1]^2 on the row of pixels only the place on a pixel counts.

        Raises:
            ArgumentError: The number of lanes isn't a multiple of the number of pixels.
        """
        lanes, pixels = dr.width(sample2), dr.width(self.pixel_idx)
        if lanes % pixels:
            raise ArgumentError(f"{self.id()}: {lanes} lanes aren't a multiple of the {pixels} pixels")
        column = Point2f(sample2) * Point2f(self.film().crop_size())
        source = dr.repeat(self.pixel_idx, lanes // pixels)
        timed: Any = self._ray(source, column - dr.floor(column), Point2f(sample3), active)
        timed.time = Float(time)
        return timed, dr.full(Color3f, self.weight, lanes)

"""Jobs: the pieces of one call of `render`, and the samples that its image consists of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import drjit as dr

from djpt.core.interruption import Interruption
from djpt.core.records import Ray3f
from djpt.dispatch.ensemble import Detached, Ensemble
from djpt.errors import RenderError
from djpt.films import Film
from djpt.integrators.base import Integrator
from djpt.jit.types import Bool, Color3f, Float, Int32, Point2f, UInt32
from djpt.rendering.progress import Progress
from djpt.samplers import SampleIndex, Sampler, SampleStream
from djpt.samplers.seeds import Seed, opaque_seed
from djpt.scene.scene import Scene
from djpt.sensors import Sensor

__all__ = ["MAX_SAMPLES", "Band", "Job", "image_channels", "require_countable"]

MAX_SAMPLES = 2**32
"""Samples are numbered in 32 bits."""


@dataclass(frozen=True)
class Band:
    """Some consecutive rows of the sampled grid."""

    first_row: int
    rows: int


@dataclass
class Job:
    """One image: everything but the order in which its samples are computed.

    The sampled grid is the film's crop window, widened by `border` pixels on each side. Sample
    number pixel * spp + k, pixels counted row by row, is the k-th sample of a pixel. All numbers
    that kernels read are opaque, so that new sizes, seeds and counts compile nothing.
    """

    scene: Scene
    sensor: Any
    film: Film
    integrator: Integrator
    sampler: Sampler
    seed: Seed
    spp: int
    progress: Progress | None = None
    pass_spp: int = 0
    """Samples per pixel of one pass; 0: as many as suit the schedule. It changes time and memory, never the image."""
    interruption: Interruption | None = None
    """The handling of signals that end the render; None: Python's own."""
    repeated: bool = False
    """Whether the same kernels will be launched many times, so that the time to compile them doesn't matter."""

    splits_freely: ClassVar[bool] = True
    """Whether passes of any size make the same image."""

    width: int = field(init=False)
    height: int = field(init=False)

    def __post_init__(self) -> None:
        border = self.film.border
        self.width, self.height = (n + 2 * border for n in self.film.crop_size())
        require_countable(self.width, self.height, self.spp)
        self.seed_value = opaque_seed(self.seed, self.sampler.base_seed)
        self.spp_value = dr.opaque(UInt32, self.spp)
        self.width_value = dr.opaque(UInt32, self.width)
        self._border = dr.opaque(Float, border)
        self._origin = Point2f(*(dr.opaque(Float, n - border) for n in self.film.crop_offset()))
        inverse = [dr.opaque(Float, 1 / n) for n in self.film.crop_size()]
        self._inverse_crop = Point2f(*inverse)
        self._crop_columns, self._crop_rows = (dr.opaque(UInt32, n) for n in self.film.crop_size())
        self.camera = camera(self.sensor)
        self._shutter_open = dr.opaque(Float, self.sensor.shutter_open())
        self._shutter_open_time = dr.opaque(Float, self.sensor.shutter_open_time())
        self._rolling_shutter = dr.opaque(Float, self.sensor.rolling_shutter()) if self.sensor.rolls else None
        self._inverse_height = dr.opaque(Float, 1 / self.film.size()[1])
        self._weight = None if self.sensor.weight == 1 else dr.opaque(Float, self.sensor.weight)

    def with_scene(self, scene: Scene) -> Job:
        """The job over another view of the scene."""
        return replace(self, scene=scene)

    @property
    def is_watched(self) -> bool:
        """Whether somebody waits for the ends of passes."""
        return self.progress is not None or self.interruption is not None

    @property
    def samples(self) -> int:
        """The number of samples of the image."""
        return self.width * self.height * self.spp

    def channel_count(self) -> int:
        """Channels per pixel of the developed image."""
        return len(self.channel_names())

    def channel_names(self) -> tuple[str, ...]:
        """Names of the channels of the developed image, without those that aren't filtered."""
        return image_channels(self.film, self.integrator)

    def centre_rays(self, first_row: int, rows: int) -> Ray3f:
        """The rays through the centre of the lens and the centres of some rows of the crop's pixels, row by row."""
        width, _ = self.film.crop_size()
        columns = dr.opaque(UInt32, width)
        pixel = dr.arange(UInt32, width * rows) + dr.opaque(UInt32, width * first_row)
        row = pixel // columns
        position = Point2f(Float(pixel - row * columns) + 0.5, Float(row) + 0.5)
        return self._camera_ray(pixel, position, Point2f(0.5), Point2f(0.5), Float(0.5))

    def stream(self, pixel: UInt32, k: UInt32) -> SampleStream:
        """The random numbers of the k-th sample of a pixel of the grid."""
        return self.sampler.stream(self.seed_value, SampleIndex(pixel, k, self.spp_value, self.width_value))

    def light_stream(self, number: UInt32) -> SampleStream:
        """The random numbers of a light path; the image has `samples` of them, numbered from 0.

        Light paths belong to no pixel. Where a pixel's samples are points of a sequence, however many, light paths are
        points of a single one.
        """
        if self.sampler.continues:
            return self.stream(UInt32(0), number)
        return self.stream(number // self.spp_value, number % self.spp_value)

    def coordinates(self, pixel: UInt32) -> tuple[Float, Float]:
        """Column and row of a pixel of the grid."""
        row = pixel // self.width_value
        return Float(Int32(pixel - row * self.width_value)), Float(Int32(row))

    def begin(self, pixel: UInt32, k: UInt32, x: Float, y: Float) -> tuple[SampleStream, Ray3f, Point2f]:
        """Begin the k-th sample of a pixel in column `x` and row `y`: random numbers, camera ray, film offset.

        The offset is the first two numbers of the stream.
        """
        stream = self.stream(pixel, k)
        return stream, *self.sampled_ray(stream, pixel, x, y)

    def sampled_ray(self, stream: SampleStream, pixel: UInt32, x: Float, y: Float) -> tuple[Ray3f, Point2f]:
        """A camera ray by the next numbers of a stream, and its film offset."""
        offset = stream.next_2d()
        aperture, moment = self._on_lens_in_time(stream)
        position = Point2f(x + offset.x - self._border, y + offset.y - self._border)
        return self._camera_ray(pixel, position, offset, aperture, moment), offset

    def ray_at(self, place: Point2f, stream: SampleStream) -> Ray3f:
        """A camera ray through a place in [0, 1)^2 on the crop window, by the next numbers of a stream."""
        columns, rows = self._crop_columns, self._crop_rows
        position = Point2f(place.x * Float(columns), place.y * Float(rows))
        column, row = dr.minimum(UInt32(position.x), columns - 1), dr.minimum(UInt32(position.y), rows - 1)
        offset = position - Point2f(Float(column), Float(row))
        return self._camera_ray(row * columns + column, position, offset, *self._on_lens_in_time(stream))

    def _on_lens_in_time(self, stream: SampleStream) -> tuple[Point2f, Float]:
        """The point on the lens and the time of a camera ray, as far as the sensor uses them."""
        aperture = stream.next_2d() if self.sensor.uses_aperture else Point2f(0.5)
        # Mitsuba's order of numbers. What nothing asks for isn't computed.
        return aperture, stream.next_1d() if self.sensor.shutter_open_time() > 0 else Float(0.5)

    def _camera_ray(self, pixel: UInt32, position: Point2f, offset: Point2f, aperture: Point2f, moment: Float) -> Ray3f:
        """The ray through a position on the crop window, in pixels; `offset` is where that is on its pixel.

        `moment` says when, in shares of the time for which the shutter is open.
        """
        time = self._time(position, moment) if self.scene.in_time or self.sensor.moves else Float(0)
        on_crop = position * self._inverse_crop
        if self.sensor.by_pixel:
            ray = self.camera.ray_of_pixel(pixel, offset, aperture, time)
        else:
            ray = self.camera.ray_at(time, on_crop, aperture)
        ray.medium = self.scene.medium_of_camera(self.sensor, pixel, on_crop)
        return ray

    def _time(self, position: Point2f, moment: Float) -> Float:
        """The time of a ray: see `_camera_ray`."""
        opens = self._shutter_open
        if self._rolling_shutter is not None:
            row = dr.clip((position.y + self._origin.y + self._border) * self._inverse_height, 0, 1)
            opens = dr.fma(row, self._rolling_shutter, opens)
        return dr.fma(moment, self._shutter_open_time, opens)

    def in_crop(self, x: Float, y: Float, offset: Point2f) -> Point2f:
        """The position on the crop window, [0, 1)^2, of a place on the pixel of the grid in column `x` and row `y`."""
        return Point2f(x + offset.x - self._border, y + offset.y - self._border) * self._inverse_crop

    def on_film(self, column: Float, row: Float) -> Point2f:
        """The position on the whole film, in pixels, of the corner of a pixel of the grid."""
        return Point2f(column, row) + self._origin

    def film_offset(self, pixel: UInt32, k: UInt32) -> Point2f:
        """The film offset in [0, 1)^2 of a sample, drawn again."""
        return self.stream(pixel, k).next_2d()

    def channels(self, color: Color3f, valid: Bool, aovs: list[Float]) -> list[Float]:
        """The channels of one sample."""
        return (self.film.channels(self._measured(color), valid) if self.integrator.writes_color else []) + aovs

    def tangent_channels(self, color: Color3f) -> list[Float]:
        """The derivative of `channels` in the direction of a change of the colour."""
        return self.film.tangent_channels(self._measured(color))

    def color_adjoint(self, channels: Sequence[Float]) -> Color3f:
        """The adjoint of `channels`: the gradient with respect to the colour, from the one of the channels."""
        return self._measured(self.film.color_adjoint(channels))

    def _measured(self, color: Color3f) -> Color3f:
        return color if self._weight is None else color * self._weight

    def bands(self, pixels: int) -> list[Band]:
        """The grid in bands of whole rows of about `pixels` pixels."""
        rows = max(1, pixels // self.width)
        return [Band(y, min(rows, self.height - y)) for y in range(0, self.height, rows)]


def image_channels(film: Film, integrator: Integrator) -> tuple[str, ...]:
    """Names of the channels that an integrator's samples have on a film."""
    color = film.channel_names() if integrator.writes_color else ()
    return color + tuple(integrator.aov_names())


def camera(sensor: Sensor) -> Sensor:
    """A copy of a sensor whose values, and those of its children, are opaque."""
    sensor.prepare()
    ensemble, values = Ensemble([sensor]), Detached()
    # Long tables must exist before a kernel's loop asks for them.
    values.prepare(ensemble.leaves())
    return ensemble.groups[0].at(UInt32(0), values)


def require_countable(width: int, height: int, spp: int) -> None:
    """Raise `RenderError` if there are too many samples."""
    if spp >= MAX_SAMPLES or width * height * spp > MAX_SAMPLES:
        raise RenderError(
            f"{width} x {height} pixels at {spp} spp are more than 2^32 samples; "
            "render fewer spp under several seeds and average the images"
        )

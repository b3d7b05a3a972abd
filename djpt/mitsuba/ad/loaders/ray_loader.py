"""Batches of rays and of the pixels that they should see, for optimisations over many views."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import Ray3f
from djpt.description.loader import load_dict
from djpt.description.properties import Properties
from djpt.errors import ArgumentError, RenderError
from djpt.jit.types import Bool, Color3f, Float, Point2f, TensorXf, UInt32
from djpt.samplers.seeds import permute_kensler
from djpt.sensors.base import Sensor
from djpt.sensors.group import SensorGroup

__all__ = ["FlatSensor", "RayDataLoader"]

PIXEL_FORMATS = {1: "luminance", 3: "rgb", 4: "rgba"}


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
        self._carriers: list[Any] = []
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

    def ray_of_pixel(self, pixel: UInt32, offset: Point2f, aperture_sample: Point2f, time: Float) -> Ray3f:
        return self._ray(dr.gather(UInt32, self.pixel_idx, pixel), offset, aperture_sample, time, True)

    def looks_through(self, pixel: UInt32, film_position: Point2f) -> UInt32 | None:
        return dr.gather(UInt32, self.pixel_idx, pixel) // dr.opaque(
            UInt32, self.source_film_width * self.source_film_height
        )

    def _ray(
        self, source: UInt32, offset: Point2f, aperture_sample: Point2f, time: Float, active: Bool | bool
    ) -> Ray3f:
        """The ray through a place on a pixel of one of the sensors."""
        width, height = (dr.opaque(UInt32, n) for n in (self.source_film_width, self.source_film_height))
        row = source // width
        number = row // height
        corner = Point2f(Float(source - row * width), Float(row - number * height))
        position = (corner + offset) * dr.rcp(Point2f(Float(width), Float(height)))
        return self.ray_of(number, position, aperture_sample, time, active)

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
        ray = self._ray(source, column - dr.floor(column), Point2f(sample3), Float(time), active)
        return ray, dr.full(Color3f, self.weight, lanes)


class RayDataLoader:
    """The pixels of all views of a scene in random order, some at a time.

    target, sensor = loader.next()
    image = djpt.render(scene, params, sensor=sensor, spp=4)    # (1, pixels_per_batch, channels), as target

    Pixels that are neighbours in a tile stay neighbours, so that their rays take similar ways; tiles are in random
    order. The last batch of a pass is filled up with pixels from its beginning.

    Args:
        sensors: The sensors, or one: of one film size, without crop window and `sample_border`.
        target_images: The image (H, W, C) that each of them should see.
        pixels_per_batch: The number of pixels that `next` returns.
        seed: Chooses the order.
        regular_reshuffle: Whether each pass over all pixels has an order of its own.
        tile_size: The width of tiles in pixels; 1: single pixels; as large as the image: single pixels, too, but a
            batch may hold a pixel twice only where it is filled up.

    Raises:
        ArgumentError: Sensors and images don't fit together, or a number is out of range.

    Attributes:
        num_sensors: The number of sensors.
        width, height, channel_size: The size of the images.
        total_pixels, effective_total_pixels: The number of all pixels, and that of a pass.
        iter_shuffle: The number of batches of a pass.
        tiles_per_row, tiles_per_col, tiles_per_sensor: The numbers of tiles.
        pixel_batch_multiplier: The number of pixels over that of a batch: the factor that makes a sum over a batch
            comparable with one over all pixels.
        flat_sensor: The sensor that `next` returns.
    """

    def __init__(
        self,
        sensors: Any,
        target_images: Any,
        pixels_per_batch: int,
        seed: int = 0,
        regular_reshuffle: bool = False,
        tile_size: int = 4,
    ) -> None:
        if tile_size <= 0:
            raise ArgumentError(f"RayDataLoader: tile_size ({tile_size}) must be positive")
        views, images = listed(sensors), listed(target_images)
        require_fit(views, images)
        self.num_sensors = len(views)
        self.height, self.width, self.channel_size = (int(n) for n in images[0].shape)
        self.total_pixels = self.num_sensors * self.width * self.height
        if not 0 < pixels_per_batch <= self.total_pixels:
            raise ArgumentError(
                f"RayDataLoader: pixels_per_batch ({pixels_per_batch}) must be from 1 to total_pixels "
                f"({self.total_pixels})"
            )
        self.pixels_per_batch, self.seed, self.regular_reshuffle = pixels_per_batch, seed, regular_reshuffle
        self.tile_size = tile_size
        self.tiles_per_row, self.tiles_per_col = -(-self.width // tile_size), -(-self.height // tile_size)
        self.tiles_per_sensor = self.tiles_per_row * self.tiles_per_col
        self.iter_shuffle = -(-self.total_pixels // pixels_per_batch)
        self.effective_total_pixels = self.iter_shuffle * pixels_per_batch
        self.pixel_batch_multiplier = self.total_pixels / pixels_per_batch
        self.target_images, self.counter = images, 0
        self._targets = np.concatenate([np.array(image).reshape(-1, self.channel_size) for image in images])
        film = {
            "type": "hdrfilm",
            "width": pixels_per_batch,
            "height": 1,
            "pixel_format": PIXEL_FORMATS[self.channel_size],
            "rfilter": {"type": "box"},
        }
        self.flat_sensor = FlatSensor(Properties("flat_sensor", "flat_sensor", {"film": load_dict(film)}))
        self.flat_sensor.initialize(views, pixels_per_batch)

    def next(self) -> tuple[TensorXf, FlatSensor]:
        """The next batch: its target (1, pixels_per_batch, channels), and the sensor that sees its pixels.

        The sensor is always the same one, changed.
        """
        batch = self.counter % self.iter_shuffle
        if self.counter == 0 or (self.regular_reshuffle and batch == 0):
            self.shuffle_pixel_index(UInt32((self.seed + self.counter) & 0xFFFFFFFF))
        pixels = self._order[batch * self.pixels_per_batch :][: self.pixels_per_batch]
        self.flat_sensor.pixel_idx = UInt32(pixels)
        target = Float(self._targets[pixels].ravel())
        self.counter += 1
        return TensorXf(target, shape=(1, self.pixels_per_batch, self.channel_size)), self.flat_sensor

    def shuffle_pixel_index(self, seed: UInt32 | int) -> None:
        """Put all pixels in the order that belongs to a seed."""
        chosen = UInt32(seed)
        if self.tile_size == 1:
            order = permutation(self.effective_total_pixels, chosen) % self.total_pixels
        elif self.tile_size >= max(self.width, self.height):
            order = permutation(self.total_pixels, chosen)
        else:
            order = self._tiled(permutation(self.num_sensors * self.tiles_per_sensor, chosen))
        self._order = np.resize(order, self.effective_total_pixels).astype(np.uint32)  # which repeats the beginning

    def _tiled(self, tiles: NDArray[np.uint32]) -> NDArray[Any]:
        """All pixels, tile by tile, and row by row within a tile."""
        sensor, place = np.divmod(tiles.astype(np.int64)[:, None, None], self.tiles_per_sensor)
        row, column = np.divmod(place, self.tiles_per_row)
        inside = np.arange(self.tile_size)
        x, y = column * self.tile_size + inside, row * self.tile_size + inside[:, None]
        pixel = (sensor * self.height + y) * self.width + x
        # Tiles may stick out on the right and below.
        return pixel[(x < self.width) & (y < self.height)]


def permutation(n: int, seed: UInt32) -> NDArray[np.uint32]:
    """The numbers below n in an order that belongs to a seed."""
    if n == 1:
        return np.zeros(1, np.uint32)
    return np.array(permute_kensler(dr.arange(UInt32, n), dr.opaque(UInt32, n), dr.opaque(UInt32, seed[0])))


def listed(items: Any) -> list[Any]:
    """The items of a list or tuple, or the one that was given alone."""
    return list(items) if isinstance(items, (list, tuple)) else [items]


def require_fit(sensors: list[Sensor], images: list[Any]) -> None:
    """Raise `ArgumentError` unless each sensor has an image of its size, and all have the same."""
    where = "RayDataLoader: "
    if not sensors or not images:
        raise ArgumentError(f"{where}At least one sensor and one target image are needed")
    if len(sensors) != len(images):
        raise ArgumentError(f"{where}{len(sensors)} sensors don't fit {len(images)} target images")
    for image in images:
        if len(image.shape) != 3:
            raise ArgumentError(f"{where}Target images must have shape (height, width, channels), found {image.shape}")
        if image.shape != images[0].shape:
            raise ArgumentError(
                f"{where}all images must have one height, width and number of channels, "
                f"found {images[0].shape} and {image.shape}"
            )
    height, width, channels = images[0].shape
    if channels not in PIXEL_FORMATS:
        raise ArgumentError(f"{where}images must have 1, 3 or 4 channels, found {channels}")
    for sensor in sensors:
        film: Any = sensor.film()
        if tuple(film.crop_size()) != tuple(film.size()):
            raise ArgumentError(f"{where}{sensor.id()} has a crop window, which isn't supported here")
        if tuple(film.size()) != (width, height):
            size = " x ".join(str(n) for n in film.size())
            raise ArgumentError(f"{where}{sensor.id()} has {size} pixels, its image {width} x {height}")
        if film.sample_border():
            raise ArgumentError(f"{where}{sensor.id()} has sample_border, which isn't supported here")
        if film.base_channels_count() != channels:
            raise ArgumentError(
                f"{where}the film of {sensor.id()} has {film.base_channels_count()} channels, its image {channels}"
            )

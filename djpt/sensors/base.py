"""The contract of sensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from djpt.description.numeric import as_number
from djpt.description.plugin import Plugin, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import lookup, registered
from djpt.errors import ParameterError, RenderError, SceneError
from djpt.records import DirectionSample3f, Ray3f
from djpt.transforms import ScalarTransform4f, as_transform
from djpt.types import Bool, Float, Point2f, Point3f, Vector3f

__all__ = ["Sensor"]


class Sensor(Plugin):
    """Where an image is taken from: makes the rays of film positions; owns a film and a sampler.

    Parameters of all sensors: `to_world` (camera to world: the camera looks along its +z, +y is up;
    no scale; default identity), `shutter_open` and `shutter_close` (0: nothing moves yet, so they
    change no image), a nested `film` (default `hdrfilm`) and `sampler` (default `independent`).
    """

    kind: ClassVar[str] = "sensor"
    on_shape: ClassVar[bool] = False
    """Must it be nested in a shape? The scene then sets `shape`."""
    shape: Any = None
    can_be_reached: ClassVar[bool] = False
    """Can light be traced towards it (`sample_direction`)?"""
    needs_aperture_sample = False
    """Do rays depend on more than the film position? Two more numbers per sample are then drawn, after the film's."""
    weight = 1.0
    """What radiance is multiplied by to give what the sensor measures; the same for all its rays."""
    one_pixel: ClassVar[bool] = False
    """Does it measure one number? Its film then has one pixel, also by default."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        size = ONE_PIXEL if self.one_pixel else {}
        self.film: Any = props.child("film") or default(props, "film", "hdrfilm", **size)
        if self.one_pixel and self.film.size != (1, 1):
            width, height = self.film.size
            problem = f"must have 1 x 1 pixels, found {width} x {height}: a '{props.plugin_name}' measures one number"
            raise props.error("film", problem)
        self.sampler: Any = props.child("sampler") or default(props, "sampler", "independent")
        self.to_world = props.transform("to_world")
        try:
            self.check_placement(self.to_world)
        except SceneError as error:
            raise props.error("to_world", str(error)) from None
        self.shutter_open = props.float("shutter_open", 0.0)
        self.shutter_open_time = props.float("shutter_close", self.shutter_open) - self.shutter_open
        if self.shutter_open_time < 0:
            raise props.error("shutter_close", f"must not be less than 'shutter_open' ({self.shutter_open:g})")

    @staticmethod
    def check_placement(transform: ScalarTransform4f) -> None:
        """Raise `SceneError` if `to_world` can't be this."""
        if transform.has_scale():
            raise SceneError("must not scale: a camera has no size")

    # ---- parameters --------------------------------------------------------------------

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("shutter_open", self.shutter_open)
        callback.put("shutter_open_time", self.shutter_open_time)
        callback.put("film", self.film)

    def check_parameter(self, name: str, value: Any) -> Any:
        if name == "to_world":
            transform = as_transform(value)
            self.check_placement(transform)
            return transform
        number = as_number(value)
        if name == "shutter_open_time" and number < 0:
            raise ParameterError(f"must be at least 0, found {number:g}")
        return number

    def parameters_changed(self, keys: Sequence[str]) -> None:
        """Recompute what kernels read; ``film`` is among the keys if the film's size or crop changed."""

    # ---- on the host -------------------------------------------------------------------

    def viewpoint(self) -> NDArray[np.float64] | None:
        """The point (3,) near which all rays start; None if they start in many places."""
        return self.to_world.translation()

    def starts(self) -> Sequence[NDArray[np.float64]]:
        """Points (3,) near which rays start, of those that are known."""
        p = self.viewpoint()
        return [] if p is None else [p]

    def near_share(self) -> float:
        """How far from the sensor its rays start, in units of their `maxt`: 0 unless there is a near plane."""
        return 0.0

    def set_bounds(self, center: NDArray[np.float64], radius: float) -> None:
        """Called with the scene's bounding sphere, and again when it changes; for sensors that are far away."""

    def prepare(self) -> None:
        """Called before each rendering."""

    # ---- in kernels --------------------------------------------------------------------

    def sample_ray(self, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True) -> Ray3f:
        """The ray through a position in [0, 1]^2 of the film's crop window, y downwards.

        `aperture_sample` in [0, 1)^2 is random only for sensors with `needs_aperture_sample`. The ray's
        `d` has unit length; it covers near to far clip.
        """
        raise NotImplementedError

    def sample_direction(
        self, ref: Point3f, aperture_sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Float]:
        """The way from the point `ref` to the sensor, for light paths: only if `can_be_reached`.

        `ds.uv` is the film position in the crop window that shows the point, `ds.p` where its camera ray starts. The
        importance is the area of the crop window (which is 1) that an area across `ds.d` at `ref` covers, per unit
        of the latter; 0 where the point isn't seen. Visibility isn't considered.

        Raises:
            RenderError: light can't be traced towards the sensor.
        """
        raise self.unreachable()

    def pdf_ray(self, d: Vector3f) -> tuple[Float, Float]:
        """(pdf, distance): the density of the direction `d` of a camera ray, and where rays come together behind it.

        pdf is per unit solid angle, for film positions that are uniform over the crop window. distance is that from
        the centre of projection to the ray's origin (on the near plane, say). At distance t from the origin the
        density per unit area across the ray, which is the importance of `sample_direction`, is thus

            pdf / (t + distance)^2.

        Parallel rays come together at infinity: their distance is inf, and their pdf is per unit area across them.

        `d`, of unit length, must be the direction of a ray of `sample_ray`. Whether it lies in the crop window isn't
        tested: filters look beyond it.

        Raises:
            RenderError: light can't be traced towards the sensor.
        """
        raise self.unreachable()

    def unreachable(self) -> RenderError:
        """The error of sensors that light can't be traced towards."""
        possible = (name for name, sensor in registered("sensor").items() if getattr(sensor, "can_be_reached", False))
        return RenderError(f"{self.id}: light can't be traced towards this sensor; possible: {', '.join(possible)}")


ONE_PIXEL = {"width": 1, "height": 1}


def default(props: Properties, kind: str, name: str, **entries: Any) -> Any:
    """A nested plugin that the description leaves out, with its own defaults except for `entries`."""
    return lookup(kind, name)(Properties(name, f"{props.node}.{kind}", entries, f"{props.id}.{kind}"))

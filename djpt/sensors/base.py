"""The contract of sensors."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.bounding_box import ScalarBoundingBox3f
from djpt.core.numeric import AttachedNumber, as_number
from djpt.core.records import DirectionSample3f, Ray3f
from djpt.core.transforms import ScalarTransform4f, as_transform
from djpt.core.transforms.keyframes import Placement
from djpt.description.plugin import Endpoint, NotMovable, ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import lookup, registered
from djpt.errors import ParameterError, RenderError, SceneError, near_miss
from djpt.films.base import Film
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32
from djpt.samplers.base import Sampler
from djpt.sensors.mitsuba_api import SampledRays

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["Sensor"]


class Sensor(SampledRays, Endpoint):
    """A camera or meter: the rays of film positions, with a film and a sampler of its own.

    Parameters of all sensors: `to_world` (camera to world: the camera looks along its +z, +y is up; no scale; may be
    animated; default identity), `shutter_open` (default 0) and `shutter_close` (default `shutter_open`): the times of
    samples are uniform between them; `rolling_shutter` (default 0): the time by which the shutter opens, and closes,
    later at the bottom of the film than at the top (earlier if negative); `medium` (the one that rays start in;
    default: the scene finds it), a nested `film` (default `hdrfilm`) and `sampler` (default `independent`).
    """

    kind: ClassVar[str] = "sensor"
    on_shape: ClassVar[bool] = False
    """Whether it must be nested in a shape; the scene then sets `shape`."""
    can_be_reached: ClassVar[bool] = False
    """Whether light can be traced towards it: `sample_wi` and `pdf_ray` exist."""
    is_central: ClassVar[bool] = False
    """Whether its rays, those through a point of its lens, meet in one point, its `origin`."""
    uses_aperture = False
    """Whether rays depend on more than the film position: on two more numbers, drawn after those of the film."""
    weight = 1.0
    """The factor from radiance to what the sensor measures; the same for all its rays."""
    by_pixel: ClassVar[bool] = False
    """Whether neighbouring pixels look elsewhere: `ray_of_pixel` then is asked in place of `ray_through`."""
    has_neighbours: ClassVar[bool] = True
    """Whether rays have neighbours on the film, to compute footprints from."""
    motions: ClassVar[tuple[str, ...]] = ()
    """The attributes that place its rays and may have gradients; `attached_matrix` is that of `to_world`."""
    density_moves: ClassVar[bool] = False
    """Whether the importance of `sample_wi` is attached where its rays are: see `attached`."""
    can_move: ClassVar[bool] = True
    """Whether its `to_world` may be animated."""
    canvas: Film | None = None
    """The film that it shares with others, as a part of a batch."""
    column = 0
    """The column at which its picture begins there, in pixels."""
    is_attached = False
    """Whether it is a view whose rays are attached: see `attached`."""
    fixed: frozenset[str] = frozenset()
    """The attributes that rays are computed from and that stay, whatever has gradients: see `djpt.sensors.moving`."""
    stands_for: Any = None
    """The camera of which it is a view with such attributes."""
    has_image_circle = False
    """Whether its film reaches past what the lens shows: rays there have a `maxt` of 0 and meet nothing, not even the
    environment."""
    one_pixel: ClassVar[bool] = False
    """Whether it measures one number: its film then must have one pixel, and has by default."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        size = ONE_PIXEL if self.one_pixel else {}
        self._film: Film = props.child("film") or default(props, "film", "hdrfilm", **size)
        width, height = self._film.size()
        if self.one_pixel and (width, height) != (1, 1):
            problem = f"must have 1 x 1 pixels, found {width} x {height}: a '{props.plugin_name()}' measures one number"
            raise props.error("film", problem)
        self._sampler: Sampler = props.child("sampler") or default(props, "sampler", "independent")
        self._medium = props.child("medium")
        self.motion = props.animation("to_world") if self.can_move else None
        self.to_world = props.transform("to_world")
        if self.motion is not None:
            with props.naming("to_world"):
                self._demand_size()
        try:
            self.check_placement(self.to_world)
        except SceneError as error:
            raise props.error("to_world", str(error)) from None
        opens = self._shutter_open = props.float("shutter_open", 0.0)
        self._shutter_open_time = props.float("shutter_close", opens) - opens
        if self._shutter_open_time < 0:
            raise props.error("shutter_close", f"must not be less than 'shutter_open' ({opens:g})")
        self.rolls = "rolling_shutter" in props
        """Whether the time of a sample depends on its row."""
        self._rolling_shutter = props.float("rolling_shutter", 0.0)

    def _demand_size(self) -> None:
        """Require of an animation that it scales as little as the `to_world` of the sensor may."""
        try:
            self.check_placement(ScalarTransform4f().scale(2.0))
        except SceneError:
            self.motion.demand("rigid", "must not scale: a camera has no size")
        else:
            self.motion.demand("similar", "must scale uniformly")

    @staticmethod
    def check_placement(transform: ScalarTransform4f) -> None:
        """Raise `SceneError` if `transform` can't be the `to_world`."""
        if transform.has_scale():
            raise SceneError("must not scale: a camera has no size")

    # ---- parameters --------------------------------------------------------------------

    def traverse(self, callback: TraversalCallback) -> None:
        # A shutter that opens for a while has derivatives: by what moves.
        open_for_a_while = self._shutter_open_time > 0
        flags = ParamFlags.Differentiable if open_for_a_while else ParamFlags.NonDifferentiable
        for name in ("shutter_open", "shutter_open_time"):
            callback.put(name, getattr(self, f"_{name}"), flags, attribute=f"_{name}")
        if self.rolls:
            callback.put("rolling_shutter", self._rolling_shutter, attribute="_rolling_shutter")
        callback.put("film", self._film)
        if self._medium is not None:
            callback.put("medium", self._medium)

    def check_parameter(self, name: str, value: Any) -> Any:
        if name == "to_world":
            transform = self._attached(value) if dr.grad_enabled(value) else as_transform(value)
            self.check_placement(transform)
            return transform
        number = AttachedNumber(value) if dr.grad_enabled(value) else as_number(value)
        if name == "shutter_open_time" and number < 0:
            raise ParameterError(f"must be at least 0, found {number:g}")
        return number

    def _attached(self, value: Any) -> ScalarTransform4f:
        """A `to_world` with gradients."""
        if "attached_matrix" not in self.motions:
            raise ParameterError(f"{self.id()}.to_world: gradients with respect to this parameter aren't available")
        from djpt.sensors.moving import attached_transform  # images of still cameras need none of it

        return attached_transform(value)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        """Recompute what kernels read; ``film`` is among the keys if the film's size or crop changed."""

    # ---- motion ------------------------------------------------------------------------

    @property
    def attached_matrix(self) -> Any:
        """The matrix of `to_world` if it has gradients, else None."""
        lanes = getattr(self.to_world, "lanes", None)
        return None if lanes is None else lanes.matrix

    def delegates(self) -> Sequence[Any]:
        """The sensors that it hands its rays on to, one of them per lane; none, if it has rays of its own."""
        return []

    def looks_through(self, pixel: UInt32, film_position: Point2f) -> UInt32 | None:
        """The number of the one of its `delegates` that looks through a place on the crop window; None if it has none.

        If it has rays `by_pixel`, the pixel counts.
        """
        return None

    def members(self) -> Sequence[Any]:
        """The sensors whose `motions` place its rays: itself, or those that it hands its rays on to."""
        return [self]

    def attached_names(self) -> list[str]:
        """The attributes that place its rays and have gradients, also where these are suspended."""
        if not self.motions:
            return []
        with dr.resume_grad():
            values = ((name, getattr(self, name)) for name in self.motions)
            return [name for name, value in values if value is not None and dr.grad_enabled(value)]

    def lens_moves(self) -> bool:
        """Whether numbers of its lens have gradients."""
        return any(name != "attached_matrix" for name in self.attached_names())

    def middle(self) -> Point2f:
        """The place on the crop window that shows the optical axis: of those with `has_image_circle` only."""
        raise NotImplementedError

    def edge_of_view(self, turn: Float) -> Point2f:
        """The places on the crop window where what is shown ends, at fractions of a turn about the `middle`."""
        raise NotImplementedError

    def attached(self) -> Any:
        """The sensor, its rays attached to what places them; itself if nothing has gradients."""
        if self.is_attached or not self.attached_names():
            return self
        from djpt.sensors.moving import attached_view  # images of still cameras need none of it

        return attached_view(self)

    def parts(self) -> Sequence[Any]:
        """The cameras that share its picture, side by side: itself, or those of a batch, which have a `canvas`."""
        return [self]

    def through_lens(self, aperture_sample: Point2f) -> Any:
        """The camera, seen through the point of its lens that belongs to a sample: a pinhole; itself without a lens."""
        return self

    def moved_rays(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The attributes that rays are computed from, attached to the values of `motions` that have gradients."""
        raise NotImplementedError

    # ---- its parts ---------------------------------------------------------------------

    def film(self) -> Film:
        """The film."""
        return self._film

    def take_film(self, film: Film) -> None:
        """Take another film."""
        if film is not self._film:
            self._film = film
            self.parameters_changed(("film",))

    def resize_film(self, width: int, height: int) -> None:
        """Take a film of another size, like the present one in all else."""
        self._film = copy.copy(self._film)  # it may be another sensor's as well
        self._film.resize(width, height)
        self.parameters_changed(("film",))

    def sampler(self) -> Sampler:
        """The sampler that the sensor's images are rendered with."""
        return self._sampler

    def shutter_open(self) -> float:
        """The time at which the shutter opens."""
        return float(self._shutter_open)

    def shutter_open_time(self) -> float:
        """The time for which the shutter stays open, of each row of the film."""
        return float(self._shutter_open_time)

    def attached_shutter(self) -> dict[str, Any]:
        """The times of the shutter that have gradients, by attribute."""
        times = {name: getattr(self, name) for name in ("_shutter_open", "_shutter_open_time")}
        attached = {name: time.lanes for name, time in times.items() if isinstance(time, AttachedNumber)}
        return {name: lanes for name, lanes in attached.items() if dr.grad_enabled(lanes)}

    def rolling_shutter(self) -> float:
        """The time by which the shutter opens later at the bottom of the film than at the top."""
        return self._rolling_shutter

    def world_transform(self) -> ScalarTransform4f:
        """The transform from camera to world."""
        return self.to_world

    def bbox(self) -> ScalarBoundingBox3f:
        """The box about the shape that the sensor is nested in; an empty one for a sensor that stands in space."""
        return ScalarBoundingBox3f() if self.shape is None else self.shape.bbox()

    @property
    def m_to_world(self) -> ScalarTransform4f:
        """Mitsuba's name of `to_world`, for sensors that scripts write."""
        return self.to_world

    @m_to_world.setter
    def m_to_world(self, transform: ScalarTransform4f) -> None:
        self.to_world = transform

    @property
    def m_film(self) -> Film:
        """Mitsuba's name of what `film` returns."""
        return self._film

    # ---- working frames ----------------------------------------------------------------

    def move_into(self, frame: Frame) -> None:
        """By default sensors can't be moved: each class knows where it stands, and which lengths it has."""
        raise NotMovable(f"{self.id()}: its place is unknown")

    def move_nested(self, frame: Frame) -> None:
        """Move the medium and the shape that the sensor stands in; each class moves what else it has nested."""
        self._medium, self.shape = frame.copy_of(self._medium), frame.copy_of(self.shape)

    # ---- on the host -------------------------------------------------------------------

    def viewpoint(self) -> NDArray[np.float64] | None:
        """The point (3,) near which all rays start; None if they start in many places."""
        return self.to_world.translation()

    @property
    def moves(self) -> bool:
        """Whether its rays depend on their time."""
        return self.carrier is not None

    def starts(self) -> Sequence[NDArray[np.float64]]:
        """The points (3,) near which rays start, as far as they are known."""
        p = self.viewpoint()
        if p is None or self.carrier is None:
            return [] if p is None else [p]
        keyframes = self.carrier.keyframes
        return [keyframes.at(float(time)).transform_point(p) for time in keyframes.moments()]

    def near_clip_fraction(self) -> float:
        """The distance from sensor to rays' origins, in units of their `maxt`; 0 unless there is a near plane."""
        return 0.0

    def hold_copies(self, copy_of: Callable[[Any], Any]) -> None:
        """Hold copies of nested sensors and shapes, as a copy in a scene at one moment; None stands for itself."""

    def set_bounds(self, center: NDArray[np.float64], radius: float) -> None:
        """Take the scene's bounding sphere, once and whenever it changes: some sensors stand outside of it."""

    def prepare(self) -> None:
        """Get ready for a rendering; called before each."""

    # ---- in kernels --------------------------------------------------------------------

    def ray_at(
        self, time: Float, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True
    ) -> Ray3f:
        """Sample a ray in the world at a time; `ray_through` gives those of a sensor that moves in its own space."""
        ray: Ray3f = self.ray_through(film_position, aperture_sample, active).replaced(time=time)
        if not self.moves:
            return ray
        return self.placed(ray, Placement.identity() if self.carrier is None else self.carrier.placement(time))

    def placed(self, ray: Ray3f, placement: Placement) -> Ray3f:
        """A ray of the sensor's own space in the world, where the sensor is at the ray's time."""
        d = placement.vector(ray.d)
        # Of sensors that have a size only the places and directions of rays change, not how far they look.
        return ray.replaced(o=placement.point(ray.o), d=d / dr.abs(placement.scale.x))

    def ray_through(self, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True) -> Ray3f:
        """Sample the ray through a position in [0, 1]^2 of the film's crop window, y downwards.

        `aperture_sample` in [0, 1)^2 is random only for sensors with `uses_aperture`. The ray's
        `d` has unit length; its origin and `maxt` lie on the near and far plane where there are any. Where nothing is
        shown `maxt` is 0, see `has_image_circle`.
        """
        raise NotImplementedError

    def ray_of_pixel(self, pixel: UInt32, offset: Point2f, aperture_sample: Point2f, time: Float) -> Ray3f:
        """Sample the ray through a place in [0, 1)^2 on a pixel at a time: for `by_pixel` only.

        Pixels are counted row by row.
        """
        raise NotImplementedError

    def sample_wi(
        self, ref: Point3f, aperture_sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Float]:
        """Sample the way from the point `ref` to the sensor, with its importance, for light paths.

        `ds.uv` is the position in the crop window that shows the point, and `ds.p` the origin of its camera ray. The
        importance is the fraction of the crop window that a small area across `ds.d` at `ref` covers, per unit of that
        area; 0 where the point isn't seen. Visibility isn't considered.

        Raises:
            RenderError: light can't be traced towards the sensor.
        """
        raise self.unreachable()

    def pdf_ray(self, ray: Ray3f) -> tuple[Float, Float]:
        """The density of a camera ray's direction, and its distance from the centre of projection: (pdf, distance).

        pdf is per unit solid angle, for film positions that are uniform over the crop window; distance is measured
        from the centre to the ray's origin. At t from the origin the importance of `sample_wi` is then

            pdf / (t + distance)^2    per unit area across the ray.

        Parallel rays have no centre: their distance is inf, and their pdf is per unit area across them.

        `ray` must be one of `ray_through`. Whether it lies in the crop window isn't tested: filters look beyond it.

        Raises:
            RenderError: light can't be traced towards the sensor.
        """
        raise self.unreachable()

    def unreachable(self) -> RenderError:
        """The error of sensors that light can't be traced towards."""
        possible = (name for name, sensor in registered("sensor").items() if getattr(sensor, "can_be_reached", False))
        return RenderError(f"{self.id()}: light can't be traced towards this sensor{near_miss('', possible)}")


ONE_PIXEL = {"width": 1, "height": 1}


def default(props: Properties, kind: str, name: str, **entries: Any) -> Any:
    """A nested plugin that the description leaves out, with its own defaults except for `entries`."""
    return lookup(kind, name)(Properties(name, f"{props.node}.{kind}", entries, f"{props.id()}.{kind}"))

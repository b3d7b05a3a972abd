"""Light from the sky and the sun over many days."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import drjit as dr

from djpt.core.records import EmissionSample, Ray3f
from djpt.description.plugin import HIDDEN, ParamFlags, TraversalCallback
from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_emitter
from djpt.emitters.sky.daylight import Daylight, Instant
from djpt.emitters.sky.directions import FITTED, SkyDirections
from djpt.emitters.sky.dome import SkyDome, atmosphere
from djpt.emitters.sky.position import FARTHEST, WITHIN_REACH, TimeAndPlace, sun_direction
from djpt.emitters.sky.tables import entries_between, table
from djpt.errors import ParameterError, SceneError
from djpt.jit.kernels import as_float, opaque
from djpt.jit.types import Array4f, Bool, Color3f, Float, Normal3f, Point2f, TensorXf, UInt32, Vector3f

__all__ = ["TimedSunSky"]

PLACE = {"latitude": 35.6894, "longitude": 139.6917, "timezone": 9.0}
WINDOW = {"window_start_time": 7.0, "window_end_time": 19.0}
DATES = tuple(f"{end}_{part}" for end in ("start", "end") for part in ("year", "month", "day"))
FAR: dict[str, Any] = {"low": -FARTHEST, "high": FARTHEST}
ELEVATIONS, LOWEST = 30, 2.0
"""The count of the sun's elevations in the tables, 3 degrees apart; the lowest."""
INSTANTS = 64
"""The instants that `power` is an average of."""


class TimedSunSky(Daylight):
    """The sky and the sun over many days: a ray sees them at its time.

    While the shutter is open, the days from the start to the end pass, and of each the hours of a window. So an image
    of a camera whose shutter opens and closes at the same times is an average over days, months or years. At one
    instant the light is that of `djpt.emitters.sunsky.SunSky`.

    Light that is traced from the emitter has no time: `ptracer` can't use it.

    Parameters: those of `djpt.emitters.sky.daylight.Daylight`, and

    * `start_year`, `start_month`, `start_day` (default 2025, 1, 1), `end_year`, `end_month`, `end_day` (default a year
      later): the first day, and the one after the last; at least one day passes;
    * `window_start_time`, `window_end_time`: the hours of a day, in [0, 24] (default 7 and 19);
    * `latitude`, `longitude` (degrees, default Tokyo), `timezone` (hours, default 9);
    * `shutter_open`, `shutter_close` (default 0, 1), as the camera has them.

    Images have derivatives with respect to `albedo`.

    The sun is as bright as its elevation says. Mitsuba 3.9.1 looks it up 1.5 degrees lower, and its dates are multiples
    of six hours: its sun stands up to a quarter of a degree elsewhere.
    """

    in_any_frame = True
    in_time = True
    allowed: ClassVar[Mapping[str, Allowed]] = {
        **Daylight.allowed,
        **dict.fromkeys((*PLACE, *DATES), WITHIN_REACH),
    }
    values: ClassVar[Mapping[str, ParamFlags]] = {
        **Daylight.values,
        **dict.fromkeys((*PLACE, *WINDOW, "first_day", "days", "shutter_open", "per_shutter"), HIDDEN),
    }
    tables: ClassVar[Mapping[str, ParamFlags]] = {
        "controls": ParamFlags.Differentiable,
        **dict.fromkeys(("suns", "densities"), HIDDEN),
    }

    latitude: Any
    longitude: Any
    timezone: Any
    window_start_time: Any
    window_end_time: Any
    controls: Any
    """The sky's colours, by control point and quantity: see `SkyDome.of`."""
    suns: Any
    """By elevation: the sun's irradiance (3), and the fraction of samples that go to the sky."""
    densities: Any
    """By elevation: the parameters of `SkyDirections` (5), and 0."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        for key, number in PLACE.items():
            setattr(self, key, as_float(props.float(key, number, **FAR)))
        hours = {key: props.float(key, hour, low=0.0, high=24.0) for key, hour in WINDOW.items()}
        if hours["window_end_time"] < hours["window_start_time"]:
            problem = f"must not be less than 'window_start_time' ({hours['window_start_time']:g})"
            raise props.error("window_end_time", problem)
        for key, hour in hours.items():
            setattr(self, key, as_float(hour))
        self.start_year, self.start_month, self.start_day = (
            props.integer(key, default, **FAR) for key, default in zip(DATES, (2025, 1, 1), strict=False)
        )
        self.end_year = props.integer("end_year", self.start_year + 1, **FAR)
        self.end_month = props.integer("end_month", self.start_month, **FAR)
        self.end_day = props.integer("end_day", self.start_day, **FAR)
        opens, closes = props.float("shutter_open", 0.0), props.float("shutter_close", 1.0)
        if closes < opens:
            raise props.error("shutter_close", f"must not be less than 'shutter_open' ({opens:g})")
        self.shutter_open = as_float(opens)
        self.per_shutter = as_float(1 / (closes - opens) if closes > opens else 0.0)
        try:
            self._measure()
        except ParameterError as error:
            raise props.error("end_year", f"is too early: {error}") from None

    # ---- parameters --------------------------------------------------------------------

    def traverse(self, callback: TraversalCallback) -> None:
        super().traverse(callback)
        for name in (*PLACE, *WINDOW):
            callback.put(name, getattr(self, name), HIDDEN)
        for name in DATES:
            callback.put(name, getattr(self, name))

    def parameters_changed(self, keys: Sequence[str]) -> None:
        super().parameters_changed(keys)
        self._measure()

    def _measure(self) -> None:
        """Compute what kernels read: the days, and the atmosphere at all elevations of the sun."""
        first, after = (
            TimeAndPlace(year=year, month=month, day=day, hour=0.0, timezone=0.0).days()
            for year, month, day in (
                (self.start_year, self.start_month, self.start_day),
                (self.end_year, self.end_month, self.end_day),
            )
        )
        if after < first:
            raise ParameterError(f"the end must not be before the start, found {first - after:g} days earlier")
        self.first_day, self.days = as_float(first), as_float(max(after - first, 1.0))
        controls = atmosphere(self.turbidity, self.albedo.eval(None))
        dr.make_opaque(controls.numbers)
        self.controls = TensorXf(controls.numbers, controls.shape)
        with dr.suspend_grad():
            irradiances = table("irradiance").at(self.turbidity - 1).numbers
            row = dr.arange(UInt32, ELEVATIONS)
            red, green, blue, of_sun, of_sky = (dr.gather(Float, irradiances, row * 5 + k) for k in range(5))
            # Copies: Dr.Jit would give a scale of 0, if it is only held here, the width of what it is multiplied with.
            sky_scale, sun_scale = Float(dr.detach(self.sky_scale)), Float(dr.detach(self.sun_scale))
            of_sky = of_sky * sky_scale
            both = of_sky + of_sun * sun_scale
            suns = Array4f(red, green, blue, dr.select(both > 0, of_sky / both, 1))
            fitted = table("density").swapped().at(self.turbidity - 1).numbers
            cell = dr.arange(UInt32, ELEVATIONS * 6)
            row, column = cell // 6, cell % 6
            densities = dr.gather(Float, fitted, row * FITTED + column, column < FITTED)
            self.suns = TensorXf(opaque(dr.ravel(suns)), (ELEVATIONS, 1, 4))
            self.densities = TensorXf(opaque(densities), (ELEVATIONS, 1, 6))
            # Where the disc is at an instant and its colour are told to its copies.
            self.disc.set(self.turbidity, Vector3f(0, 0, 1), Color3f(0))
            passed = (dr.arange(Float, INSTANTS) + 0.5) * (self.days / INSTANTS)
            z = self._sun_after(passed).z
            luminance = TensorXf(both, (ELEVATIONS, 1, 1))
            self.irradiance = dr.mean(dr.select(z > 0, entries_between(luminance, ELEVATIONS, above_lowest(z)), 0))
            dr.make_opaque(self.irradiance)

    # ---- in kernels --------------------------------------------------------------------

    def at(self, time: Float) -> Instant:
        sun = self._sun_after((time - self.shutter_open) * self.per_shutter * self.days)
        place = above_lowest(sun.z)
        red, green, blue, _ = entries_between(self.suns, ELEVATIONS, place)
        # How samples are drawn is read half an entry lower, as in Mitsuba: then samples are the same.
        share = entries_between(self.suns, ELEVATIONS, place - 0.5)[3]
        fitted = entries_between(self.densities, ELEVATIONS, place * (3 * ELEVATIONS / 86) - 0.5)
        return Instant(
            SkyDome.of(self.controls, dr.safe_asin(sun.z)),
            self.disc.moved(sun, Color3f(red, green, blue)),
            SkyDirections.of(dr.atan2(sun.y, sun.x), list(fitted)),
            share,
            self.sky_scale,
            self.sun_scale,
        )

    def _sun_after(self, days: Float) -> Vector3f:
        """The direction of the sun in the light's space, after a number of days have passed."""
        day = dr.floor(days)
        hours = dr.lerp(self.window_start_time, self.window_end_time, days - day) - self.timezone
        date = self.first_day + day + hours * (1 / 24)
        return Vector3f(*sun_direction(date, hours, self.latitude, self.longitude))

    # ---- light that is traced from the emitter ------------------------------------------

    def sample_ray(
        self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Bool | bool = True
    ) -> tuple[Ray3f, Color3f]:
        es = self.emission_at(Float(time), Point2f(sample2), Point2f(sample3))
        es.ray.time = Float(time)
        return es.ray, dr.select(active, es.weight, 0)

    def sample_emission(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> EmissionSample:
        raise self._without_time()

    def pdf_emission(self, d: Vector3f, n: Normal3f, uv: Point2f, active: Bool | bool = True) -> tuple[Float, Float]:
        raise self._without_time()

    def _without_time(self) -> SceneError:
        return SceneError(
            f"{self.id()}: light that is traced from a 'timed_sunsky' has no time; take an integrator that starts at "
            "the camera, such as 'path', or a 'sunsky'"
        )


def above_lowest(z: Float) -> Float:
    """The number of entries, 3 degrees each, between the lowest elevation and that of a sun at the height `z`."""
    return (dr.safe_asin(z) * (180 / math.pi) - LOWEST) * (1 / 3)


register_emitter("timed_sunsky", TimedSunSky)

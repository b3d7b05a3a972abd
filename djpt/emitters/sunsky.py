"""Light from the sky and the sun."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.description.allowed import bounds as within
from djpt.description.frozen import recording
from djpt.description.numeric import as_array, as_number, non_negative
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_emitter
from djpt.emitters.bounds import LightBounds
from djpt.emitters.extent import number
from djpt.emitters.oriented import OrientedEmitter
from djpt.emitters.sky.angles import squared_chord
from djpt.emitters.sky.directions import SkyDirections
from djpt.emitters.sky.disc import WAVELENGTHS, SunDisc, irradiances
from djpt.emitters.sky.dome import SkyDome
from djpt.emitters.sky.position import TimeAndPlace
from djpt.errors import ParameterError
from djpt.frame import Frame3f
from djpt.kernels import as_float, as_vector, maximum
from djpt.records import (
    DirectionSample3f,
    EmissionSample,
    EmitterFlags,
    Observer,
    Ray3f,
    SurfaceInteraction3f,
)
from djpt.types import Bool, Color3f, Float, Normal3f, Point2f, UInt32, Vector3f
from djpt.warp import square_to_uniform_disk_concentric

__all__ = ["SunSky"]

HIDDEN = ParamFlags.NonDifferentiable
LUMINANCE = 1 / 106.7502593994140625
"""The inverse of the integral of the eye's sensitivity over wavelengths in nm: a spectrum of ones has luminance 1."""
CLOCK = tuple(asdict(TimeAndPlace()))


class SunSky(OrientedEmitter):
    """The sky and the sun by day, by the model of Hosek and Wilkie; below the horizon it is black.

    In the light's space z points up, x to the south and y to the west, as in Mitsuba (a left-handed system). Radiance
    is in W m^-2 sr^-1 nm^-1: a scene of metres then has physical units. It isn't clamped: some colours of the sun and
    the sky have negative components in sRGB.

    One of the sun and the sky is chosen by the luminance of their irradiance. Directions to the sun are uniform over
    its disc, those to the sky have the density of `djpt.emitters.sky.directions.SkyDirections`.

    Parameters:

    * `turbidity` (1 to 10, default 3: a clear sky; 10 is hazy), `albedo` of the ground (texture in [0, 1] that can't
      vary, default 0.3);
    * `sun_direction` (world space, towards the sun); or `latitude`, `longitude` (degrees, default Tokyo), `timezone`
      (hours, default 9), `year`, `month`, `day` (default 2010, 7, 10), `hour`, `minute`, `second` (default 15:00:00);
    * `sun_scale`, `sky_scale` (default 1, not negative), `sun_aperture` (the angle of the disc in degrees, in (0, 180),
      default 0.5358; its power stays the same), `complex_sun` (default false; true darkens the edge of the disc);
    * `to_world` (a rotation or reflection, default identity).

    At a given time the sun stands where Mitsuba sees it to a quarter of a degree: there, dates have single precision.
    Derivatives by `sun_direction` don't see that the edge of the disc moves.
    """

    values: ClassVar[Mapping[str, ParamFlags]] = {
        **OrientedEmitter.values,
        **dict.fromkeys(("center", "radius", "sky_share"), HIDDEN),
        **dict.fromkeys(("sky_scale", "sun_scale"), HIDDEN),
    }
    children = ("dome", "disc", "directions")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.turbidity = as_float(props.float("turbidity", 3.0, low=1.0, high=10.0))
        self.sky_scale = as_float(props.float("sky_scale", 1.0, low=0.0))
        self.sun_scale = as_float(props.float("sun_scale", 1.0, low=0.0))
        self.albedo = props.texture("albedo", 0.3, low=0.0, high=1.0)
        if not self.albedo.is_constant:
            raise props.error("albedo", "can't vary: it is that of all the ground")
        self.timed = "sun_direction" not in props
        if self.timed:
            defaults = asdict(TimeAndPlace())
            for key, default in defaults.items():
                read = props.integer if isinstance(default, int) else props.float
                setattr(self, key, read(key, default))
            self._ask_clock()
        else:
            if given := [key for key in CLOCK if key in props]:
                raise props.error("sun_direction", f"can't be given together with '{given[0]}'")
            direction = props.vector("sun_direction")
            if not direction.any():
                raise props.error("sun_direction", "must not be zero")
            self.sun_direction: Any = as_vector(direction / np.linalg.norm(direction))
        aperture = props.float("sun_aperture", 0.5358, low=0.0, high=180.0, low_open=True, high_open=True)
        self.dome, self.directions = SkyDome(), SkyDirections()
        self.disc = SunDisc(aperture, props.boolean("complex_sun", False))
        self.set_bounds(np.zeros(3), 1.0)
        self._measure()

    # ---- parameters --------------------------------------------------------------------

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("sampling_weight", self.share, attribute="share")
        callback.put("to_world", self.to_world)
        for name in ("turbidity", "sky_scale", "sun_scale"):
            callback.put(name, getattr(self, name), HIDDEN)
        callback.put("albedo", self.albedo)
        for name in CLOCK if self.timed else ():
            callback.put(name, getattr(self, name))
        follows = HIDDEN | ParamFlags.ReadOnly
        callback.put("sun_direction", self.sun_direction, follows if self.timed else ParamFlags.Differentiable)

    def check_parameter(self, name: str, value: Any) -> Any:
        if recording():
            return super().check_parameter(name, value)
        if name in ("sky_scale", "sun_scale"):
            non_negative(value)
        elif name == "turbidity" and not 1 <= as_number(value) <= 10:
            raise ParameterError(f"must {within(1, 10)}, found {as_number(value):g}")
        elif name == "sun_direction" and not as_array(dr.detach(value)).any():
            raise ParameterError("must not be zero")
        return super().check_parameter(name, value)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        super().parameters_changed(keys)
        if self.timed and {"to_world", *CLOCK} & set(keys):
            self._ask_clock()
        self._measure()

    def _ask_clock(self) -> None:
        """Compute the sun's direction at the time and the place."""
        local = TimeAndPlace(**{name: getattr(self, name) for name in CLOCK}).sun_direction()
        linear = self.to_world.matrix[:3, :3]
        self.sun_direction = as_vector(linear / np.linalg.norm(linear, axis=0) @ local)

    def _measure(self) -> None:
        """Compute what kernels read: the colours of the sky and the sun, and how directions are sampled."""
        sun = dr.normalize(self.world_to_local(self.sun_direction))
        elevation, azimuth = dr.safe_asin(sun.z), dr.atan2(sun.y, sun.x)
        if not recording() and number(sun.z) < 0:
            warnings.warn(f"{self.id()}: the sun is below the horizon: no light comes from the sky", stacklevel=2)
        irradiance, of_sun, of_sky = irradiances(self.turbidity, elevation)
        self.dome.set(self.turbidity, self.albedo.eval(None), elevation)
        self.disc.set(self.turbidity, sun, irradiance)
        self.directions.set(self.turbidity, elevation, azimuth)
        with dr.suspend_grad():
            of_sun, of_sky = of_sun * self.sun_scale, of_sky * self.sky_scale
            self._irradiance = of_sun + of_sky
            both = of_sky + of_sun * self.disc.dilution
            self.sky_share: Any = dr.select(both > 0, of_sky / both, 0)
            dr.make_opaque(self._irradiance, self.sky_share)

    # ---- on the host -------------------------------------------------------------------

    def flags(self, active: Bool | bool = True) -> int:
        return int(EmitterFlags.Infinite | EmitterFlags.SpatiallyVarying)

    def set_bounds(self, center: NDArray[np.float64], radius: float) -> None:
        self.center, self.radius = as_vector(center), as_float(radius)

    def power(self) -> float:
        return number(self._irradiance) * WAVELENGTHS * LUMINANCE * math.pi * number(self.radius) ** 2

    def bounds(self) -> LightBounds | None:
        return None

    # ---- in kernels --------------------------------------------------------------------

    def eval(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        local = self.world_to_local(-si.wi)
        return self._radiance(local, self.disc.covers(local))

    def sample_direction(
        self, it: Observer, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        local, pdf, weight, radiance = self._sample(sample)
        d = self.local_to_world(local)
        ds = DirectionSample3f.of(
            # A stand-in for the point at infinity; visibility rays use `d` (see `Scene.shadow_ray`).
            it.p + d,
            -d,
            Point2f(0),
            d,
            Float(dr.inf),
            pdf,
            weight,
            Bool(False),
            UInt32(0),
        )
        return ds, radiance * weight

    def pdf_direction(self, it: Observer, ds: DirectionSample3f, active: Bool | bool = True) -> Float:
        local = self.world_to_local(ds.d)
        return self._pdf(local, self.disc.covers(local))

    def sample_emission(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> EmissionSample:
        local, pdf, weight, radiance = self._sample(direction_sample)
        # From a disk as wide as the scene, in front of it.
        at = square_to_uniform_disk_concentric(position_sample)
        d = self.local_to_world(-local)
        across = Frame3f.from_normal(d).to_world(Vector3f(at.x, at.y, 0))
        area = math.pi * dr.square(self.radius)
        return EmissionSample(
            ray=Ray3f(dr.fma(across - d, self.radius, self.center), d),
            weight=radiance * (weight * area),
            n=d,
            uv=Point2f(0),
            cos=Float(1),
            pdf_position=dr.rcp(area),
            pdf_direction=pdf,
            finite=Bool(False),
            delta=Bool(False),
        )

    def pdf_emission(self, d: Vector3f, n: Normal3f, uv: Point2f, active: Bool | bool = True) -> tuple[Float, Float]:
        local = self.world_to_local(-d)
        return dr.rcp(math.pi * dr.square(self.radius)), self._pdf(local, self.disc.covers(local))

    def _is_day(self, local: Vector3f) -> Bool:
        """Whether light comes from a direction of the light's space: it is above the horizon, and so is the sun."""
        return (local.z >= 0) & (self.disc.direction.z >= 0)

    def _radiance(self, local: Vector3f, on_disc: Bool) -> Color3f:
        """The radiance from a direction of the light's space."""
        lit, cos_theta = self._is_day(local), maximum(local.z, Float(0))
        chord2 = squared_chord(self.disc.direction, local)
        sky = self.dome.radiance(cos_theta, chord2) * self.sky_scale
        sun = self.disc.radiance(cos_theta, chord2, on_disc) * self.sun_scale
        return dr.select(lit, (sky + dr.select(on_disc, sun, 0)) * LUMINANCE, 0)

    def _pdf(self, local: Vector3f, on_disc: Bool) -> Float:
        """The density of `_sample`, per unit solid angle."""
        density = dr.lerp(dr.select(on_disc, self.disc.pdf(), 0), self.directions.pdf(local), self.sky_share)
        return dr.select(self._is_day(local), density, 0)

    def _sample(self, sample: Point2f) -> tuple[Vector3f, Float, Float, Color3f]:
        """Sample a direction in the light's space, with its density per solid angle, 1 / density, and radiance."""
        to_sky = sample.x < self.sky_share
        rest = Point2f((sample.x - self.sky_share) / (1 - self.sky_share), sample.y)
        sky = self.directions.sample(Point2f(sample.x / self.sky_share, sample.y))
        local = dr.select(to_sky, sky, self.disc.sample(rest))
        on_disc = ~to_sky | self.disc.covers(local)
        pdf = self._pdf(local, on_disc)
        return local, pdf, dr.select(pdf > 0, dr.rcp(pdf), 0), self._radiance(local, on_disc)


register_emitter("sunsky", SunSky)

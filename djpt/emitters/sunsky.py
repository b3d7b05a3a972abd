"""Light from the sky and the sun."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, ClassVar

import drjit as dr
import numpy as np

from djpt.core.numeric import as_array
from djpt.description.plugin import HIDDEN, ParamFlags, TraversalCallback
from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_emitter
from djpt.emitters.extent import number
from djpt.emitters.sky.daylight import Daylight, Instant
from djpt.emitters.sky.directions import SkyDirections
from djpt.emitters.sky.dome import SkyDome, irradiances
from djpt.emitters.sky.position import FARTHEST, WITHIN_REACH, TimeAndPlace
from djpt.errors import ParameterError
from djpt.jit.frozen import recording
from djpt.jit.kernels import as_vector
from djpt.jit.types import Float

__all__ = ["SunSky"]

CLOCK = tuple(asdict(TimeAndPlace()))


class SunSky(Daylight):
    """The sky and the sun by day, by the model of Hosek and Wilkie; below the horizon it is black.

    One of the sun and the sky is chosen by the luminance of their irradiance.

    Parameters: those of `djpt.emitters.sky.daylight.Daylight`, and

    * `sun_direction` (world space, towards the sun); or
    * `latitude`, `longitude` (degrees, default Tokyo), `timezone` (hours, default 9), `year`, `month`, `day` (default
      2010, 7, 10), `hour`, `minute`, `second` (default 15:00:00).

    At a given time the sun stands where Mitsuba sees it to a quarter of a degree: there, dates have single precision.
    The noise of derivatives with respect to `sun_direction` grows like the inverse of `sun_aperture`, see
    `djpt.emitters.sky.dome.SunDisc.radiance`.
    """

    in_any_frame = True
    values: ClassVar[Mapping[str, ParamFlags]] = {**Daylight.values, "sky_fraction": HIDDEN}
    turbidity_flags = ParamFlags.Differentiable
    children = ("dome", "disc", "directions")
    allowed: ClassVar[Mapping[str, Allowed]] = {**Daylight.allowed, **dict.fromkeys(CLOCK, WITHIN_REACH)}

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.timed = "sun_direction" not in props
        if self.timed:
            defaults = asdict(TimeAndPlace())
            for key, default in defaults.items():
                read = props.integer if isinstance(default, int) else props.float
                setattr(self, key, read(key, default, low=-FARTHEST, high=FARTHEST))
            self._ask_clock()
        else:
            if given := [key for key in CLOCK if key in props]:
                raise props.error("sun_direction", f"can't be given together with '{given[0]}'")
            direction = props.vector("sun_direction")
            if not direction.any():
                raise props.error("sun_direction", "must not be zero")
            self.sun_direction: Any = as_vector(direction / np.linalg.norm(direction))
        self.dome, self.directions = SkyDome(), SkyDirections()
        self._measure()

    # ---- parameters --------------------------------------------------------------------

    def traverse(self, callback: TraversalCallback) -> None:
        super().traverse(callback)
        for name in CLOCK if self.timed else ():
            callback.put(name, getattr(self, name))
        follows = HIDDEN | ParamFlags.ReadOnly
        callback.put("sun_direction", self.sun_direction, follows if self.timed else ParamFlags.Differentiable)

    def check_parameter(self, name: str, value: Any) -> Any:
        if name == "sun_direction" and not recording() and not as_array(dr.detach(value)).any():
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
            warnings.warn(f"{self.id()}: the sun is below the horizon, so no light comes from the sky", stacklevel=2)
        irradiance, of_sun, of_sky = irradiances(self.turbidity, elevation)
        self.dome.set(self.turbidity, self.albedo.eval(None), elevation)
        self.disc.set(self.turbidity, sun, irradiance)
        self.directions.set(self.turbidity, elevation, azimuth)
        with dr.suspend_grad():
            of_sun, of_sky = of_sun * self.sun_scale, of_sky * self.sky_scale
            self.irradiance = of_sun + of_sky
            both = of_sky + of_sun * self.disc.dilution
            self.sky_fraction: Any = dr.select(both > 0, of_sky / both, 0)
            dr.make_opaque(self.irradiance, self.sky_fraction)

    # ---- in kernels --------------------------------------------------------------------

    def at(self, time: Float) -> Instant:
        return Instant(self.dome, self.disc, self.directions, self.sky_fraction, self.sky_scale, self.sun_scale)


register_emitter("sunsky", SunSky)

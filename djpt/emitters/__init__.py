"""Emitters, one per file. The file registers its emitter; one line here says where it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if TYPE_CHECKING:
    from djpt.emitters.area import Area as Area
    from djpt.emitters.base import Emitter as Emitter
    from djpt.emitters.constant import ConstantBackground as ConstantBackground
    from djpt.emitters.directional import DirectionalEmitter as DirectionalEmitter
    from djpt.emitters.directionalarea import DirectionalArea as DirectionalArea
    from djpt.emitters.envmap import EnvironmentMap as EnvironmentMap
    from djpt.emitters.point import PointLight as PointLight
    from djpt.emitters.projector import Projector as Projector
    from djpt.emitters.spot import SpotLight as SpotLight
    from djpt.emitters.sunsky import SunSky as SunSky
    from djpt.emitters.timed_sunsky import TimedSunSky as TimedSunSky
else:
    __getattr__, __dir__, __all__ = lazily(__name__)

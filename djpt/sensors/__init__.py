"""Sensors, one per file. The file registers its sensor; one line here says where it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if TYPE_CHECKING:
    from djpt.sensors.base import Sensor as Sensor
    from djpt.sensors.batch import Batch as Batch
    from djpt.sensors.distant import Distant as Distant
    from djpt.sensors.fisheye import Fisheye as Fisheye
    from djpt.sensors.irradiancemeter import IrradianceMeter as IrradianceMeter
    from djpt.sensors.orthographic import Orthographic as Orthographic
    from djpt.sensors.panorama import Panorama as Panorama
    from djpt.sensors.perspective import Perspective as Perspective
    from djpt.sensors.radiancemeter import RadianceMeter as RadianceMeter
    from djpt.sensors.thinlens import ThinLens as ThinLens
else:
    __getattr__, __dir__, __all__ = lazily(__name__)

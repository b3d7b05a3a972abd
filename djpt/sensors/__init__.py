"""Sensors: the contract, and one file for each kind of camera or meter."""

from djpt.description.registry import register_sensor
from djpt.sensors.base import Sensor
from djpt.sensors.batch import Batch
from djpt.sensors.distant import Distant
from djpt.sensors.irradiancemeter import IrradianceMeter
from djpt.sensors.orthographic import Orthographic
from djpt.sensors.perspective import Perspective
from djpt.sensors.radiancemeter import RadianceMeter
from djpt.sensors.thinlens import ThinLens

__all__ = [
    "Batch",
    "Distant",
    "IrradianceMeter",
    "Orthographic",
    "Perspective",
    "RadianceMeter",
    "Sensor",
    "ThinLens",
]

register_sensor("batch", Batch)
register_sensor("distant", Distant)
register_sensor("irradiancemeter", IrradianceMeter)
register_sensor("orthographic", Orthographic)
register_sensor("perspective", Perspective)
register_sensor("radiancemeter", RadianceMeter)
register_sensor("thinlens", ThinLens)

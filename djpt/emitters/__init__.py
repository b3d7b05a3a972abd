"""Emitters: the contract, and one file for each kind of light."""

from djpt.description.registry import register_emitter
from djpt.emitters.area import Area
from djpt.emitters.base import Emitter
from djpt.emitters.constant import ConstantBackground
from djpt.emitters.directional import DirectionalEmitter
from djpt.emitters.directionalarea import DirectionalArea
from djpt.emitters.envmap import EnvironmentMap
from djpt.emitters.point import PointLight
from djpt.emitters.projector import Projector
from djpt.emitters.spot import SpotLight

__all__ = [
    "Area",
    "ConstantBackground",
    "DirectionalArea",
    "DirectionalEmitter",
    "Emitter",
    "EnvironmentMap",
    "PointLight",
    "Projector",
    "SpotLight",
]

register_emitter("area", Area)
register_emitter("point", PointLight)
register_emitter("constant", ConstantBackground)
register_emitter("directional", DirectionalEmitter)
register_emitter("directionalarea", DirectionalArea)
register_emitter("envmap", EnvironmentMap)
register_emitter("projector", Projector)
register_emitter("spot", SpotLight)

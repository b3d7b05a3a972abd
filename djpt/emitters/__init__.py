"""Emitters: one file each, one registration line each."""

from djpt.description.registry import register_emitter
from djpt.emitters.area import Area
from djpt.emitters.base import Emitter
from djpt.emitters.constant import ConstantBackground
from djpt.emitters.point import PointLight

__all__ = ["Area", "ConstantBackground", "Emitter", "PointLight"]

register_emitter("area", Area)
register_emitter("point", PointLight)
register_emitter("constant", ConstantBackground)

"""Plugins as Mitsuba's class library sees them: their base class, their kinds, their manager."""

from __future__ import annotations

import enum
from typing import Any

from djpt.description.plugin import Plugin, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import kind_of, lookup, mitsuba_kind_of, register_phase

__all__ = ["Object", "ObjectType", "PluginManager", "TraversalCallback", "register_phasefunction"]

Object = Plugin
"""The base class of all plugins; ``Object()`` is one without a kind."""

register_phasefunction = register_phase
"""A former name of `register_phase`."""


class ObjectType(enum.Enum):
    """The kinds of plugins; the numbers are Mitsuba's."""

    Unknown = 0
    Scene = 1
    ReconstructionFilter = 2
    Sensor = 3
    Film = 4
    Emitter = 5
    Sampler = 6
    Shape = 7
    Texture = 8
    Volume = 9
    Medium = 10
    BSDF = 11
    PhaseFunction = 12
    Integrator = 13


KINDS = {
    "scene": ObjectType.Scene,
    "rfilter": ObjectType.ReconstructionFilter,
    "sensor": ObjectType.Sensor,
    "film": ObjectType.Film,
    "emitter": ObjectType.Emitter,
    "sampler": ObjectType.Sampler,
    "shape": ObjectType.Shape,
    "texture": ObjectType.Texture,
    "volume": ObjectType.Volume,
    "medium": ObjectType.Medium,
    "bsdf": ObjectType.BSDF,
    "phase": ObjectType.PhaseFunction,
    "integrator": ObjectType.Integrator,
}
"""The kinds of Mitsuba by the names that djpt has for them."""


class PluginManager:
    """The registry of plugins, as an object: `PluginManager.instance`."""

    @staticmethod
    def instance() -> PluginManager:
        """The only one."""
        return _manager

    def create_object(self, props: Properties) -> Any:
        """Make a plugin from its properties.

        Raises:
            SceneError: there is no such plugin, or the properties don't fit it.
        """
        plugin = lookup(None, props.plugin_name())(props)
        props.check_all_used()
        return plugin

    def plugin_type(self, name: str) -> ObjectType:
        """The kind of the plugin `name`, also of those of Mitsuba's that djpt lacks; `Unknown` if there is none."""
        return KINDS.get((name and kind_of(name)) or mitsuba_kind_of(name) or "", ObjectType.Unknown)


_manager = PluginManager()

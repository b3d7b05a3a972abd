"""The instance that a hit belongs to."""

from __future__ import annotations

from typing import Any

from djpt.core.records.record import Record
from djpt.core.records.scene_ref import SceneRef, scene_of
from djpt.jit.types import UInt32

__all__ = ["Instanced"]


class Instanced(Record):
    """The part of a hit that tells the instance."""

    instances: tuple[UInt32, ...]
    """The index of the instance into ``scene.shapes()``; nothing in scenes without instances: see `instance`."""
    scene_ref: SceneRef

    @property
    def instance(self) -> Any:
        """The instance that was hit, a `djpt.ShapePtr`, null on other shapes; or what was assigned.

        None in a record that belongs to no scene. Known where a script asks a scene for the hit.
        """
        if "_instance" in self.__dict__:
            return self.__dict__["_instance"]
        return scene_of(self).instance_at(self) if self.scene_ref else None

    @instance.setter
    def instance(self, instance: Any) -> None:
        # Dr.Jit's operations don't carry it along.
        self.__dict__["_instance"] = instance

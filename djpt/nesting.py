"""What belongs to which shape: the emitters and sensors that stand in it, and the BSDF of one that has none."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from djpt.description.plugin import Plugin
from djpt.description.properties import Properties
from djpt.description.registry import registered
from djpt.errors import SceneError
from djpt.materials import BSDF, Diffuse
from djpt.shapes import Shape

__all__ = ["black", "collect", "default_bsdf"]


def collect(kind: str, plugins: Iterable[Plugin]) -> list[Any]:
    """All plugins of a kind, `emitter` or `sensor`, in order; those that stand in shapes learn their `shape`.

    Raises:
        SceneError: One stands where it can't.
    """
    found: list[Any] = []
    for plugin in plugins:
        if plugin.kind == kind:
            if plugin.on_shape and plugin.shape is None:  # type: ignore[attr-defined]
                raise SceneError(f"{plugin.id}: this {kind} must be nested in a shape")
            found.append(plugin)
        elif isinstance(plugin, Shape) and getattr(plugin, kind, None) is not None:
            found.append(adopt(plugin, getattr(plugin, kind)))
    return found


def adopt(shape: Shape, nested: Any) -> Any:
    """An emitter or sensor that is nested in a shape, told which one it is."""
    if not nested.on_shape:
        fitting = ", ".join(
            name for name, plugin in registered(nested.kind).items() if getattr(plugin, "on_shape", False)
        )
        raise SceneError(f"{shape.id}: the {nested.kind} '{nested.id}' can't be nested in a shape; possible: {fitting}")
    if nested.shape not in (None, shape):
        raise SceneError(f"{shape.id}: its {nested.kind} already belongs to '{nested.shape.id}'")
    nested.shape = shape
    return nested


def default_bsdf(shape: Shape) -> BSDF:
    """The BSDF of a shape that has none: grey 0.5, black if it emits."""
    name = f"{shape.id}.bsdf"
    return black(name) if shape.emitter is not None else Diffuse(Properties("diffuse", name, {"reflectance": 0.5}))


def black(name: str) -> BSDF:
    """A surface that reflects nothing."""
    return Diffuse(Properties("diffuse", name, {"reflectance": 0.0}))

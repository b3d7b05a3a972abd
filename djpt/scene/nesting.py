"""What belongs to which shape: the emitters and sensors that stand in it, and the BSDF of one that has none."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from typing import Any

from djpt.description.plugin import Plugin
from djpt.description.properties import Properties
from djpt.description.registry import registered
from djpt.emitters import Emitter
from djpt.errors import SceneError, near_miss
from djpt.geometry.aggregate import unseen
from djpt.materials import BSDF, Diffuse
from djpt.sensors import Sensor
from djpt.shapes import Shape

__all__ = ["black", "collect_emitters", "collect_sensors", "numbers"]


def collect_emitters(plugins: Iterable[Plugin]) -> list[Emitter]:
    """The emitters of a scene's `plugins`, in their order.

    A shape's emitter is numbered where the shape stands, whether it is nested there or the shape refers to an area
    light that stands in the scene: the latter by itself doesn't count. Emitters of shapes learn their `shape`. A
    warning tells of area lights that no shape refers to.

    Raises:
        SceneError: A shape's emitter can't be nested, or belongs to two shapes; or a shape that emits light stands in
            the scene twice.
    """
    found: list[Emitter] = []
    of_shapes: list[Emitter] = []
    for plugin in plugins:
        if isinstance(plugin, Shape) and plugin.emitter() is not None:
            adopt(plugin, plugin.emitter())
            if plugin.emitter() in found:
                raise SceneError(f"{plugin.id()}: a shape that emits light can't appear in the scene twice")
            found.append(plugin.emitter())
        elif isinstance(plugin, Emitter):
            (of_shapes if plugin.on_shape else found).append(plugin)
    for emitter in of_shapes:
        if emitter.shape is None:
            warnings.warn(f"{emitter.id()}: no shape refers to this emitter, so it emits no light", stacklevel=2)
    return found


def collect_sensors(plugins: Iterable[Plugin]) -> list[Sensor]:
    """The sensors of a scene's `plugins`, in their order.

    Those of shapes learn their `shape`. One that stands in the scene, and that a shape refers to, has two numbers.

    Raises:
        SceneError: A shape's sensor can't be nested, or belongs to two shapes.
    """
    found: list[Sensor] = []
    for plugin in plugins:
        if isinstance(plugin, Shape) and plugin.sensor() is not None:
            found.append(adopt(plugin, plugin.sensor()))
        elif isinstance(plugin, Sensor):
            found.append(plugin)
    return found


def adopt(shape: Shape, nested: Any) -> Any:
    """An emitter or sensor that a shape has, nested or by reference, told which shape that is."""
    if not nested.on_shape:
        fitting = (name for name, plugin in registered(nested.kind).items() if getattr(plugin, "on_shape", False))
        hint = near_miss("", fitting)
        raise SceneError(f"{shape.id()}: the {nested.kind} '{nested.id()}' can't be nested in a shape{hint}")
    if nested.shape not in (None, shape):
        raise SceneError(f"{shape.id()}: its {nested.kind} already belongs to '{nested.shape.id()}'")
    nested.shape = shape
    return nested


def numbers(shapes: Iterable[Shape], emitters: Sequence[Emitter]) -> tuple[list[BSDF], list[int], list[int]]:
    """The BSDFs of shapes, each once; per shape the number of its BSDF, and that of its emitter.

    The number of emitters stands for none.
    """
    bsdfs: list[BSDF] = []
    bsdf_of_shape: list[int] = []
    emitter_of_shape: list[int] = []
    for shape in shapes:
        if unseen(shape):
            bsdf_of_shape.append(0)
            emitter_of_shape.append(len(emitters))
            continue
        bsdf = shape.bsdf()
        if bsdf not in bsdfs:
            bsdfs.append(bsdf)
        bsdf_of_shape.append(bsdfs.index(bsdf))
        emitter_of_shape.append(len(emitters) if shape.emitter() is None else emitters.index(shape.emitter()))
    return bsdfs, bsdf_of_shape, emitter_of_shape


def black(name: str) -> BSDF:
    """A surface that reflects nothing."""
    return Diffuse(Properties("diffuse", name, {"reflectance": 0.0}))

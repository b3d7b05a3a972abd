"""Arbitrary output variables: what the camera sees besides light."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.description.plugin import TraversalCallback
from djpt.description.properties import Properties
from djpt.errors import SceneError, near_miss
from djpt.integrators.base import Integrator
from djpt.records import Ray3f, SurfaceInteraction3f
from djpt.samplers.base import SampleStream
from djpt.types import Bool, Color3f, Float, Vector2f, Vector3f

if TYPE_CHECKING:
    from djpt.scene import Scene

__all__ = ["AOV"]


def vector(v: Vector3f) -> list[Float]:
    """Three channels."""
    return [v.x, v.y, v.z]


def pair(v: Vector2f) -> list[Float]:
    """Two channels."""
    return [v.x, v.y]


VARIABLES: dict[str, tuple[str, Callable[[SurfaceInteraction3f], list[Float]]]] = {
    "albedo": ("RGB", lambda si: vector(si.bsdf().eval_diffuse_reflectance(si))),
    "depth": ("T", lambda si: [si.t]),
    "position": ("XYZ", lambda si: vector(si.p)),
    "uv": ("UV", lambda si: pair(si.uv)),
    "geo_normal": ("XYZ", lambda si: vector(si.n)),
    "sh_normal": ("XYZ", lambda si: vector(si.sh_frame.n)),
    "dp_du": ("XYZ", lambda si: vector(si.dp_du)),
    "dp_dv": ("XYZ", lambda si: vector(si.dp_dv)),
    "prim_index": ("I", lambda si: [Float(si.scene.primitive_index(si))]),
    "shape_index": ("I", lambda si: [Float(si.shape_index + 1)]),
}
"""Name of a variable -> names of its channels, and its value at a surface point."""


class AOV(Integrator):
    """Images of surface properties, after those of nested integrators.

    Parameters: `aovs`, a list ``name:variable, ..``: channels are called ``name.X`` and so on. The
    variables: `albedo`, `depth` (from the near plane), `position`, `uv`, `geo_normal`, `sh_normal`,
    `dp_du`, `dp_dv`, `prim_index`, `shape_index` (counted from 1; 0 is a miss). All are 0 on a miss,
    and filtered like colours. Nested integrators under any key render their images first; without
    one the image has AOV channels only.
    """

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.variables = parse(props.string("aovs"), props.node)
        self.nested: list[tuple[str, Integrator]] = props.children("integrator")
        for name, integrator in self.nested:
            if integrator.aov_names():
                raise SceneError(f"{props.node}.{name}: an integrator with AOVs of its own can't be nested")
        self.writes_color = bool(self.nested)
        self.needs_light = any(integrator.needs_light for _, integrator in self.nested)

    def traverse(self, callback: TraversalCallback) -> None:
        for i, (_, integrator) in enumerate(self.nested):
            callback.put(f"integrator_{i}", integrator)

    def aov_names(self) -> Sequence[str]:
        further = [f"{name}.{c}" for name, _ in self.nested[1:] for c in "RGB"]
        return further + [f"{name}.{c}" for name, kind in self.variables for c in VARIABLES[kind][0]]

    def sample(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, active: Bool | bool = True
    ) -> tuple[Color3f, Bool, list[Float]]:
        si = scene.ray_intersect(ray, active)
        valid = si.is_valid()
        color, covered, channels = Color3f(0), valid, list[Any]()
        for i, (_, integrator) in enumerate(self.nested):
            # Every integrator sees the numbers that it would see alone.
            nested_color, nested_valid, _ = integrator.sample(scene, sampler.clone(), ray, active)
            if i == 0:
                color, covered = nested_color, nested_valid
            else:
                channels += vector(nested_color)
        for _, kind in self.variables:
            channels += [dr.select(valid, c, 0) for c in VARIABLES[kind][1](si)]
        return color, covered, channels


def parse(text: str, node: str) -> list[tuple[str, str]]:
    """``name:variable, ..`` as pairs."""
    result: list[tuple[str, str]] = []
    for item in text.split(","):
        name, colon, kind = (part.strip() for part in item.partition(":"))
        if not (name and colon):
            raise SceneError(f"{node}: 'aovs' is a list of name:variable, found '{item.strip()}'")
        if kind not in VARIABLES:
            raise SceneError(f"{node}: unknown variable '{kind}' in 'aovs'{near_miss(kind, VARIABLES)}")
        if name in dict(result):
            raise SceneError(f"{node}: the name '{name}' appears twice in 'aovs'")
        result.append((name, kind))
    return result

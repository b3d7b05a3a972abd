"""Arbitrary output variables: what the camera sees besides light."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import Ray3f, SceneView, SurfaceInteraction3f
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.errors import SceneError, near_miss
from djpt.integrators.base import Integrator
from djpt.integrators.paths.nesting import NestingIntegrator
from djpt.jit.types import Bool, Color3f, Float, Vector2f, Vector3f
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["AOV"]


def vector(v: Vector3f) -> list[Float]:
    """The components of a vector, as three channels."""
    return [v.x, v.y, v.z]


def pair(v: Vector2f) -> list[Float]:
    """The components of a vector, as two channels."""
    return [v.x, v.y]


def start_distance(scene: SceneView, ray: Ray3f) -> Float:
    """The distance between the camera and the start of its ray."""
    # Without a near plane the ray may be unbounded.
    return dr.select(scene.near_clip_fraction > 0, ray.maxt * scene.near_clip_fraction, 0)


Variable = Callable[[SurfaceInteraction3f, Ray3f], "list[Float]"]
"""The channels of a variable at a surface point that the camera's ray hits."""

VARIABLES: dict[str, tuple[str, Variable]] = {
    "albedo": ("RGB", lambda si, ray: vector(si.bsdf().eval_diffuse_reflectance(si))),
    "depth": ("T", lambda si, ray: [si.t]),
    "distance": ("T", lambda si, ray: [si.t + start_distance(si.scene, ray)]),
    "position": ("XYZ", lambda si, ray: vector(si.p)),
    "uv": ("UV", lambda si, ray: pair(si.uv)),
    "geo_normal": ("XYZ", lambda si, ray: vector(si.n)),
    "sh_normal": ("XYZ", lambda si, ray: vector(si.bsdf().sh_frame(si).n)),
    "dp_du": ("XYZ", lambda si, ray: vector(si.dp_du)),
    "dp_dv": ("XYZ", lambda si, ray: vector(si.dp_dv)),
    "prim_index": ("I", lambda si, ray: [Float(si.scene.primitive_index(si))]),
    "shape_index": ("I", lambda si, ray: [Float(si.shape_index + 1)]),
}
"""Name of a variable -> names of its channels, and its value."""

LENGTHS = ("depth", "distance", "dp_du", "dp_dv")
"""The variables that are lengths, or consist of some."""

DIFFERENTIALS = ("duv_dx", "duv_dy")
"""Mitsuba's variables that need ray differentials, which djpt's cameras don't make."""


MOST = 256
"""Variables of one integrator: kernels have code for each."""


class AOV(NestingIntegrator):
    """Images of surface properties, after those of nested integrators.

    Parameters: `aovs`, a list ``name:variable, ..``: channels are called ``name.X`` and so on. The
    variables: `albedo`, `depth` (along the ray from where it starts, which is the near plane of a camera that has one),
    `distance` (along the ray from the camera: from the pinhole, from the point on the lens, or from the plane of an
    orthographic camera), `position`, `uv`, `geo_normal`, `sh_normal`, `dp_du`, `dp_dv`, `prim_index`, `shape_index`
    (counted from 1; 0 is a miss). All are 0 on a miss.

    `unfiltered` (default false): the variables are filtered like colours, so that on edges they are mixtures. If true,
    each pixel has the values of the one ray through its centre (of the lens, too), whatever `spp` and the filter are:
    indices are whole then. They carry no derivatives.

    Nested integrators under any key render their images first, filtered in either case; without one
    the image has AOV channels only. `distance` and `unfiltered` are djpt's own, all else is Mitsuba's.

    Derivatives: with one nested path tracer, its image has those that it has alone, by the same samples. Filtered
    variables have theirs by plain AD: of albedos by reflectances, for example.
    """

    pure = True
    in_any_frame = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.variables = parse(props.string("aovs"), props.node)
        self.unfiltered = props.boolean("unfiltered", False)
        for name, integrator in self.nested:
            if integrator.aov_names():
                raise SceneError(f"{props.node}.{name}: an integrator with AOVs of its own can't be nested")
        self.writes_color = bool(self.nested)
        self.measures_distance = any(kind == "distance" for _, kind in self.variables)
        if self.nested:
            self.run_as_nested()
        if self.runs_as_nested:
            # The colours by the estimator of the nested integrator, the properties by plain AD of `seen`.
            self.differentiable = self.path_tracer.differentiable and not self.path_tracer.renders_itself()
            if not self.unfiltered:
                # State machines ask camera rays for no channels.
                self.schedules = tuple(name for name in self.schedules if name in ("flat", "wave"))

    def beside_nested(self) -> AOV | None:
        if self.unfiltered:
            return None
        alone = copy(self)
        alone.nested, alone.runs_as_nested, alone.writes_color = [], False, False
        alone.schedules = Integrator.schedules
        return alone

    def aov_names(self) -> Sequence[str]:
        further = [f"{name}.{c}" for name, _ in self.nested[1:] for c in "RGB"]
        return further if self.unfiltered else further + self.variable_names()

    def unfiltered_names(self) -> Sequence[str]:
        return self.variable_names() if self.unfiltered else []

    def variable_names(self) -> list[str]:
        """The channels of the surface properties."""
        return [f"{name}.{c}" for name, kind in self.variables for c in VARIABLES[kind][0]]

    def sample(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, medium: Any = None, active: Bool | bool = True
    ) -> tuple[Color3f, Bool, list[Float]]:
        samples = self.samples(scene, sampler, ray, active)
        channels = [c for color, _, _ in samples[1:] for c in vector(color)]
        if self.unfiltered:
            color, covered, _ = samples[0]
            return color, covered, channels
        si = scene.ray_intersect(ray, active)
        channels += self.seen(si, ray)
        if not samples:
            return Color3f(0), si.is_valid(), channels
        color, covered, _ = samples[0]
        return color, covered, channels

    def camera_channels(self, scene: Scene, ray: Ray3f) -> list[Float]:
        return [] if self.unfiltered else self.seen(scene.ray_intersect(ray), ray)

    def unfiltered_channels(self, scene: Scene, ray: Ray3f) -> list[Float]:
        return self.seen(scene.ray_intersect(ray), ray)

    def seen(self, si: SurfaceInteraction3f, ray: Ray3f) -> list[Float]:
        """The channels of all variables at a surface point."""
        valid = si.is_valid()
        return [dr.select(valid, c, 0) for _, kind in self.variables for c in channels_of(kind, si, ray)]


def channels_of(kind: str, si: SurfaceInteraction3f, ray: Ray3f) -> list[Float]:
    """The channels of a variable, in the units of the scene's description."""
    channels, units = VARIABLES[kind][1](si, ray), si.scene.units
    if units is not None and kind == "position":
        return vector(units.point(si.p))
    if units is not None and kind in LENGTHS:
        return [units.length(c) for c in channels]
    return channels


def parse(text: str, node: str) -> list[tuple[str, str]]:
    """Parse ``name:variable, ..`` into pairs; raise `SceneError` if it isn't a list of known variables."""
    result: list[tuple[str, str]] = []
    items = text.split(",")
    if len(items) > MOST:
        raise SceneError(f"{node}: 'aovs' can have up to {MOST} variables, found {len(items)}")
    for item in items:
        name, colon, kind = (part.strip() for part in item.partition(":"))
        if not (name and colon):
            raise SceneError(f"{node}: 'aovs' is a list of name:variable, found '{item.strip()}'")
        if kind in DIFFERENTIALS:
            needed = "ray differentials, which djpt doesn't have"
            raise SceneError(f"{node}: '{kind}' in 'aovs' needs {needed}{near_miss('', VARIABLES)}")
        if kind not in VARIABLES:
            raise SceneError(f"{node}: unknown variable '{kind}' in 'aovs'{near_miss(kind, VARIABLES)}")
        if name in dict(result):
            raise SceneError(f"{node}: the name '{name}' appears twice in 'aovs'")
        result.append((name, kind))
    return result


register_integrator("aov", AOV)

"""The contracts of integrators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import drjit as dr

from djpt.description.plugin import Plugin
from djpt.description.properties import Properties
from djpt.kernels import wide
from djpt.records import Ray3f, SurfaceInteraction3f
from djpt.samplers.base import SampleStream
from djpt.types import Bool, Color3f, Float, Normal3f, Point3f, UInt32

if TYPE_CHECKING:
    from djpt.scene import Scene
    from djpt.sensors.base import Sensor

__all__ = ["Integrator", "PathIntegrator", "PathState", "Vertex", "mis_weight"]


class Integrator(Plugin):
    """Estimates the radiance along camera rays.

    The smallest integrator overrides `sample` and nothing else: it is then run with one lane per
    sample, and differentiated by Dr.Jit's automatic differentiation of its code.

    Parameters of all integrators: `hide_emitters` (default false): camera rays pass through
    area lights and see no environment.
    """

    kind: ClassVar[str] = "integrator"

    needs_light = False
    """Is every image black without an emitter? `render` then refuses."""
    shows_delta = True
    """Does light get around by mirrors and panes? If not, `render` warns of such materials."""
    samples_lights = True
    """Does it ask emitters for directions? If not, `render` warns of those that no path meets, such as points."""
    stepwise = False
    """Does it advance vertex by vertex (see `PathIntegrator`), so that schedules are free in how they fill lanes?"""
    differentiable = True
    """Can its code be differentiated? If not, `render` refuses parameters with gradients."""
    starts_at_lights = False
    """Are rays traced from emitters? Those that shine in one direction only are seen in no other way."""
    emitter_choice = "uniform"
    """How light sampling chooses emitters: see `djpt.emitters.choice`."""
    writes_color = True
    """False if the image consists of AOVs alone."""
    measures_distance = False
    """Does it need to know how far from the camera rays start: `Scene.near_share`?"""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.hide_emitters = props.boolean("hide_emitters", False)

    def check_scene(self, scene: Scene, sensor: Sensor) -> None:
        """Raise `RenderError` if there is nothing that this integrator can show to the sensor."""

    def sample(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, active: Bool | bool = True
    ) -> tuple[Color3f, Bool, list[Float]]:
        """Radiance along `ray`, whether it counts as covered (alpha), and one value per AOV."""
        raise NotImplementedError

    def aov_names(self) -> Sequence[str]:
        """Names of the extra channels that `sample` returns."""
        return ()

    def unfiltered_names(self) -> Sequence[str]:
        """Names of channels, after all others, that come from one ray through the centre of each pixel."""
        return ()

    def unfiltered_channels(self, scene: Scene, ray: Ray3f) -> list[Float]:
        """The values of these channels along `ray`."""
        return []


@dataclass
class PathState:
    """What a path carries from one vertex to the next."""

    p: Point3f
    """The previous vertex, before rays were moved off its surface."""
    throughput: Color3f
    """Product of the weights f abs(cos) / pdf so far, Russian roulette included."""
    bsdf_pdf: Float
    """Density with which the BSDF chose the current ray; 0 if light sampling couldn't have (camera, delta)."""
    eta: Float | None
    """Product of relative indices of refraction; None in scenes without refraction."""
    depth: UInt32
    """Vertices so far."""
    n: Normal3f | None = None
    """Geometric normal of the previous vertex; None if the choice of emitters doesn't look at it."""
    covered: Bool | None = None
    """Has a vertex been met that isn't a mere opening (a null interface)? None in scenes without such."""
    body: UInt32 | None = None
    """The absorbing body that the ray runs through: see `djpt.media.interior`; None in scenes without any."""


@dataclass
class Vertex:
    """What happened at a path vertex.

    Contributions include the throughput. Where the scene's values are attached to AD leaves,
    `emitted`, `reflected` and `weight` are attached as well; all else is detached.
    """

    emitted: Color3f
    """Light from the vertex itself, weighted against light sampling."""
    reflected: Color3f
    """Light of the sampled emitter, to be added if `shadow_ray` is free."""
    shadow_ray: Ray3f
    weight: Color3f
    """f abs(cos) / pdf of the sampled direction."""
    ray: Ray3f
    """The continuation."""
    state: PathState
    active: Bool
    """Does the path go on?"""
    valid: Bool
    """Does the sample count as covered, if the path ends here?"""


class PathIntegrator(Integrator):
    """An estimator that advances one path vertex at a time.

    Between two ray queries lies one call of `vertex`. It makes at most one shadow query and one
    continuation, so schedules are free in how they fill lanes, and the replay for gradients calls
    the same code.
    """

    needs_light = True
    stepwise = True

    @property
    def longest_path(self) -> int:
        """Vertices of the longest path; -1: unbounded."""
        return -1

    def start(self, scene: Scene) -> PathState:
        """The state of a path that is about to trace its camera ray."""
        raise NotImplementedError

    def vertex(
        self, scene: Scene, sampler: SampleStream, state: PathState, ray: Ray3f, si: SurfaceInteraction3f
    ) -> Vertex:
        """Process the hit (or miss) `si` of `ray`."""
        raise NotImplementedError

    def passes_lights(self, state: PathState) -> Bool | None:
        """Where the next ray ignores shapes that emit; None: nowhere."""
        return state.depth == 0 if self.hide_emitters else None

    def trace(self, scene: Scene, state: PathState, ray: Ray3f) -> SurfaceInteraction3f:
        """The next hit of a path."""
        pi = scene.closest_hit(ray, through_lights=self.passes_lights(state))
        return scene.surface_interaction(ray, pi, full=scene.needs_uv)

    def sample(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, active: Bool | bool = True
    ) -> tuple[Color3f, Bool, list[Float]]:
        parts, valid = self.walk(scene, sampler, ray, active)
        return parts[0], valid, []

    def walk(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, active: Bool | bool = True, bounces: int = 0
    ) -> tuple[list[Color3f], Bool]:
        """All vertices of one path per lane: radiance and whether it is covered.

        With `bounces` = n, the radiance comes in n parts: by how often light was scattered, 0 to n - 1 times.
        """
        lanes = dr.width(ray, sampler)
        start = PathLoop(
            ray=wide(ray, lanes),
            sampler=sampler,
            state=wide(self.start(scene), lanes),
            radiance=[dr.zeros(Color3f, lanes) for _ in range(max(1, bounces))],
            valid=dr.full(Bool, False, lanes),
            active=Bool(active) & dr.full(Bool, True, lanes),
        )

        def body(lane: PathLoop) -> tuple[PathLoop]:
            si = self.trace(scene, lane.state, lane.ray)
            v = self.vertex(scene, lane.sampler, lane.state, lane.ray, si)
            visible = scene.unoccluded(v.shadow_ray)
            reflected, depth = dr.select(visible, v.reflected, 0), lane.state.depth
            if bounces:
                radiance = [
                    r + dr.select(depth == k, v.emitted, dr.select(depth + 1 == k, reflected, 0))
                    for k, r in enumerate(lane.radiance)
                ]
            else:
                radiance = [lane.radiance[0] + v.emitted + reflected]
            valid = dr.select(v.active, lane.valid, v.valid)
            return (PathLoop(v.ray, lane.sampler, v.state, radiance, valid, v.active),)

        (end,) = dr.while_loop((start,), lambda lane: lane.active, body, label=type(self).__name__)
        return end.radiance, end.valid


@dataclass
class PathLoop:
    """Loop state of one path per lane."""

    ray: Ray3f
    sampler: SampleStream
    state: PathState
    radiance: list[Color3f]
    valid: Bool
    active: Bool


def mis_weight(pdf_a: Float, pdf_b: Float) -> Float:
    """Power heuristic a^2 / (a^2 + b^2) of strategy a (Veach and Guibas 1995); 0 if both are 0."""
    a, b = dr.square(pdf_a), dr.square(pdf_b)
    weight = a * dr.rcp(a + b)
    return dr.select(dr.isfinite(weight), weight, 0)

"""The contracts of integrators, one path per lane, and warnings of light and media that an integrator can't show."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import drjit as dr

from djpt.core.records import (
    BSDFFlags,
    EmitterFlags,
    PreliminaryIntersection3f,
    Ray3f,
    Reference,
    SurfaceInteraction3f,
    has_flag,
)
from djpt.description.plugin import Plugin
from djpt.description.properties import Properties
from djpt.errors import RenderError
from djpt.jit.kernels import loop_traced_once, wide
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point3f, TensorXf, UInt32, Vector3f
from djpt.samplers.base import SampleStream
from djpt.scene.scene import require_scene

if TYPE_CHECKING:
    from djpt.scene.scene import Scene
    from djpt.sensors.base import Sensor

__all__ = [
    "Integrator",
    "PathIntegrator",
    "PathState",
    "SamplingIntegrator",
    "Vertex",
    "mis_weight",
    "refuse_scattering_media",
    "trace_path",
]


class Integrator(Plugin):
    """Estimates the radiance along camera rays.

    The smallest integrator overrides `sample` and nothing else: it is then run with one lane per
    sample, and differentiated by Dr.Jit's automatic differentiation of its code. Estimators that follow
    paths derive from `PathIntegrator`, those that start at the lights or need several passes from
    `djpt.integrators.paths.passes.PassIntegrator`.

    Parameters of all integrators: `hide_emitters` (default false): camera rays pass through
    area lights and see no environment; `unproven_gradients` (default false): derivatives that are known to be wrong
    are computed all the same, in place of an error (see `djpt.rendering.gradients.unproven`); `samples_per_pass` and
    `block_size` (without effect, for Mitsuba's scenes: the size of passes follows from memory and time).
    """

    kind: ClassVar[str] = "integrator"

    schedules: tuple[str, ...] = ("wave",)
    """The schedules that can run it, by their modules: see `djpt.rendering.schedules`."""

    needs_light = False
    """True if every image is black without an emitter: `render` then refuses."""
    shows_delta = True
    """True if mirrors and panes are followed; else `check_scene` warns of such materials."""
    samples_lights = True
    """True if emitters are asked for directions; else `check_scene` warns of those that no path meets."""
    starts_at_lights = False
    """True if rays are traced from emitters: the only way to show those that shine in one direction only."""
    follows_motion = True
    """True if the rays of a path keep the time of its sample. Else what moves is rendered as a mean of still scenes."""
    differentiable = True
    """True if its code can be differentiated; else `render` refuses parameters with gradients."""
    emitter_choice = "uniform"
    """The way that light sampling chooses emitters: see `djpt.emitters.light_samplers`."""
    writes_color = True
    """False if the image consists of AOVs alone."""
    follows_media = False
    """True if light can be scattered on the way between surfaces: see `Scene.replace`."""
    follows_overlaps = False
    """True if paths follow bodies that overlap by their priorities: see `djpt.geometry.overlapping`."""
    measures_distance = False
    """True if it needs to know how far from the camera rays start: `Scene.near_clip_fraction`."""

    holds_sums: ClassVar[bool] = False
    """True if its passes go over the whole image, whose sums are held from one to the next."""

    pure: ClassVar[bool] = False
    """True if its methods do nothing but trace kernels: they ask samplers only for what a `SampleStream` has, return
    the types of the contract, and leave nothing behind in Python, so that rounds can be recorded. Else `sample` is
    given a whole `Sampler`, and may return Python's numbers. Counts for the class that says so, not for those derived
    from it."""

    follows_silhouettes: ClassVar[bool] = False
    """True if derivatives by the place of shapes know what appears and disappears at their outlines."""

    follows_shapes: ClassVar[bool] = False
    """True if djpt's schedules let its paths move with shapes: see `djpt.rendering.gradients.moving_light_paths`."""

    follows_camera: ClassVar[bool] = False
    """True if derivatives by the place of a camera are known, also through media: see
    `djpt.rendering.gradients.camera_in_media`."""

    unproven_gradients: bool = False
    """True if derivatives that are known to be wrong are computed all the same: see
    `djpt.rendering.gradients.unproven`."""

    _cancelled = False

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.hide_emitters = props.boolean("hide_emitters", False)
        self.unproven_gradients = props.boolean("unproven_gradients", False)
        props.integer("samples_per_pass", -1)
        props.integer("block_size", 0)

    @property
    def path_tracer(self) -> Integrator:
        """The integrator whose paths are advanced vertex by vertex: this one, or one that is nested in it."""
        return self

    def beside_nested(self) -> Integrator | None:
        """The integrator of the channels that it has beside the image of `path_tracer`; None if there are none.

        For those that run as one that is nested in them, and that say they are `differentiable`.
        """
        return None

    def sample_channels(self, color: Color3f, valid: Bool) -> list[Float]:
        """The values of `aov_names` for a finished sample of `path_tracer`: its colour, and whether it is covered."""
        return []

    def camera_channels(self, scene: Scene, ray: Ray3f) -> list[Float]:
        """The last values of `aov_names`, after `sample_channels`: those that follow from the camera ray of a sample.

        The schedule `machine` asks for none, nor does that for media.
        """
        return []

    @property
    def stepwise(self) -> bool:
        """True if it advances vertex by vertex, so that paths can be replayed: see `PathIntegrator`."""
        return "flat" in self.schedules

    @property
    def replays(self) -> bool:
        """True if derivatives are by path replay, with the memory of a picture; else by plain AD of its code."""
        return self.stepwise or self.starts_at_lights

    def fits_any_frame(self) -> bool:
        """True if it, and what is nested in it, is known to render the same `in_any_frame`."""
        return self.says("in_any_frame")

    def is_pure(self) -> bool:
        """True if it, and what is nested in it, is `pure`."""
        return self.says("pure")

    def check_scene(self, scene: Scene, sensor: Sensor) -> None:
        """Warn of what this integrator can't show, or raise `RenderError` if that is all there is."""
        warn_of_unrendered(self, scene)

    def attached_image(self, scene: Scene, sensor: Any, seed: Any, spp: int) -> Any:
        """The image of an integrator that renders by itself, attached to what the view `scene` reads.

        Its graph can be traversed again and again. None if derivatives aren't those of a graph.
        """
        return None

    def prepare_scene(self, scene: Scene) -> None:
        """Let the scene compute what this integrator will ask for, and what depends on the values of parameters.

        Called before a frozen function renders: while one is recorded, values can't be read.
        """
        scene.lights.choice  # noqa: B018
        if self.starts_at_lights:
            scene.lights.brightness  # noqa: B018

    def sample(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, medium: Any = None, active: Bool | bool = True
    ) -> tuple[Color3f, Bool, list[Float]]:
        """Radiance along `ray`, whether it counts as covered (alpha), and one value per AOV.

        `medium` is only there for the signature: a ray knows the medium that it runs through.
        """
        raise NotImplementedError

    def sample_nested(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, active: Bool | bool
    ) -> tuple[Color3f, Bool, list[Float]]:
        """`sample` for an integrator that this one is nested in."""
        return self.sample(scene, sampler, ray, None, active)

    def renders_itself(self) -> bool:
        """True if it overrides `render`; then it asks samplers for more than a `SampleStream` has."""
        return type(self).render is not Integrator.render

    def render(
        self,
        scene: Scene,
        sensor: Any = 0,
        seed: Any = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> TensorXf:
        """Render an image of a scene with this integrator.

        It is that of `djpt.render`; derivatives are by the samples of the image itself.

        A class that overrides it renders by itself, and differentiates by `render_forward` and `render_backward`.

        Args:
            scene: What `load_dict` returned.
            sensor: Index into ``scene.sensors()``, or a sensor.
            seed: Seed of the image.
            spp: Samples per pixel; 0 takes the sampler's.
            develop: Whether to return the image; else it is left to the film, see `djpt.films.HDRFilm.develop`.
            evaluate: Whether to compute it at once; always done here.
        """
        image = require_scene(scene).renderer.film_image(scene, sensor, self, seed, spp)
        return image if develop else TensorXf()

    def render_forward(self, scene: Scene, params: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0) -> TensorXf:
        """The change (H, W, C) of the image that the gradients set on the scene's parameters cause."""
        return require_scene(scene).renderer.image_derivative(scene, self, sensor, seed, spp, None)

    def render_backward(
        self, scene: Scene, params: Any, grad_in: TensorXf, sensor: Any = 0, seed: Any = 0, spp: int = 0
    ) -> None:
        """Add the gradients that follow from those of the image, `grad_in` (H, W, C), to the scene's parameters."""
        require_scene(scene).renderer.image_derivative(scene, self, sensor, seed, spp, grad_in)

    def skip_area_emitters(
        self, scene: Scene, ray: Ray3f, coherent: bool = False, active: Bool | bool = True
    ) -> PreliminaryIntersection3f:
        """The first hit of a ray with a shape that doesn't emit: for `hide_emitters`.

        `coherent` is there for the signature.
        """
        return scene.closest_hit(ray, active, through_lights=Bool(True))

    def cancel(self) -> None:
        """Ask a rendering to stop, from its `progress` function or another thread: it raises `RenderError`."""
        self._cancelled = True

    def should_stop(self) -> bool:
        """True if `cancel` was called since the rendering began."""
        return self._cancelled

    def resume(self) -> None:
        """Forget `cancel`: a rendering begins."""
        self._cancelled = False

    def aov_names(self) -> Sequence[str]:
        """Names of the extra channels that `sample` returns."""
        return ()

    def unfiltered_names(self) -> Sequence[str]:
        """Names of channels, after all others, that come from one ray through the centre of each pixel."""
        return ()

    def held_bytes(self) -> int:
        """An estimate of the memory that it takes besides samples and images."""
        return 0

    def layer_names(self) -> Sequence[str]:
        """Names of the channels of further images, after all others: see `SplattingIntegrator`."""
        return ()

    def unfiltered_channels(self, scene: Scene, ray: Ray3f) -> list[Float]:
        """The values of the channels `unfiltered_names` along `ray`."""
        return []


SamplingIntegrator = Integrator
"""Mitsuba's name: every integrator of djpt has a method `sample`."""

SMALL = 1e-3
"""Smaller factors are kept apart: dividing by them would amplify the rounding errors of products that contain them."""

State = TypeVar("State", bound="PathState")


@dataclass
class PathState:
    """The state of a path between two vertices.

    An integrator that carries more derives a dataclass from it, returns that from `start`, and passes it on with
    `dataclasses.replace`.
    """

    keeps: ClassVar[tuple[str, ...]] = ("p", "n")
    """Fields that need no reset where a new path begins: the previous vertex isn't read before there is one."""

    p: Point3f
    """The previous vertex, before rays were moved off its surface."""
    throughput: Color3f
    """Product of the weights f abs(cos) / pdf so far, Russian roulette and media included."""
    bsdf_pdf: Float
    """Density with which the BSDF chose the current ray; 0 if light sampling couldn't have (camera, delta)."""
    eta: Float | None
    """Product of relative indices of refraction; None in scenes without refraction."""
    depth: UInt32
    """The number of vertices so far."""
    n: Normal3f | None = None
    """Geometric normal of the previous vertex; None if the light sampler doesn't use it."""
    covered: Bool | None = None
    """True once a vertex was met that isn't a null interface; None in scenes without null interfaces."""
    zero_weight: Color3f | None = None
    """While the derivatives of materials or media are replayed, the factor of each channel that was set aside, or 1:
    see `weighted`. Else None."""

    @property
    def reference(self) -> Reference:
        """The previous vertex as the reference point of light sampling."""
        return Reference(self.p, self.n)

    def weighted(self: State, weight: Color3f, differs: Callable[[], Bool]) -> State:
        """The state with its throughput times the weight of a vertex; of `weight` and throughput only values count.

        A weight of 0 ends a channel, and what would have come along it is never found; but its product with a
        derivative of the weight may not be 0. So in replays the first weight of each channel that is too small to
        divide by becomes its `zero_weight`, instead of being multiplied, where the vertex `differs`: has a weight with
        derivatives, in a direction that could be sampled.
        """
        factor = dr.detach(weight)
        if self.zero_weight is None or not dr.grad_enabled(weight):
            return replace(self, throughput=self.throughput * factor)
        small = (self.zero_weight == 1) & (dr.abs(factor) < SMALL) & differs()
        throughput = self.throughput * dr.select(small, 1, factor)
        return replace(self, throughput=throughput, zero_weight=dr.select(small, factor, self.zero_weight))

    def restarted(self: State, ended: Bool, fresh: State) -> State:
        """The state `fresh` where a path has `ended`."""

        def either(name: str, mine: Any) -> Any:
            return mine if mine is None or name in self.keeps else dr.select(ended, getattr(fresh, name), mine)

        return type(self)(**{name: either(name, mine) for name, mine in vars(self).items()})


@dataclass
class Vertex:
    """The result of a path vertex.

    Contributions include the throughput. Where the scene's values are attached to AD leaves,
    `emitted`, `reflected` and `weight` are attached as well; all else is detached.
    """

    emitted: Color3f
    """Light from the vertex itself, weighted against light sampling."""
    reflected: Color3f
    """Light of the sampled emitter before visibility is tested: see `Scene.transmittance`."""
    shadow_ray: Ray3f
    """The ray from the vertex to the sampled emitter."""
    weight: Color3f
    """f abs(cos) / pdf of the sampled direction."""
    ray: Ray3f
    """The continuation."""
    state: PathState
    """The state of the continued path."""
    active: Bool
    """True where the path continues."""
    valid: Bool
    """True where the sample counts as covered, if the path ends here."""
    lit: Bool | None = None
    """True where the sampled emitter would shine if it and the material weren't black; None: where `reflected` isn't
    black. Asked for derivatives only."""


class PathIntegrator(Integrator):
    """An estimator that advances one path vertex at a time.

    Between two ray queries lies one call of `vertex`. It makes at most one shadow query and one
    continuation, so schedules are free in how they fill lanes, and the replay for gradients calls
    the same code.
    """

    schedules: tuple[str, ...] = ("flat", "machine", "wave")
    needs_light = True

    @property
    def longest_path(self) -> int:
        """The number of vertices of the longest path; -1: unbounded."""
        return -1

    def start(self, scene: Scene) -> PathState:
        """The state of a path that is about to trace its camera ray."""
        raise NotImplementedError

    def begin(self, scene: Scene, sampler: SampleStream) -> PathState:
        """`start`, for integrators that draw numbers before the first ray; needs a schedule other than `machine`."""
        return self.start(scene)

    def vertex(
        self, scene: Scene, sampler: SampleStream, state: PathState, ray: Ray3f, si: SurfaceInteraction3f
    ) -> Vertex:
        """Process the hit (or miss) `si` of `ray`."""
        raise NotImplementedError

    def passes_lights(self, state: PathState) -> Bool | None:
        """True where the next ray ignores shapes that emit; None if no ray does."""
        return state.depth == 0 if self.hide_emitters else None

    def path_passes_lights(self, state: PathState, shadow: Bool) -> Bool | None:
        """True where the next ray, if it isn't a shadow ray, ignores shapes that emit; None if no ray does."""
        through = self.passes_lights(state)
        return None if through is None else through & ~shadow

    def trace(
        self, scene: Scene, state: PathState, ray: Ray3f, sampler: SampleStream | None = None
    ) -> SurfaceInteraction3f:
        """The next hit of a path.

        It may leave out hits that `advance` won't ask for, if it knows the `sampler` that is to be given there; nothing
        is drawn from it.
        """
        pi = scene.closest_hit(ray, through_lights=self.passes_lights(state))
        return scene.surface_interaction(ray, pi, scene.surface_detail)

    def searches_pairs(self, scene: Scene) -> bool:
        """Whether `trace` and `transmittance` may be one search, `SceneQueries.next_hit`."""
        plain, own = PathIntegrator, type(self)
        return scene.geometry.searches_pairs and own.trace is plain.trace and own.transmittance is plain.transmittance

    def advance(
        self, scene: Scene, sampler: SampleStream, state: PathState, ray: Ray3f, si: SurfaceInteraction3f
    ) -> Vertex:
        """Process a hit by `vertex`, with the absorption between the previous vertex and this one included."""
        passed = scene.media.transmittance(ray, si.t)
        v = self.vertex(scene, sampler, replace(state, throughput=state.throughput * passed), ray, si)
        # The throughput has the value of `passed` already.
        if dr.grad_enabled(passed):
            value = dr.detach(passed)
            v.weight = v.weight * dr.select(value > 0, passed * dr.rcp(value), 1)
        return v

    def transmittance(self, scene: Scene, sampler: SampleStream, v: Vertex) -> Color3f:
        """The transmittance of `v.shadow_ray`, times `v.reflected`; the schedule `machine` doesn't ask for it."""
        return scene.transmittance(v.shadow_ray, v.reflected, v.lit if dr.grad_enabled(v.reflected) else None)

    def sample(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, medium: Any = None, active: Bool | bool = True
    ) -> tuple[Color3f, Bool, list[Float]]:
        parts, valid = trace_path(self, scene, sampler, ray, active)
        return parts[0], valid, []


def mis_weight(pdf_a: Float, pdf_b: Float) -> Float:
    """Power heuristic a^2 / (a^2 + b^2) of strategy a (Veach and Guibas 1995); 0 if both are 0."""
    a, b = dr.square(pdf_a), dr.square(pdf_b)
    weight = a * dr.rcp(a + b)
    return dr.select(dr.isfinite(weight), weight, 0)


def scattering_media(scene: Scene) -> list[str]:
    """The names of a scene's media that scatter light."""
    return [medium.id() for medium in scene.every_medium.plugins if medium.phase is not None]


def refuse_scattering_media(name: str, scene: Scene) -> None:
    """Raise `RenderError` if a scene has media that the integrator of this name can't follow light through."""
    found = scattering_media(scene)
    if found:
        raise RenderError(
            f"'{name}' doesn't follow light through scattering media, found {', '.join(found)}; "
            "possible: the integrator 'volpath'"
        )


def warn_of_unrendered(integrator: Integrator, scene: Scene) -> None:
    """Warn of the materials and lights of a scene that stay black, and of its media that don't show.

    No number of samples changes that.
    """
    name = type(integrator).__name__
    delta = [bsdf.id() for bsdf in scene.bsdfs.plugins if has_flag(bsdf.flags(), BSDFFlags.Delta)]
    if delta and not integrator.shows_delta:
        warn(
            f"'{name}' without BSDF samples can't show mirrors, smooth glass or openings: "
            f"these lobes of {', '.join(delta)} stay black"
        )
    unseen = scattering_media(scene)
    if unseen and integrator.needs_light and not integrator.follows_media:
        warn(
            f"'{name}' doesn't follow light through media: it leaves out {', '.join(unseen)}; "
            "render with the integrator 'volpath'"
        )
    if integrator.starts_at_lights or not integrator.needs_light:
        return
    lights = [e for e in scene.emitters() if has_flag(e.flags(), EmitterFlags.Delta)]
    beams = [e.id() for e in lights if e.on_shape]
    if beams:
        warn(f"'{name}' can't show light that leaves a surface in one direction only: {stay_black(beams)}")
    points = [] if integrator.samples_lights else [e.id() for e in lights if not e.on_shape]
    if points:
        warn(
            f"'{name}' doesn't sample lights, and finds none that is a point or shines in one direction by "
            f"chance: {stay_black(points)}"
        )


def warn(message: str) -> None:
    """Warn the caller of `render`, which checks the scene by way of `make_job` and `Integrator.check_scene`."""
    warnings.warn(message, stacklevel=levels_to_caller())


def stay_black(names: Sequence[str]) -> str:
    """``a stays black``, ``a, b stay black``."""
    return f"{', '.join(names)} stay{'s' if len(names) == 1 else ''} black"


def levels_to_caller() -> int:
    """The levels from the calling function up to the code outside of djpt that called it, for `warnings.warn`."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).split(".")[0] == "djpt":
        level, frame = level + 1, frame.f_back
    return level


@dataclass
class PathLoop:
    """Loop state of one path per lane."""

    o: Point3f
    d: Vector3f
    medium: UInt32 | None
    times: Any
    """Time of the ray, see `Ray3f.times`: a tuple, whose type Dr.Jit needn't know."""
    sampler: SampleStream
    state: Any
    """A `PathState`; the type is `Any`, because Dr.Jit would look for the name in this module."""
    radiance: list[Color3f]
    valid: Bool
    active: Bool


def trace_path(
    integrator: PathIntegrator,
    scene: Scene,
    sampler: SampleStream,
    ray: Ray3f,
    active: Bool | bool = True,
    bounces: int = 0,
    state: PathState | None = None,
) -> tuple[list[Color3f], Bool]:
    """Follow one path per lane to its end, and return its radiance and whether it counts as covered.

    With `bounces` = n, the radiance comes in n parts, for light that was scattered 0 to n - 1 times. Paths begin as
    the integrator says, or with a given `state`.
    """
    lanes = dr.width(ray, sampler)
    start = PathLoop(
        o=wide(ray.o, lanes),
        d=wide(ray.d, lanes),
        medium=wide(ray.medium, lanes),
        times=wide(ray.times, lanes),
        sampler=sampler,
        state=wide(integrator.begin(scene, sampler) if state is None else state, lanes),
        radiance=[dr.zeros(Color3f, lanes) for _ in range(max(1, bounces))],
        valid=dr.full(Bool, False, lanes),
        active=Bool(active) & dr.full(Bool, True, lanes),
    )

    def body(lane: PathLoop) -> tuple[PathLoop]:
        # Only the first ray may have an end. As loop state it would nearly always stay infinite, and Dr.Jit traces
        # a loop again when it finds that something stays what it is.
        way = Ray3f(lane.o, lane.d, maxt=dr.select(lane.state.depth == 0, ray.maxt, dr.inf), medium=lane.medium)
        way.times = lane.times
        si = integrator.trace(scene, lane.state, way, lane.sampler)
        v = integrator.advance(scene, lane.sampler, lane.state, way, si)
        reflected, depth = integrator.transmittance(scene, lane.sampler, v), lane.state.depth
        if bounces:
            radiance = [
                r + dr.select(depth == k, v.emitted, dr.select(depth + 1 == k, reflected, 0))
                for k, r in enumerate(lane.radiance)
            ]
        else:
            radiance = [lane.radiance[0] + v.emitted + reflected]
        valid = dr.select(v.active, lane.valid, v.valid)
        on = v.ray
        return (PathLoop(on.o, on.d, on.medium, on.times, lane.sampler, v.state, radiance, valid, v.active),)

    (end,) = loop_traced_once(start, lambda lane: lane.active, body, type(integrator).__name__)
    return end.radiance, end.valid

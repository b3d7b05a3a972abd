"""`find_nan`: where a NaN or an infinity in an image or a gradient comes from."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.core.records import BSDFContext
from djpt.description.parameters import SceneParameters, traverse
from djpt.dispatch.ensemble import Detached, Leaf, TableLeaf
from djpt.errors import ParameterError
from djpt.integrators.base import PathIntegrator, Vertex
from djpt.jit.kernels import wide
from djpt.jit.types import Bool, Color3f, TensorXf, UInt32
from djpt.rendering.gradients.leaves import Leaves, Numbering, attached_parameters
from djpt.rendering.gradients.modes import Mode
from djpt.rendering.gradients.zero_weights import begun, blank
from djpt.rendering.image import make_job
from djpt.rendering.render import render
from djpt.rendering.schedules.job import Job
from djpt.rendering.settings import RenderSettings
from djpt.scene.scene import Scene

__all__ = ["NonFinite", "find_nan"]

LANES = 2**18
"""The number of samples that are traced at once, one vertex after the other, with all results in memory."""

LONGEST = 1000
"""The number of vertices after which a path is given up."""


@dataclass(frozen=True)
class NonFinite:
    """The first number found that isn't finite. What isn't known is None.

    * `where`: ``image``, ``loss`` or ``gradient``.
    * `quantity`: what isn't finite there, such as ``the light sample`` or ``the derivative of the outgoing light``.
    * `value`: the number, ``nan``, ``inf`` or ``-inf``.
    * `plugin`: the name of the plugin that computed it; `parameter`: the key of the parameter that it comes from.
    * `pixel`: column and row on the film; `sample`: the number of the sample in the pixel; `vertex`: the number of
      the path vertex, 0 where the camera ray ends.
    """

    where: str
    quantity: str
    value: float
    plugin: str | None = None
    parameter: str | None = None
    pixel: tuple[int, int] | None = None
    sample: int | None = None
    vertex: int | None = None

    def __str__(self) -> str:
        parts = [f"{self.where}: {self.quantity} is {self.value}"]
        if self.plugin is not None:
            parts.append(f"plugin '{self.plugin}'")
        if self.parameter is not None:
            parts.append(f"parameter '{self.parameter}'")
        if self.pixel is not None:
            parts.append(f"pixel {self.pixel}")
        if self.sample is not None:
            parts.append(f"sample {self.sample}")
        if self.vertex is not None:
            parts.append(f"vertex {self.vertex}")
        return ", ".join(parts)


def find_nan(
    scene: Scene,
    keys: str | Sequence[str] = (),
    *,
    loss: Callable[[TensorXf], Any] | None = None,
    sensor: Any = 0,
    integrator: Any = None,
    seed: int = 0,
    spp: int = 0,
) -> NonFinite | None:
    """Find a NaN or an infinity in an image of a scene, or in the gradient of a loss, and where it comes from.

    First the image is rendered, with the same arguments as by `djpt.render`. If a pixel isn't finite, the samples that
    reach it are traced again, vertex by vertex, until a factor isn't. If all pixels are finite and there are `keys`,
    the gradient of the loss is computed; if an entry isn't finite, all samples of the gradient are replayed vertex by
    vertex, and each lane's own derivatives are looked at. This takes the time of tens of images, but only where
    something is wrong.

    Parameters are finite, since `SceneParameters.update` refuses others. One is named if the derivative is one by it,
    or if the image becomes finite once it is changed a little (the scene has its former values afterwards).
    Integrators that don't advance by vertices, such as ``bdpt``, ``ptracer`` or ``prb_projective``, get pixel and
    parameter only.

    Args:
        scene: What `load_dict` returned.
        keys: Parameters of `djpt.traverse` for whose gradients to look; none: the image only.
        loss: A function of the image (H, W, C) that returns one number; by default the sum of all pixels.
        sensor: Index into ``scene.sensors()``, or a sensor.
        integrator: By default the scene's.
        seed: Of the image; that of the gradient is derived from it, as by `djpt.render`.
        spp: Samples per pixel; 0 takes the sampler's.

    Returns:
        What was found first, or None if everything is finite.

    Raises:
        ParameterError: A key is unknown, or has no derivatives.
    """
    params = traverse(scene)
    names = [keys] if isinstance(keys, str) else list(keys)
    for name in names:
        if not params.flags(name).differentiable:
            raise ParameterError(f"{name}: has no derivatives")
    settings = RenderSettings.of(scene, sensor, integrator, seed=seed, spp=spp)
    with dr.suspend_grad():
        image = render(scene, sensor=sensor, integrator=integrator, seed=seed, spp=spp)
    bad = places(image)
    if len(bad):
        return Search(scene, params, settings).in_image(bad, first_bad(image))
    return in_gradient(scene, params, names, loss, settings) if names else None


def places(image: Any) -> npt.NDArray[np.intp]:
    """The pixels (row, column) of an image that aren't finite."""
    return np.argwhere(~np.isfinite(np.array(image)).all(axis=2))


def first_bad(value: Any) -> float:
    """The first entry that isn't finite."""
    entries = np.array(dr.detach(value), np.float64).ravel()
    return float(entries[~np.isfinite(entries)][0])


# ---- the gradient -----------------------------------------------------------------------------


def in_gradient(
    scene: Scene,
    params: SceneParameters,
    names: Sequence[str],
    loss: Callable[[TensorXf], Any] | None,
    settings: RenderSettings,
) -> NonFinite | None:
    """What isn't finite in the loss, in its derivative by the image, or in the gradient."""
    former = {name: type(params[name])(dr.detach(params[name])) for name in names}
    try:
        for name in names:
            params[name] = type(former[name])(former[name])
            dr.enable_grad(params[name])
        params.update()
        image = render(
            scene,
            params,
            sensor=settings.sensor,
            integrator=settings.integrator,
            seed=settings.seed,
            spp=settings.spp,
        )
        pixels = TensorXf(dr.detach(image))
        dr.enable_grad(pixels)
        value = dr.sum(pixels, axis=None) if loss is None else loss(pixels)
        dr.backward(value)
        adjoint = dr.grad(pixels)
        bad = places(adjoint)
        if len(bad):
            row, column = bad[0]
            what = "the derivative by a pixel"
            return NonFinite("loss", what, first_bad(adjoint), pixel=(int(column), int(row)))
        if not np.isfinite(np.array(dr.detach(value))).all():
            return NonFinite("loss", "the loss", first_bad(value))
        dr.backward(dr.sum(image * adjoint, axis=None))
        wrong = [name for name in names if not np.isfinite(np.array(dr.grad(params[name]))).all()]
        if not wrong:
            return None
        seen = NonFinite("gradient", "the gradient", first_bad(dr.grad(params[wrong[0]])), parameter=wrong[0])
        return Search(scene, params, settings).in_gradient(seen)
    finally:
        params.update(former)


class LaneLeaves(Leaves):
    """Leaves of which each lane has its own, so that the derivatives of one lane are seen."""

    def __init__(self, values: Detached, numbering: Numbering, lanes: int) -> None:
        super().__init__(values, numbering)
        self._lanes = lanes

    def __call__(self, leaf: Leaf, slot: UInt32) -> Any:
        value = super().__call__(leaf, slot)
        if isinstance(leaf, TableLeaf) or not self.attaches(leaf):
            return value
        own = wide(dr.detach(value), self._lanes)
        dr.enable_grad(own)
        self.taken[-1] = (leaf, slot, own)
        return own

    def entry(self, leaf: TableLeaf, slot: UInt32, index: UInt32, active: Bool | bool) -> Any:
        return super().entry(leaf, wide(slot, self._lanes), index, active)

    def culprit(self, active: Bool) -> tuple[int, Leaf, UInt32, float] | None:
        """The first lane with a derivative that isn't finite: its number, leaf, slot or address, and value."""
        taken: list[tuple[Leaf, UInt32, Any]] = [*self.taken, *self.read]
        for leaf, place, value in taken:
            gradient = np.atleast_2d(np.array(dr.select(active, dr.grad(value), 0)))
            for lane in np.flatnonzero(~np.isfinite(gradient).all(axis=0))[:1]:
                return int(lane), leaf, place, first_bad(gradient[:, lane])
        return None


@dataclass
class Steps:
    """The state of all lanes between two vertices; `again`, `radiance` and the rest are as in a replay."""

    ray: Any
    sampler: Any
    path: Any
    active: Bool
    radiance: Color3f
    behind: Color3f | None
    again: Bool


class Search:
    """The search for a number that isn't finite in the samples of an image or a gradient."""

    def __init__(self, scene: Scene, params: SceneParameters, settings: RenderSettings) -> None:
        self.scene, self.params, self.settings = scene, params, settings

    # ---- images --------------------------------------------------------------------------

    def in_image(self, bad: npt.NDArray[np.intp], value: float) -> NonFinite:
        """The origin of a value in some pixels (row, column)."""
        row, column = (int(n) for n in bad[0])
        found = NonFinite("image", "a pixel", value, pixel=(column, row))
        job = self.job(self.settings.seed)
        if not self.is_stepwise(job):
            return found
        for pixel, k in self.batches(job, bad):
            for number, before, sampler, v, arrived, si in self.vertices(job, pixel, k):
                lane = bad_lane(before.active, v, arrived)
                if lane is None:
                    continue
                quantity, plugin, what = self.blame(job, Lane(lane), before, sampler, v, arrived, si)
                return NonFinite(
                    "image",
                    quantity,
                    first_bad(what),
                    plugin,
                    self.parameter_of(plugin, job, int(pixel[lane]), int(k[lane])),
                    self.pixel(job, int(pixel[lane])),
                    int(k[lane]),
                    number,
                )
        return found

    def blame(
        self, job: Job, lane: Lane, before: Steps, sampler: Any, v: Vertex, arrived: Color3f, si: Any
    ) -> tuple[str, str | None, Any]:
        """The first factor of a vertex that isn't finite on a lane: in words, its plugin, and its value."""
        scene = job.scene
        hit = bool(lane.of(si.is_valid()))
        if not lane.finite(before.ray.o, before.ray.d):
            return "the camera ray", job.sensor.id(), lane.of(before.ray.d)
        if hit and not lane.finite(si.p, si.n):
            return "the hit", named(lane.of(si.shape.index), scene.shapes()), lane.of(si.p)
        passed = scene.media.transmittance(before.ray, si.t)
        if hit and not lane.finite(passed):
            return "the transmittance of the way", None, lane.of(passed)
        if not lane.finite(v.emitted):
            return "the emitted light", named(lane.of(si.emitter().index), scene.emitters()), lane.of(v.emitted)
        bsdf = named(lane.of(si.bsdf().index), scene.bsdfs.plugins) if hit else None
        if not lane.finite(arrived):
            value = si.bsdf().eval(BSDFContext(), si, si.to_local(v.shadow_ray.d)) if hit else Color3f(0)
            if not lane.finite(value):
                return "the value of the BSDF", bsdf, lane.of(value)
            light = scene.lights.sampling.sample(si, sampler.next_2d())
            number = lane.of(light.ds.emitter_index)
            if not lane.finite(light.weight) or len(scene.emitters()) == 1:
                return "the light sample", named(number, scene.emitters()), lane.of(arrived)
            return "the light sample", bsdf, lane.of(arrived)
        what = v.weight if not lane.finite(v.weight) else v.ray.d
        return (
            "the weight of the sampled direction" if what is v.weight else "the sampled direction",
            bsdf,
            lane.of(what),
        )

    def parameter_of(self, plugin: str | None, job: Job, pixel: int, k: int) -> str | None:
        """The parameter of a plugin that makes a sample finite if it is changed a little."""
        keys = [key for key in self.params if any(owner.id() == plugin for owner in self.params.owners(key))]
        floats = [key for key in keys if dr.is_array_v(self.params[key]) and dr.is_float_v(self.params[key])]
        for key in floats:
            former = type(self.params[key])(dr.detach(self.params[key]))
            for changed in (former * 0.97 + 0.01, former * 0.97 - 0.01):
                try:
                    self.params.update({key: changed})
                    fresh = self.job(job.seed)
                    steps = self.vertices(fresh, UInt32([pixel]), UInt32([k]))
                    if all(bad_lane(before.active, v, arrived) is None for _, before, _, v, arrived, _ in steps):
                        return key
                except ParameterError:
                    continue
                finally:
                    self.params.update({key: former})
        return None

    # ---- gradients -----------------------------------------------------------------------

    def in_gradient(self, seen: NonFinite) -> NonFinite:
        """The origin of a value in the gradient."""
        job = self.job(self.settings.gradient_seed)
        if not self.is_stepwise(job):
            return seen
        parameters = attached_parameters(job.scene)
        assert isinstance(job.scene.lookup, Detached)
        values = job.scene.lookup.snapshot([(p.owner, p.attribute) for p in parameters])
        every = [leaf for ensemble in job.scene.ensembles() for leaf in ensemble.leaves()]
        numbering = Numbering(parameters, every, values)
        grid = np.argwhere(np.ones((job.height, job.width), bool))
        for pixel, k in self.batches(job, grid, whole=True):
            found = self.replayed(job, pixel, k, values, numbering)
            if found is not None:
                lane, number, leaf, place, value = found
                owner = self.owner(leaf, values, place, lane)
                return NonFinite(
                    "gradient",
                    "the derivative of the outgoing light",
                    value,
                    owner.id(),
                    self.key_of(owner, leaf.attribute) or seen.parameter,
                    self.pixel(job, int(pixel[lane])),
                    int(k[lane]),
                    number,
                )
        return seen

    def replayed(
        self, job: Job, pixel: UInt32, k: UInt32, values: Detached, numbering: Numbering
    ) -> tuple[int, int, Leaf, UInt32, float] | None:
        """Walk samples twice: lane, vertex, leaf, slot or address, and value of the first bad derivative."""
        lanes, mode = dr.width(pixel), Mode()
        radiance, behind = None, None
        for again in (False, True):
            fresh = LaneLeaves(values, numbering, lanes)
            attached = job.scene.replace(lookup=fresh)
            steps = self.begun(job, pixel, k, attached)
            steps.again = dr.full(Bool, again, lanes)
            if radiance is not None:
                steps.radiance, steps.behind = radiance, behind
            for number in range(LONGEST):
                leaves = LaneLeaves(values, numbering, lanes)
                view = job.scene.replace(lookup=leaves)
                before = steps.active
                outgoing, steps = self.replay_step(job, mode, steps, view)
                if again:
                    with dr.resume_grad():
                        if dr.grad_enabled(outgoing):
                            dr.backward(dr.sum(dr.select(before, dr.sum(outgoing), 0)))
                    found = leaves.culprit(before)
                    if found is not None:
                        lane, leaf, place, value = found
                        return lane, number, leaf, place, value
                if not dr.any(steps.active):
                    break
            radiance, behind = steps.radiance, steps.behind
        return None

    def replay_step(self, job: Job, mode: Mode, steps: Steps, view: Scene) -> tuple[Color3f, Steps]:
        """The attached light that leaves a vertex, and the state after it."""
        integrator = job.integrator
        assert isinstance(integrator, PathIntegrator)
        with dr.suspend_grad():
            si = integrator.trace(job.scene, steps.path, steps.ray)
            si.scene = view
            with dr.resume_grad():
                v = integrator.advance(view, steps.sampler, steps.path, steps.ray, si)
                arrived = integrator.transmittance(view, steps.sampler, v)
            walk: Any = steps
            radiance, behind, outgoing = mode.outgoing(walk, v, arrived)
            radiance = dr.select(steps.active, dr.detach(radiance), steps.radiance)
            if behind is not None:
                behind = dr.select(steps.active, dr.detach(behind), steps.behind)
            after = Steps(
                dr.detach(v.ray),
                steps.sampler,
                dr.detach(v.state),
                steps.active & v.active,
                radiance,
                behind,
                steps.again,
            )
            dr.eval(after.ray, after.sampler, after.path, after.active, after.radiance, after.behind)
            return outgoing, after

    def owner(self, leaf: Leaf, values: Detached, place: UInt32, lane: int) -> Any:
        """The plugin that a leaf's value belongs to, from its slot, or the address of its entry."""
        number = int(place[lane if dr.width(place) > 1 else 0])
        if isinstance(leaf, TableLeaf):
            buffer = values.buffer(leaf)
            starts = [int(buffer.address(UInt32(i), UInt32(0))[0]) for i in range(len(leaf.owners))]
            number = max((i for i in range(len(starts)) if starts[i] <= number), key=lambda i: starts[i])
        return leaf.owners[number]

    def key_of(self, owner: Any, attribute: str) -> str | None:
        """The name in `traverse` of an attribute of a plugin."""
        keys = [key for key in self.params if next(self.params.owners(key)).id() == owner.id()]
        return next((key for key in keys if key.rpartition(".")[2] == attribute), keys[0] if len(keys) == 1 else None)

    # ---- samples -------------------------------------------------------------------------

    def job(self, seed: Any) -> Job:
        """The job of the image, or of its derivative."""
        return make_job(self.scene, RenderSettings(**{**vars(self.settings), "seed": seed}))

    def is_stepwise(self, job: Job) -> bool:
        """Whether samples can be traced vertex by vertex."""
        return isinstance(job.integrator, PathIntegrator) and job.integrator.stepwise and job.sampler.has_streams

    def batches(
        self, job: Job, pixels: npt.NDArray[np.intp], *, whole: bool = False
    ) -> Iterator[tuple[UInt32, UInt32]]:
        """The samples, pixel of the grid and number, that reach some pixels (row, column) of the film, or the grid."""
        reach = 0 if whole else int(np.ceil(job.film.rfilter().radius() - 0.5)) if job.film.filters else 0
        around = np.arange(-reach, reach + 1)
        offset = 0 if whole else job.film.border
        rows = (pixels[:, :1] + offset + np.repeat(around, len(around))).ravel()
        columns = (pixels[:, 1:] + offset + np.tile(around, len(around))).ravel()
        inside = (rows >= 0) & (rows < job.height) & (columns >= 0) & (columns < job.width)
        numbers = (rows * job.width + columns)[inside]
        numbers = numbers[np.sort(np.unique(numbers, return_index=True)[1])]
        size = max(1, LANES // job.spp)
        for first in range(0, len(numbers), size):
            some = numbers[first : first + size]
            pixel = np.repeat(some, job.spp).astype(np.uint32)
            yield UInt32(pixel), UInt32(np.tile(np.arange(job.spp), len(some)).astype(np.uint32))

    def begun(self, job: Job, pixel: UInt32, k: UInt32, attached: Scene | None = None) -> Steps:
        """All samples before their first vertex."""
        integrator, lanes = job.integrator, dr.width(pixel)
        assert isinstance(integrator, PathIntegrator)
        sampler, ray, _ = job.begin(pixel, k, *job.coordinates(pixel))
        path = integrator.begin(job.scene, sampler)
        if attached is not None:
            path = begun(path, attached)
        behind = None if attached is None else blank(attached, lanes)
        false = dr.full(Bool, False, lanes)
        return Steps(
            wide(ray, lanes), sampler, wide(path, lanes), dr.full(Bool, True, lanes), Color3f(0), behind, false
        )

    def vertices(self, job: Job, pixel: UInt32, k: UInt32) -> Iterator[tuple[int, Steps, Any, Vertex, Color3f, Any]]:
        """The vertices of samples: number, state and random numbers before, vertex, its light sample, hit."""
        integrator = job.integrator
        assert isinstance(integrator, PathIntegrator)
        with dr.suspend_grad():
            steps = self.begun(job, pixel, k)
            for number in range(LONGEST):
                sampler = steps.sampler.clone()
                si = integrator.trace(job.scene, steps.path, steps.ray)
                v = integrator.advance(job.scene, steps.sampler, steps.path, steps.ray, si)
                arrived = integrator.transmittance(job.scene, steps.sampler, v)
                after = Steps(v.ray, steps.sampler, v.state, steps.active & v.active, steps.radiance, None, steps.again)
                dr.eval(after.ray, after.sampler, after.path, after.active, v.emitted, arrived, v.weight)
                yield number, steps, sampler, v, arrived, si
                steps = after
                if not dr.any(steps.active):
                    return

    def pixel(self, job: Job, number: int) -> tuple[int, int]:
        """Column and row on the film of a pixel of the grid."""
        row, column = divmod(number, job.width)
        return column - job.film.border, row - job.film.border


@dataclass(frozen=True)
class Lane:
    """One lane of arrays."""

    number: int

    def of(self, value: Any) -> Any:
        """The value there, as an array of NumPy."""
        found = np.array(dr.detach(value))
        return found[..., self.number if found.shape[-1] > 1 else 0]

    def finite(self, *values: Any) -> bool:
        """Whether all values there are finite."""
        return all(bool(np.isfinite(self.of(value)).all()) for value in values)


def bad_lane(active: Bool, v: Vertex, arrived: Color3f) -> int | None:
    """The first active lane on which the light of a vertex, or what its path goes on with, isn't finite."""
    onward = active & v.active
    bad = (active & ~finite(v.emitted, arrived)) | (onward & ~finite(v.weight, v.ray.o, v.ray.d))
    lanes = np.flatnonzero(np.array(bad))
    return int(lanes[0]) if len(lanes) else None


def finite(*values: Any) -> Bool:
    """True where all components are finite."""
    good = Bool(True)
    for value in values:
        for component in value:
            good &= dr.isfinite(component)
    return good


def named(number: Any, plugins: Sequence[Any]) -> str | None:
    """The name of a plugin by its number."""
    return plugins[int(number)].id() if 0 <= int(number) < len(plugins) else None

"""Training: paths that are followed to learn where light comes from.

A path remembers each choice of a direction: the square of the guide's map, the density, and the light that it had found
by then. What it finds later, over its throughput, is an estimate C of the light that the chosen direction brings. Per
square the sum of C^2 p is kept: the second moment, to whose square root the best density is proportional (A. Rath,
P. Grittmann, S. Herholz, P. Vévoda, P. Slusallek and J. Křivánek, "Variance-aware path guiding", SIGGRAPH 2020).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import Ray3f
from djpt.integrators.base import Integrator, PathIntegrator, Vertex
from djpt.integrators.guiding.guide import SQUARES
from djpt.jit.kernels import as_float, loop_traced_once, minimum, while_loop, wide
from djpt.jit.types import Bool, Color3f, Float, Int64, Point3f, UInt32, Vector3f
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["GuidedVertex", "Lane", "LearningIntegrator", "TrainingPaths", "TrainingResult", "follow", "train"]


class TrainingPaths(Protocol):
    """Paths that an integrator learns from, and that no image counts."""

    @property
    def scene(self) -> Scene:
        """The scene."""

    @property
    def samples(self) -> int:
        """The number of samples of the image that is to be rendered."""

    def begin(self, first: int, end: int) -> tuple[SampleStream, Ray3f]:
        """Random numbers and camera rays of the paths `first` <= i < `end`, which are spread evenly over the image."""

    def pause(self) -> None:
        """Stop here if somebody has asked for it."""


class LearningIntegrator(Integrator):
    """An estimator that follows paths to learn from them, and renders with what it knows then.

    What it has learned doesn't depend on the samples of the image, whose mean it can't change therefore.
    """

    schedules: tuple[str, ...] = ("learning",)
    needs_light = True
    differentiable = False

    def trained(self, training_paths: TrainingPaths) -> Integrator:
        """The trained integrator, which renders the image."""
        raise NotImplementedError


DIGITS = 24
"""Binary digits behind the point of the sums, whole numbers whose order doesn't matter."""

MOST = 2.0**15
"""The largest summand, in units of the usual one."""

REMEMBERED = 16
"""The number of vertices that a path remembers."""


@dataclass
class GuidedVertex(Vertex):
    """A vertex that chooses a direction by a guide."""

    cell: UInt32 = field(default_factory=UInt32)
    """The cell of the vertex."""
    square: UInt32 = field(default_factory=UInt32)
    """The square of the chosen direction."""
    density: Float = field(default_factory=Float)
    """The density of the choice per area of the map; 0 where there was nothing to choose, as at mirrors."""


@dataclass
class Choice:
    """A choice of a direction, as a path remembers it."""

    square: UInt32
    density: Float
    throughput: Float
    """Throughput of the path before the choice, mean of the channels."""
    radiance: Float
    """Radiance that the path had found by then, mean of the channels."""


@dataclass
class Lane:
    """Loop state of a training path."""

    o: Point3f
    d: Vector3f
    medium: UInt32 | None
    times: Any
    sampler: Any
    state: Any
    radiance: Color3f
    """Radiance that the path has found, as `Note` leaves it."""
    notes: Any
    """What the path remembers, in local memory."""
    count: UInt32
    """The number of notes."""
    active: Bool


Note = Callable[[Lane, Any, Color3f, Color3f], tuple[Any, Bool, Color3f]]
"""What a path remembers of a vertex.

Arguments: the lane, the vertex, the lane's radiance with what the vertex emits, and what the vertex reflects.
Results: a note, whether it is written, and the radiance that the lane goes on with."""


def follow(
    integrator: PathIntegrator, scene: Scene, sampler: SampleStream, ray: Ray3f, notes: Any, note: Note, label: str
) -> Lane:
    """Follow one training path per lane, without an image; the lanes when all have ended.

    Args:
        integrator: The estimator.
        scene: The scene.
        sampler: Random numbers.
        ray: Camera rays.
        notes: Local memory, one array per lane.
        note: Called at each vertex.
        label: The name of the loop.
    """
    lanes = dr.width(ray, sampler)
    start = Lane(
        o=wide(ray.o, lanes),
        d=wide(ray.d, lanes),
        medium=wide(ray.medium, lanes),
        times=wide(ray.times, lanes),
        sampler=sampler,
        state=wide(integrator.begin(scene, sampler), lanes),
        radiance=dr.zeros(Color3f, lanes),
        notes=notes,
        count=dr.zeros(UInt32, lanes),
        active=dr.full(Bool, True, lanes),
    )

    def body(lane: Lane) -> tuple[Lane]:
        way = Ray3f(lane.o, lane.d, maxt=dr.select(lane.state.depth == 0, ray.maxt, dr.inf), medium=lane.medium)
        way.times = lane.times
        si = integrator.trace(scene, lane.state, way, lane.sampler)
        v = integrator.advance(scene, lane.sampler, lane.state, way, si)
        reflected = integrator.transmittance(scene, lane.sampler, v)
        found, written, radiance = note(lane, v, lane.radiance + v.emitted, reflected)
        lane.notes.write(found, lane.count, written)
        count, on = dr.select(written, lane.count + 1, lane.count), v.ray
        return (Lane(on.o, on.d, on.medium, on.times, lane.sampler, v.state, radiance, lane.notes, count, v.active),)

    (end,) = loop_traced_once(start, lambda lane: lane.active, body, label)
    return end


@dataclass
class TrainingResult:
    """The results of training."""

    sums: NDArray[np.float64]
    """(leaves, SQUARES): the sums of C^2 p, in units of their own."""
    visits: NDArray[np.uint32]
    """The choices in each cell."""
    mean: float
    """The mean of C^2 p over all choices."""


def train(
    integrator: PathIntegrator, scene: Scene, sampler: SampleStream, ray: Ray3f, leaves: int, cells: int, unit: float
) -> TrainingResult:
    """Follow one path per lane, without an image.

    Args:
        integrator: One whose vertices are `GuidedVertex`.
        scene: The scene.
        sampler: Random numbers.
        ray: Camera rays.
        leaves: The number of leaves of the integrator's guide.
        cells: The number of its cells.
        unit: A usual value of C^2 p.
    """
    visits, sums = dr.zeros(UInt32, cells), dr.zeros(Int64, leaves * SQUARES)
    dr.eval(visits, sums)

    def note(lane: Lane, v: GuidedVertex, arrived: Color3f, reflected: Color3f) -> tuple[Choice, Bool, Color3f]:
        radiance = arrived + reflected
        chosen = v.active & (v.density > 0) & (lane.count < REMEMBERED)
        dr.scatter_add(visits, UInt32(1), v.cell, chosen)
        return Choice(v.square, v.density, dr.mean(lane.state.throughput), dr.mean(radiance)), chosen, radiance

    end = follow(integrator, scene, sampler, ray, dr.alloc_local(Choice, REMEMBERED), note, "practice")
    found, scale = dr.mean(end.radiance), dr.rcp(as_float(unit))

    def add_choice(i: UInt32, choices: Any) -> tuple[UInt32, Any]:
        choice = choices.read(i)
        light = (found - choice.radiance) * dr.rcp(choice.throughput)
        summand = minimum(dr.square(light) * choice.density * scale, MOST)
        good = (choice.throughput > 0) & (summand > 0)
        dr.scatter_add(sums, Int64(dr.round(summand * 2.0**DIGITS)), choice.square, good)
        return i + 1, choices

    last, _ = while_loop(
        (dr.zeros(UInt32, dr.width(end.count)), end.notes),
        lambda i, choices: i < end.count,
        add_choice,
        label="practice notes",
    )
    dr.eval(last, visits, sums)
    whole = sums.numpy().astype(np.float64).reshape(leaves, SQUARES) * (unit / 2.0**DIGITS)
    seen = visits.numpy()
    return TrainingResult(whole, seen, float(whole.sum() / max(int(seen.sum()), 1)))

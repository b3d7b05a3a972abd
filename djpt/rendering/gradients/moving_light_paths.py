"""Derivatives, by shapes that move, of images that light paths add to.

A light path is a function of its random numbers x. As shapes move, its vertices y_k(x) move along: each is where the
ray that arrives meets the surface; directions stay in the frame of the surface, and those of perfectly smooth lobes
follow from the direction that arrives. Let s_k be the light that y_k sends to the film, P(y_k) its place there, and h_j
the filter of pixel j. Then

    I_j = E[sum over k of s_k h_j(P(y_k))],    dI_j = E[sum over k of ds_k h_j + s_k grad h_j . dP]

wherever the vertices are continuous in x. Where they jump - at the outline of a body, at the edge of a shadow, where
light begins to be reflected back into glass - the derivative has a term that is left out here, and scripts must ask for
it to be (`unproven_gradients`). It is 0 for the facets of a lens whose light comes from all of its front.

M. Nimier-David, D. Vicini, T. Zeltner and W. Jakob, "Mitsuba 2: A Retargetable Forward and Inverse Renderer", 2019,
section 4.3, finds lenses by their caustics so.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f, SurfaceInteraction3f
from djpt.description.registry import name_of
from djpt.errors import RenderError
from djpt.films.footprint import ChangeSplats, in_window
from djpt.integrators.ptracer import ParticleTracer
from djpt.jit.types import Bool, Color3f, Float, Point2f, TensorXf
from djpt.rendering.gradients.derivatives import add
from djpt.rendering.gradients.fresh_leaves import FreshLeaves
from djpt.rendering.gradients.gradient_sums import changes as propagated_to
from djpt.rendering.gradients.leaves import Parameter
from djpt.rendering.gradients.splatted import adjoints_of_light, light_image, passes_of_paths, straight_light
from djpt.rendering.gradients.traced_light import TracedLight
from djpt.rendering.schedules.job import Job
from djpt.rfilters.base import is_wide

__all__ = ["MovingLightDerivative"]

MOST_EDGES = 16
"""The edges of the longest paths that are followed: kernels repeat what happens at a vertex as often."""

PASS_PATHS = 2**19
"""Light paths of a pass."""


def require_followed(job: Job, moving: list[Parameter]) -> None:
    """Refuse what has no derivatives by light paths that move with shapes.

    Raises:
        RenderError: It says what, and what is possible.
    """
    what = f"'{moving[-1].owner.id()}' moves with parameters that have gradients, and "
    assert isinstance(job.integrator, ParticleTracer)
    depth = job.integrator.max_depth
    if depth < 0 or depth > MOST_EDGES:
        raise RenderError(f"{what}the integrator has the 'max_depth' {depth}; possible: 0 to {MOST_EDGES}")
    film = job.film
    if not film.filters or is_wide(film.taps):
        raise RenderError(
            f"{what}the film has the filter '{name_of(type(film.rfilter()))}': light that moves over it changes pixels "
            "by the slope of the filter; possible: a 'gaussian' or a 'tent' a few pixels wide"
        )
    for parameter in moving:
        shape: Any = parameter.owner
        if shape.emitter() is not None:
            raise RenderError(
                f"'{shape.id()}' moves with parameters that have gradients, and shines: how light paths move with a "
                "lamp isn't followed; possible: 'direct_projective' or 'prb_projective'"
            )


class MovingLightPaths(TracedLight):
    """Light paths whose vertices are attached to the shapes that they meet."""

    def hit(self, ray: Ray3f, active: Bool) -> SurfaceInteraction3f:
        found = self._scene.closest_hit(dr.detach(ray), active)
        return self._scene.surface_interaction_of(found, ray)

    def splats(self) -> Iterator[tuple[Point2f, Color3f, Bool]]:
        """The place on the film of each vertex, the light that it sends there, and whether it counts."""
        integrator, sampler = self._integrator, self.sampler()
        state, active = integrator.start(self._scene, sampler), Bool(True)
        for _ in range(1, integrator.max_depth):
            step = self.step(state, sampler, active)
            yield step.position, step.light, active & step.shows & in_window(step.position)
            state, active = step.state, active & step.active


class MovingLightDerivative:
    """The derivative of an image by `ptracer`, by shapes that move and by all else."""

    def __init__(self, job: Job, parameters: list[Parameter], moving: int) -> None:
        """`moving`: the number of those that shapes move by, which come last.

        Raises:
            RenderError: Light paths can't be followed.
        """
        require_followed(job, parameters[-moving:])
        self._job, self._count, self._leaves = job, moving, FreshLeaves(parameters)
        self._straight = straight_light(job, parameters[: -self._count])

    def backward(self, image: TensorXf) -> list[Any]:
        with dr.suspend_grad():
            pixels = adjoints_of_light(self._job, image, False)

        def of_pass(begin: int, end: int) -> list[Any]:
            with self._leaves.attached(self._job.scene) as (fresh, scene):
                loss = Float(0)
                for position, light, shows in MovingLightPaths(self._job, scene, begin, end).splats():
                    loss += Float(dr.select(shows, dr.dot(light, pixels.at(position, shows)), 0))
                if dr.grad_enabled(loss):
                    dr.backward(loss)
                return [dr.grad(leaf) for leaf in fresh]

        by_light = add(of_pass(*part) for part in passes_of_paths(self._job, PASS_PATHS))
        straight = self._straight.backward(image)
        return [
            *(a + b for a, b in zip(by_light[: -self._count], straight, strict=True)),
            *by_light[-self._count :],
        ]

    def forward(self, tangents: list[Any]) -> TensorXf:
        job, changes = self._job, ChangeSplats(self._job.film)
        for begin, end in passes_of_paths(job, PASS_PATHS):
            with self._leaves.attached(job.scene, tangents) as (_, scene):
                shares = [
                    share
                    for position, light, shows in MovingLightPaths(job, scene, begin, end).splats()
                    for share in changes.shares(position, light, shows)
                ]
                found = propagated_to(*(share for _, share, _ in shares))
            for (pixel, _, counts), change in zip(shares, found, strict=True):
                changes.put(pixel, change, counts)
            dr.eval(changes.memory)
        with dr.suspend_grad():
            return light_image(job, changes, False) + self._straight.forward(tangents[: -self._count])

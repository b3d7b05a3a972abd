"""The rays of a path that move: how their changes are carried along the path, and their adjoints back.

The ray of a camera moves with it. A perfectly smooth surface takes the ray on that it reflects or refracts: the rays
of a chain of such surfaces are one continuous function of the first, and of the places of the surfaces. At a rough
surface the chain ends: of the hit only its position matters to the next vertex, which sees it in another direction.

    camera -> mirror -> glass -> glass -> rough       links: (o, d) -> hit -> (o', d')
    camera -> rough -> mirror -> rough                a rough link: (o, d) -> hit -> direction at the mirror

In forward mode the changes of (o, d) and of the last position are carried from vertex to vertex. In reverse mode the
links of a chain are kept, and its end differentiates them one by one, from the last to the first. A rough surface is a
link, too, if a smooth one comes next.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f, SurfaceInteraction3f
from djpt.integrators.projective.reattach import attached_wi, mirrored
from djpt.jit.types import Bool, Color3f, Float, Point3f, UInt32, Vector3f

__all__ = ["MOST_LINKS", "Chain", "Changes", "carried_rays", "onward_direction"]

MOST_LINKS = 64
"""The longest chain of surfaces that reverse mode follows."""

Hit = Callable[[Ray3f, Bool, Bool], SurfaceInteraction3f]
"""Finds the attached hits of rays: (rays, active lanes, whether they come from the camera)."""


def leaf(value: Any, change: Any = None) -> Any:
    """A copy that has gradients of its own: the `change` in forward mode."""
    fresh = type(value)(dr.detach(value))
    dr.enable_grad(fresh)
    if change is not None:
        dr.set_grad(fresh, change)
    return fresh


def onward_direction(si: SurfaceInteraction3f, wo: Vector3f, eta: Float, active: Bool) -> Vector3f:
    """The direction of a ray from a smooth surface, in world space, attached to the hit: see `mirrored`."""
    return si.bsdf().sh_frame(si, active).to_world(mirrored(si.wi, wo, eta))


@dataclass
class Changes:
    """Forward mode: the changes of the ray to the present vertex, and of the position of the one before."""

    o: Any
    d: Any
    p: Any

    @staticmethod
    def of(ray: Ray3f, lanes: int) -> Changes:
        """Those of the camera's rays."""
        zero = dr.zeros(Vector3f, lanes)
        with dr.resume_grad():
            attached = [value for value in (ray.o, ray.d) if dr.grad_enabled(value)]
            if attached:
                dr.forward_to(*attached, flags=dr.ADFlag.ClearEdges)
            return Changes(zero + Vector3f(dr.grad(ray.o)), zero + Vector3f(dr.grad(ray.d)), zero)

    def attach(self, ray: Ray3f, previous: Point3f) -> tuple[Ray3f, Point3f]:
        """The ray and the previous position, with their changes."""
        return Ray3f(leaf(ray.o, self.o), leaf(ray.d, self.d)), leaf(previous, self.p)

    def leave(self, light: Color3f, p: Point3f, d: Vector3f, smooth: Bool) -> tuple[Color3f, Changes]:
        """The change of the light, and what is carried on from a vertex at `p` in the direction `d`, all attached."""
        attached = [value for value in (light, p, d) if dr.grad_enabled(value)]
        found: Any = dr.forward_to(*attached, flags=dr.ADFlag.ClearEdges) if attached else ()
        of = iter(found if len(attached) > 1 else (found,))
        by_light, by_p, by_d = (next(of) if dr.grad_enabled(v) else dr.zeros(type(v)) for v in (light, p, d))
        by_p = Vector3f(by_p)
        return by_light, Changes(dr.select(smooth, by_p, 0), dr.select(smooth, Vector3f(by_d), 0), by_p)


@dataclass
class Link:
    """A surface of a chain: the ray that arrives there, how it goes on, and the ray's own adjoint."""

    o: Point3f
    d: Vector3f
    wo: Vector3f
    """The direction of the ray onward, in the local frame; of a rough surface the point that is hit."""
    eta: Float
    """The ratio of the indices of refraction; of a rough surface 0, or -1 if the ray onward doesn't turn."""
    adjoint_o: Vector3f
    """The adjoint of the ray's origin; behind a rough surface, where the ray stays, of the point where it begins."""
    adjoint_d: Vector3f


@dataclass
class Chain:
    """Reverse mode: what is known of the rays that have led to the present vertex since the last rough surface."""

    links: Any
    """The smooth surfaces, in local memory."""
    count: Any
    """Their number."""
    adjoint_o: Any
    """The adjoint of the ray that arrived at the vertex before, without what has been found behind that vertex."""
    adjoint_d: Any
    from_camera: Any
    """Whether the first ray is the camera's."""
    camera_o: Any
    """The adjoint of the camera's ray."""
    camera_d: Any

    @staticmethod
    def start(lanes: int) -> Chain:
        """The chain at the first vertex, which the ray of the camera leads to."""
        zero = dr.zeros(Vector3f, lanes)
        links = dr.alloc_local(Link, MOST_LINKS)
        return Chain(links, dr.zeros(UInt32, lanes), zero, zero, dr.full(Bool, True, lanes), zero, zero)

    def attach(self, ray: Ray3f, previous: Point3f) -> tuple[Ray3f, Point3f]:
        """The ray and the previous position, with gradients of their own."""
        return Ray3f(leaf(ray.o), leaf(ray.d)), leaf(previous)

    def go_on(self, ray: Ray3f, wo: Vector3f, eta: Float, smooth: Bool, by_p: Vector3f, behind_rough: Bool) -> Chain:
        """Leave the vertex that the attached `ray` hit; where it is `smooth`, it becomes a link.

        Of chains with more than `MOST_LINKS` surfaces the first ones are forgotten, as if the ray behind were fixed.

        Args:
            ray: the ray.
            wo: the direction onward, in the local frame.
            eta: the ratio of the indices of refraction; -1 where the ray doesn't turn.
            smooth: where the chain goes on.
            by_p: the adjoint of the position of the vertex before.
            behind_rough: where that is rough.
        """
        o, d = Vector3f(dr.grad(ray.o)), Vector3f(dr.grad(ray.d))
        link = Link(dr.detach(ray.o), dr.detach(ray.d), wo, eta, dr.select(behind_rough, by_p, o), d)
        chain = self.add(link, smooth)
        return replace(chain, adjoint_o=o, adjoint_d=d)

    def keep_rough(self, ray: Ray3f, p: Point3f, active: Bool) -> Chain:
        """Make the vertex before a link, a rough surface that `ray` hit at `p`."""
        link = Link(ray.o, ray.d, Vector3f(dr.detach(p)), Float(0), self.adjoint_o, self.adjoint_d)
        return self.add(link, active)

    def add(self, link: Link, active: Bool) -> Chain:
        """Note a link."""
        full = active & (self.count == MOST_LINKS)
        count = dr.select(full, 0, self.count)
        self.links.write(link, count, active)
        return replace(self, count=dr.select(active, count + 1, count), from_camera=self.from_camera & ~full)

    def end_before(self, hit: Hit, ray: Ray3f, adjoint: Vector3f, active: Bool) -> Chain:
        """End the chain at the vertex before, a rough surface that `ray` hit, given the adjoint of its position."""
        moved = Ray3f(leaf(ray.o), leaf(ray.d))
        si = hit(moved, active, self.from_camera & (self.count == 0))
        back(dr.dot(si.p, dr.select(active, Point3f(adjoint), 0)))
        chain = self.end(hit, self.adjoint_o + dr.grad(moved.o), self.adjoint_d + dr.grad(moved.d), active)
        return replace(chain, from_camera=chain.from_camera & ~active)

    def end(self, hit: Hit, adjoint_o: Vector3f, adjoint_d: Vector3f, active: Bool) -> Chain:
        """End the chain with the adjoint of its last ray: propagate it to the surfaces, and to the camera's ray."""

        def body(i: UInt32, o: Vector3f, d: Vector3f, links: Any) -> tuple[UInt32, Vector3f, Vector3f, Any]:
            i = i - 1
            link, before = links.read(i), links.read(dr.maximum(i, 1) - 1)
            behind_rough = (i > 0) & (before.eta == 0)
            with dr.resume_grad():
                ray, begin = Ray3f(leaf(link.o), leaf(link.d)), leaf(Point3f(before.wo))
                si = hit(ray, Bool(True), self.from_camera & (i == 0))
                si.wi = dr.select(behind_rough, attached_wi(si, begin), si.wi)
                turns = link.eta > 0
                turned = onward_direction(si, link.wo, link.eta, turns)
                back(dr.dot(si.p, Point3f(o)) + dr.dot(turned, dr.select(turns, d, Vector3f(0))))
                by_o = dr.select(behind_rough, Vector3f(dr.grad(begin)), Vector3f(dr.grad(ray.o)))
                by_d = dr.select(behind_rough, 0, link.adjoint_d + dr.grad(ray.d))
                return i, link.adjoint_o + by_o, Vector3f(by_d), links

        state = dr.select(active, self.count, 0), Vector3f(adjoint_o), Vector3f(adjoint_d), self.links
        _, o, d, links = dr.while_loop(state, lambda i, *_: i > 0, body, label="links of a chain")
        seen = active & self.from_camera
        return replace(
            self,
            links=links,
            count=dr.select(active, 0, self.count),
            camera_o=self.camera_o + dr.select(seen, o, 0),
            camera_d=self.camera_d + dr.select(seen, d, 0),
        )


def back(value: Float) -> None:
    """Propagate the gradient 1 of a value, if it depends on anything."""
    if dr.grad_enabled(value):
        dr.backward_from(value)


def carried_rays(mode: dr.ADMode, ray: Ray3f, lanes: int) -> Any:
    """What a walk carries, at the first vertex, which the rays of the camera lead to: `Changes`, a `Chain`, or None."""
    if mode == dr.ADMode.Primal:
        return None
    return Changes.of(ray, lanes) if mode == dr.ADMode.Forward else Chain.start(lanes)

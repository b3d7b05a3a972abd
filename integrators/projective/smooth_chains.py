"""Chains of perfectly smooth surfaces: where rays arrive that mirrors, glass and masks lead on.

    ray -> mirror -> glass -> glass -> anything        links: the rays, numbered from 0

Of a surface that both reflects and lets through, one is chosen, by bits that belong to the chain: two rays next to each
other then take the same turns, and part only where they meet different surfaces.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, Ray3f, RayFlags, SurfaceInteraction3f, has_flag
from djpt.dispatch.family import NONE
from djpt.integrators.projective.carried_rays import onward_direction
from djpt.integrators.projective.reattach import attached_ray, attached_wi
from djpt.integrators.projective.self_views import body_of, following
from djpt.jit.frozen import recording
from djpt.jit.types import Bool, Color3f, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.scene.intersecting_shapes import is_convex
from djpt.textures.patches import Patches

__all__ = ["MOST_CHAIN_LINKS", "Chains", "random_turns"]

MOST_CHAIN_LINKS = 8
"""The surfaces that chains are followed through, at most."""

REFLECTED = int(BSDFFlags.DeltaReflection)
PASSED = int(BSDFFlags.DeltaTransmission | BSDFFlags.Null)
REFLECTION, TRANSMISSION = BSDFContext(type_mask=REFLECTED), BSDFContext(type_mask=PASSED)
BEYOND = 1 / 4
"""How far beyond two points, in their distance, surfaces are looked for between them, which rounding moves."""
CHANCE = 0.5
"""The random number of lobes: all smooth reflections of a surface go one way, and so does all that passes."""


class Chains:
    """The chains of a scene.

    Args:
        integrator: the integrator, which may hide emitters from the camera.
        scene: the scene, attached or not.
        longest: the number of the last link, at most; 0: nothing is followed.
        from_camera: whether the first rays are those of a camera.
    """

    def __init__(self, integrator: Any, scene: Any, longest: int, from_camera: Bool | bool) -> None:
        self._integrator, self.scene, self._from_camera = integrator, scene, from_camera
        self.longest = min(longest, MOST_CHAIN_LINKS)
        shapes = scene.geometry.contents.shapes
        self.patches = Patches(shapes)
        self._has_edges = UInt32([int(has_edges(shape)) for shape in shapes] if self.longest else [0] * len(shapes))

    def surface(self, si: SurfaceInteraction3f) -> UInt32:
        """A number for the shape that is hit, its side and patch, and, if it has edges, its triangle; 0 for nothing."""
        valid = si.is_valid()
        edges = valid & (dr.gather(UInt32, self._has_edges, si.shape_index, valid) != 0)
        found = dr.select(edges, side_of(si) + si.prim_index * UInt32(0xC2B2AE35), side_of(si))
        if not self.patches:
            return found
        return dr.select(valid, found + self.patches.number(si) * UInt32(0x27D4EB2F), 0)

    def hit(self, ray: Ray3f, link: UInt32 | int, active: Bool) -> SurfaceInteraction3f:
        """Where the ray of a link arrives."""
        first = Bool(self._from_camera) & (UInt32(link) == 0)
        found: SurfaceInteraction3f = self._integrator.first_hit(self.scene, ray, active, first)
        return found

    def stuck(self, ray: Ray3f, link: UInt32, active: Bool) -> Point3f:
        """The point of a surface that the ray of a link hits, attached to the surface, to which it sticks."""
        first = Bool(self._from_camera) & (link == 0)
        return Point3f(self._integrator.first_hit(self.scene, ray, active, first, RayFlags.FollowShape).p)

    def turn(self, si: SurfaceInteraction3f, bits: UInt32, active: Bool) -> tuple[Any, Color3f, Bool]:
        """The sample of the smooth lobe that a chain takes at a hit, its weight, and where there is one."""
        bsdf = si.bsdf()
        flags = bsdf.flags()
        reflects, passes = has_flag(flags, REFLECTED), has_flag(flags, PASSED)
        smooth = active & si.is_valid() & (reflects | passes)
        through = passes & (~reflects | ((bits & 1) != 0))
        middle = Point2f(CHANCE)
        bs, weight = bsdf.sample(REFLECTION, si, Float(CHANCE), middle, smooth & ~through)
        other, other_weight = bsdf.sample(TRANSMISSION, si, Float(CHANCE), middle, smooth & through)
        bs, weight = dr.select(through, other, bs), dr.select(through, other_weight, weight)
        weight = dr.select(smooth, weight * dr.select(reflects & passes, 2.0, 1.0), 0)
        return bs, Color3f(weight), smooth & dr.any(weight != 0)

    def follow(self, ray: Ray3f, bits: UInt32, active: Bool) -> UInt32:
        """A number for the surfaces that a chain meets, one after the other."""

        def body(link: UInt32, o: Point3f, d: Vector3f, maxt: Float, known: UInt32, goes: Bool) -> Any:
            si = self.hit(Ray3f(o, d, maxt=maxt), link, goes)
            known = dr.select(goes, known * UInt32(0x9E3779B1) + self.surface(si), known)
            bs, _, smooth = self.turn(si, bits >> link, goes & (link < last))
            onward = si.spawn_ray(si.to_world(bs.wo))
            return link + 1, Point3f(onward.o), Vector3f(onward.d), dr.full(Float, dr.inf, lanes), known, smooth

        lanes, last = dr.width(bits), dr.opaque(UInt32, self.longest)
        zero = dr.zeros(UInt32, lanes)
        start = zero, Point3f(ray.o) + Float(zero), Vector3f(ray.d) + Float(zero), ray.maxt + Float(zero), zero
        return UInt32(dr.while_loop((*start, active), lambda *s: s[-1], body, label="smooth surfaces")[4])

    def show_others(self, a: SurfaceInteraction3f, b: SurfaceInteraction3f, active: Bool) -> Bool:
        """Whether points of smooth surfaces show different ones: by reflections alone, or by all that passes."""
        other = Bool(False)
        for bits in (UInt32(0), UInt32(2**MOST_CHAIN_LINKS - 1)):
            numbers = []
            for si in (a, b):
                bs, _, smooth = self.turn(si, bits, active)
                onward = si.spawn_ray(si.to_world(bs.wo))
                numbers.append(dr.select(smooth, self.follow(onward, bits + dr.zeros(UInt32, dr.width(a)), smooth), 0))
            other |= numbers[0] != numbers[1]
        return active & other

    def parting(self, first: Ray3f, second: Ray3f, bits: UInt32, active: Bool) -> tuple[UInt32, Any, Any]:
        """The number of the link at which two chains meet different surfaces; their rays there, with weights."""

        def body(link: UInt32, a: Any, b: Any, goes: Bool) -> Any:
            there = [self.hit(Ray3f(o, d, maxt=maxt), link, goes) for o, d, maxt, _ in (a, b)]
            goes = goes & (self.surface(there[0]) == self.surface(there[1])) & (link < last)
            turned = [self.turn(si, bits >> link, goes) for si in there]
            rays = [si.spawn_ray(si.to_world(bs.wo)) for si, (bs, _, _) in zip(there, turned, strict=True)]
            goes = goes & turned[0][2] & turned[1][2]
            goes = goes & ~self._parted(rays[0].o, rays[1].o, goes)
            onward = []
            for (o, d, maxt, weight), ray, (_, factor, _) in zip((a, b), rays, turned, strict=True):
                onward.append(
                    (
                        dr.select(goes, ray.o, o),
                        dr.select(goes, ray.d, d),
                        dr.select(goes, Float(dr.inf), maxt),
                        dr.select(goes, weight * factor, weight),
                    )
                )
            return dr.select(goes, link + 1, link), onward[0], onward[1], goes

        lanes, last = dr.width(bits), dr.opaque(UInt32, self.longest)
        zero = dr.zeros(Float, lanes)
        ends = [(Point3f(r.o) + zero, Vector3f(r.d) + zero, r.maxt + zero, Color3f(1) + zero) for r in (first, second)]
        link, a, b, _ = dr.while_loop(
            (dr.zeros(UInt32, lanes), ends[0], ends[1], active), lambda *s: s[-1], body, label="where chains part"
        )
        first, second = (Ray3f(o, d, maxt=maxt) for o, d, maxt, _ in (a, b))
        return link, (first, a[3]), (second, b[3])

    def _parted(self, a: Point3f, b: Point3f, active: Bool) -> Bool:
        """Whether something is between points next to each other at which rays leave a surface.

        So it is in narrow wedges, next to the edge in which two surfaces meet: rays begin at a height above the first
        one, which is behind the second one. That only one of them sees what is behind it makes no edge.
        """
        way = b - a
        return Bool(self.scene.ray_test(Ray3f(dr.fma(way, -BEYOND, a), way, maxt=Float(1 + 2 * BEYOND)), active))

    def arrive(self, ray: Ray3f, bits: UInt32, link: UInt32, active: Bool) -> SurfaceInteraction3f:
        """Where the ray of a link arrives, given the first ray; nowhere if the chain ends before."""

        def body(number: UInt32, o: Point3f, d: Vector3f, maxt: Float, goes: Bool) -> Any:
            si = self.hit(Ray3f(o, d, maxt=maxt), number, goes)
            bs, _, smooth = self.turn(si, bits >> number, goes)
            onward = si.spawn_ray(si.to_world(bs.wo))
            return number + 1, Point3f(onward.o), Vector3f(onward.d), dr.full(Float, dr.inf, lanes), smooth

        lanes = dr.width(bits)
        zero = dr.zeros(Float, lanes)
        start = dr.zeros(UInt32, lanes), Point3f(ray.o) + zero, Vector3f(ray.d) + zero, ray.maxt + zero, active
        number, o, d, maxt, goes = dr.while_loop(
            start, lambda number, *s: s[-1] & (number < link), body, label="smooth surfaces before an edge"
        )
        return self.hit(Ray3f(o, d, maxt=maxt), number, goes & (number == link))

    def attached(
        self,
        ray: Ray3f,
        bits: UInt32,
        link: UInt32,
        active: Bool,
        previous: Point3f | None = None,
        viewer: UInt32 | None = None,
    ) -> Ray3f:
        """The ray of a link, attached to the first ray and to the surfaces on the way.

        Args:
            ray: the first rays; those of rough surfaces stay, and only the point where they start moves, `previous`.
            bits: the turns.
            link: the number of the link.
            active: the lanes that matter.
            previous: where first rays start, attached.
            viewer: the numbers of the bodies there, if they take rays along: see `self_views`.
        """
        along = Bool(False)
        if previous is not None and viewer is not None:
            sees = active & (viewer != NONE)
            first = self.hit(dr.detach(ray), 0, sees)
            along = sees & (body_of(self.scene, first.shape_index, first.is_valid()) == viewer)
            ray = following(ray, previous, along)
        for number in range(self.longest):
            here = active & (number < link)
            si = self.hit(ray, number, here)
            if number == 0 and previous is not None:
                si.wi = dr.select(Bool(self._from_camera) | along, si.wi, attached_wi(si, previous))
            with dr.suspend_grad():
                still = dr.detach(si)
                bs, _, _ = self.turn(still, bits >> number, here)
                onward = still.spawn_ray(still.to_world(bs.wo))
            moved = attached_ray(onward, Ray3f(si.p, onward_direction(si, bs.wo, bs.eta, here)), here)
            ray = Ray3f(dr.select(here, moved.o, ray.o), dr.select(here, moved.d, ray.d))
        return ray


def random_turns(sampler: Any) -> UInt32:
    """The bits by which chains choose at surfaces that both reflect and let through, one for each link."""
    return UInt32(sampler.next_1d() * 2.0**MOST_CHAIN_LINKS)


def side_of(si: SurfaceInteraction3f) -> UInt32:
    """A number for the shape that is hit and its side; 0 for nothing."""
    side = dr.select(dr.dot(si.n, si.to_world(si.wi)) > 0, UInt32(1), UInt32(2))
    return UInt32(dr.select(si.is_valid(), (si.shape_index + 1) * UInt32(0x85EBCA6B) + side, 0))


def has_edges(shape: Any) -> bool:
    """Whether a part of a shape may stand before another one, or is shaded by a normal of its own."""
    smooth = shape.of_triangles and shape.has_vertex_normals()
    return not smooth or recording() or not is_convex(shape)

"""Edges that random lines cross: the boundary term of curves that aren't known in advance.

A line of the length h that lies at random on an area A meets a curve with the density 2 h / (pi A) per length of it
(Crofton). Where two places on the line show different surfaces, bisection finds the point between. There are two kinds:

    one surface hides the other:    g = <n, o + t d - y>,    y: the point of the front, n: across its edge and the ray
    two surfaces meet:              g = t_a - t_b,           the distances along the ray to their tangent planes

The curve is g = 0, and moves across itself with the speed -(dg / dtheta) / abs(grad g).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.records import BSDFFlags, Ray3f, SurfaceInteraction3f, has_flag
from djpt.dispatch.family import NONE
from djpt.integrators.projective.kept import keep
from djpt.integrators.projective.self_views import body_of
from djpt.integrators.projective.smooth_chains import Chains, side_of
from djpt.integrators.projective.strips import beside_outline
from djpt.integrators.projective.wedges import clear_of_wedges
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point3f, UInt32, Vector2f, Vector3f
from djpt.textures.patches import adjoin

__all__ = ["PRECISION", "STRIP", "Line", "Lines", "edges_on_lines"]

PRECISION = 4e-6
"""The distance of rays that rounding leaves apart: an angle, or a part of the width of the film."""
STRIP = 40
"""The width, in such distances, of the strips beside outlines in which edges of patches are left to the outlines."""
DIRECTION_STEPS = 12
"""How often a line beside the first one is divided in halves."""
BESIDE = 1 / 16
"""How far beside a crossing the direction of an edge is looked for, as a fraction of the reach along the line."""
NARROWER, NARROWEST = 1 / 8, 4
"""The ratio of such reaches, the first of which is a part of a line; and how often rays apart the last one holds."""
MEET_WITHIN = 32
"""How far from two rays surfaces may meet between them, in halves of their distance."""
MEET_CLOSE = 1e-3
"""How far off each other's tangent planes surfaces that meet may be, relative to coordinates and distances."""
ROUNDING = 2e-6
"""That of the distance of a point from a plane, relative to the same."""

SMOOTH = int(BSDFFlags.Delta)

Line = Callable[[Float, Float], Ray3f]
"""The rays at places along a line and beside it, in one unit."""


@dataclass(frozen=True)
class Lines:
    """Random lines.

    Args:
        rays: the rays at places: those along the lines are between 0 and `length`.
        length: their length h.
        apart: the distance along lines of rays that rounding leaves apart: `PRECISION` in their unit.
        parts: how many parts of a line are looked at: edges closer to each other than one may be missed in pairs.
        bits: the turns of the chains of smooth surfaces that the rays take.
        depth: the number of edges before the rays begin.
        meetings: whether curves count in which the surfaces meet that the rays hit first.
        outlines: where outlines count of what they hit first.
        start: the points where the rays begin, attached, if they are those of rough surfaces.
        viewer: the numbers of the bodies there, if they take rays along by which they see themselves: see `self_views`.
    """

    rays: Line
    length: float
    apart: float
    parts: int
    bits: UInt32
    depth: Any
    meetings: bool = True
    outlines: Bool | bool = False
    start: Point3f | None = None
    viewer: UInt32 | None = None


def edges_on_lines(
    integrator: Any, chains: Chains, lines: Lines, sampler: Any, active: Bool, weight: Callable[[Float], Color3f]
) -> tuple[Color3f, Float, Float]:
    """The derivative by random points of edges, attached; that for an edge of the speed 1; and the places on the lines.

    Args:
        integrator: the integrator.
        chains: the chains of smooth surfaces of the scene.
        lines: the lines.
        sampler: random numbers.
        active: the lanes that matter.
        weight: the factors of edges at places on the lines.
    """
    with dr.suspend_grad():
        low, high, times, apart = crossing(chains, lines, sampler, active)
        link, (ray_a, weight_a), (ray_b, weight_b) = chains.parting(
            lines.rays(low, Float(0)), lines.rays(high, Float(0)), lines.bits, apart
        )
        a, b = (chains.hit(ray, link, apart) for ray in (ray_a, ray_b))
        # An edge within a shape sticks to it, like its outline.
        touching = touch(a, b, ray_a.d, ray_b.d)
        meet = touching & (a.shape_index != b.shape_index)
        counts = apart & (chains.surface(a) != chains.surface(b))
        within = chains.patches.differ(a, b)
        counts &= (link > 0) | (meet & lines.meetings) | within | lines.outlines
        counts &= lines.depth + link < dr.opaque(UInt32, integrator.max_depth)
        front_first = a.is_valid() & (~b.is_valid() | (a.t <= b.t))
        front, ray = dr.select(front_first, a, b), dr.select(front_first, ray_a, ray_b)
        hidden = counts & ~meet
        rim = (link > 0) | within & ~Bool(lines.outlines)
        across = edge_direction(chains, lines, link, 0.5 * (low + high), a, b, ray, front.t, hidden, rim)
        counts &= meet | (dr.squared_norm(across) > 0)
        depth = lines.depth + link
        place = dr.select(front_first, low, high)
        edge = Edge(chains, lines, place, link, meet, across, front_first, (a, ray_a), (b, ray_b), counts)
        slope = edge.slope()
        (seen_a, horizon_a), (seen_b, horizon_b) = clear_of_wedges(chains.scene, a, b, ray.d, counts & touching)
        if chains.longest:
            (ray_a, seen_a), (ray_b, seen_b) = edge.beside_strip(slope, seen_a, seen_b)
        # The same random numbers on both sides: where they look alike, the difference vanishes.
        again = sampler.clone()
        here = weight_a * integrator.radiance_along(chains.scene, ray_a, seen_a, depth, again, counts, horizon_a)
        there = weight_b * integrator.radiance_along(chains.scene, ray_b, seen_b, depth, sampler, counts, horizon_b)
        factor = weight(place) * (times * (0.5 * math.pi / lines.length))
        here, there = here * factor, there * factor
        keep(place, link, counts, here, there, across, meet, a.p, b.p, a.n, b.n)
    length = dr.norm(slope)
    moves = counts & (length > 0) & dr.isfinite(length)
    across_line = dr.select(moves, -dr.sign(slope.x) / length, 0)
    change_here, change_there = edge.changes()
    value = Color3f(here) * change_here - Color3f(there) * change_there
    # Before rough surfaces that move the sides count with speeds of their own, and matter even if they look alike.
    largest = dr.abs(here - there) if lines.start is None else dr.maximum(dr.abs(here), dr.abs(there))
    mass = dr.select(moves, dr.max(largest) / length, 0)
    return value * across_line, mass, place


def touch(a: SurfaceInteraction3f, b: SurfaceInteraction3f, d_a: Vector3f, d_b: Vector3f) -> Bool:
    """Whether two surfaces meet where two rays next to each other part, of which each hits one of them first.

    Between the rays, or close to them, their tangent planes have the same distance. Those of a surface and of one
    close behind its outline haven't.

    Args:
        a: the hits of one ray.
        b: those of the other one.
        d_a: the direction of the first ray.
        d_b: that of the second one.
    """
    gap = a.p - b.p
    off_a, off_b = dr.dot(b.n, gap), dr.dot(a.n, gap)
    cosine_a, cosine_b = dr.dot(b.n, d_a), dr.dot(a.n, d_b)
    # How far beyond the plane of b each ray meets that of a.
    along_a, along_b = off_a / cosine_a, off_b / cosine_b
    size = dr.maximum(dr.max(dr.abs(a.p)) + a.t, dr.max(dr.abs(b.p)) + b.t)
    close = dr.maximum(dr.abs(off_a), dr.abs(off_b)) < MEET_CLOSE * size
    rounding = ROUNDING * size * (dr.rcp(dr.abs(cosine_a)) + dr.rcp(dr.abs(cosine_b)))
    apart = dr.abs(along_a + along_b) > dr.fma(MEET_WITHIN, dr.abs(along_a - along_b), rounding)
    return Bool(close & ~apart & a.is_valid() & b.is_valid())


@dataclass(frozen=True)
class Edge:
    """Points of edges: the function g whose zeros they are."""

    chains: Chains
    lines: Lines
    place: Float
    """The places on the lines."""
    link: UInt32
    """The number of the ray that touches the edge."""
    meet: Bool
    """Whether two surfaces meet; else one hides the other, or both are parts of one."""
    across: Normal3f
    """The direction across the edge and the ray."""
    first_in_front: Bool
    first: tuple[SurfaceInteraction3f, Ray3f]
    """The surface on this side, and the ray that hits it."""
    second: tuple[SurfaceInteraction3f, Ray3f]
    """The surface on the other side."""
    active: Bool

    def value(self, ray: Ray3f, p: Point3f, q: Point3f) -> Float:
        """The value of g, given the ray and the points of both surfaces."""
        normals = [Normal3f(dr.detach(si.n)) for si, _ in (self.first, self.second)]
        o, d = ray.o, ray.d
        t, u = (
            dr.dot(n, point - o) / dr.select(self.meet, dr.dot(n, d), Float(1))
            for n, point in zip(normals, (p, q), strict=True)
        )
        y = dr.select(self.first_in_front, p, q)
        along = dr.dot(dr.detach(y - o), dr.detach(d))
        return dr.select(self.meet, t - u, dr.dot(self.across, dr.fma(d, along, o) - y))

    def slope(self) -> Vector2f:
        """The gradient of g, along the line and beside it."""
        slopes = []
        with dr.resume_grad():
            for direction in (Vector2f(1, 0), Vector2f(0, 1)):
                offset = Float(0)
                dr.enable_grad(offset)
                ray = self.lines.rays(self.place + direction.x * offset, direction.y * offset)
                moved = self.chains.attached(ray, self.lines.bits, self.link, self.active)
                g = self.value(moved, *(Point3f(dr.detach(si.p)) for si, _ in (self.first, self.second)))
                dr.forward_from(offset, flags=dr.ADFlag.ClearEdges)
                slopes.append(dr.grad(g))
        return Vector2f(*slopes)

    def beside_strip(self, slope: Vector2f, *seen: SurfaceInteraction3f) -> list[tuple[Ray3f, SurfaceInteraction3f]]:
        """The rays to both sides, and what they hit: in front at the inner border of the strip, if that shows others.

        The edges that a smooth surface shows run along its outline in the end, as those do that lie on it.
        """
        lines, length, shown = self.lines, dr.norm(slope), []
        hides = self.active & ~self.meet & (length > 0)
        for low, (_, ray), si in zip((True, False), (self.first, self.second), seen, strict=True):
            lanes = hides & (self.first_in_front == low) & has_flag(si.bsdf().flags(), SMOOTH)
            far = dr.select(lanes, dr.sign(slope.x) * ((-STRIP if low else STRIP) * lines.apart) / length, 0)
            first = lines.rays(dr.fma(slope.x, far, self.place), slope.y * far)
            aside = self.chains.attached(first, lines.bits, self.link, lanes)
            inner = self.chains.hit(aside, self.link, lanes)
            lanes &= self.chains.surface(inner) == self.chains.surface(si)
            inner, onward, other = beside_outline(self.chains, inner, aside.d, si, lanes)
            lanes &= other
            o, d = dr.select(lanes, aside.o, ray.o), dr.select(lanes, onward, ray.d)
            shown.append((Ray3f(o, d, maxt=ray.maxt), dr.select(lanes, inner, si)))
        return shown

    def changes(self) -> tuple[Float, Float]:
        """The changes of g, as it counts for this side and for the other one: 0, attached to what moves.

        At the edge, the line from x, where rays begin, to what a side shows moves by (1 - s) x', with s the fraction of
        the way that the edge is at, or by x' where a shape sees itself. Behind smooth surfaces, the chain moves.
        """
        lines, link = self.lines, self.link
        first = lines.rays(self.place, Float(0))
        ray = self.chains.attached(first, lines.bits, link, self.active, lines.start, lines.viewer)
        sides = self.first, self.second
        points = [self.chains.stuck(r, link, self.active & si.is_valid()) for si, r in sides]
        changes = []
        for si, _ in sides:
            g = self.value(self._at_edge(ray, si), *points)
            changes.append(dr.select(self.active, g - dr.detach(g), 0))
        return changes[0], changes[1]

    def _at_edge(self, ray: Ray3f, si: SurfaceInteraction3f) -> Ray3f:
        """The ray at the edge of a side: turned, where it comes from a rough surface, as far as that moves it."""
        x, viewer = self.lines.start, self.lines.viewer
        if x is None or viewer is None:
            return ray
        edge, t = (dr.detach(v) for v in (dr.select(self.first_in_front, self.first[0].t, self.second[0].t), si.t))
        rest = dr.select(dr.isfinite(t), 1 - edge / t, Float(1))
        along = (viewer != NONE) & (body_of(self.chains.scene, si.shape_index, si.is_valid()) == viewer)
        share = dr.select(along, Float(1), dr.select(self.meet, Float(0), rest))
        direct = self.active & (self.link == 0)
        start = dr.detach(ray.o)
        return Ray3f(
            dr.select(direct, start, ray.o), ray.d + dr.select(direct, (x - dr.detach(x)) * (share / edge), Vector3f(0))
        )


def crossing(chains: Chains, lines: Lines, sampler: Any, active: Bool) -> tuple[Float, Float, Float, Bool]:
    """The places just before and after a point at which the surfaces change, its weight, and where there is one.

    One of the parts of a line with different surfaces at their ends is chosen, and divided in halves. Between three
    surfaces there are two changes, of which one is chosen.
    """

    def look(place: Float, active: Bool) -> UInt32:
        return chains.follow(lines.rays(place, Float(0)), lines.bits, active)

    lanes, part = dr.width(lines.bits), lines.length / lines.parts
    zero = dr.zeros(Float, lanes)

    def walk(k: UInt32, before: UInt32, first: UInt32, last: UInt32, low: Float, count: Float, chance: Float) -> Any:
        found = look(Float(k) * part, active)
        changed = found != before
        count = dr.select(changed, count + 1, count)
        threshold = dr.rcp(dr.maximum(count, 1))
        chosen = changed & (chance * dr.maximum(count, 1) <= 1)
        chance = dr.select(
            changed & (count > 1),
            dr.select(chosen, chance / threshold, (chance - threshold) / (1 - threshold)),
            chance,
        )
        return (
            k + 1,
            found,
            dr.select(chosen, before, first),
            dr.select(chosen, found, last),
            dr.select(chosen, Float(k - 1) * part, low),
            count,
            chance,
        )

    begin = look(zero, active)
    one = dr.full(UInt32, 1, lanes)
    state = one, begin, begin, begin, zero, zero, sampler.next_1d() + zero
    end = dr.opaque(UInt32, lines.parts)
    _, _, first, last, low, count, chance = dr.while_loop(
        state, lambda k, *_: active & (k <= end), walk, label="parts of lines"
    )
    apart = active & (count > 0)

    def halve(k: UInt32, low: Float, high: Float, first: UInt32, last: UInt32, chance: Float, times: Float) -> Any:
        middle = 0.5 * (low + high)
        found = look(middle, apart)
        third = (found != first) & (found != last)
        chance = dr.select(third, 2 * chance, chance)
        ahead = (found == first) | (third & (chance >= 1))
        chance = dr.select(third & (chance >= 1), chance - 1, chance)
        return (
            k + 1,
            dr.select(ahead, middle, low),
            dr.select(ahead, high, middle),
            dr.select(ahead, found, first),
            dr.select(ahead, last, found),
            chance,
            dr.select(third, 2 * times, times),
        )

    steps = dr.opaque(UInt32, max(math.ceil(math.log2(part / lines.apart)), 1))
    start = dr.zeros(UInt32, lanes), low, low + part, first, last, chance, count
    _, low, high, _, _, _, times = dr.while_loop(start, lambda k, *_: apart & (k < steps), halve, label="bisection")
    return low, high, times, apart


def edge_direction(
    chains: Chains,
    lines: Lines,
    link: UInt32,
    middle: Float,
    a: SurfaceInteraction3f,
    b: SurfaceInteraction3f,
    ray: Ray3f,
    t: Float,
    active: Bool,
    rim: Bool,
) -> Normal3f:
    """The unit vector across an edge and the ray that touches it: 0 where it isn't found.

    A second crossing, a little beside the first one, shows in which direction the edge goes on. All edges on a surface
    end at its outline, along which they run at last, too close to tell which is which. So where `rim` is true, edges in
    the strip beside the outline don't count: the outline parts what is at the inner border of the strip from what is
    behind (`SilhouetteSample3f.strip`).
    """
    same = a.is_valid() & b.is_valid() & (a.shape_index == b.shape_index)
    touch = same & adjoin(a, b)

    def side(place: Float, beside: Float, active: Bool) -> tuple[Bool, Bool]:
        """Whether a chain arrives at the surface on this side of the edge, or on the other side."""
        si = chains.arrive(lines.rays(place, beside), lines.bits, link, active)
        nearer = dr.squared_norm(si.p - a.p) < dr.squared_norm(si.p - b.p)
        first = dr.select(same, si.is_valid() & nearer, side_of(si) == side_of(a))
        number = chains.surface(si)
        first = dr.select(touch, number == chains.surface(a), first)
        return first, dr.select(touch, number == chains.surface(b), ~first)

    # What is seen there may be narrow: of some steps the largest is taken that reaches beyond the edge alone.
    def narrow(reach: Float, found: Bool) -> Any:
        reach = reach * NARROWER
        there = side(middle - reach, BESIDE * reach, active)[0] & side(middle + reach, BESIDE * reach, active)[1]
        return reach, there

    lanes, narrowest = dr.width(lines.bits), dr.opaque(Float, NARROWEST * lines.apart / NARROWER)
    reach, found = dr.while_loop(
        (
            dr.full(Float, lines.length / lines.parts / NARROWER, lanes),
            dr.full(Bool, False, lanes),
        ),
        lambda reach, found: active & ~found & (reach > narrowest),
        narrow,
        label="width of edges",
    )
    beside = BESIDE * reach

    def halve(k: UInt32, start: Float, end: Float) -> Any:
        half = 0.5 * (start + end)
        ahead, _ = side(half, beside, found)
        return k + 1, dr.select(ahead, half, start), dr.select(ahead, end, half)

    _, start, end = dr.while_loop(
        (dr.zeros(UInt32, lanes), middle - reach, middle + reach),
        lambda k, *_: found & (k < DIRECTION_STEPS),
        halve,
        label="direction of edges",
    )
    along = dr.normalize(Vector2f(0.5 * (start + end) - middle, beside))
    width = Float(STRIP * lines.apart)
    s, r = along.y * width, along.x * width
    inside = side(middle - s, r, found & rim)[0] & side(middle + s, -r, found & rim)[1]
    found = found & (inside | ~rim)
    # How the point of the ray moves along the edge.
    with dr.resume_grad():
        step = Float(0)
        dr.enable_grad(step)
        moved = chains.attached(lines.rays(dr.fma(along.x, step, middle), along.y * step), lines.bits, link, found)
        dr.forward_from(step, flags=dr.ADFlag.ClearEdges)
        o, d = dr.grad(moved.o), dr.grad(moved.d)
    across = dr.cross(ray.d, dr.fma(d, t, o))
    size = dr.norm(across)
    return Normal3f(dr.select(found & (size > 0), across / size, 0))

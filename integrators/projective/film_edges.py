"""Edges on the film that no shape knows of: where surfaces meet, or textures jump, and what mirrors and glass show."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.errors import RenderError
from djpt.integrators.projective.crossings import PRECISION, Lines, edges_on_lines
from djpt.integrators.projective.detail import seen_through
from djpt.integrators.projective.guiding import (
    UNIFORM_SHARE,
    BaseGuidingDistr,
    OcSpaceDistr,
    UniformDistr,
    effective_number,
    places_of,
)
from djpt.integrators.projective.reattach import has_mirrors
from djpt.integrators.projective.smooth_chains import Chains, random_turns
from djpt.jit.kernels import power_of_two
from djpt.jit.types import Bool, Color3f, Float, Point2f, Point3f, Vector2f

__all__ = ["FilmEdges"]

SHORT, LONG, PARTS = 0.25, 0.5, 8
"""The length of lines in pixels, with chains of smooth surfaces to follow a longer one, and their parts."""
FEW_LINES, MOST_LINES, ENOUGH = 1 << 14, 1 << 18, 256
"""The lines that the guide learns from, at least one per pixel: few, and if the edges that these find count for less
than enough of the same mass, as many as are expected to find enough, up to the most."""
LEVELS, EXTRA = 7, (8, 128)
"""The levels of the guide's octree, and the random points in each leaf, fewer if there are many leaves."""
MOST_EXTRA = 1 << 16
"""The random points for all lines that have crossed an edge; there are some leaves for each."""


class FilmEdges:
    """Such edges, found by random lines on the film, of which each is a point of the unit cube: a place, and an angle.

    Where the smooth surfaces of a scene show edges, an octree over the cube learns where these are.

    Args:
        integrator: the integrator.
        scene: the scene.
        sensor: the camera.
        meetings: whether surfaces may meet.
    """

    def __init__(self, integrator: Any, scene: Any, sensor: Any, meetings: bool) -> None:
        self._integrator, self._sensor, self._meetings = integrator, sensor, meetings
        longest = integrator.max_depth - 1 if has_mirrors(scene) else 0
        self._chains = Chains(integrator, scene, min(longest, 1) if integrator.direct_light_only else longest, True)
        self._guide: BaseGuidingDistr = UniformDistr()

    def learn(self, seed: Any) -> None:
        """Learn where edges are, if there are chains of smooth surfaces to follow: from few lines, or from more.

        Small lamps in mirrors show few of them an edge; an even sky in a ball shows one to every fiftieth line.
        """
        if not self._chains.longest:
            return
        with dr.suspend_grad():
            points, mass = self._random_lines(seed, FEW_LINES)
            lines, known = dr.width(points), effective_number(mass)
            if known < ENOUGH and lines < MOST_LINES:
                wanted = power_of_two(int(lines * ENOUGH / known)) if known else MOST_LINES
                points, mass = self._random_lines(seed, min(wanted, MOST_LINES))
            found = dr.width(places_of(mass > 0))
            if not found:
                return
            tree = OcSpaceDistr(
                LEVELS,
                1 << 24,
                min(max(power_of_two(MOST_EXTRA // found), EXTRA[0]), EXTRA[1]),
                lambda points, sampler: (Color3f(self._across(points, Float(1), sampler)[1]),),
                0.0,
                0.0,
                1,
                uniform_share=UNIFORM_SHARE,
            )
            try:
                tree.set_points(points, mass, seed)
            except RenderError:
                # Random points of the leaves find nothing.
                return
            self._guide = tree

    def _random_lines(self, seed: Any, lines: int) -> tuple[Point3f, Float]:
        """Random points of the cube, at least one per pixel, and the masses of the edges that their lines cross."""
        width, height = self._sensor.film().crop_size()
        count = -(-lines // (width * height))
        sampler, _ = self._integrator.prepare(self._sensor, seed, count, self._integrator.aov_names())
        points = Point3f(sampler.next_1d(), sampler.next_1d(), sampler.next_1d())
        mass = self._across(points, Float(1), sampler)[1]
        dr.eval(points, mass)
        return points, mass

    def estimate(self, sampler: Any) -> tuple[Color3f, Point2f, Bool]:
        """The derivative of the image by random points of edges, attached, their places, and where there are any."""
        with dr.suspend_grad():
            points, inverse = self._guide.sample(sampler)
        value, mass, place = self._across(Point3f(points), inverse, sampler)
        return value, place, mass > 0

    def _across(self, points: Point3f, weight: Float, sampler: Any) -> tuple[Color3f, Float, Point2f]:
        """The derivative by lines that belong to points of the cube, that for edges of the speed 1, and the places."""
        window, sensor = Point2f(self._sensor.film().crop_size()), seen_through(self._sensor, sampler)
        length = LONG if self._chains.longest else SHORT
        # Edges at the border of the film are crossed by lines about places beyond it, too.
        room = window + length
        middle = Point2f(points.x, points.y) * room - 0.5 * length
        weight = weight * (room.x * room.y / (window.x * window.y))
        sin, cos = dr.sincos(2 * math.pi * points.z)
        along, aside = Vector2f(cos, sin), Vector2f(-sin, cos)
        bits = random_turns(sampler)

        def place(s: Float, r: Float) -> Point2f:
            return Point2f(middle + along * (s - 0.5 * length) + aside * r)

        def rays(s: Float, r: Float) -> Ray3f:
            found: Ray3f = sensor.sample_ray_differential(0, 0, place(s, r) / window, Point2f(0))[0]
            return found

        apart = PRECISION * max(self._sensor.film().crop_size())
        lines = Lines(rays, length, apart, PARTS, bits, 0, self._meetings)
        value, mass, found = edges_on_lines(
            self._integrator, self._chains, lines, sampler, Bool(True), lambda _: Color3f(dr.detach(weight))
        )
        at = Point2f(dr.detach(place(found, Float(0))))
        shown = (at.x >= 0) & (at.y >= 0) & (at.x < window.x) & (at.y < window.y)
        return value, dr.select(shown, mass, 0), at

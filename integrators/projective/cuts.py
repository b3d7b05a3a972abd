"""The boundary term of curves in which surfaces meet: where shapes cut each other."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f, SurfaceInteraction3f
from djpt.integrators.projective.detail import seen_through
from djpt.integrators.projective.splat import keep
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32, Vector2f

__all__ = ["cuts_on_film"]

SEGMENT = 0.25
"""The length of segments, in pixels."""
BISECTIONS = 16
CLOSE = 1e-3
"""How far apart two surfaces may be where they meet, relative to 1 + the largest coordinate."""


def cuts_on_film(integrator: Any, scene: Any, sensor: Any, sampler: Any) -> tuple[Color3f, Point2f, Bool]:
    """The derivative of the image by random points of such curves, attached, their places, and where there are any.

    A segment of the length h that lies at random on a film of the area A meets a curve with the density 2 h / (pi A)
    per length of the curve (Crofton). If its ends show different surfaces a and b, bisection finds the point between.
    There, planes in the place of the surfaces have the same distance t along the ray: the curve is
    g = t_a - t_b = 0, and moves across itself with the speed -(dg / dtheta) / abs(grad g).
    """
    window, sensor = Point2f(sensor.film().crop_size()), seen_through(sensor, sampler)
    with dr.suspend_grad():
        place = sampler.next_2d() * window
        sin, cos = dr.sincos(2 * math.pi * sampler.next_1d())
        step = Vector2f(cos, sin) * SEGMENT
        low, high = place - 0.5 * step, place + 0.5 * step
        first, last = (surface(seen(integrator, scene, sensor, at, Bool(True))) for at in (low, high))
        apart = first != last
        chance = sampler.next_1d()

        def body(k: UInt32, low: Point2f, high: Point2f, first: Any, last: Any, chance: Float, weight: Float) -> Any:
            middle = 0.5 * (low + high)
            found = surface(seen(integrator, scene, sensor, middle, apart))
            # Between three surfaces there are two curves: one of them is chosen.
            third = (found != first) & (found != last)
            chance = dr.select(third, 2 * chance, chance)
            ahead = (found == first) | (third & (chance >= 1))
            chance = dr.select(chance >= 1, chance - 1, chance)
            return (
                k + 1,
                dr.select(ahead, middle, low),
                dr.select(ahead, high, middle),
                dr.select(ahead, found, first),
                dr.select(ahead, last, found),
                chance,
                dr.select(third, 2 * weight, weight),
            )

        lanes = dr.width(place)
        start = dr.zeros(UInt32, lanes), Point2f(low), Point2f(high), first, last, chance, dr.full(Float, 1, lanes)
        _, low, high, _, _, _, times = dr.while_loop(
            start, lambda k, *_: apart & (k < BISECTIONS), body, label="bisection"
        )
        a, b = (seen(integrator, scene, sensor, at, apart) for at in (low, high))
        size = CLOSE * (1 + dr.max(dr.abs(a.p)))
        gap = a.p - b.p
        meet = apart & a.is_valid() & b.is_valid()
        meet &= (dr.abs(dr.dot(a.n, gap)) < size) & (dr.abs(dr.dot(b.n, gap)) < size)
        here, there = (
            integrator.shade(scene, sampler, shown_ray(sensor, at, window), UInt32(0), None, meet) for at in (low, high)
        )
        keep(low, high, meet, here, there, times)
    change = change_of_distance(integrator, scene, sensor, low, meet)
    change -= change_of_distance(integrator, scene, sensor, high, meet)
    middle = 0.5 * (low + high)
    slope = film_slope(sensor, middle, window, dr.detach(a), dr.detach(b))
    length = dr.norm(slope)
    moves = meet & (length > 0)
    speed = change * dr.select(moves, -dr.sign(dr.dot(slope, step)) / length, 0)
    weight = dr.select(moves, (here - there) * (times * (0.5 * math.pi / SEGMENT)), 0)
    return Color3f(weight) * speed, middle, moves


def shown_ray(sensor: Any, place: Point2f, window: Point2f) -> Ray3f:
    """The rays through places on the film, in pixels."""
    found: Ray3f = sensor.sample_ray_differential(0, 0, place / window, Point2f(0))[0]
    return found


def seen(integrator: Any, scene: Any, sensor: Any, place: Point2f, active: Bool) -> SurfaceInteraction3f:
    """What is seen at places on the film."""
    ray = shown_ray(sensor, place, Point2f(sensor.film().crop_size()))
    found: SurfaceInteraction3f = integrator.first_hit(scene, ray, active)
    return found


def surface(si: SurfaceInteraction3f) -> UInt32:
    """A number for the shape that is hit; 0 for nothing."""
    return UInt32(dr.select(si.is_valid(), si.shape_index + 1, 0))


def change_of_distance(integrator: Any, scene: Any, sensor: Any, place: Point2f, active: Bool) -> Float:
    """How the distance of what is seen changes: 0, attached."""
    t = seen(integrator, scene, sensor, place, active).t
    return dr.select(active, t - dr.detach(t), 0)


def film_slope(
    sensor: Any, place: Point2f, window: Point2f, a: SurfaceInteraction3f, b: SurfaceInteraction3f
) -> Vector2f:
    """The gradient on the film, per pixel, of the difference of the distances to the tangent planes of two hits."""
    slopes = []
    with dr.resume_grad():
        for direction in (Vector2f(1, 0), Vector2f(0, 1)):
            offset = Float(0)
            dr.enable_grad(offset)
            ray = shown_ray(sensor, dr.detach(place) + direction * offset, window)
            o, d = ray.o, ray.d
            g = dr.dot(a.n, a.p - o) / dr.dot(a.n, d) - dr.dot(b.n, b.p - o) / dr.dot(b.n, d)
            dr.forward(offset)
            slopes.append(dr.grad(g))
    return Vector2f(*slopes)

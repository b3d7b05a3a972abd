"""Derivatives of flights with respect to the extinction, which trackers lack, since they only make decisions.

Along a ray the radiance is L = integral of T(t) sigma_s(t) S(t) dt, plus what lies behind, where T is the transmittance
and S the light that arrives to be scattered. A change of sigma_t changes it in two ways.

* T(t) changes by -T(t) times the integral of the change up to t. Each flight takes that from one uniform point of the
  way that it has flown (`passed`), so there is no density to divide by.
* More matter scatters more light. Where light was scattered, that is the light over sigma_t, which no path finds where
  there is no matter, and few where there is little. So both this estimate (`of_flight`) and another are taken, with the
  shares sigma_t / (sigma_t + sigma_0) and sigma_0 / (sigma_t + sigma_0) of the derivative (`thin`). The other one is
  the light that a point of the way would scatter, the same point as before (`uniform_point`): a flight gets as far as
  there with the probability T. A path that begins at the point finds that light: see
  `djpt.rendering.gradients.extinction_walk`.

Trackers read one number of a grid in place of the eight around a point, which has the right mean. Derivatives are those
of the interpolation between the eight: what a point tells is spread over all, with less noise for each.

M. Nimier-David, T. Mueller, A. Keller and W. Jakob, "Unbiased Inverse Volume Rendering with Differential Trackers",
SIGGRAPH 2022, have found why the second estimate is needed; theirs takes the point among collisions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.core.records.interactions import MediumInteraction3f
from djpt.jit.kernels import maximum
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.media.flight import FAR
from djpt.samplers.independent import IndependentStream
from djpt.samplers.seeds import sample_tea_32

if TYPE_CHECKING:
    from djpt.media.base import Medium

__all__ = ["ScatteringPoint", "elsewhere", "of_flight", "own_stream", "passed", "uniform_point"]

THIN = 0.03
"""sigma_0 as a fraction of the majorant, in dense media."""
FEW = 0.5
"""sigma_0 times the way of a ray through the medium, in thin ones: collisions so rare would be noise."""
LEAST = 1e-6
"""The minimum sigma_0, for unbounded media without matter."""
SHORT = 1e-9
"""The minimum distance that is divided by."""


def own_stream(ray: Ray3f, t: Float) -> IndependentStream:
    """Random numbers that depend on a segment of a ray alone.

    Derivatives take no numbers from the path's own stream: paths are the same with and without derivatives.
    """
    numbers = (ray.o.x, ray.o.y, ray.o.z, ray.d.x, ray.d.y, ray.d.z, t)
    words: list[Any] = [dr.reinterpret_array(UInt32, x) for x in numbers]
    a, b = words[0] ^ (words[1] << 16) ^ (words[2] >> 7), words[3] ^ (words[4] << 11) ^ (words[5] >> 5)
    return IndependentStream.seeded(*sample_tea_32(a + words[6], b))


@dataclass
class ScatteringPoint:
    """A uniform point of a part of a ray that was flown."""

    t: Float
    length: Float
    """The length of that part, the inverse of the density; 0 where there is none."""
    choice: Float
    """A number to choose between this point and those of other parts."""

    @staticmethod
    def none() -> ScatteringPoint:
        """The scattering point of lanes that have none: its weight is 0."""
        return ScatteringPoint(Float(0), Float(0), Float(0))


def uniform_point(ray: Ray3f, start: Float, end: Float, active: Bool) -> ScatteringPoint:
    """The point of a segment that derivatives are taken from; it depends on the segment alone."""
    stream = own_stream(ray, end)
    length = dr.select(active & (end > start) & (end < FAR), end - start, 0)
    return ScatteringPoint(dr.fma(length, stream.next_1d(), start), length, stream.next_1d())


def passed(medium: Medium, ray: Ray3f, start: Float, end: Float, active: Bool) -> Color3f:
    """1, with the derivative of the transmittance between two points of a ray, over the transmittance.

    Args:
        medium: The medium, with values that have derivatives.
        ray: The ray, with a unit direction.
        start: Where the segment begins.
        end: Where it ends; lanes with an empty segment have no derivative.
        active: Lanes that have a segment.
    """
    point = uniform_point(ray, start, end, active)
    sigma_t = medium.extinction(MediumInteraction3f.on(ray, point.t), point.length > 0)
    return with_change(-point.length * sigma_t)


def of_flight(medium: Medium, ray: Ray3f, start: Float, end: Float, collided: Bool, active: Bool) -> Color3f:
    """1, with the derivative of a flight over its weight: by its segment and, where it `collided`, its collision.

    One of the two is drawn, in proportion to what a change of sigma_t counts there: reading the eight numbers around a
    point, and adding to each, takes time.
    """
    point, at = uniform_point(ray, start, end, active), MediumInteraction3f.on(ray, end)
    gain = dr.select(collided, dr.rcp(dr.detach(medium.extinction(at, collided)) + thin(medium, ray, at)), 0)
    chance = dr.max(gain) * dr.rcp(dr.max(gain) + point.length)
    there = collided & (point.choice < chance)
    factor = dr.select(there, gain * dr.rcp(chance), -point.length * dr.rcp(1 - chance))
    mei = MediumInteraction3f.on(ray, dr.select(there, end, point.t))
    drawn = there | (point.length > 0)
    return with_change(dr.select(drawn, factor * medium.extinction(mei, drawn), 0))


def elsewhere(medium: Medium, ray: Ray3f, mei: MediumInteraction3f, active: Bool) -> Color3f:
    """The fraction of the derivative of sigma_t that is left for scattering points."""
    sigma_0 = thin(medium, ray, mei)
    return sigma_0 * dr.rcp(dr.detach(medium.extinction(mei, active)) + sigma_0)


def thin(medium: Medium, ray: Ray3f, mei: MediumInteraction3f) -> Float:
    """sigma_0, the extinction at which both estimates have equal shares.

    A collision of which there is one in n flights counts n times, so what is rare on the whole way of the ray through
    the medium's box is left to scattering points.
    """
    _, mint, maxt = medium.intersect_aabb(ray)
    rare = FEW * dr.rcp(maximum(maxt - mint, Float(SHORT)))
    return maximum(dr.detach(dr.max(medium.get_majorant(mei))) * THIN, maximum(rare, Float(LEAST)))


def with_change(change: Color3f) -> Color3f:
    """1, with the derivative of `change`."""
    if not dr.grad_enabled(change):
        return Color3f(1)
    one: Any = dr.replace_grad(Color3f(1), change)  # type: ignore[func-returns-value]
    return one

"""Flights through media whose extinction varies: delta tracking and ratio tracking.

Matter that has no effect is added until the extinction is the same everywhere, a majorant m. Distances are then
sampled in closed form; a collision at p is real with the probability sigma_t(p) / m, and otherwise the light goes on
(E. Woodcock et al., 1965). The share of light that passes a segment is estimated by the product of 1 - sigma_t / m over
all collisions (J. Novak, A. Selle and W. Jarosz, "Residual Ratio Tracking", SIGGRAPH Asia 2014). Majorants may change
along the ray: a flight that reaches the end of one goes on from there, since it has no memory.

Both are linear in sigma_t at each collision, so an estimate with the right mean serves as well as the value.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.kernels import maximum, minimum, wide
from djpt.media.differentials import ScatteringPoint, elsewhere, of_flight, own_stream, passed, uniform_point
from djpt.media.flight import Flight
from djpt.records import Ray3f
from djpt.records.media import MediumInteraction3f
from djpt.samplers.base import SampleStream, go_on_with
from djpt.types import Bool, Color3f, Float

if TYPE_CHECKING:
    from djpt.media.base import Medium

__all__ = ["Majorants", "fly", "scattering_point", "span", "transmittance"]

Majorants = Callable[[Float, "Bool | bool"], tuple[Float, Float]]
"""Gives the majorant at a point of a ray, and the distance where it ends to hold; it must lie beyond the point."""

LITTLE = 0.1
"""Estimates of a transmittance below it are ended by Russian roulette, or raised to `KEPT`."""
KEPT = 0.5


@dataclass
class Track:
    """A flight, or a segment whose transmittance is estimated: loop state."""

    t: Float
    weight: Color3f
    """Of a flight, the weight that the choice between channels leaves; else the transmittance so far."""
    collided: Bool
    stream: Any
    active: Bool
    shown: tuple[Float, ...] = ()
    """A place of the flight so far, uniformly distributed: of media that glow and have weights."""
    shown_weight: tuple[Color3f, ...] = ()
    """The weight at that place."""


def fly(
    medium: Medium,
    ray: Ray3f,
    length: Float,
    throughput: Color3f,
    stream: SampleStream,
    active: Bool,
    leaves: Medium | None = None,
) -> Flight:
    """Sample how far light gets on a segment of a ray with a unit direction, by delta tracking.

    If sigma_t differs between channels, a collision is real with the mean of their probabilities, each counted as much
    as light is left in its channel: so the mean of the path's throughput stays as it is, and no channel outgrows it.
    (P. Kutz et al., "Spectral and Decomposition Tracking for Rendering Heterogeneous Volumes", SIGGRAPH 2017, call
    such probabilities history-aware.) The light of a medium that glows is read at one place of the flight, uniformly
    distributed: flights reach a place as light comes from it. `leaves` is the medium with values that have derivatives:
    those by transmittance, albedo and emission are then attached.
    """
    start, end = span(medium, ray, length, active)
    majorants, coloured = medium.majorants(ray), medium.has_spectral_extinction()
    importance = dr.detach(throughput) * dr.rcp(dr.mean(dr.detach(throughput)))

    def step(track: Track) -> tuple[Track]:
        t, meets, share = collision(medium, majorants, ray, end, track)
        probability = dr.mean(importance * track.weight * share) if coloured else share.x
        real = meets & (track.stream.next_1d(meets) < probability)
        weight = track.weight
        if coloured:
            weight = weight * dr.select(real, share * dr.rcp(probability), (1 - share) * dr.rcp(1 - probability))
            weight = dr.select(meets, weight, track.weight)
        shown, shown_weight = place_shown(track, start, t) if track.shown else ((), ())
        return (Track(t, weight, real, track.stream, track.active & ~real & (t < end), shown, shown_weight),)

    track = run(step, start, end, stream, active, "delta tracking", coloured and medium.emits())
    emitted = glow(medium, ray, start, track, stream, active, leaves) if medium.emits() else Color3f(0)
    weight = track.weight
    if leaves is not None:
        weight = weight * of_flight(leaves, ray, start, track.t, track.collided, active)
    albedo = (leaves or medium).albedo_at(MediumInteraction3f.on(ray, track.t), track.collided)
    value = dr.select(track.collided, weight * albedo, weight)
    return Flight(track.t, track.collided, value, Color3f(1), emitted)


def place_shown(track: Track, start: Float, t: Float) -> tuple[tuple[Float, ...], tuple[Color3f, ...]]:
    """A place of a flight that has come to `t`, uniformly distributed, and the weight there."""
    step = t - track.t
    # In proportion to its length the last step replaces all before.
    share = step * dr.rcp(t - start)
    u = track.stream.next_1d(track.active)
    here = track.active & (u < share)
    place = dr.select(here, dr.fma(u * dr.rcp(share), step, track.t), track.shown[0])
    return (place,), (dr.select(here, track.weight, track.shown_weight[0]),)


def glow(
    medium: Medium,
    ray: Ray3f,
    start: Float,
    track: Track,
    stream: SampleStream,
    active: Bool,
    leaves: Medium | None,
) -> Color3f:
    """An estimate of the light that a medium adds on a flight, from one place of it; attached if there are `leaves`."""
    flown = dr.select(active, track.t - start, 0)
    if track.shown:
        place, weight = track.shown[0], track.shown_weight[0]
    else:
        place, weight = dr.fma(stream.next_1d(active), flown, start), Color3f(1)
    if leaves is not None:
        weight = weight * passed(leaves, ray, start, place, flown > 0)
    emission = (leaves or medium).emission_at(MediumInteraction3f.on(ray, place), flown > 0)
    return dr.select(flown > 0, emission * weight * flown, 0)


def transmittance(
    medium: Medium, ray: Ray3f, length: Float, stream: SampleStream, active: Bool, leaves: Medium | None = None
) -> Color3f:
    """An estimate of the share of light that passes a segment of a ray with a unit direction, by ratio tracking.

    `leaves` is the medium with values that have derivatives.
    """
    start, end = span(medium, ray, length, active)
    majorants = medium.majorants(ray)

    def step(track: Track) -> tuple[Track]:
        t, meets, share = collision(medium, majorants, ray, end, track)
        left = dr.select(meets, track.weight * (1 - share), track.weight)
        chance = dr.max(left) * (1 / KEPT)
        little = meets & (chance * KEPT < LITTLE)
        survives = ~little | (track.stream.next_1d(little) < chance)
        left = dr.select(survives, dr.select(little, left * dr.rcp(chance), left), 0)
        return (Track(t, left, Bool(False), track.stream, track.active & survives & (t < end)),)

    left = run(step, start, end, stream, active, "ratio tracking").weight
    return left if leaves is None else left * passed(leaves, ray, start, end, active)


def scattering_point(
    medium: Medium, ray: Ray3f, flown: Float, length: Float, active: Bool
) -> tuple[ScatteringPoint, Color3f]:
    """A point of a segment at which more matter would scatter light, and the weight of a change of sigma_t there.

    A flight that got as far as `flown` has passed a point with the probability of the transmittance. That isn't so if
    channels differ: then the point lies anywhere on the segment, and the transmittance is estimated.
    """
    coloured = medium.has_spectral_extinction()
    point = uniform_point(ray, *span(medium, ray, length if coloured else flown, active), active)
    mei = MediumInteraction3f.on(ray, point.t)
    weight = medium.albedo_at(mei, active) * (elsewhere(medium, mei, active) * point.length)
    if coloured:
        weight = weight * transmittance(medium, ray, point.t, own_stream(ray, point.t), active & (point.length > 0))
    return point, weight


def span(medium: Medium, ray: Ray3f, length: Float, active: Bool) -> tuple[Float, Float]:
    """The part of a segment that lies in the medium's box; an empty one where there is none."""
    meets, mint, maxt = medium.intersect_aabb(ray)
    start = maximum(mint, Float(0))
    return start, dr.select(meets & active, minimum(maxt, length), start)


def collision(
    medium: Medium, majorants: Majorants, ray: Ray3f, end: Float, track: Track
) -> tuple[Float, Bool, Color3f]:
    """Go on to the next collision, real or not, or to where the majorant ends to hold.

    Returned are the distance, whether there is a collision, and an estimate of sigma_t / majorant there.
    """
    majorant, holds = majorants(track.t, track.active)
    inverse = dr.rcp(majorant)
    reach = minimum(holds, end)
    t = track.t - dr.log(1 - track.stream.next_1d(track.active)) * inverse
    meets = track.active & (t < reach)
    share = medium.extinction_at(MediumInteraction3f.on(ray, t), track.stream.next_1d(meets), meets) * inverse
    return dr.select(meets, t, reach), meets, share


def run(
    step: Callable[[Track], tuple[Track]],
    start: Float,
    end: Float,
    stream: SampleStream,
    active: Bool,
    label: str,
    places: bool = False,
) -> Track:
    """Make steps until the segment is through, and leave the stream where they have left it.

    With `places` the track has places to be `shown`.
    """
    lanes = dr.width(start, end, stream, active)
    first = Track(
        t=wide(start, lanes),
        weight=dr.ones(Color3f, lanes),
        collided=dr.full(Bool, False, lanes),
        stream=stream,
        active=(active & (start < end)) | dr.full(Bool, False, lanes),
        shown=(wide(start, lanes),) if places else (),
        shown_weight=(dr.ones(Color3f, lanes),) if places else (),
    )
    # What a tracker reads has no derivatives: see `djpt.media.differentials`.
    with dr.suspend_grad():
        (track,) = dr.while_loop((first,), lambda track: track.active, step, label=label)
    go_on_with(stream, track.stream)
    return track

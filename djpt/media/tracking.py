"""Flights through media whose extinction varies: delta tracking and ratio tracking.

Matter that has no effect is added until the extinction is the same everywhere, a majorant m. Distances are then sampled
in closed form; a collision at p is real with the probability sigma_t(p) / m, and otherwise the light continues (E.
Woodcock et al., 1965). The fraction of light that passes a segment is estimated by the product of 1 - sigma_t / m over
all collisions (J. Novak, A. Selle and W. Jarosz, "Residual Ratio Tracking", SIGGRAPH Asia 2014). Majorants may change
along the ray: a flight that reaches the end of one continues from there, since it has no memory.

Both are linear in sigma_t at each collision, so an estimate with the right mean serves as well as the value.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.core.records.interactions import MediumInteraction3f
from djpt.jit.kernels import maximum, minimum, wide
from djpt.jit.types import Bool, Color3f, Float
from djpt.media.differentials import ScatteringPoint, elsewhere, of_flight, own_stream, passed, uniform_point
from djpt.media.flight import Flight
from djpt.samplers.base import SampleStream, go_on_with

if TYPE_CHECKING:
    from djpt.media.base import Medium

__all__ = ["Majorants", "Track", "fly", "landing", "scattering_point", "span", "step", "transmittance"]

Majorants = Callable[[Float, "Bool | bool"], tuple[Float, Float]]
"""Returns the majorant at a point of a ray, and the distance up to which it holds, which must lie beyond the point."""

LITTLE = 0.1
"""Estimates of a transmittance below it are ended by Russian roulette, or raised to `KEPT`."""
KEPT = 0.5

SHORTEST = 2.0**-16
"""The least mean distance between collisions, as a fraction of 1 + max abs(coordinates): denser matter counts as that.

Shorter steps get lost when they are added to a distance in single precision: a flight through clear air beside dense
matter would never end. The fraction is a sixth of `RAY_EPSILON`, by which rays are kept off surfaces.
"""


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
    """Sample how far light travels on a segment of a ray with a unit direction, by delta tracking.

    If sigma_t differs between channels, a collision is real with the mean of their probabilities, each counted as much
    as light is left in its channel: so the mean of the path's throughput stays as it is, and no channel outgrows it.
    (P. Kutz et al., "Spectral and Decomposition Tracking for Rendering Heterogeneous Volumes", SIGGRAPH 2017, call
    such probabilities history-aware.) The light of a medium that glows is read at one place of the flight, uniformly
    distributed: flights reach a place as light comes from it. `leaves` is the medium with values that have derivatives:
    those by transmittance, albedo and emission are then attached.
    """
    start, end = span(medium, ray, length, active)
    majorants, coloured = medium.majorants(ray), medium.has_spectral_extinction()
    importance = importance_of(throughput)

    def fly_on(track: Track) -> tuple[Track]:
        t, meets, share = collision(medium, majorants, ray, end, track)
        probability = scattering_probability(coloured, importance, track.weight, share)
        real = meets & (track.stream.next_1d(meets) < probability)
        weight = weight_after(coloured, track.weight, share, probability, meets, real)
        shown, shown_weight = place_shown(track, start, t) if track.shown else ((), ())
        return (Track(t, weight, real, track.stream, track.active & ~real & (t < end), shown, shown_weight),)

    track = run(fly_on, start, end, stream, active, "delta tracking", coloured and medium.emits())
    return landing(medium, ray, start, track, stream, active, leaves)


def landing(
    medium: Medium,
    ray: Ray3f,
    start: Float,
    track: Track,
    stream: SampleStream,
    active: Bool,
    leaves: Medium | None = None,
) -> Flight:
    """The flight from `start` that has ended as its track says; for `leaves` see `fly`."""
    emitted = glow(medium, ray, start, track, stream, active, leaves) if medium.emits() else Color3f(0)
    weight = track.weight
    if leaves is not None:
        weight = weight * of_flight(leaves, ray, start, track.t, track.collided, active)
    albedo = (leaves or medium).albedo_at(MediumInteraction3f.on(ray, track.t), track.collided)
    value = dr.select(track.collided, weight * albedo, weight)
    return Flight(track.t, track.collided, value, Color3f(1), emitted)


def importance_of(throughput: Color3f) -> Color3f:
    """The importance of each channel of a path, with the mean 1."""
    return dr.detach(throughput) * dr.rcp(dr.mean(dr.detach(throughput)))


def scattering_probability(coloured: bool, importance: Color3f, weight: Color3f, share: Color3f) -> Float:
    """The probability that a collision is real: `share` is sigma_t / majorant."""
    return dr.mean(importance * weight * share) if coloured else share.x


def weight_after(
    coloured: bool, weight: Color3f, share: Color3f, probability: Float, meets: Bool, real: Bool
) -> Color3f:
    """The weight of a flight after a collision, if there was one."""
    if not coloured:
        return weight
    after = weight * dr.select(real, share * dr.rcp(probability), (1 - share) * dr.rcp(1 - probability))
    return dr.select(meets, after, weight)


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
    """An estimate of the fraction of light that passes a segment of a ray with a unit direction, by ratio tracking.

    `leaves` is the medium with values that have derivatives.
    """
    start, end = span(medium, ray, length, active)
    majorants = medium.majorants(ray)

    def pass_on(track: Track) -> tuple[Track]:
        t, meets, share = collision(medium, majorants, ray, end, track)
        left, chance, little = thinned(track.weight, share, meets)
        survives = ~little | (track.stream.next_1d(little) < chance)
        left = dr.select(survives, dr.select(little, left * dr.rcp(chance), left), 0)
        return (Track(t, left, Bool(False), track.stream, track.active & survives & (t < end)),)

    left = run(pass_on, start, end, stream, active, "ratio tracking").weight
    return left if leaves is None else left * passed(leaves, ray, start, end, active)


def thinned(transmittance: Color3f, share: Color3f, meets: Bool) -> tuple[Color3f, Float, Bool]:
    """The transmittance after a collision, the chance to survive that gives it, and where it is taken."""
    left = dr.select(meets, transmittance * (1 - share), transmittance)
    chance = dr.max(left) * (1 / KEPT)
    return left, chance, meets & (chance * KEPT < LITTLE)


def step(
    medium: Medium,
    majorants: Majorants,
    ray: Ray3f,
    start: Float,
    end: Float,
    estimates: Bool,
    throughput: Color3f,
    track: Track,
) -> Track:
    """The next step of a flight or, where `estimates`, of an estimate of a transmittance.

    It does what a step of `fly` or `transmittance` does, with the same random numbers, but both at once: for loops in
    which rays of both kinds are under way. Only where the track is `active` something happens.
    """
    coloured, moves = medium.has_spectral_extinction(), track.active
    t, meets, share = collision(medium, majorants, ray, end, track)
    probability = scattering_probability(coloured, importance_of(throughput), track.weight, share)
    left, chance, little = thinned(track.weight, share, meets)
    number = track.stream.next_1d(dr.select(estimates, little, meets))
    survives = ~(estimates & little) | (number < chance)
    real = meets & ~estimates & (number < probability)
    left = dr.select(survives, dr.select(little, left * dr.rcp(chance), left), 0)
    onward = weight_after(coloured, track.weight, share, probability, meets, real)
    shown, shown_weight = track.shown, track.shown_weight
    if coloured and medium.emits():
        shown, shown_weight = place_shown(replace(track, active=moves & ~estimates), start, t)
    return Track(
        t=dr.select(moves, t, track.t),
        weight=dr.select(estimates, left, onward),
        collided=dr.select(moves, real, track.collided),
        stream=track.stream,
        active=moves & ~real & survives & (t < end),
        shown=shown,
        shown_weight=shown_weight,
    )


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
    weight = medium.albedo_at(mei, active) * (elsewhere(medium, ray, mei, active) * point.length)
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
    """Continue to the next collision, real or not, or to the end of the majorant's range.

    Returned are the distance, whether there is a collision, and an estimate of sigma_t / majorant there.
    """
    majorant, holds = majorants(track.t, track.active)
    inverse = maximum(dr.rcp(majorant), (1 + dr.max(dr.abs(ray.o)) + track.t) * SHORTEST)
    reach = minimum(holds, end)
    t = track.t - dr.log(1 - track.stream.next_1d(track.active)) * inverse
    meets = track.active & (t < reach)
    share = medium.extinction_at(MediumInteraction3f.on(ray, t), track.stream.next_1d(meets), meets) * inverse
    # Rounding, or matter that is denser than steps are short, must not make what passes negative.
    return dr.select(meets, t, reach), meets, Color3f(*(minimum(c, Float(1)) for c in share))


def run(
    advance: Callable[[Track], tuple[Track]],
    start: Float,
    end: Float,
    stream: SampleStream,
    active: Bool,
    label: str,
    places: bool = False,
) -> Track:
    """Make steps to the end of the segment, and advance the stream by the numbers that they draw.

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
        (track,) = dr.while_loop((first,), lambda track: track.active, advance, label=label)
    go_on_with(stream, track.stream)
    return track

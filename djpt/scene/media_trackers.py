"""Rays through tracked media, a few steps at a time."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.media import tracking
from djpt.media.flight import Flight
from djpt.media.tracking import Track
from djpt.samplers.base import SampleStream
from djpt.scene.media_placement import Media

if TYPE_CHECKING:
    from djpt.media.base import Medium

__all__ = ["Trackers"]


class Trackers:
    """The tracking of a scene's media, taken out of its loops.

    What `Media.fly` and `Media.transmittance` do at once becomes `begun`, `advance` until the track is no longer
    active, and `landing` or `left`, with the same random numbers. Media with a closed form have no steps.
    """

    def __init__(self, media: Media) -> None:
        self._media = media
        self._groups = [group for group in media.ensemble.groups if group.plugins[0].is_tracked]
        self._shows = any(p.emits() and p.has_spectral_extinction() for g in self._groups for p in g.plugins)

    def tracked(self, medium: UInt32 | None) -> Bool:
        """True where a medium has steps."""
        result = Bool(False)
        if medium is None:
            return result
        for group in self._groups:
            result |= self._media.ensemble.members(group, medium)
        return result

    def begun(self, ray: Ray3f, length: Float, stream: SampleStream, active: Bool) -> tuple[Track, Float]:
        """The track at the start of a segment of a ray with a unit direction, and where it ends."""
        start, end = (Float(0), Float(0)) if ray.medium is None else self._media.in_box(ray, length)
        shown: tuple[Any, Any] = ((start,), (Color3f(1),)) if self._shows else ((), ())
        return Track(start, Color3f(1), Bool(False), stream, active & (start < end), *shown), end

    def advance(
        self, track: Track, ray: Ray3f, length: Float, end: Float, estimates: Bool, throughput: Color3f, steps: int
    ) -> Track:
        """Make some steps where the track is active: of a flight or, where it `estimates`, of a transmittance."""
        assert ray.medium is not None
        for group in self._groups:
            mine = self._media.ensemble.members(group, ray.medium)
            medium = self._medium(group, ray)
            majorants, (start, _) = medium.majorants(ray), tracking.span(medium, ray, length, mine)
            moved = replace(track, active=track.active & mine)
            for _ in range(steps):
                moved = tracking.step(medium, majorants, ray, start, end, estimates, throughput, moved)
            track = replace(moved, active=dr.select(mine, moved.active, track.active))
        return track

    def landing(
        self,
        ray: Ray3f,
        length: Float,
        channel: UInt32 | None,
        throughput: Color3f,
        track: Track,
        stream: SampleStream,
        active: Bool,
    ) -> Flight:
        """The flight whose track has ended; in media with a closed form it is sampled now."""
        flight = Flight.none()
        if ray.medium is None:
            return flight
        for group in self._media.ensemble.groups:
            mine = self._media.ensemble.members(group, ray.medium) & active
            medium = self._medium(group, ray)
            if group in self._groups:
                start, _ = tracking.span(medium, ray, length, mine)
                ended = replace(track, collided=track.collided & mine)
                of_group = tracking.landing(medium, ray, start, ended, stream, mine)
            else:
                of_group = medium.fly(ray, length, channel, throughput, stream, mine)
            flight = dr.select(mine, of_group, flight)
        return flight

    def left(self, ray: Ray3f, length: Float, track: Track) -> Color3f:
        """The fraction of light that is left behind a segment whose track has ended."""
        left = Color3f(1)
        if ray.medium is None:
            return left
        for group in self._media.ensemble.groups:
            mine = self._media.ensemble.members(group, ray.medium)
            if group in self._groups:
                left = dr.select(mine, track.weight, left)
            else:
                share = self._medium(group, ray).transmittance(ray, length, None, mine)
                left = dr.select(mine, share, left)
        return left

    def _medium(self, group: Any, ray: Ray3f) -> Medium:
        """The medium of each ray, if it is in this group."""
        assert ray.medium is not None
        medium: Medium = group.at(self._media.ensemble.slots(group, ray.medium), self._media.lookup)
        return medium

"""Lights that move: questions carried into the space of the emitter of each lane, and answers back into the world.

All motions here are similarities, those of lights without size even rigid, so solid angles and the densities over them
are the same in both spaces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import drjit as dr

from djpt.core.lookup import Members
from djpt.core.records import DirectionSample3f, EmissionSample, Interaction3f, Observer, SurfaceInteraction3f
from djpt.core.transforms.keyframes import Placement
from djpt.emitters.base import Emitter
from djpt.jit.types import Float, UInt32, Vector3f

__all__ = ["Carriers", "carriers_of"]


def carriers_of(emitters: Sequence[Emitter]) -> Carriers | None:
    """The motions of some emitters; None if none of them moves."""
    return Carriers(emitters) if any(emitter.carrier is not None for emitter in emitters) else None


class Carriers:
    """The animated transforms of emitters, by the numbers of these."""

    def __init__(self, emitters: Sequence[Emitter]) -> None:
        kinds: dict[tuple[int, bool], tuple[Any, bool, list[int]]] = {}
        for i, emitter in enumerate(emitters):
            motion, infinite = emitter.carrier, emitter.from_infinity
            if motion is not None:
                kinds.setdefault((id(motion), infinite), (motion, infinite, []))[2].append(i)
        self._motions = [(motion, far, Members(numbers, len(emitters))) for motion, far, numbers in kinds.values()]
        self._turns_sky = any(far for _, far, _ in self._motions)

    def at(self, index: UInt32, time: Float) -> Carried:
        """The spaces of emitters at a time, per lane; of those that stay the world."""
        result = Placement.identity()
        for motion, far, members in self._motions:
            placement = motion.placement(time)
            result = dr.select(members.contain(index), placement.turned() if far else placement, result)
        return Carried(result, self._turns_sky)


class Carried:
    """The space of the emitter of each lane."""

    def __init__(self, placement: Placement, turns_sky: bool) -> None:
        self._placement, self._turns_sky = placement, turns_sky
        self._size = dr.abs(placement.scale.x)
        self.area = dr.square(self._size)
        """The factor from areas of the emitter to the world."""

    def own_observer(self, it: Observer) -> Observer:
        """The point that light is sampled for."""
        p = self._placement.own_point(it.p)
        return it.replaced(p=p) if isinstance(it, Interaction3f) else replace(it, p=p)

    def own_hit(self, si: SurfaceInteraction3f) -> SurfaceInteraction3f:
        """A hit, or a miss that sees the sky: local directions at hits are the same in all spaces."""
        if not self._turns_sky:
            return si
        wi = dr.select(si.is_valid(), si.wi, self._placement.own_vector(si.wi))
        result: SurfaceInteraction3f = si.replaced(wi=wi)
        result.found_at(si.t, si.is_valid())
        return result

    def own_direction(self, d: Any) -> Vector3f:
        """A unit direction."""
        return self._placement.own_vector(d) * self._size

    def own_sample(self, ds: DirectionSample3f) -> DirectionSample3f:
        """A direction towards the emitter."""
        place = self._placement
        result: DirectionSample3f = ds.replaced(
            p=place.own_point(ds.p),
            n=self.own_direction(ds.n),
            d=self.own_direction(ds.d),
            dist=ds.dist / self._size,
        )
        return result

    def sample(self, ds: DirectionSample3f) -> DirectionSample3f:
        """A sampled direction, in the world."""
        place = self._placement
        result: DirectionSample3f = ds.replaced(
            p=place.point(ds.p),
            n=place.vector(ds.n) / self._size,
            d=place.vector(ds.d) / self._size,
            dist=ds.dist * self._size,
        )
        return result

    def emission(self, es: EmissionSample, time: Float) -> EmissionSample:
        """A ray that leaves the emitter, in the world: densities by area change with its size."""
        place = self._placement
        ray = es.ray.replaced(o=place.point(es.ray.o), d=place.vector(es.ray.d) / self._size)
        ray.time = time
        return replace(
            es,
            ray=ray,
            n=place.vector(es.n) / self._size,
            weight=es.weight * self.area,
            pdf_position=es.pdf_position / self.area,
        )


def time_of(it: Observer, ds: DirectionSample3f | None = None) -> Float:
    """The time at which a point asks for light; 0 of a mere point."""
    if isinstance(it, Interaction3f):
        return it.time
    return Float(0) if ds is None else ds.time

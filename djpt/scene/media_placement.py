"""The media of a scene: which of them a ray runs through, free flights in them, and transmittance."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from djpt.core.lookup import Members, Numbers
from djpt.core.records import RAY_EPSILON, Ray3f, SurfaceInteraction3f
from djpt.core.records.flags import SurfaceDetail
from djpt.core.records.interactions import MediumInteraction3f
from djpt.description.plugin import Plugin
from djpt.dispatch.ensemble import Ensemble, Group, Lookup, is_attached
from djpt.dispatch.family import Family, Pointer
from djpt.errors import SceneError
from djpt.geometry.aggregate import Geometry, unseen
from djpt.jit.kernels import opaque, wide
from djpt.jit.types import Bool, Color3f, Float, Point3f, UInt32, Vector3f
from djpt.media import tracking
from djpt.media.differentials import ScatteringPoint
from djpt.media.flight import Flight
from djpt.media.tracking import Track
from djpt.samplers.base import SampleStream
from djpt.shapes.base import Shape

if TYPE_CHECKING:
    from djpt.media.base import Medium
    from djpt.phase.pointer import PhaseFunctionPtr
    from djpt.sensors.base import Sensor

__all__ = ["Media", "Trackers", "absorbing_sides", "all_sides"]

DIRECTIONS = ((0.3651484, 0.5477226, 0.7527727), (-0.6202, 0.3351, -0.7093), (0.2418, -0.9043, 0.3518))
"""Directions in which boundaries are looked for: arbitrary, but not along an axis, where rays run within faces."""


class Media:
    """Media that a scene follows along its rays. `vacuum` is the number for no medium.

    A ray carries the number of the medium that it runs through (`Ray3f.medium`). The number changes where it leaves a
    surface that bounds a medium, to the one on the side that it leaves to, and nowhere else.
    """

    def __init__(
        self, geometry: Geometry, lookup: Lookup, sides: Sequence[tuple[Any, Any] | None], others: Sequence[Medium] = ()
    ) -> None:
        """Number the media.

        Args:
            geometry: What rays hit.
            lookup: The way to read the plugins' values.
            sides: The media inside and outside of each shape (None stands for vacuum); None if it bounds no medium.
            others: Media that no shape bounds.
        """
        found = [medium for pair in sides if pair is not None for medium in pair if medium is not None]
        self.plugins: list[Medium] = list({id(medium): medium for medium in [*found, *others]}.values())
        self.ensemble: Ensemble[Medium] = Ensemble(self.plugins)
        phases = [medium.phase for medium in self.plugins if medium.phase is not None]
        self._phases: Ensemble[Any] = Ensemble(list({id(phase): phase for phase in phases}.values()))
        self._phase_of = Numbers([index_of(self._phases.plugins, medium.phase) for medium in self.plugins])
        self.vacuum = len(self.plugins)
        self._geometry, self.lookup = geometry, lookup
        # For shapes that bound no medium: one number more.
        self._kept = self.vacuum + 1
        self._inside = [self._kept if pair is None else self.number(pair[0]) for pair in sides]
        self._outside = [self._kept if pair is None else self.number(pair[1]) for pair in sides]
        self._closed = [i for i, pair in enumerate(sides) if pair is not None and is_closed(geometry, i)]
        self.prepare()

    def __bool__(self) -> bool:
        """True if there are any."""
        return bool(self.plugins)

    def prepare(self) -> None:
        """Build the tables that kernels read, after the scene was compiled or edited."""
        self._around: dict[tuple[float, ...], int] = {}
        self._inside_of_face = self._geometry.per_face(self._inside)
        self._outside_of_face = self._geometry.per_face(self._outside)
        self._bounds = Members(self._closed, len(self._inside))

    def replace(self, lookup: Lookup) -> Media:
        """A view whose values are read through `lookup`."""
        view = copy.copy(self)
        view.lookup = lookup
        return view

    def number(self, medium: Medium | None) -> int:
        """The number of a medium, or that of the vacuum."""
        return index_of(self.plugins, medium)

    @property
    def ensembles(self) -> Sequence[Ensemble[Any]]:
        """The plugins whose values kernels look up: media and their phase functions."""
        return (self.ensemble, self._phases) if self.plugins else ()

    def of_extinction(self) -> set[int]:
        """The ids of plugins whose values the extinction of tracked media depends on."""
        waiting: list[Any] = [plugin for medium in self.plugins for plugin in medium.of_extinction()]
        found: set[int] = set()
        while waiting:
            plugin = waiting.pop()
            found.add(id(plugin))
            if plugin.kind != "medium":
                children = (getattr(plugin, name) for name in plugin.children)
                waiting += [child for child in children if isinstance(child, Plugin)]
        return found

    @property
    def scatter(self) -> bool:
        """True if light can be scattered."""
        return any(medium.phase is not None for medium in self.plugins)

    @property
    def emit(self) -> bool:
        """True if some of them glow."""
        return any(medium.emits() for medium in self.plugins)

    @property
    def are_coloured(self) -> bool:
        """True if the extinction of some of them may differ between channels."""
        return any(medium.has_spectral_extinction() for medium in self.plugins)

    def are_attached(self) -> bool:
        """Whether some of them, or of their phase functions, compute with AD leaves."""
        return any(self.lookup.attaches(leaf) for ensemble in self.ensembles for leaf in ensemble.leaves())

    def number_of(self, medium: Any) -> UInt32:
        """The numbers of media as scripts give them: a medium or None for all lanes, or a `MediumPtr`."""
        if not isinstance(medium, Pointer):
            return UInt32(self.number(medium))
        numbers = Numbers([self.number(plugin) for plugin in medium.plugins] + [self.vacuum])
        return numbers.at(dr.minimum(medium.index, len(medium.plugins)))

    # ---- which medium ---------------------------------------------------------------------

    def around(self, p: np.ndarray | None) -> int:
        """The medium that a point (3,) lies in, computed at once; None stands for a point outside of all bodies.

        A ray may slip through an edge: the majority of three decides. Answers are kept, so that frozen functions need
        no kernel for what was asked before.
        """
        if p is None:
            return self.vacuum
        key = tuple(float(x) for x in p)
        if key not in self._around:
            self._around[key] = self._majority(key)
        return self._around[key]

    def _majority(self, p: tuple[float, ...]) -> int:
        directions = Vector3f(*(list(c) for c in zip(*DIRECTIONS, strict=True)))
        numbers = self.at(opaque(Point3f(*p)), directions).numpy()
        return int(np.bincount(numbers).argmax())

    def at(self, p: Point3f, direction: Vector3f | None = None, outside: UInt32 | None = None) -> UInt32:
        """The medium that each point lies in: the one on this side of the first boundary in an arbitrary direction.

        It is `outside` (default: the vacuum) where there is none. Only closed shapes count as boundaries. Traces rays
        through the scene: only where paths begin.
        """
        d = Vector3f(*DIRECTIONS[0]) if direction is None else direction
        outside = UInt32(self.vacuum) if outside is None else outside
        if not self._closed:
            return outside

        def step(walk: Walk) -> tuple[Walk]:
            ray = Ray3f(walk.o, walk.d)
            hit = self._geometry.closest(ray)
            found = hit.is_valid() & walk.active
            bounds = found & self._bounds.contain(hit.shape_index)
            surface = self._geometry.surface(ray, hit, self.lookup, SurfaceDetail.FRAME)
            leaving = points_outward(surface.n, surface.sh_frame.n, walk.d)
            side = dr.select(leaving, self._inside_of_face.at(hit.face), self._outside_of_face.at(hit.face))
            there = ray(dr.select(found, hit.t, 0))
            on = dr.fma(walk.d, RAY_EPSILON * (1 + dr.max(dr.abs(there))), there)
            return (Walk(on, walk.d, dr.select(bounds, side, walk.medium), found & ~bounds),)

        start = wide(Walk(Point3f(p), d, outside, Bool(True)), dr.width(p, d))
        (end,) = dr.while_loop((start,), lambda walk: walk.active, step, label="medium")
        return end.medium

    def of_sensor(self, sensor: Sensor, named: Medium | None = None) -> tuple[UInt32, UInt32 | None]:
        """The media that the rays of a sensor start in, and that lies outside of all bodies; None: the vacuum.

        Outside is the medium that the sensor names, or else the one `named`, if it stands there. If it hands its rays
        on to others, the first result has a number for each of these, unless they are all the same.
        """
        named = sensor.get_medium() or named
        several = [self.of_sensor(other, named) for other in sensor.delegates()]
        if several:
            starts = [int(start[0]) for start, _ in several]
            outer = next((outside for _, outside in several if outside is not None), None)
            return dr.opaque(UInt32, starts[0]) if len(set(starts)) == 1 else UInt32(starts), outer
        eye = sensor.viewpoint()
        if eye is not None and sensor.carrier is not None:
            eye = sensor.carrier.keyframes.at(sensor.shutter_open()).transform_point(eye)
        given, around = self.number(named), self.around(eye)
        return self.at_sensor(given, around)

    def at_sensor(self, given: int, around: int) -> tuple[UInt32, UInt32 | None]:
        """The media of `of_sensor`, from the numbers of the medium that the sensor names and of the one around it."""
        start = dr.opaque(UInt32, around if given == self.vacuum else given)
        outer = dr.opaque(UInt32, given) if given != self.vacuum and around == self.vacuum else None
        return start, outer

    def along(self, ray: Ray3f, t: Float, active: Bool) -> UInt32:
        """What a ray carries as its `medium` at a distance t, if it meets no surface before."""
        assert ray.medium is not None
        return ray.medium

    def filling(self, medium: UInt32) -> UInt32:
        """The numbers of media, from what rays carry as their `medium`: the same, unless bodies overlap."""
        return medium

    def index_around(self, si: SurfaceInteraction3f) -> Float | None:
        """The index of refraction around the shape at `si`, relative to that around the scene; None: always 1."""
        return None

    def beyond(self, si: SurfaceInteraction3f, d: Vector3f) -> UInt32:
        """The medium of a ray that leaves `si` in the world direction `d`."""
        side = self.side(si, d)
        elsewhere = UInt32(self.vacuum) if si.medium is None else si.medium
        return dr.select(side == self._kept, elsewhere, side)

    def side(self, si: SurfaceInteraction3f, d: Vector3f) -> UInt32:
        """The medium on the side of `si` that `d` points to; `vacuum` + 1 on surfaces that bound no medium."""
        outward = points_outward(si.n, si.sh_frame.n, d)
        return dr.select(outward, self._outside_of_face.at(si.face), self._inside_of_face.at(si.face))

    def phases(self, medium: UInt32) -> PhaseFunctionPtr:
        """The phase functions of media with the numbers `medium`."""
        from djpt.phase.pointer import PhaseFunctionPtr

        number = self._phase_of.at(self.filling(medium))
        pointer: PhaseFunctionPtr = PhaseFunctionPtr.into(Family(self._phases, self.lookup), number)
        return pointer

    def are_tracked(self, medium: UInt32) -> Bool:
        """True where distances in a medium are tracked."""
        tracked = Members([i for i, m in enumerate(self.plugins) if m.is_tracked], self.vacuum)
        return tracked.contain(self.filling(medium))

    def sample_emitters(self, medium: UInt32) -> Bool:
        """True where emitters are to be sampled from points in a medium."""
        sampling = Members([i for i, m in enumerate(self.plugins) if m.use_emitter_sampling()], self.vacuum)
        return sampling.contain(self.filling(medium))

    def coefficients(self, medium: UInt32, mei: MediumInteraction3f, active: Bool) -> tuple[Color3f, Color3f]:
        """sigma_s and sigma_t at points in media; 0 in a vacuum."""
        found, medium = (Color3f(0), Color3f(0)), self.filling(medium)
        for group in self.ensemble.groups:
            mine = self.ensemble.members(group, medium) & active
            here = group.at(self.ensemble.slots(group, medium), self.lookup)
            sigma_s, _, sigma_t = here.get_scattering_coefficients(mei, mine)
            found = dr.select(mine, (sigma_s, sigma_t), found)
        return found

    # ---- what becomes of light ---------------------------------------------------------------

    def fill(self, medium: UInt32) -> Bool:
        """True where a ray's medium isn't the vacuum."""
        return self.filling(medium) < self.vacuum

    def reach(self, ray: Ray3f, channel: UInt32 | None, throughput: Color3f, stream: SampleStream) -> Float:
        """The distance at which light is scattered if no surface is nearer, where that is known before the flight.

        Elsewhere infinity. Nothing is drawn from `stream`, which `fly` is to be given next.
        """
        assert ray.medium is not None
        number, reach = self.filling(ray.medium), Float(dr.inf)
        if self.emit or self.are_attached():  # then a flight depends on the surface behind its end
            return reach
        for group in self.ensemble.groups:
            mine, slot = self.ensemble.members(group, number), self.ensemble.slots(group, number)
            medium = group.at(slot, self.lookup)
            reach = dr.select(mine, medium.reach(ray, channel, throughput, stream.clone(), mine), reach)
        return reach

    def fly(
        self,
        ray: Ray3f,
        length: Float,
        channel: UInt32 | None,
        throughput: Color3f,
        stream: SampleStream,
    ) -> Flight:
        """Sample a free flight along a segment of a ray: see `djpt.media.base.Medium.fly`."""
        from djpt.media.flight import Flight

        assert ray.medium is not None
        number, flight = self.filling(ray.medium), Flight.none()
        for group in self.ensemble.groups:
            mine, slot = self.ensemble.members(group, number), self.ensemble.slots(group, number)
            medium, leaves = tracked_and_attached(group, slot, self.lookup)
            if leaves is None:
                flown = medium.fly(ray, length, channel, throughput, stream, mine)
            else:
                flown = tracking.fly(medium, ray, length, throughput, stream, mine, leaves)
            flight = dr.select(mine, flown, flight)
        return flight

    def passing_weight(self, ray: Ray3f, t: Float, throughput: Color3f, active: Bool) -> Color3f:
        """The transmittance up to a distance, over the probability of getting there: see `Medium.passing_weight`."""
        assert ray.medium is not None
        number, weight = self.filling(ray.medium), Color3f(1)
        for group in self.ensemble.groups:
            mine = self.ensemble.members(group, number)
            medium = group.at(self.ensemble.slots(group, number), self.lookup)
            weight = dr.select(mine, medium.passing_weight(ray, t, throughput, mine & active), weight)
        return weight

    def transmittance(
        self, ray: Ray3f, length: Float | None = None, stream: SampleStream | None = None, active: Bool | bool = True
    ) -> Color3f:
        """exp(-tau) for a segment of a ray in its medium, or an estimate of it; 1 in vacuum.

        Args:
            ray: The ray.
            length: The length of the segment, which begins at the ray's origin; by default that of a shadow ray.
            stream: Random numbers for an estimate; without them the medium must have a closed form.
            active: Lanes that have a segment.
        """
        left = Color3f(1)
        if ray.medium is None:
            return left
        length = dr.select(ray.maxt < dr.inf, dr.norm(ray.d), dr.inf) if length is None else length
        number = self.filling(ray.medium)
        for group in self.ensemble.groups:
            mine, slot = self.ensemble.members(group, number), self.ensemble.slots(group, number)
            medium, leaves = tracked_and_attached(group, slot, self.lookup)
            if leaves is None or stream is None:
                share = medium.transmittance(ray, length, stream, mine & active)
            else:
                share = tracking.transmittance(medium, ray, length, stream, mine & active, leaves)
            left = dr.select(mine, share, left)
        return left

    def in_box(self, ray: Ray3f, length: Float) -> tuple[Float, Float]:
        """The part of a segment of a ray that lies in the box of a tracked medium; elsewhere an empty one."""
        assert ray.medium is not None
        number, start, end = self.filling(ray.medium), Float(0), Float(0)
        for group in self._tracked():
            mine = self.ensemble.members(group, number)
            medium = group.at(self.ensemble.slots(group, number), self.lookup.plain())
            first, last = tracking.span(medium, ray, length, mine)
            start, end = dr.select(mine, first, start), dr.select(mine, last, end)
        return start, end

    def scattering_point(
        self, ray: Ray3f, flown: Float, length: Float, active: Bool
    ) -> tuple[ScatteringPoint, Color3f]:
        """A point of a segment of a ray at which more matter would scatter light.

        With it comes the weight of a change of sigma_t there: the transmittance over the density, the albedo, and this
        estimate's share of the derivative (see `djpt.media.differentials`).

        Args:
            ray: The ray.
            flown: How far light got on it.
            length: The length of the segment.
            active: Lanes that have a segment.
        """
        assert ray.medium is not None
        number, found, weight = self.filling(ray.medium), ScatteringPoint.none(), Color3f(0)
        for group in self._tracked():
            mine = self.ensemble.members(group, number) & active
            medium = group.at(self.ensemble.slots(group, number), self.lookup.plain())
            of_group = tracking.scattering_point(medium, ray, flown, length, mine)
            found, weight = dr.select(mine, of_group, (found, weight))
        return found, weight

    def extinction(self, medium: UInt32, mei: MediumInteraction3f, active: Bool) -> Color3f:
        """sigma_t at points in tracked media; 0 in all others."""
        return self._tracked_value(medium, lambda leaves, mine: leaves.extinction(mei, mine & active))

    def extinction_at(self, medium: UInt32, mei: MediumInteraction3f, u: Float, active: Bool) -> Color3f:
        """An estimate of sigma_t at points in tracked media, from a uniform number; 0 in all others."""
        return self._tracked_value(medium, lambda leaves, mine: leaves.extinction_at(mei, u, mine & active))

    def _tracked_value(self, medium: UInt32, value: Callable[[Medium, Bool], Color3f]) -> Color3f:
        """The results of tracked media; 0 for all others."""
        number, answer = self.filling(medium), Color3f(0)
        for group in self._tracked():
            mine = self.ensemble.members(group, number)
            leaves = group.at(self.ensemble.slots(group, number), self.lookup)
            answer = dr.select(mine, value(leaves, mine), answer)
        return answer

    def _tracked(self) -> list[Group[Medium]]:
        """The groups of media whose flights are tracked."""
        return [group for group in self.ensemble.groups if group.plugins[0].is_tracked]


@dataclass
class Walk:
    """A ray on its way to the first boundary: loop state."""

    o: Point3f
    d: Vector3f
    medium: UInt32
    active: Bool


def tracked_and_attached(group: Group[Medium], slot: UInt32, lookup: Lookup) -> tuple[Medium, Medium | None]:
    """A medium to fly in, and the same one with values that have derivatives if it is tracked and there are some.

    What a tracker reads must have none: it decides in a loop.
    """
    if group.plugins[0].is_tracked and is_attached(group, lookup):
        return group.at(slot, lookup.plain()), group.at(slot, lookup)
    return group.at(slot, lookup), None


def index_of(plugins: Sequence[Any], plugin: Any) -> int:
    """The place of a plugin in a sequence; one beyond the last if it isn't there."""
    return next((i for i, other in enumerate(plugins) if other is plugin), len(plugins))


def points_outward(n: Vector3f, shading: Vector3f, d: Vector3f) -> Bool:
    """True where a direction points to the outside of a surface, `n` and `shading` being its normals.

    The geometric normal decides, since rays are moved off the surface along it. A mirroring transform has turned it
    round, but not the shading normal.
    """
    return dr.dot(n, d) * dr.dot(n, shading) > 0


def is_closed(geometry: Geometry, shape: int) -> bool:
    """Whether a shape encloses a volume."""
    return geometry.contents.shapes[shape].is_closed()


def absorbing_sides(shapes: Sequence[Shape]) -> list[tuple[Any, Any] | None]:
    """The media on both sides of shapes if only the BSDFs that absorb are looked at; None for all other shapes."""
    bodies: dict[int, Medium] = {}
    return [absorbing_side(shape, bodies) for shape in shapes]


def absorbing_side(shape: Shape, bodies: dict[int, Medium]) -> tuple[Any, Any] | None:
    """The medium inside of a shape whose BSDF absorbs, and the vacuum; `bodies` has those of BSDFs by id."""
    if unseen(shape) or not shape.bsdf().absorbs:
        return None
    from djpt.media.absorption import AbsorbingBody

    bsdf = shape.bsdf()
    return bodies.setdefault(id(bsdf), AbsorbingBody(bsdf)), None


def all_sides(shapes: Sequence[Shape]) -> list[tuple[Any, Any] | None]:
    """The media on both sides of shapes; None for those that bound no medium.

    Raises:
        SceneError: A shape has an interior medium, and a BSDF that absorbs.
    """
    result: list[tuple[Any, Any] | None] = []
    for shape, absorbing in zip(shapes, absorbing_sides(shapes), strict=True):
        if unseen(shape) or not shape.is_medium_transition():
            result.append(absorbing)
            continue
        inside, outside = shape.interior_medium(), shape.exterior_medium()
        if inside is not None and absorbing is not None:
            raise SceneError(
                f"{shape.id()}: the BSDF '{shape.bsdf().id()}' absorbs, and the shape has an 'interior': "
                "light in it needs one medium"
            )
        result.append((absorbing[0] if absorbing is not None else inside, outside))
    return result


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

"""Unified points, beams and paths."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.errors import RenderError
from djpt.integrators.bidirectional.subpath import Subpath, mis_weight
from djpt.integrators.paths.path_vertex import MediumVertex, NextVertex, phase_evaluated
from djpt.integrators.photons import NOWHERE, PhotonMap, PhotonStore
from djpt.integrators.photons.beams import Beam, BeamStore
from djpt.integrators.photons.cells import Cells, Segment
from djpt.integrators.photons.photon import MOST_EDGES, edges_and_medium
from djpt.integrators.photons.photon_mapping import scattering_at
from djpt.integrators.vcm import PhotonPath, VertexConnectionMerging
from djpt.jit.types import Bool, Color3f, Float, Int64, Point3f, UInt32, Vector3f
from djpt.samplers.base import SampleStream
from djpt.samplers.seeds import sample_tea_32

if TYPE_CHECKING:
    from djpt.scene.scene import Scene
    from djpt.sensors.base import Sensor

__all__ = ["UnifiedPointsBeamsPaths"]

MEAN_SINE = math.pi / 4
"""The mean sine of the angle between two directions."""

PARALLEL = 1e-6
"""The least squared sine of the angle between two beams that are looked at."""


@dataclass
class BeamPath(PhotonPath):
    """The state of a light path that leaves photons and perhaps beams."""

    leaves_beams: Bool


class UnifiedPointsBeamsPaths(VertexConnectionMerging):
    """Joins paths as `bdpt`, merges vertices as `vcm`, and merges photons and beams of light with beams of the camera.

    In a medium not only the end of a flight counts the photons about it: the whole flight does, as a beam. And a light
    path leaves not only photons where it is scattered: its flights are beams, too. With the density p of a connection
    of the same two vertices, which as all others knows nothing of the densities of distances, the densities are

        point-point 3D    p sigma_t 4/3 pi r^3 N,
        point-beam 2D     p pi r^2 N,
        beam-beam 1D      p 2 r M pi/4 / sigma_t,

    for photons of N and beams of M light paths of a pass, and the radius r; pi/4 is the mean sine of the angle between
    two beams. All ways are weighted against each other. Without media that scatter light it is `vcm`.

    A *short* beam ends where the flight does, a *long* one at the next surface. Short ones need no transmittance where
    the extinction is grey, so they are the same in fog and in smoke; long ones are noisier only where light is
    followed through much matter for nothing.

    Parameters: those of `vcm`; `points`, `beams_of_camera`, `beams_of_light` (default true: use the estimator
    point-point 3D, point-beam 2D, beam-beam 1D), `beam_count` (the light paths of a pass that leave beams, on average,
    default 2^8, at most `photon_count`), `point_count` (those whose photons beams of the
    camera look for, on average, default 2^13), `long_beams` (default false; homogeneous media only).

    J. Křivánek, I. Georgiev, T. Hachisuka, P. Vévoda, M. Šik, D. Nowrouzezahrai and W. Jarosz, "Unifying Points, Beams,
    and Paths in Volumetric Light Transport Simulation", 2014; W. Jarosz, D. Nowrouzezahrai, I. Sadeghi and H. W.
    Jensen, "A Comprehensive Theory of Volumetric Radiance Estimation using Photon Points and Beams", 2011.
    """

    pure = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.points = props.boolean("points", True)
        self.beams_of_camera = props.boolean("beams_of_camera", True)
        self.beams_of_light = props.boolean("beams_of_light", True)
        self.point_count = min(props.integer("point_count", 2**13, low=1), self.photon_count)
        self.beam_count = min(props.integer("beam_count", 2**8, low=1), self.photon_count)
        self.long_beams = props.boolean("long_beams", False)
        self._balls: Cells | None = None
        self._capsules: Cells | None = None
        self._beams: BeamStore | None = None
        self._share = self._of_pair = self._over_pairs = self._over_points = self._of_point = Float(0)

    def check_scene(self, scene: Scene, sensor: Sensor) -> None:
        for medium in scene.every_medium.plugins:
            if medium.is_tracked and (self.beams_of_camera or self.beams_of_light):
                self.check_tracked(medium)
        super().check_scene(scene, sensor)

    def check_tracked(self, medium: Any) -> None:
        """Raise `RenderError` if a medium that varies has no beams."""
        if medium.has_spectral_extinction():
            raise RenderError(
                f"'{self.id()}' has no beams in media that vary and have an extinction for each channel, found "
                f"'{medium.id()}'; possible: 'has_spectral_extinction' false, or the integrator 'vcm'"
            )
        if self.long_beams:
            raise RenderError(
                f"'{self.id()}' has no long beams in media that vary, found '{medium.id()}'; "
                "possible: 'long_beams' false"
            )

    # ---- passes ------------------------------------------------------------------------

    def store(self, scene: Scene) -> PhotonStore:
        if not scene.media.scatter:
            return super().store(scene)
        beams = self.beam_count if self.beams_of_light else 0
        return BeamStore(self.id(), self.photon_count, self.weighs_photons, True, beams)

    def looks_in_box(self, scene: Scene) -> bool:
        return scene.media.scatter and (self.beams_of_camera or self.beams_of_light)

    def looking_at(self, photons: PhotonMap) -> UnifiedPointsBeamsPaths:
        integrator = super().looking_at(photons)
        assert isinstance(integrator, UnifiedPointsBeamsPaths)
        points = self.fraction(self.point_count, photons)
        integrator._share = dr.opaque(Float, self.fraction(self.beam_count, photons))
        integrator._over_points = dr.opaque(Float, 1 / points)
        integrator._of_point = self.h(photons.expected * dr.opaque(Float, points / self.crowd))
        pairs = photons.radius * dr.opaque(Float, 2 * min(self.beam_count, photons.paths))
        integrator._of_pair = pairs * MEAN_SINE * dr.opaque(Float, 1 / self.crowd)
        integrator._over_pairs = photons.expected * dr.rcp(pairs)
        return integrator

    @staticmethod
    def fraction(count: int, photons: PhotonMap) -> float:
        """The fraction of the light paths of a map that `count` of them are, if there are so many."""
        return min(count / photons.paths, 1)

    def take(self, store: PhotonStore, count: int) -> None:
        super().take(store, count)
        photons = self.photons
        if not isinstance(store, BeamStore) or photons is None or photons.box is None:
            return
        there = Bool(True)
        if self.beams_of_camera:
            self._balls = Cells(photons.box, photons.radius)
            most = dr.opaque(UInt32, round(self.fraction(self.point_count, photons) * (2**32 - 1)))
            self._balls.fill(count, lambda i: ball(photons, i, most))
        if self.beams_of_light:
            self._beams = store
            self._capsules = Cells(photons.box, photons.radius)
            self._capsules.fill(store.beams, lambda i: store.beam(i, there).segment)

    # ---- densities ---------------------------------------------------------------------

    def point_merging(self, sigma_t: Color3f) -> Float:
        return super().point_merging(sigma_t) if self.points else Float(0)

    def camera_beam_merging(self, p: Point3f) -> Float:
        """h(density) of merging photons at a point with beams of the camera."""
        return self.in_box(p, self._of_point) if self.beams_of_camera else Float(0)

    def beam_pair_merging(self, p: Point3f, sigma_t: Color3f) -> Float:
        """h(density) of merging beams of light with beams of the camera at a point."""
        if not self.beams_of_light:
            return Float(0)
        density = self._of_pair * dr.rcp(dr.mean(sigma_t))
        return self.in_box(p, self.h(density))

    def in_box(self, p: Point3f, merging: Float) -> Float:
        """What there is of a merging at a point: beams are looked for in a box only."""
        assert self.photons is not None
        box = self.photons.box
        return Float(0) if box is None else dr.select(box.contains(p), merging, 0)

    def merging_at(self, scene: Scene, medium: UInt32, p: Point3f, active: Bool) -> Float:
        _, sigma_t = scattering_at(scene, medium, p, active)
        return self.point_merging(sigma_t) + self.camera_beam_merging(p) + self.beam_pair_merging(p, sigma_t)

    # ---- mergings ----------------------------------------------------------------------

    def merged_in_medium(
        self,
        scene: Scene,
        subpath: Subpath,
        p: Point3f,
        at: MediumVertex,
        edges: UInt32,
        sampler: SampleStream,
        joins: Bool,
    ) -> Color3f:
        if not self.points:
            return Color3f(0)
        return super().merged_in_medium(scene, subpath, p, at, edges, sampler, joins)

    def crossed(self, scene: Scene, incoming: Subpath, reached: NextVertex, active: Bool) -> Color3f | None:
        if self._balls is None and self._capsules is None:
            return None
        assert incoming.ray.medium is not None
        length = self.beam_length(reached)
        assert incoming.merges is not None
        inside = active & incoming.merges & scene.media.fill(incoming.ray.medium)
        edges = dr.select(incoming.depth < self.joined, self.joined - incoming.depth, 0)
        found = Color3f(0)
        if self._balls is not None:
            found = found + self.photons_along(scene, incoming, length, edges, inside)
        if self._capsules is not None:
            found = found + self.beams_along(scene, incoming, length, edges, inside)
        return incoming.throughput * found

    def beam_length(self, reached: NextVertex) -> Float:
        """The length of the beam that an edge of a path is."""
        return reached.length if self.long_beams else dr.minimum(reached.vertex.si.t, reached.length)

    def left(self, scene: Scene, ray: Ray3f, t: Float, throughput: Color3f, active: Bool) -> Color3f:
        """The transmittance of a beam up to a distance, over the probability that it reaches so far."""
        if self.long_beams:
            return scene.media.transmittance(ray, t, None, active)
        return scene.media.passing_weight(ray, t, throughput, active)

    def photons_along(self, scene: Scene, incoming: Subpath, length: Float, edges: UInt32, inside: Bool) -> Color3f:
        """The light of the photons about an edge of a camera path, over its throughput: point-beam 2D."""
        photons, cells, ray = self.photons, self._balls, incoming.ray
        assert photons is not None
        assert cells is not None
        assert ray.medium is not None
        lanes, medium = dr.width(ray, length, inside), ray.medium
        most, square = Float(dr.minimum(edges, MOST_EDGES)), dr.square(photons.radius)

        def meets(i: UInt32, there: Bool, start: Float, end: Float) -> Bool:
            p, word = photons.position(i, there)
            traversed, within = edges_and_medium(word)
            to = p - ray.o
            t = dr.dot(to, ray.d)
            near = (t >= start) & (t < end) & (dr.squared_norm(to - t * ray.d) <= square)
            return there & near & (within == medium) & (traversed <= most)

        def add(i: UInt32, there: Bool, total: list[Int64]) -> list[Int64]:
            photon = photons.photon(i, there, lanes)
            t = dr.dot(photon.p - ray.o, ray.d)
            value, pdf, back = phase_evaluated(scene, medium, photon.p, -ray.d, -photon.d, there)
            by_light = photon.vcm + photon.vc * self.h(pdf)
            _, sigma_t = scattering_at(scene, medium, photon.p, there)
            beside = self.point_merging(sigma_t) + self.beam_pair_merging(photon.p, sigma_t)
            others = by_light + self.part(incoming, t, back) + beside
            weight = mis_weight(others * dr.rcp(self._of_point)) * self._over_points
            left = self.left(scene, ray, t, incoming.throughput, there)
            return photons.added(total, there, value * photon.flux * left * weight)

        return photons.color(cells.meet(ray, length, inside, meets, add, photons.zero(lanes)))

    def beams_along(self, scene: Scene, incoming: Subpath, length: Float, edges: UInt32, inside: Bool) -> Color3f:
        """The light of the beams about an edge of a camera path, over its throughput: beam-beam 1D."""
        photons, store, cells, ray = self.photons, self._beams, self._capsules, incoming.ray
        assert photons is not None
        assert store is not None
        assert cells is not None
        assert ray.medium is not None
        lanes, medium = dr.width(ray, length, inside), ray.medium
        most, square = Float(dr.minimum(edges, MOST_EDGES)), dr.square(photons.radius)

        def meets(i: UInt32, there: Bool, start: Float, end: Float) -> Bool:
            beam = store.beam(i, there)
            crossing = Crossing.of(ray, beam)
            near = (crossing.t >= start) & (crossing.t < end) & (crossing.s >= 0) & (crossing.s < beam.length)
            near &= (crossing.squared_distance <= square) & (crossing.squared_sine > PARALLEL)
            return there & near & (beam.medium == medium) & (beam.edges <= most)

        def add(i: UInt32, there: Bool, total: list[Int64]) -> list[Int64]:
            beam = store.beam(i, there)
            crossing = Crossing.of(ray, beam)
            p = ray(crossing.t)
            value, pdf, back = phase_evaluated(scene, medium, p, -ray.d, -beam.d, there)
            sigma_s, sigma_t = scattering_at(scene, medium, p, there)
            by_light = self.part(beam, crossing.s, pdf)
            beside = self.point_merging(sigma_t) + self.camera_beam_merging(p)
            others = by_light + self.part(incoming, crossing.t, back) + beside
            weight = mis_weight(others * dr.rcp(self.beam_pair_merging(p, sigma_t)))
            left = self.left(scene, ray, crossing.t, incoming.throughput, there)
            arrives = self.left(scene, Ray3f(beam.o, beam.d, medium=medium), crossing.s, beam.flux, there)
            light = value * sigma_s * beam.flux * arrives * left
            worth = light * (weight * self._over_pairs * dr.rsqrt(crossing.squared_sine))
            return photons.added(total, there, worth)

        return photons.color(cells.meet(ray, length, inside, meets, add, photons.zero(lanes)))

    def part(self, path: Subpath | Beam, t: Float, pdf: Float) -> Float:
        """A path's part of a weight, if it had arrived at the distance `t` and went on with a density."""
        spread = dr.select(path.before < dr.inf, self.h(dr.square(t + path.before)), 1)
        return path.vcm * spread + path.vc * self.h(pdf)

    # ---- photons -----------------------------------------------------------------------

    def leave(self, scene: Scene, sampler: SampleStream) -> PhotonPath:
        path = super().leave(scene, sampler)
        if not scene.media.scatter or not self.beams_of_light:
            return path
        return BeamPath(path.subpath, path.power, sampler.next_1d() < self._share)

    def crossing(self, scene: Scene, path: PhotonPath, reached: NextVertex, store: PhotonStore) -> None:
        if not isinstance(path, BeamPath) or not isinstance(store, BeamStore):
            return
        subpath, ray = path.subpath, path.subpath.ray
        assert ray.medium is not None
        flux = subpath.throughput * path.power
        length = self.beam_length(reached)
        edges = Float(subpath.depth)
        # A point on the way isn't on a surface.
        vc = subpath.vc
        if self.everywhere:
            assert subpath.merging is not None
            vc = vc + subpath.merging
        beam = Beam(ray.o, ray.d, length, edges, ray.medium, flux, subpath.vcm, vc, subpath.before)
        there = scene.media.fill(ray.medium) & (subpath.depth < self.joined) & (dr.max(flux) > 0)
        store.add_beam(beam, path.leaves_beams & there)


def ball(photons: PhotonMap, i: UInt32, most: UInt32) -> Segment:
    """What the ball of a photon is about, if it is in a medium and among those chosen; else a segment of no use.

    The bits of its position choose it: threads, which decide about its number, mustn't. `most` of 2^32 - 1 are chosen.
    """
    p, word = photons.position(i, Bool(True))
    x, y, z = (UInt32(dr.reinterpret_array(UInt32, c)) for c in p)
    inside = edges_and_medium(word)[1] != NOWHERE
    chosen = inside & (sample_tea_32(x ^ (z * 0x9E3779B1), y)[0] <= most)
    return Segment(p, Vector3f(0, 0, 1), dr.select(chosen, Float(0), -1))


@dataclass
class Crossing:
    """Where a ray and a beam are nearest to each other."""

    t: Float
    """The distance along the ray."""
    s: Float
    """The distance along the beam."""
    squared_distance: Float
    squared_sine: Float
    """Of the angle between them."""

    @staticmethod
    def of(ray: Ray3f, beam: Beam) -> Crossing:
        """That of a ray and a beam, both with unit directions; it means nothing if they are parallel."""
        n, cos, to = dr.cross(ray.d, beam.d), dr.dot(ray.d, beam.d), beam.o - ray.o
        squared_sine = dr.squared_norm(n)
        inverse = dr.rcp(squared_sine)
        along, back = dr.dot(to, ray.d), dr.dot(to, beam.d)
        return Crossing(
            (along - cos * back) * inverse,
            (cos * along - back) * inverse,
            dr.square(dr.dot(to, n)) * inverse,
            squared_sine,
        )


register_integrator("upbp", UnifiedPointsBeamsPaths)

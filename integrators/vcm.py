"""Vertex connection and merging."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import drjit as dr

from djpt.core.records import Ray3f
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.integrators.bdpt import BidirectionalPath
from djpt.integrators.bidirectional.subpath import LightVertex, Subpath, carried, mis_weight
from djpt.integrators.paths.path_vertex import (
    MediumVertex,
    NextVertex,
    PathVertex,
    Scattering,
    next_vertex,
    phase_evaluated,
)
from djpt.integrators.photons import (
    NOWHERE,
    Photon,
    PhotonMap,
    PhotonStore,
    inverse_coverage,
    inverse_coverage_in_medium,
)
from djpt.integrators.photons.photon_mapping import (
    PhotonMapping,
    is_sharp,
    over_cosine,
    over_scattering,
    scattering_at,
)
from djpt.integrators.termination import roulette
from djpt.jit.types import Bool, Color3f, Float, Point3f, UInt32
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene
    from djpt.sensors.base import Sensor

__all__ = ["PhotonPath", "VertexConnectionMerging"]

PATHS_PER_SAMPLE = (1 / 16, 1.0)
"""The fewest and the most light paths of a pass for each of its camera paths."""

FEWEST_PATHS = 2**14
"""The light paths of a pass, at least, unless their number is given: mergings of few paths are noisy."""


@dataclass
class PhotonPath:
    """The state of a light path that leaves photons."""

    subpath: Subpath
    power: Float
    """The power that the throughput is a fraction of."""


class VertexConnectionMerging(PhotonMapping, BidirectionalPath):
    """Joins a path from the camera and one from a light in all ways of `bdpt`, and merges it with photons.

    A vertex of a camera path counts the photons about it as if they had come to the vertex itself. That is one more
    way to find a path, and far the best one for what is reflected, scattered and reflected. With the density p of a
    connection of the same two vertices, a merging has the density

        p pi r^2 N,    N light paths of a pass, r the radius,

    and all ways are weighted against each other: mergings count little where connections do well.

    In media that scatter light the photons about a vertex are those of a ball: the density is p sigma_t 4/3 pi r^3 N,
    where the weights know, as those of `bdpt`, no other densities of distances.

    Mergings are of use where nothing else is: what the camera sees directly, light paths show to the lens, with little
    noise, at a fraction of the time. So by default only what it sees by way of mirrors, glass, or gloss is merged:
    edges that begin on such a surface and have no other vertices before. The vertices of a path decide that, so it
    is the same for all strategies.

    Parameters: those of `bdpt` (without `strategies`), those of all `PhotonMapping` (`photon_count` is 2^16 by
    default), and `merging`: the edges of camera paths that are merged, `glossy` (default) or `everywhere`, as in the
    literature; with sensors to which light can't be traced the first edge is one of the former. About as many light
    paths leave photons as camera paths are merged, at least one for sixteen of all. Images whose samples don't fill a
    pass have fewer, at least 2^14, unless `photon_count` is given.

    I. Georgiev, J. Křivánek, T. Davidovič and P. Slusallek, "Light Transport Simulation with Vertex Connection and
    Merging", 2012; T. Hachisuka, J. Pantaleoni and H. W. Jensen, "A Path Space Extension for Robust Light Transport
    Simulation", 2012.
    """

    pure = True
    # Each camera path has a light path of its own besides: photons are for what can't be connected.
    paths_per_sample = 1 / 4  # where all are merged
    default_photon_count = 2**16
    crowd = 4.0
    weighs_photons = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        if self.strategies:
            raise props.error("strategies", "isn't possible with photons; possible with: bdpt")
        self.everywhere = props.string("merging", "glossy", choices=("glossy", "everywhere")) == "everywhere"
        self.is_count_given = "photon_count" in props
        self._merging = self._merging_in_media = Float(0)

    def paths_for(self, sharp_fraction: Callable[[], float]) -> float:
        """As many light paths as camera paths that are merged, to a power of two; a fixed fraction if all are."""
        if self.everywhere:
            return self.paths_per_sample
        least, most = PATHS_PER_SAMPLE
        return min(most, 2.0 ** round(math.log2(max(least, sharp_fraction()))))

    def paths_of_pass(self, fraction: float) -> int:
        if self.is_count_given:
            return self.photon_count
        return max(FEWEST_PATHS, math.ceil(min(fraction, 1) * self.photon_count))

    def looking_at(self, photons: PhotonMap) -> VertexConnectionMerging:
        integrator = super().looking_at(photons)
        # Those about a vertex share its camera path: they count for one sample.
        one = dr.opaque(Float, 1 / self.crowd)
        integrator._merging = self.h(photons.expected * one)
        integrator._merging_in_media = photons.expected_in_ball * one
        return integrator

    # ---- where paths meet --------------------------------------------------------------

    def at_light(self, scene: Scene, sampler: SampleStream) -> tuple[Subpath, Float]:
        subpath, power = super().at_light(scene, sampler)
        return replace(subpath, merging=Float(0)), power

    def at_camera(self, scene: Scene, camera: Sensor, ray: Ray3f, inside: Bool) -> Subpath:
        merges = self.everywhere or not self.shows_light(scene, camera)
        return replace(super().at_camera(scene, camera, ray, inside), merges=Bool(merges))

    def is_sharp(self, vertex: PathVertex) -> Bool | bool:
        """True at surfaces with mirrors, glass, or gloss; if all mergings are wanted, at all vertices."""
        if self.everywhere:
            return True
        sharp = is_sharp(vertex.si)
        return sharp if vertex.medium_vertex is None else sharp & ~vertex.medium_vertex.inside

    def goes_on_sharp(self, camera: Subpath, vertex: PathVertex) -> Bool | bool:
        """True where a camera path that goes on from a vertex is merged: this one and all before are sharp."""
        if self.everywhere:
            return True
        assert camera.merges is not None
        return self.is_sharp(vertex) & (camera.merges | (camera.depth == 1))

    def joinable(self, scene: Scene, subpath: Subpath, vertex: PathVertex) -> Subpath:
        """The subpath up to a vertex that can be joined: by connections, whose densities are 1, and by mergings.

        Mergings at vertices of a light path need sharp ones between them and the camera; for a camera path, those at
        this vertex depend on the ones before.
        """
        if subpath.merging is not None:
            return replace(subpath, merging=dr.select(self.is_sharp(vertex), subpath.merging, 0))
        assert subpath.merges is not None
        return replace(subpath, vcm=subpath.vcm + dr.select(subpath.merges, self.merging(scene, vertex), 0))

    def mergeable(
        self,
        scene: Scene,
        light: Subpath | LightVertex,
        vertex: PathVertex,
        camera: Subpath | None,
        before: PathVertex | None,
    ) -> tuple[Float, Float]:
        assert light.merging is not None
        if camera is None or before is None:
            vcm = light.vcm + self.merging(scene, vertex) if self.everywhere else light.vcm
            return vcm, light.vc + light.merging
        merges = self.goes_on_sharp(camera, before)
        vcm = light.vcm + dr.select(merges, self.merging(scene, vertex), 0)
        return vcm, light.vc + dr.select(merges, light.merging, 0)

    def continued(
        self, scene: Scene, subpath: Subpath, vertex: PathVertex, s: Scattering, throughput: Color3f
    ) -> Subpath:
        onward = super().continued(scene, subpath, vertex, s, throughput)
        if subpath.merging is None:
            return replace(onward, merges=Bool(self.goes_on_sharp(subpath, vertex)))
        return replace(onward, merging=carried(subpath.merging, self.merging(scene, vertex), vertex, s, self.h))

    def merging(self, scene: Scene, vertex: PathVertex) -> Float:
        """The sum of h(density) of all ways to merge paths at a vertex."""
        inside = vertex.medium_vertex
        if inside is None:
            return Float(self._merging)  # a copy, since loops write to their state
        in_medium = self.merging_at(scene, inside.medium, vertex.si.p, inside.inside)
        return dr.select(inside.inside, in_medium, self._merging)

    def merging_at(self, scene: Scene, medium: UInt32, p: Point3f, active: Bool) -> Float:
        """The sum of h(density) of all ways to merge paths at a point in a medium."""
        return self.point_merging(scattering_at(scene, medium, p, active)[1])

    def point_merging(self, sigma_t: Color3f) -> Float:
        """h(density) of merging points in a medium; it has one number for all channels."""
        return self.h(self._merging_in_media * dr.mean(sigma_t))

    def merged(self, scene: Scene, subpath: Subpath, vertex: PathVertex, sampler: SampleStream, joins: Bool) -> Color3f:
        """The light of the photons about a vertex of a camera path."""
        assert self.photons is not None
        assert subpath.merges is not None
        si, medium_vertex = vertex.si, vertex.medium_vertex
        edges = dr.select(subpath.depth < self.joined, self.joined - subpath.depth, 0)
        joins, in_medium = joins & subpath.merges, None
        if medium_vertex is not None:
            in_medium = self.merged_in_medium(
                scene, subpath, si.p, medium_vertex, edges, sampler, joins & medium_vertex.inside
            )
            vertex, joins = PathVertex(si, None), joins & ~medium_vertex.inside

        def worth(photon: Photon) -> Color3f:
            value, pdf, back = vertex.evaluate(scene, True, -photon.d)
            by_light = photon.vcm + photon.vc * self.h(pdf)
            by_camera = subpath.vcm + subpath.vc * self.h(back)
            weight = mis_weight((by_light + by_camera) * dr.rcp(self._merging))
            return over_cosine(value, si, photon) * photon.flux * weight

        found = self.photons.density(si.p, si.n, edges, joins, worth)
        light = subpath.throughput * found * inverse_coverage(scene, self.photons, si, sampler, dr.max(found) > 0)
        return light if in_medium is None else light + subpath.throughput * in_medium

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
        """The light of the photons about a vertex in a medium, over the path's throughput."""
        assert self.photons is not None
        sigma_s, sigma_t = scattering_at(scene, at.medium, p, joins)
        here = self.point_merging(sigma_t)
        beside = self.merging_at(scene, at.medium, p, joins) - here

        def worth(photon: Photon) -> Color3f:
            value, pdf, back = phase_evaluated(scene, at.medium, p, at.wi, -photon.d, joins)
            by_light = photon.vcm + photon.vc * self.h(pdf)
            by_camera = subpath.vcm + subpath.vc * self.h(back)
            return value * photon.flux * mis_weight((by_light + by_camera + beside) * dr.rcp(here))

        found = self.photons.density_in_medium(p, at.medium, edges, joins, worth)
        covered = inverse_coverage_in_medium(scene, self.photons, p, sampler, dr.max(found) > 0)
        return over_scattering(found, sigma_s) * covered

    # ---- photons -----------------------------------------------------------------------

    def leave(self, scene: Scene, sampler: SampleStream) -> PhotonPath:
        return PhotonPath(*self.at_light(scene, sampler))

    def arrive(
        self, scene: Scene, sampler: SampleStream, path: PhotonPath, store: PhotonStore
    ) -> tuple[PhotonPath, Bool]:
        ray = path.subpath.ray
        si = scene.surface_interaction(ray, scene.closest_hit(ray), scene.surface_detail)
        reached = next_vertex(scene, ray, si, path.subpath.throughput, sampler)
        vertex = reached.vertex
        self.crossing(scene, path, reached, store)
        subpath = self.joinable(scene, path.subpath.arrived(vertex, reached.transmittance, self.h), vertex)
        on = vertex.si.is_valid() & (subpath.depth < self.joined)
        flux = subpath.throughput * path.power
        # Camera paths that count it merge there.
        assert subpath.merging is not None
        vc = subpath.vc + subpath.merging
        photon = Photon(vertex.si.p, vertex.si.n, Float(subpath.depth), ray.d, flux, subpath.vcm, vc)
        photon.medium = vertex.medium(NOWHERE)
        store.add(photon, on & vertex.is_smooth() & (dr.max(flux) > 0))

        s = vertex.scatter(scene, False, None, sampler, on)
        eta = None if subpath.eta is None else subpath.eta * s.sample.eta
        throughput, survives = roulette(sampler, subpath.throughput * s.weight, eta, subpath.depth > self.roulette_from)
        after = self.continued(scene, subpath, vertex, s, throughput)
        if scene.media.scatter:
            after = path.subpath.passing(vertex, vertex.passes(s), after)
        return replace(path, subpath=after), on & survives & (after.depth < self.joined)

    def crossing(self, scene: Scene, path: PhotonPath, reached: NextVertex, store: PhotonStore) -> None:
        """Leave what else the next edge of a light path leaves: nothing but the photon at its end."""


register_integrator("vcm", VertexConnectionMerging)

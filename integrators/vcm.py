"""Vertex connection and merging."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import drjit as dr

from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.integrators.base import refuse_scattering_media
from djpt.integrators.bdpt import BidirectionalPath
from djpt.integrators.bidirectional.subpath import Subpath, mis_weight
from djpt.integrators.paths.path_vertex import PathVertex
from djpt.integrators.photons import Photon, PhotonMap, PhotonStore, inverse_coverage
from djpt.integrators.photons.photon_mapping import PhotonMapping, over_cosine, scatters
from djpt.integrators.termination import roulette
from djpt.jit.types import Bool, Color3f, Float
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene
    from djpt.sensors.base import Sensor

__all__ = ["VertexConnectionMerging"]


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

    Parameters: those of `bdpt` (without `strategies`) and of all `PhotonMapping`; a camera path has one
    light path at most.

    I. Georgiev, J. Křivánek, T. Davidovič and P. Slusallek, "Light Transport Simulation with Vertex Connection and
    Merging", 2012; T. Hachisuka, J. Pantaleoni and H. W. Jensen, "A Path Space Extension for Robust Light Transport
    Simulation", 2012.
    """

    pure = True
    # A photon takes its time at each of the vertices, and first of all connections need many samples.
    paths_per_sample = 1
    crowd = 4.0
    weighs_photons = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        if self.strategies:
            raise props.error("strategies", "isn't possible with photons; possible with: bdpt")
        self._merging = Float(0)

    def check_scene(self, scene: Scene, sensor: Sensor) -> None:
        refuse_scattering_media("vcm", scene)
        super().check_scene(scene, sensor)

    def looking_at(self, photons: PhotonMap) -> VertexConnectionMerging:
        integrator = super().looking_at(photons)
        # Those about a vertex share its camera path: they count for one sample.
        integrator._merging = self.h(photons.expected * dr.opaque(Float, 1 / self.crowd))
        return integrator

    # ---- where paths meet --------------------------------------------------------------

    def joinable(self, subpath: Subpath) -> Subpath:
        """The subpath up to a vertex that can be joined: by connections, whose densities are 1, and by mergings."""
        return replace(subpath, vcm=subpath.vcm + self._merging)

    def merged(self, scene: Scene, subpath: Subpath, vertex: PathVertex, sampler: SampleStream, joins: Bool) -> Color3f:
        """The light of the photons about a vertex of a camera path."""
        assert self.photons is not None
        si = vertex.si

        def worth(photon: Photon) -> Color3f:
            value, pdf, back = vertex.evaluate(scene, True, -photon.d)
            by_light = photon.vcm + photon.vc * self.h(pdf)
            by_camera = subpath.vcm + subpath.vc * self.h(back)
            weight = mis_weight((by_light + by_camera) * dr.rcp(self._merging))
            return over_cosine(value, si, photon) * photon.flux * weight

        edges = dr.select(subpath.depth < self.joined, self.joined - subpath.depth, 0)
        found = self.photons.density(si.p, si.n, edges, joins, worth)
        return subpath.throughput * found * inverse_coverage(scene, self.photons, si, sampler, dr.max(found) > 0)

    # ---- photons -----------------------------------------------------------------------

    def leave(self, scene: Scene, sampler: SampleStream) -> PhotonPath:
        return PhotonPath(*self.at_light(scene, sampler))

    def arrive(
        self, scene: Scene, sampler: SampleStream, path: PhotonPath, store: PhotonStore
    ) -> tuple[PhotonPath, Bool]:
        ray = path.subpath.ray
        si = scene.surface_interaction(ray, scene.closest_hit(ray), scene.surface_detail)
        vertex = PathVertex(si, None)
        subpath = path.subpath.arrived(vertex, scene.media.transmittance(ray, si.t), self.h)
        on = si.is_valid() & (subpath.depth < self.joined)
        flux = subpath.throughput * path.power
        photon = Photon(si.p, si.n, Float(subpath.depth), ray.d, flux, subpath.vcm, subpath.vc)
        store.add(photon, on & scatters(si) & (dr.max(flux) > 0))

        s = vertex.scatter(scene, False, None, sampler, on)
        eta = None if subpath.eta is None else subpath.eta * s.sample.eta
        throughput, survives = roulette(sampler, subpath.throughput * s.weight, eta, subpath.depth > self.roulette_from)
        after = self.joinable(subpath).scattered(vertex, s, throughput, self.h)
        return PhotonPath(after, path.power), on & survives & (subpath.depth + 1 < self.joined)


register_integrator("vcm", VertexConnectionMerging)

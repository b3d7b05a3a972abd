"""The camera paths of `sppm` among media that scatter light."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import drjit as dr

from djpt.core.records import BSDFContext, Ray3f, SurfaceInteraction3f
from djpt.description.properties import Properties
from djpt.integrators.base import Vertex
from djpt.integrators.paths.path_vertex import phase_evaluated
from djpt.integrators.photons import Photon, PhotonMap, inverse_coverage, inverse_coverage_in_medium
from djpt.integrators.photons.photon_mapping import over_cosine, over_scattering, scattering_at, scatters
from djpt.integrators.volpath import VolumetricPath, VolumetricPathState
from djpt.jit.types import Bool, Color3f, UInt32
from djpt.media.flight import Flight
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.integrators.photons.photon_mapping import PhotonMapping
    from djpt.scene.scene import Scene

__all__ = ["GatheringPath"]


@dataclass
class GatheringState(VolumetricPathState):
    """The state of a camera path that looks at photons once."""

    scattered: Bool | bool = False
    """True behind the vertex that scatters light, where photons were looked at."""


class GatheringPath(VolumetricPath):
    """A path of `volpath` up to the first vertex that scatters light, and from there to what it meets of emitters.

    At that vertex, on a surface or in a medium, the light of all longer ways is that of the photons.
    """

    def __init__(self, owner: PhotonMapping, photons: PhotonMap, longest: UInt32, roulette_from: UInt32) -> None:
        """A path that looks at `photons`, with the parameters of the integrator that owns it."""
        super().__init__(Properties("volpath", owner.id(), {"hide_emitters": owner.hide_emitters}))
        self.photons, self.longest, self.roulette_from = photons, longest, roulette_from

    def start(self, scene: Scene) -> GatheringState:
        return GatheringState(**vars(super().start(scene)), scattered=Bool(False))

    def arrive(
        self,
        scene: Scene,
        sampler: SampleStream,
        state: VolumetricPathState,
        ray: Ray3f,
        si: SurfaceInteraction3f,
        flight: Flight,
    ) -> Vertex:
        assert isinstance(state, GatheringState)
        v = super().arrive(scene, sampler, state, ray, si, flight)
        first, throughput = ~Bool(state.scattered), state.throughput_after(flight)
        looks, edges = first & (state.depth + 1 < self.longest), self.longest - state.depth - 1
        light = self.of_surface(scene, sampler, si, edges, looks & ~flight.scattered)
        light = light + self.of_medium(scene, sampler, ray, flight, edges, looks & flight.scattered)
        crosses = v.state.depth == state.depth
        v.emitted = v.emitted + throughput * light
        v.reflected = dr.select(first, v.reflected, 0)
        v.active &= first | crosses
        assert isinstance(v.state, GatheringState)
        scatters_here = flight.scattered | (~crosses & (v.state.bsdf_pdf > 0))
        v.state = replace(v.state, scattered=state.scattered | scatters_here)
        return v

    def of_surface(
        self, scene: Scene, sampler: SampleStream, si: SurfaceInteraction3f, edges: UInt32, looks: Bool
    ) -> Color3f:
        """The light of the photons about a point on a surface."""

        def worth(photon: Photon) -> Color3f:
            value = si.bsdf().eval(BSDFContext(), si, si.to_local(-photon.d), True)
            return over_cosine(value, si, photon) * photon.flux

        found = self.photons.density(si.p, si.n, edges, looks & si.is_valid() & scatters(si), worth)
        return found * inverse_coverage(scene, self.photons, si, sampler, dr.max(found) > 0)

    def of_medium(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, flight: Flight, edges: UInt32, looks: Bool
    ) -> Color3f:
        """The light of the photons about a point in a medium, over the coefficient that the flight's value has."""
        p, medium = ray(flight.t), ray.medium
        if medium is None:
            return Color3f(0)

        def worth(photon: Photon) -> Color3f:
            return phase_evaluated(scene, medium, p, -ray.d, -photon.d, looks)[0] * photon.flux

        found = self.photons.density_in_medium(p, medium, edges, looks, worth)
        found = over_scattering(found, scattering_at(scene, medium, p, looks)[0])
        return found * inverse_coverage_in_medium(scene, self.photons, p, sampler, dr.max(found) > 0)

"""Stochastic progressive photon mapping."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import BSDFContext, Ray3f, SurfaceInteraction3f
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.errors import RenderError
from djpt.integrators.base import PathState, Vertex
from djpt.integrators.bidirectional.strategies import Sink
from djpt.integrators.bidirectional.subpath import is_beam
from djpt.integrators.path import Path
from djpt.integrators.paths.passes import LightPath
from djpt.integrators.paths.path_vertex import next_vertex
from djpt.integrators.photons import NOWHERE, Photon, PhotonStore, inverse_coverage
from djpt.integrators.photons.gathering_path import GatheringPath
from djpt.integrators.photons.photon_mapping import PhotonMapping, over_cosine, scatters
from djpt.integrators.ptracer import leave_light
from djpt.integrators.termination import roulette
from djpt.jit.types import Bool, Color3f, Float, Point2f
from djpt.materials.base import sample_light
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene
    from djpt.sensors.base import Sensor

__all__ = ["StochasticProgressivePhotonMapping"]


@dataclass
class PhotonPath(LightPath):
    """The state of a light path that leaves photons."""

    beam: Bool | bool = False
    """True where it began with a beam, which no light sample finds."""


class StochasticProgressivePhotonMapping(PhotonMapping, Path):
    """Follows camera paths through mirrors and glass up to the first surface that scatters, and looks at photons there.

    The light of that surface comes from three sources, each of which is all light of its kind:

    * straight from emitters: by light samples and BSDF samples, as in `path`;
    * over other surfaces: 1 / (c pi r^2 N) times the sum of f flux over the photons within the radius r, of N light
      paths of two and more edges, c being the fraction of the disk that is surface;
    * through its own mirrors, if it has any, such as a coat: the path goes on.

    Among media that scatter light a camera path ends at a point in a medium as well, where `volpath` would scatter it.
    The light there is 1 / (4/3 c pi r^3 N) times the sum of phase function times flux over the photons of a ball, of
    which the fraction c is in the medium.

    Finds what no unbiased method does: caustics of point lights in mirrors and panes, light that is reflected,
    scattered and reflected. Light on glossy surfaces is noisy, and corners and edges are blurred at first: `vcm` is
    the better choice there.

    Parameters: `max_depth` (edges of the longest path from emitter to camera, -1 = unbounded, default -1), `rr_depth`
    (Russian roulette starts there, on either side, default 5), `hide_emitters`, `emitter_choice` (`uniform`, default,
    or `power`), and those of all `PhotonMapping`.
    """

    pure = True
    follows_media = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        if self.bounces:
            raise props.error("bounces", "isn't possible with photons; possible with: path, prb")
        # Light paths begin where no surface is known that `tree` would choose an emitter for.
        self.emitter_choice = props.string("emitter_choice", "uniform", choices=("uniform", "power"))

    def check_scene(self, scene: Scene, sensor: Sensor) -> None:
        glowing = [medium.id() for medium in scene.every_medium.plugins if medium.emits()]
        if glowing:
            raise RenderError(
                f"'sppm' has no photons of media that glow, found {', '.join(glowing)}; possible: 'volpath', 'vcm'"
            )
        super().check_scene(scene, sensor)

    def sample(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, medium: Any = None, active: Bool | bool = True
    ) -> tuple[Color3f, Bool, list[Float]]:
        if not scene.media.scatter:
            return super().sample(scene, sampler, ray, medium, active)
        assert self.photons is not None
        path = GatheringPath(self, self.photons, self.longest, self.roulette_from)
        return path.sample(scene, sampler, ray, medium, active)

    def splat_sample(
        self, scene: Scene, camera: Sensor, sampler: SampleStream, ray: Ray3f, position: Point2f, sink: Sink
    ) -> tuple[Color3f, Bool, list[Float]]:
        """The radiance along a ray; nothing is added to other pixels."""
        return self.sample(scene, sampler, ray)

    # ---- from the camera ---------------------------------------------------------------

    def vertex(
        self, scene: Scene, sampler: SampleStream, state: PathState, ray: Ray3f, si: SurfaceInteraction3f
    ) -> Vertex:
        assert self.photons is not None
        v = super().vertex(scene, sampler, state, ray, si)
        # Beyond a surface that scatters there is only the light that its BSDF sample meets.
        before = state.bsdf_pdf == 0
        looks = before & self.proceeds(state, si) & scatters(si)

        def worth(photon: Photon) -> Color3f:
            value = si.bsdf().eval(BSDFContext(), si, si.to_local(-photon.d), True)
            return over_cosine(value, si, photon) * photon.flux

        edges = self.longest - state.depth - 1
        over_surfaces = self.photons.density(si.p, si.n, edges, looks, worth)
        covered = inverse_coverage(scene, self.photons, si, sampler, dr.max(over_surfaces) > 0)
        v.emitted = v.emitted + state.throughput * over_surfaces * covered
        v.reflected = dr.select(before, v.reflected, 0)
        v.active &= before
        return v

    # ---- from the light ----------------------------------------------------------------

    def leave(self, scene: Scene, sampler: SampleStream) -> PhotonPath:
        path, emitter = leave_light(scene, sampler)
        beams = [e for e in scene.emitters() if is_beam(e.flags())]
        return PhotonPath(**vars(path), beam=is_beam(emitter.flags()) if beams else Bool(False))

    def arrive(
        self, scene: Scene, sampler: SampleStream, path: PhotonPath, store: PhotonStore
    ) -> tuple[PhotonPath, Bool]:
        if scene.media.scatter:
            return self.arrive_among_media(scene, sampler, path, store)
        ray, sample1, sample2 = path.ray, sampler.next_1d(), sampler.next_2d()
        si = scene.surface_interaction(ray, scene.closest_hit(ray), scene.surface_detail)
        flux = path.flux * scene.media.transmittance(ray, si.t)
        # One more edge at least leads to the camera.
        on = si.is_valid() & (path.depth < self.longest)
        photon = Photon(si.p, si.n, Float(path.depth), ray.d, flux)
        store.add(photon, on & scatters(si) & ((path.depth > 1) | path.beam) & (dr.max(flux) > 0))

        bs, weight = si.bsdf().visit(lambda bsdf: sample_light(bsdf, si, sample1, sample2, on), on)
        eta = None if path.eta is None else path.eta * bs.eta
        left, survives = roulette(sampler, flux * weight * path.unit, eta, path.depth > self.roulette_from)
        after = PhotonPath(
            ray=si.spawn_ray(si.to_world(bs.wo)),
            flux=left * dr.rcp(path.unit),
            unit=path.unit,
            eta=eta,
            depth=path.depth + 1,
            beam=path.beam,
        )
        return after, on & survives & (path.depth + 1 < self.longest)

    def arrive_among_media(
        self, scene: Scene, sampler: SampleStream, path: PhotonPath, store: PhotonStore
    ) -> tuple[PhotonPath, Bool]:
        """`arrive` where the vertex may be a point in a medium, and null surfaces are none."""
        ray = path.ray
        si = scene.surface_interaction(ray, scene.closest_hit(ray), scene.surface_detail)
        reached = next_vertex(scene, ray, si, path.flux * path.unit, sampler)
        vertex, flux = reached.vertex, path.flux * reached.transmittance
        on = vertex.si.is_valid() & (path.depth < self.longest)
        photon = Photon(vertex.si.p, vertex.si.n, Float(path.depth), ray.d, flux, medium=vertex.medium(NOWHERE))
        store.add(photon, on & vertex.is_smooth() & ((path.depth > 1) | path.beam) & (dr.max(flux) > 0))

        s = vertex.scatter(scene, False, None, sampler, on)
        eta, passes = None if path.eta is None else path.eta * s.sample.eta, vertex.passes(s)
        left, survives = roulette(sampler, flux * s.weight * path.unit, eta, path.depth > self.roulette_from)
        after = PhotonPath(
            ray=vertex.ray(vertex.direction(s)),
            flux=left * dr.rcp(path.unit),
            unit=path.unit,
            eta=eta,
            depth=dr.select(passes, path.depth, path.depth + 1),
            beam=path.beam,
        )
        return after, on & survives & (after.depth < self.longest)


register_integrator("sppm", StochasticProgressivePhotonMapping)

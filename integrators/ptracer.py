"""Light tracing: paths that begin at the lights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr

from djpt.core.records import BSDFFlags, BSDFSample3f, Ray3f, SurfaceInteraction3f, has_flag
from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.errors import RenderError
from djpt.films.footprint import Splats
from djpt.integrators.bidirectional.subpath import departure, scaled
from djpt.integrators.path import Path
from djpt.integrators.paths.passes import LightPath, PassIntegrator, Walks
from djpt.integrators.termination import Terminating, first_roulette, roulette
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32
from djpt.materials.base import BSDF, eval_pdf_light, sample_light
from djpt.materials.pointer import at_fixed_direction
from djpt.samplers.base import SampleStream
from djpt.sensors.base import Sensor

if TYPE_CHECKING:
    from djpt.emitters.pointer import EmitterPtr
    from djpt.scene.scene import Scene

__all__ = ["LightVertex", "ParticleTracer", "leave_light"]


@dataclass
class LightVertex:
    """The result of a vertex of a light path."""

    position: Point2f
    """The place on the film that shows it, in [0, 1)^2 of the crop window."""
    splat: Color3f
    """The light that the film receives there, per area of the window, without visibility."""
    shadow_ray: Ray3f
    """The ray from the vertex to the camera."""
    lit: Bool | None
    """True where light could arrive if it weren't black; None unless derivatives are computed."""
    path: LightPath
    """The state of the continued path."""
    active: Bool
    """True where the path continues."""


class ParticleTracer(Terminating, PassIntegrator):
    """Follows light from the emitters, and shows each of its vertices to the camera.

    A light path y_0 y_1 .. adds, for every k > 0, to the pixel that shows y_k

        1/N flux_k f(y_k) W(y_k) V,    flux_k = Le cos / p(y_0, w_0) times the product of f abs(cos) / p,

    W being the fraction of the film that an area at y_k covers. Light that comes straight from an emitter is found
    from the camera's side, as `path` with `max_depth` 1 finds it.

    Strong at caustics: light of a small emitter that reaches a diffuse surface through glass. Leaves out what the
    camera sees in a mirror or through smooth glass: no light path hits the lens by chance.

    Parameters: `max_depth` (edges of the longest path, that to the camera included, -1 = unbounded, default -1),
    `rr_depth` (Russian roulette starts there, default 5), `hide_emitters`, `emitter_choice` (`uniform`, default,
    or `power`). `spp` light paths are traced per pixel of the image.

    J. Arvo, "Backward Ray Tracing", 1986; P. Dutré, E. Lafortune and Y. Willems, "Monte Carlo Light Tracing with Direct
    Computation of Pixel Intensities", 1993; at shading normals light is scattered as in
    `djpt.materials.base`.
    """

    pure = True
    in_any_frame = True
    from_camera: Path

    starts_at_lights = True
    differentiable = True
    follows_shapes = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.max_depth = props.integer("max_depth", -1, low=-1)
        self.rr_depth = first_roulette(props, self.max_depth)
        self.emitter_choice = props.string("emitter_choice", "uniform", choices=("uniform", "power"))
        shown = {"max_depth": min(self.max_depth, 1) if self.max_depth >= 0 else 1, "hide_emitters": self.hide_emitters}
        # For light that comes straight from an emitter.
        self.from_camera = Path(Properties("path", f"{props.node}.straight", shown))

    def check_scene(self, scene: Scene, sensor: Sensor) -> None:
        if not sensor.can_be_reached:
            raise RenderError(
                f"'ptracer' can't trace light to the sensor '{sensor.id()}'; "
                "possible: perspective, thinlens, orthographic, fisheye, panorama"
            )
        super().check_scene(scene, sensor)

    # ---- passes ------------------------------------------------------------------------

    def begin(self, walks: Walks) -> Splats:
        return Splats(walks.film, walks.scene.lights.brightness)

    def add_pass(self, walks: Walks, state: Splats, begin: int, end: int) -> Splats:
        scene, camera = walks.scene, walks.camera

        def start(sampler: SampleStream) -> LightPath:
            return self.start(scene, sampler)

        def vertex(sampler: SampleStream, path: LightPath, si: SurfaceInteraction3f) -> tuple[LightPath, Bool]:
            v = self.vertex(scene, camera, sampler, path, si)
            arrived = self.seen(scene, v)
            state.add(v.position, arrived, dr.max(arrived) > 0)
            return v.path, v.active

        walks.light(start, vertex, state.memory, begin, end)
        return state

    def color(self, walks: Walks, state: Splats) -> Color3f:
        return Color3f(*state.sums()) * dr.rcp(dr.opaque(Float, walks.spp))

    # ---- light paths -------------------------------------------------------------------

    def seen(self, scene: Scene, v: LightVertex) -> Color3f:
        """The light of a vertex that arrives at the camera."""
        return scene.transmittance(v.shadow_ray, v.splat, v.lit, to_emitter=False, through_lights=self.hide_emitters)

    def start(self, scene: Scene, sampler: SampleStream) -> LightPath:
        """A path that leaves an emitter."""
        return leave_light(scene, sampler)[0]

    def vertex(
        self, scene: Scene, camera: Sensor, sampler: SampleStream, path: LightPath, si: SurfaceInteraction3f
    ) -> LightVertex:
        """Process the hit (or miss) `si` of a path's ray; `camera` is the sensor with opaque values."""
        proceed = si.is_valid() & (path.depth < self.longest)

        # ------------------ To the camera ---------------------
        ds, importance = camera.sample_wi(si.p, sampler.next_2d())
        to_camera = si.to_local(ds.d)
        sample1, sample2 = sampler.next_1d(), sampler.next_2d()

        def method(bsdf: BSDF) -> tuple[Color3f, BSDFSample3f, Color3f]:
            value, _, _ = eval_pdf_light(bsdf, si, to_camera, proceed)
            sampled, weight = sample_light(bsdf, si, sample1, sample2, proceed)
            bs = dr.detach(sampled)
            there, _, _ = eval_pdf_light(bsdf, si, bs.wo, proceed)
            if dr.grad_enabled(sampled.wo):  # a smooth surface sends light on by where it comes from
                bs.wo = dr.select(has_flag(bs.sampled_type, BSDFFlags.Delta), sampled.wo, bs.wo)
            return value, bs, at_fixed_direction(bs, weight, there)

        bsdf = si.bsdf()
        value, bs, weight = bsdf.visit(method, bsdf.branching(proceed, si.wi, si.uv))
        splat = path.flux * value * importance
        if self.hide_emitters:
            splat = dr.select(si.emitter().is_valid(), 0, splat)

        # -------------------- BSDF sampling -------------------
        d = si.to_world(bs.wo)
        flux, zero_weight = scaled(path.flux, path.zero_weight, weight, lambda: si.bsdf().vanishes() & (bs.pdf > 0))
        eta = None if path.eta is None else path.eta * bs.eta

        # ------------------ Russian roulette ------------------
        begins = path.depth > self.roulette_from
        left, survives = roulette(sampler, flux * path.unit, eta, begins)
        flux = left * dr.rcp(path.unit)

        return LightVertex(
            position=ds.uv,
            splat=dr.select(proceed, splat, 0),
            shadow_ray=si.spawn_ray_to(ds.p),
            lit=proceed if dr.grad_enabled(splat) else None,
            path=LightPath(si.spawn_ray(d), flux, path.unit, eta, path.depth + 1, zero_weight),
            active=proceed & survives,
        )


def leave_light(scene: Scene, sampler: SampleStream) -> tuple[LightPath, EmitterPtr]:
    """A path that leaves an emitter, and the emitter."""
    left = departure(scene, sampler)
    flux = left.sample.weight * left.inverse
    largest = dr.max(dr.detach(flux))
    if dr.grad_enabled(flux):
        largest = dr.select(largest > 0, largest, 1)  # black light may have derivatives
    path = LightPath(
        ray=left.ray(scene),
        flux=flux,
        unit=dr.rcp(largest),
        eta=Float(1) if scene.bsdfs.refract else None,
        depth=UInt32(1),
    )
    return path, left.emitter


register_integrator("ptracer", ParticleTracer)

"""Light tracing: paths that begin at the lights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr

from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.errors import RenderError
from djpt.integrators.base import Integrator
from djpt.integrators.path import Path
from djpt.integrators.unidirectional import UNBOUNDED, roulette
from djpt.kernels import maximum
from djpt.records import RAY_EPSILON, BSDFContext, Ray3f, SurfaceInteraction3f, TransportMode
from djpt.samplers.base import SampleStream
from djpt.sensors.base import Sensor
from djpt.types import Bool, Color3f, Float, Point2f, Point3f, UInt32, Vector3f

if TYPE_CHECKING:
    from djpt.scene import Scene

__all__ = ["LightPath", "LightVertex", "ParticleTracer"]


@dataclass
class LightPath:
    """What a light path carries from one vertex to the next."""

    ray: Ray3f
    flux: Color3f
    """Emitted radiance times cosine over the density, times the product of f abs(cos) / p so far."""
    unit: Float
    """1 / the largest component of the flux at the emitter: roulette goes by what is left of it."""
    eta: Float | None
    """Product of relative indices of refraction; None in scenes without refraction."""
    depth: UInt32
    """Edges so far."""
    body: UInt32 | None
    """The absorbing body that the ray runs through: see `djpt.media.interior`; None in scenes without any."""


@dataclass
class LightVertex:
    """What happened at a vertex of a light path."""

    position: Point2f
    """Where the film shows it, in [0, 1)^2 of the crop window."""
    splat: Color3f
    """What the film receives there, per area of the window, if `shadow_ray` is free."""
    shadow_ray: Ray3f
    path: LightPath
    """The path that goes on."""
    active: Bool
    """Does it?"""


class ParticleTracer(Integrator):
    """Follows light from the emitters, and shows each of its vertices to the camera.

    A light path y_0 y_1 .. adds, for every k > 0, to the pixel that shows y_k

        1/N flux_k f(y_k) W(y_k) V,    flux_k = Le cos / p(y_0, w_0) times the product of f abs(cos) / p,

    W being the share of the film that an area at y_k covers. Light that comes straight from an emitter is found
    from the camera's side, as `path` with `max_depth` 1 finds it.

    Strong where light reaches the eye by way of a small light, glass and a diffuse surface: caustics. Leaves out
    what the camera sees in a mirror or through smooth glass: no light path hits its lens by chance.

    Parameters: `max_depth` (edges of the longest path, that to the camera included, -1 = unbounded, default -1),
    `rr_depth` (Russian roulette starts there, default 5), `hide_emitters`, `emitter_choice` (`uniform`, default,
    or `power`). `spp` light paths are traced per pixel of the image.

    J. Arvo, "Backward Ray Tracing", 1986; P. Dutré, E. Lafortune and Y. Willems, "Monte Carlo Light Tracing with Direct
    Computation of Pixel Intensities", 1993; the correction for shading normals is that of E. Veach, 1997, 5.3.2.
    """

    needs_light = True
    starts_at_lights = True
    differentiable = False

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.max_depth = props.integer("max_depth", -1, low=-1)
        self.rr_depth = props.integer("rr_depth", 5, low=1)
        self.emitter_choice = props.string("emitter_choice", "uniform", choices=("uniform", "power"))
        shown = {"max_depth": min(self.max_depth, 1) if self.max_depth >= 0 else 1, "hide_emitters": self.hide_emitters}
        self.straight = Path(Properties("path", f"{props.node}.straight", shown))
        """For light that comes straight from an emitter."""

    def check_scene(self, scene: Scene, sensor: Sensor) -> None:
        if not sensor.can_be_reached:
            raise RenderError(
                f"'ptracer' can't trace light to the sensor '{sensor.id}'; "
                "possible: perspective, thinlens, orthographic"
            )

    def begin(self, scene: Scene, sampler: SampleStream) -> LightPath:
        """A path that leaves an emitter."""
        u = sampler.next_1d()
        index, inverse, _ = scene.emitter_choice.choose(Point3f(0), None, u)
        ray, flux = scene.emitter_ptr(index).sample_ray(sampler.next_2d(), sampler.next_2d())
        # Off the surface, along the ray: its normal isn't known here.
        a = dr.abs(ray.o)
        largest = maximum(maximum(a.x, a.y), a.z)
        ray = Ray3f(dr.fma(ray.d, dr.fma(largest, RAY_EPSILON, RAY_EPSILON), ray.o), ray.d, Float(dr.inf))
        return LightPath(
            ray=ray,
            flux=flux * inverse,
            unit=dr.rcp(dr.max(flux * inverse)),
            eta=Float(1) if scene.refracts else None,
            depth=UInt32(1),
            body=scene.interior.at(ray.o) if scene.interior.exists else None,
        )

    def vertex(
        self, scene: Scene, camera: Sensor, sampler: SampleStream, path: LightPath, si: SurfaceInteraction3f
    ) -> LightVertex:
        """Process the hit (or miss) `si` of a path's ray; `camera` is the sensor with opaque values."""
        max_depth = UNBOUNDED if self.max_depth < 0 else self.max_depth
        ctx = BSDFContext(TransportMode.Importance)
        interior, flux, body = scene.interior, path.flux, path.body
        if body is not None:
            flux = flux * interior.transmittance(scene.lookup, body, si.t)
        proceed = si.is_valid() & (path.depth < max_depth)

        # ------------------ To the camera ---------------------
        ds, importance = camera.sample_direction(si.p, sampler.next_2d())
        to_camera = si.to_local(ds.d)
        value, _, bs, weight = si.bsdf().eval_pdf_sample(
            ctx, si, to_camera, sampler.next_1d(), sampler.next_2d(), proceed
        )
        splat = flux * value * (importance * side_correction(si, path.ray.d, ds.d, to_camera))
        if body is not None:
            there = interior.beyond(si, to_camera, body)
            splat = splat * interior.transmittance(scene.lookup, there, ds.dist)
            body = interior.beyond(si, bs.wo, body)
        if self.hide_emitters:
            splat = dr.select(si.emitter(scene).is_valid(), 0, splat)

        # -------------------- BSDF sampling -------------------
        d = si.to_world(bs.wo)
        flux = flux * weight * side_correction(si, path.ray.d, d, bs.wo)
        eta = None if path.eta is None else path.eta * bs.eta

        # ------------------ Russian roulette ------------------
        begins = path.depth > self.rr_depth
        left, survives = roulette(sampler, flux * path.unit, eta, begins)
        flux = left * dr.rcp(path.unit)

        return LightVertex(
            position=ds.uv,
            splat=dr.select(proceed, splat, 0),
            shadow_ray=si.spawn_ray_to(ds.p),
            path=LightPath(si.spawn_ray(d), flux, path.unit, eta, path.depth + 1, body),
            active=proceed & survives,
        )

    def reaches_camera(self, scene: Scene, ray: Ray3f) -> Bool:
        """Is the way to the camera free?

        `Scene.unoccluded` leaves out what can't come between a surface and a light: walls around everything, a lone
        lamp. They do hide things from a camera behind them.
        """
        if self.hide_emitters:
            return ~scene.closest_hit(ray, through_lights=Bool(True)).is_valid()
        return ~scene.geometry.any_hit(ray)


def side_correction(si: SurfaceInteraction3f, arriving: Vector3f, leaving: Vector3f, wo: Vector3f) -> Float:
    """cos(wi, ns) cos(wo, ng) / (cos(wi, ng) cos(wo, ns)): what shading normals ask of light paths; 0 at leaks."""
    wi_geometric, wo_geometric = -dr.dot(si.n, arriving), dr.dot(si.n, leaving)
    ok = (wi_geometric * si.wi.z > 0) & (wo_geometric * wo.z > 0)
    ratio = dr.abs(si.wi.z * wo_geometric * dr.rcp(dr.select(ok, wi_geometric * wo.z, 1)))
    return dr.select(ok, ratio, 0)


register_integrator("ptracer", ParticleTracer)

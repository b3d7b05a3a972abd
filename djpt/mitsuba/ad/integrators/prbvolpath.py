"""Path replay through media as an integrator of scripts: `prbvolpath` with a method `sample` to override."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.records import DirectionSample3f, Interaction3f
from djpt.errors import RenderError
from djpt.integrators.ad_integrator import attached
from djpt.integrators.paths.transmittance import null_transmittance
from djpt.integrators.prbvolpath import PRBVolumetricPath
from djpt.jit.types import Bool, Color3f, Float, TensorXf, UInt32
from djpt.media.flight import of_channel
from djpt.mitsuba.ad.integrators.prb import PathReplay

__all__ = ["PRBVolpathIntegrator", "index_spectrum"]


def index_spectrum(spec: Color3f, idx: UInt32) -> Float:
    """The component of a colour that has the number `idx`: 0 red, 1 green, 2 blue."""
    return of_channel(Color3f(spec), UInt32(idx))


class PRBVolpathIntegrator(PathReplay, PRBVolumetricPath):
    """Path replay backpropagation through media, for scripts to derive from.

    Parameters: as `prbvolpath`. Distances, phase functions and directions are sampled as there; the derivatives are
    by albedos, phase functions, emission and materials, and by the extinction of media, in both modes.
    """

    def render(
        self,
        scene: Any,
        sensor: Any = 0,
        seed: Any = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> TensorXf:
        return super().render(scene.replace(all_media=True), sensor, seed, spp, develop, evaluate)

    def render_forward(self, scene: Any, params: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0) -> TensorXf:
        return super().render_forward(scene.replace(all_media=True), params, sensor, seed, spp)

    def render_backward(
        self, scene: Any, params: Any, grad_in: TensorXf, sensor: Any = 0, seed: Any = 0, spp: int = 0
    ) -> None:
        super().render_backward(scene.replace(all_media=True), params, grad_in, sensor, seed, spp)

    def sample(  # type: ignore[override]
        self,
        mode: dr.ADMode,
        scene: Any,
        sampler: Any,
        ray: Any,
        δL: Color3f | None,
        state_in: Any,
        active: Bool | bool,
        **kwargs: Any,
    ) -> tuple[Color3f, Bool, list[Float], Any]:
        """The result of all samples: see `ADIntegrator.sample`. The state is the radiance."""
        scene = scene.replace(all_media=True)
        if scene.media and ray.medium is None:
            ray = ray.replaced(medium=UInt32(scene.media.vacuum))
        return super().sample(mode, scene, sampler, ray, δL, state_in, active, **kwargs)

    def sample_emitter(
        self,
        mei: Any,
        si: Any,
        active_medium: Bool | bool,
        active_surface: Bool | bool,
        scene: Any,
        sampler: Any,
        medium: Any,
        channel: UInt32,
        active: Bool | bool,
        adj_emitted: Color3f | None = None,
        δL: Color3f | None = None,
        mode: dr.ADMode | None = None,
    ) -> tuple[Color3f, DirectionSample3f]:
        """Sample an emitter from a point in a medium or on a surface, through null surfaces and media.

        For integrators of scripts: the paths of this class sample emitters at their vertices by themselves.

        Args:
            mei: Points in media.
            si: Points on surfaces.
            active_medium: Where the point is that of `mei`.
            active_surface: Where it is that of `si`.
            scene: The scene.
            sampler: The direction takes a pair of its numbers, estimates of transmittances more.
            medium: The medium that the paths run through, a `djpt.media.pointer.MediumPtr`.
            channel: There for the signature: transmittances are those of all channels.
            active: Lanes that have a point.
            adj_emitted: In backward mode, what the sample contributes; else None.
            δL: The adjoint of the radiance, to which `adj_emitted` belongs.
            mode: In ``dr.ADMode.Backward`` gradients follow from the transmittance, if `adj_emitted` is given.

        Returns:
            What arrives from the emitter over the density of the direction, and the sample of the emitter. Derivatives
            by the transmittance are left out.

        Raises:
            RenderError: `mode` is forward mode.
        """
        if mode == dr.ADMode.Forward:
            raise RenderError("sample_emitter: derivatives of the transmittance are for backward mode; found forward")
        scene = scene.replace(all_media=True)
        in_medium, on_surface = Bool(active_medium), Bool(active_surface)
        at = dr.zeros(Interaction3f)
        at.p = dr.select(on_surface, si.p, mei.p)
        at.n = dr.select(on_surface, si.n, 0)
        ds, weight = scene.sample_emitter_direction(at, sampler.next_2d(), False, active)
        ds = dr.detach(ds)
        lit = (in_medium | on_surface) & active & (ds.pdf != 0)
        shadow = dr.detach(scene.shadow_ray(at, ds))
        if scene.media:
            shadow.medium = scene.media.number_of(medium)
            crosses = on_surface & si.is_medium_transition()
            shadow.medium = dr.select(crosses, scene.media.beyond(si, ds.d), shadow.medium)
        light = dr.select(lit, Color3f(1), 0)
        if mode != dr.ADMode.Backward or adj_emitted is None:
            return dr.select(lit, weight, 0) * dr.detach(null_transmittance(scene, sampler, shadow, light)), ds
        with dr.resume_grad(), attached(self, scene, dr.ADMode.Backward) as view:
            arrives = null_transmittance(view, sampler, shadow, light)
            share = dr.detach(arrives)
            if dr.grad_enabled(arrives):
                dr.backward(arrives * dr.select(share > 0, dr.detach(Color3f(δL) * adj_emitted) / share, 0))
        return dr.select(lit, weight, 0) * share, ds

"""The verb `render`: from a scene to an image."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr

from djpt.core.interruption import noticing
from djpt.errors import RenderError
from djpt.jit.kernels import begin_trace
from djpt.jit.types import TensorXf
from djpt.rendering.image import film_image
from djpt.rendering.progress import Progress, watched
from djpt.rendering.settings import RenderSettings
from djpt.samplers.seeds import Seed
from djpt.scene.scene import Scene

__all__ = ["render"]


def render(
    scene: Scene,
    params: Any = None,
    sensor: Any = 0,
    integrator: Any = None,
    seed: Seed = 0,
    seed_grad: Seed = 0,
    spp: int = 0,
    spp_grad: int = 0,
    *,
    schedule: str = "auto",
    progress: Progress | bool | None = None,
    pass_spp: int = 0,
    keep_partial: bool = False,
    denoise: bool | str = False,
    adaptive: bool = False,
) -> TensorXf:
    """Render an image: TensorXf of shape (height, width, channels), linear float32, row 0 on top.

    The image is a function of (scene, spp, seed) and nothing else: not of passes, threads or time. (Of
    `render_passes`, and with `adaptive`, it depends on the size of rounds as well.)
    If parameters of the scene have gradients enabled, the image is attached to them, in forward
    and reverse mode.

    Args:
        scene: What `load_dict` returned.
        params: What `traverse(scene)` returned; accepted as in Mitsuba. Gradients reach every
            attached parameter of the scene, listed here or not.
        sensor: Index into ``scene.sensors()``, or a sensor.
        integrator: An integrator in place of the scene's (default: the scene's, else `path`).
        seed: Seed of the image, 0 <= seed < 2^32: a number, or an array of one.
        seed_grad: Seed of the samples that estimate the gradient; 0 derives one from `seed`.
        spp: Samples per pixel; 0 takes the sampler's `sample_count`.
        spp_grad: Samples per pixel for the gradient; 0 takes `spp`.
        schedule: `flat` (lanes are pixels), `machine` (lanes walk through a BVH, or track rays through
            media, each at its own pace), both for integrators that advance vertex by vertex; `wave` (lanes are
            samples); or `auto`: the fastest.
        progress: Called with (samples done, samples in all) after each pass; True shows a bar, in notebooks
            and in terminals.
        pass_spp: Samples per pixel of one pass; 0 chooses. Changes time and memory, never the image.
        keep_partial: What a signal leaves, SIGINT (Ctrl-C) or SIGTERM: with True the film keeps the image of the
            samples that have been computed until the pass at hand has ended, ``sensor.film().develop()``. Integrators
            of scripts that render by themselves keep nothing.
        denoise: True or a method of `djpt.denoise`: remove the noise. Samples are counted with the box filter then,
            because denoisers need pixels whose noise is independent; albedo and normals are rendered along; and
            the film keeps the noisy image, ``sensor.film().develop()``. Such images have no derivatives.
        adaptive: Take more samples where there is more noise, `spp` on average, without bias: the last image of
            `render_passes`, which says more. Such images have no derivatives, and `pass_spp` has no effect.

    Raises:
        BackendError: The denoiser isn't installed.
        RenderError: Nothing to render, or arguments out of range.
        KeyboardInterrupt: SIGINT, after the pass at hand. With `keep_partial`, `djpt.Terminated` (a `SystemExit`) for
            SIGTERM.
    """
    if dr.flag(dr.JitFlag.SymbolicScope):
        raise RenderError("no image can be rendered within a loop, a call or a condition that Dr.Jit records")
    begin_trace()
    settings = RenderSettings.of(
        scene,
        sensor,
        integrator,
        seed=seed,
        spp=spp,
        schedule=schedule,
        pass_spp=pass_spp,
        seed_grad=seed_grad,
        spp_grad=spp_grad,
    )

    def image(settings: RenderSettings) -> TensorXf:
        if (scene.moves or settings.sensor.moves) and not adaptive:
            from djpt.rendering.time_slices import needs_slices, sliced_image  # few scenes move

            if needs_slices(scene, settings):
                return sliced_image(scene, params, settings)
        if adaptive:
            from djpt.rendering.progressive.passes import adaptive_image

            rendered = adaptive_image
        elif settings.integrator.renders_itself():
            from djpt.rendering.gradients.own_rendering import image_by_itself

            return image_by_itself(scene, params, settings)
        else:
            rendered = film_image
        with watched(progress, "rendering", "samples") as shown, noticing(keep_partial) as interruption:
            result = rendered(scene, replace(settings, progress=shown, interruption=interruption))
            if interruption is not None:
                interruption.leave("the film keeps what exists")
            return result

    if denoise:
        from djpt.rendering.denoising.rendered import render_denoised

        return render_denoised(scene, "oidn" if denoise is True else denoise, settings, image)
    return image(settings)

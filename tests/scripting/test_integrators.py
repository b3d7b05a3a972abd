"""Integrators of scripts: images, derivatives, and the bases of classes that scripts write."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import RenderError
from djpt.jit.types import Bool, Color3f, Float, Point2f, Point3f, TensorXf, UInt32, Vector3f

RED = "red.reflectance.value"
SIZE = 16


def room(rfilter: str = "box") -> Any:
    box = djpt.cornell_box()
    box["sensor"]["film"].update(width=SIZE, height=SIZE, rfilter={"type": rfilter})
    return djpt.load_dict(box)


class Replayed(djpt.ad.integrators.common.RBIntegrator):
    """Paths without light sampling, differentiated vertex by vertex in a second run."""

    @dr.syntax
    def sample(self, mode, scene, sampler, ray, δL, state_in, active, **kwargs):  # type: ignore[no-untyped-def]
        primal = mode == dr.ADMode.Primal
        zero = dr.zeros(Float, sampler.wavefront_size())
        L = Color3f(0 if primal else state_in) + zero
        δL = Color3f(0 if δL is None else δL) + zero
        β = Color3f(1) + zero
        o, d = Point3f(ray.o) + zero, Vector3f(ray.d) + zero
        depth, active = UInt32(zero), Bool(zero == 0)
        while dr.hint(active, max_iterations=3, label="bounces"):
            here = djpt.Ray3f(o, d)
            si = scene.ray_intersect(here, active)
            bsdf, goes_on = si.bsdf(here), active & si.is_valid()
            with dr.resume_grad(when=not primal):
                Le = β * si.emitter(scene).eval(si, active)
            L = L + Le if primal else L - Le
            bs, weight = bsdf.sample(djpt.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), goes_on)
            if dr.hint(not primal, mode="scalar"):
                with dr.resume_grad():
                    f = bsdf.eval(djpt.BSDFContext(), si, bs.wo, goes_on)
                    plain = dr.detach(f)
                    Lo = Le + dr.select(goes_on & (plain != 0), L * f / plain, 0)
                    if dr.hint(mode == dr.ADMode.Backward, mode="scalar"):
                        dr.backward_from(δL * Lo)
                    else:
                        δL = δL + dr.forward_to(Lo)
            β = β * dr.select(goes_on, dr.detach(weight), 0)
            onward = si.spawn_ray(si.to_world(bs.wo))
            o, d = Point3f(onward.o), Vector3f(onward.d)
            depth += 1
            active = goes_on & (depth < 3)
        return (L if primal else δL), Bool(True), [], L


class Attached(djpt.ad.common.ADIntegrator):
    """The same, differentiated by Dr.Jit."""

    def sample(self, mode: Any, scene: Any, sampler: Any, ray: Any, active: Any, **kwargs: Any) -> Any:  # type: ignore[override]
        L, β = Color3f(0), Color3f(1)
        for _ in range(3):
            si = scene.ray_intersect(ray, active)
            L = L + dr.select(active, β * si.emitter(scene).eval(si, active), 0)
            active = active & si.is_valid()
            bs, weight = si.bsdf(ray).sample(djpt.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), active)
            β, ray = β * weight, si.spawn_ray(si.to_world(bs.wo))
        return L, Bool(True), [], None


djpt.register_integrator("replayed", lambda props: Replayed(props))
djpt.register_integrator("attached_by_drjit", lambda props: Attached(props))

needs_differentials = pytest.mark.skipif(
    find_spec("djpt.mitsuba.records") is None, reason="the record of ray differentials isn't there"
)
OWN = ("replayed", "attached_by_drjit")


def derivatives(integrator: Any, rfilter: str) -> tuple[float, np.ndarray, float]:
    """The mean of the image, its gradient by the red wall's colour, and its change with the red of it."""
    scene = room(rfilter)
    params = djpt.traverse(scene)

    def image() -> tuple[Any, Any]:
        color = Color3f(0.57, 0.04, 0.05)
        dr.enable_grad(color)
        params[RED] = color
        params.update()
        return color, lambda: djpt.render(scene, params, integrator=integrator, spp=128, seed=UInt32(1))

    color, render = image()
    found = render()
    dr.backward(dr.mean(found.array))
    gradient = np.array(dr.grad(color)).ravel()
    color, render = image()
    dr.set_grad(color, Color3f(1, 0, 0))
    change = np.array(dr.forward_to(render())).mean()
    return float(np.array(found).mean()), gradient, float(change)


@needs_differentials
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_derivatives_of_scripts(rfilter: str) -> None:
    by_replay, by_drjit = (derivatives(djpt.load_dict({"type": name}), rfilter) for name in OWN)
    for a, b in zip(by_replay, by_drjit, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3)
    assert by_replay[2] == pytest.approx(by_replay[1][0], rel=1e-3)  # forward and backward
    reference = derivatives(djpt.load_dict({"type": "path_naive", "max_depth": 3}), rfilter)
    assert by_replay[0] == pytest.approx(reference[0], rel=0.1)
    np.testing.assert_allclose(by_replay[1], reference[1], rtol=0.35)


@needs_differentials
@pytest.mark.parametrize("name", OWN)
def test_methods_of_own_integrators(name: str) -> None:
    scene, integrator = room(), djpt.load_dict({"type": name})
    image = integrator.render(scene, seed=3, spp=4)
    np.testing.assert_allclose(np.array(djpt.render(scene, integrator=integrator, seed=3, spp=4)), np.array(image))
    assert image.shape == (SIZE, SIZE, 3)
    params = djpt.traverse(scene)
    color = Color3f(0.5)
    dr.enable_grad(color)
    params[RED] = color
    params.update()
    ones = dr.ones(TensorXf, (SIZE, SIZE, 3)) / (3 * SIZE**2)
    integrator.render_backward(scene, params, ones, spp=16)
    gradient = np.array(dr.grad(color)).ravel()
    dr.set_grad(color, Color3f(0, 1, 0))
    assert np.array(integrator.render_forward(scene, params, spp=16)).mean() == pytest.approx(gradient[1], rel=1e-3)


@pytest.mark.parametrize("name", ["path", "direct", "depth"])
def test_images_are_those_of_render(name: str) -> None:
    scene, integrator = room(), djpt.load_dict({"type": name})
    image = integrator.render(scene, seed=UInt32(2), spp=4)
    np.testing.assert_array_equal(np.array(image), np.array(djpt.render(scene, integrator=integrator, seed=2, spp=4)))
    assert integrator.render(scene, spp=1, develop=False).shape == (0,)
    film = scene.sensors()[0].film()
    assert film.develop().shape == (SIZE, SIZE, 3) and film.develop(raw=True).shape == (SIZE, SIZE, 4)


def test_derivatives_of_djpts_integrators() -> None:
    scene, integrator = room(), djpt.load_dict({"type": "path", "max_depth": 3})
    params = djpt.traverse(scene)
    ones = dr.ones(TensorXf, (SIZE, SIZE, 3)) / (3 * SIZE**2)
    assert np.array(integrator.render_forward(scene, params, spp=1)).max() == 0
    color = Color3f(0.5)
    dr.enable_grad(color)
    params[RED] = color
    params.update()
    integrator.render_backward(scene, params, ones, seed=4, spp=32)
    gradient = np.array(dr.grad(color)).ravel()
    dr.set_grad(color, Color3f(0, 1, 0))
    change = integrator.render_forward(scene, params, seed=4, spp=32)
    assert np.array(change).mean() == pytest.approx(gradient[1], rel=1e-3) and gradient[1] > 0


class Headlight(djpt.SamplingIntegrator):
    """A script's integrator, with numbers of Python among its results."""

    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any, active: Any) -> Any:  # type: ignore[override]
        si = scene.ray_intersect(ray, active)
        assert sampler.wavefront_size() >= 1 and sampler.clone() is not sampler
        return dr.select(si.is_valid(), dr.abs(si.wi.z) + 0 * sampler.next_1d(active), 0.0), True, [1.0]

    def aov_names(self) -> list[str]:
        return ["one"]


def test_scripts_can_write_integrators() -> None:
    djpt.register_integrator("headlight", lambda props: Headlight(props))
    image = np.array(djpt.load_dict({"type": "headlight"}).render(room(), spp=2))
    assert image.shape == (SIZE, SIZE, 4) and (image[..., 3] == 1).all() and 0.3 < image[..., :3].mean() < 1


class Confetti(djpt.AdjointIntegrator):
    """The same light everywhere, added at random places."""

    def sample(self, scene: Any, sensor: Any, sampler: Any, block: Any, sample_scale: float) -> None:  # type: ignore[override]
        place = sampler.next_2d() * Point2f(block.size())
        block.put(place, [], Color3f(1, 2, 3) * sample_scale, weight=0)


def test_scripts_can_start_at_the_lights() -> None:
    djpt.register_integrator("confetti", lambda props: Confetti(props))
    scene = room()
    image = np.array(djpt.render(scene, integrator=djpt.load_dict({"type": "confetti"}), spp=64))
    np.testing.assert_allclose(image.mean(axis=(0, 1)), [1, 2, 3], rtol=1e-4)
    params = djpt.traverse(scene)
    dr.enable_grad(params[RED])
    params.update()
    with pytest.raises(RenderError, match="starts at the lights and can't be differentiated"):
        dr.backward(dr.mean(djpt.render(scene, params, integrator=djpt.load_dict({"type": "confetti"}), spp=1).array))


def test_integrators_that_start_at_the_lights_are_adjoint() -> None:
    assert isinstance(djpt.load_dict({"type": "ptracer"}), djpt.AdjointIntegrator)
    assert not isinstance(djpt.load_dict({"type": "path"}), djpt.AdjointIntegrator)


def test_a_rendering_can_be_cancelled() -> None:
    scene, integrator = room(), djpt.load_dict({"type": "path"})
    assert not integrator.should_stop()
    with pytest.raises(RenderError, match="the rendering was cancelled"):
        djpt.render(scene, integrator=integrator, spp=4, pass_spp=1, progress=lambda done, total: integrator.cancel())
    assert djpt.render(scene, integrator=integrator, spp=1).shape == (SIZE, SIZE, 3)


def test_kinds_of_plugins() -> None:
    scene = room()
    assert isinstance(scene.sensors()[0], djpt.Endpoint) and isinstance(scene.emitters()[0], djpt.Endpoint)
    assert isinstance(scene.sensors()[0], djpt.ProjectiveCamera) and isinstance(scene.shapes()[0], djpt.Shape)
    assert isinstance(djpt.load_dict({"type": "path"}), djpt.MonteCarloIntegrator)
    assert not isinstance(scene, djpt.Medium)


def test_images_are_attached_by_their_own_samples() -> None:
    """The image is linear in the light: its derivative is that of the image itself, sample by sample."""
    key, scene = "light.emitter.radiance.value", room()
    params = djpt.traverse(scene)
    scale = Float(1)
    dr.enable_grad(scale)
    params[key] = Color3f(18, 14, 7) * scale
    params.update()
    image = djpt.load_dict({"type": "path", "max_depth": 4}).render(scene, seed=2, spp=4)
    dr.forward(scale)
    np.testing.assert_allclose(np.array(dr.grad(image)), np.array(dr.detach(image)), rtol=1e-4, atol=1e-6)
    with dr.suspend_grad():
        assert not dr.grad_enabled(djpt.load_dict({"type": "path"}).render(scene, spp=1))

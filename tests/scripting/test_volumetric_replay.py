"""Path replay through media as a class that scripts derive from."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.records.interactions import MediumInteraction3f
from djpt.errors import RenderError
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.validation.bridge import to_mitsuba
from tests.kit.media_scenes import NULL, fog, foggy_room, lit_ball

SETTINGS = {"max_depth": 6, "rr_depth": 5}
PARAMETERS = (
    "fog.interior_medium.sigma_t.value.value",
    "fog.interior_medium.albedo.value.value",
    "red.reflectance.value",
)


def made(kind: Any = None) -> Any:
    """The integrator, or one of a class that derives from it."""
    props = djpt.Properties("prbvolpath")
    for key, value in SETTINGS.items():
        props[key] = value
    return (kind or djpt.ad.integrators.prbvolpath.PRBVolpathIntegrator)(props)


def gradient(scene: Any, name: str, integrator: Any) -> np.ndarray:
    """The gradient of the mean of an image by a parameter."""
    scene = djpt.load_dict(scene)
    params = djpt.traverse(scene)
    dr.enable_grad(params[name])
    params.update()
    dr.backward(dr.mean(djpt.render(scene, params, integrator=integrator, spp=16, seed=1, seed_grad=5).array))
    return np.array(dr.grad(params[name])).ravel()


@pytest.mark.parametrize("around", [False, True], ids=["cube", "camera inside"])
def test_images_are_those_of_the_plugin(around: bool) -> None:
    scene = djpt.load_dict(foggy_room(fog(0.5, 0.8), "prbvolpath", around=around))
    mine = np.array(made().render(scene, seed=1, spp=16))
    plain = np.array(djpt.render(scene, integrator=djpt.load_dict({"type": "prbvolpath", **SETTINGS}), seed=1, spp=16))
    np.testing.assert_allclose(mine, plain, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", PARAMETERS)
@pytest.mark.sparse(3)
def test_gradients_are_those_of_the_plugin(name: str) -> None:
    scene = foggy_room(fog(1.0, 0.8))
    mine, plain = (gradient(scene, name, i) for i in (made(), djpt.load_dict({"type": "prbvolpath", **SETTINGS})))
    assert np.abs(plain).max() > 1e-3
    np.testing.assert_allclose(mine, plain, rtol=1e-4)


def test_forward_is_backward() -> None:
    scene, name = djpt.load_dict(foggy_room(fog(1.0, 0.8))), PARAMETERS[0]
    params, own = djpt.traverse(scene), made()
    dr.enable_grad(params[name])
    params.update()
    own.render_backward(scene, params, dr.full(djpt.TensorXf, 1 / (3 * 16**2), (16, 16, 3)), seed=2, spp=16)
    backward = dr.grad(params[name])[0]
    dr.set_grad(params[name], 1)
    change = np.array(own.render_forward(scene, params, seed=2, spp=16))
    assert change.mean() == pytest.approx(float(np.array(backward).ravel()[0]), rel=1e-3)


def test_image_and_gradient_are_mitsubas(mi: Any) -> None:
    """Within the noise of eight images each."""
    name, found = "ball.interior_medium.albedo.value.value", []
    description = {**lit_ball(fog(1.5, 0.7), NULL, size=8), "integrator": {"type": "prbvolpath", **SETTINGS}}
    for kind in (djpt, mi):
        scene = kind.load_dict(description if kind is djpt else to_mitsuba(description))
        own = made() if kind is djpt else scene.integrator()
        params = kind.traverse(scene)
        dr.enable_grad(params[name])
        params.update()
        rows = []
        for seed in range(8):
            mean = np.array(own.render(scene, seed=seed, spp=64)).mean()
            dr.clear_grad(params[name])
            own.render_backward(scene, params, dr.full(kind.TensorXf, 1 / 192, (8, 8, 3)), seed=seed, spp=64)
            rows.append([mean, np.array(dr.grad(params[name])).ravel()[0]])
        found.append(np.array(rows))
    error = np.sqrt(sum(rows.var(axis=0, ddof=1) / 8 for rows in found))
    assert (np.abs(found[0].mean(axis=0) - found[1].mean(axis=0)) < 4 * error).all()
    assert (error < 0.05 * found[0].mean(axis=0)).all()


class Watched(djpt.ad.integrators.prbvolpath.PRBVolpathIntegrator):
    """Says in which modes it was asked."""

    def sample(self, mode, scene, sampler, ray, δL, state_in, active, **kwargs):  # type: ignore[no-untyped-def]
        self.modes = [*getattr(self, "modes", []), mode]
        return super().sample(mode, scene, sampler, ray, δL, state_in, active, **kwargs)


def test_scripts_derive_from_it() -> None:
    own = made(Watched)
    gradient(foggy_room(fog(1.0, 0.8)), PARAMETERS[1], own)
    mode = dr.ADMode
    assert own.modes == [mode.Primal, mode.Primal, mode.Backward]


def test_the_spectrum_is_indexed(mi: Any) -> None:
    for kind in (djpt, mi):
        index = kind.ad.integrators.prbvolpath.index_spectrum
        assert np.array(index(kind.Color3f(1, 2, 3), kind.UInt32(2, 0, 1))).tolist() == [3, 1, 2]


def sample_of_emitter(mode: Any = None, **more: Any) -> tuple[Any, Any, Any]:
    """Emitters sampled from the middle of a ball of fog, one channel's extinction being 0.5."""
    scene = djpt.load_dict(lit_ball(fog(0.5, 0.8)))
    params = djpt.traverse(scene)
    dr.enable_grad(params["ball.interior_medium.sigma_t.value.value"])
    params.update()
    medium = scene.shapes()[0].interior_medium()
    mei, si = dr.zeros(MediumInteraction3f, 64), dr.zeros(djpt.SurfaceInteraction3f, 64)
    sampler = djpt.load_dict({"type": "independent"})
    sampler.seed(1, 64)
    lanes, none = dr.full(Bool, True, 64), dr.full(Bool, False, 64)
    found = made().sample_emitter(mei, si, lanes, none, scene, sampler, medium, UInt32(0), lanes, mode=mode, **more)
    return *found, params


def test_emitters_are_sampled_through_null_surfaces() -> None:
    """A white sky, seen through a way of 1: exp(-0.5) for all directions, each with the density 1 / (4 pi)."""
    emitted, ds, _ = sample_of_emitter()
    np.testing.assert_allclose(np.array(emitted) * np.array(ds.pdf), np.exp(-0.5), rtol=1e-4)


def test_the_transmittance_has_a_gradient() -> None:
    """The derivative of exp(-sigma) over itself is -1; the contribution is 1 in each of three channels here."""
    one = Color3f(1)
    _, _, params = sample_of_emitter(dr.ADMode.Backward, adj_emitted=one, δL=one)
    got = np.array(dr.grad(params["ball.interior_medium.sigma_t.value.value"])).ravel()
    assert got.sum() == pytest.approx(-3 * 64, rel=1e-3)
    with pytest.raises(RenderError, match="for backward mode; found forward"):
        sample_of_emitter(dr.ADMode.Forward, adj_emitted=one, δL=Float(1))

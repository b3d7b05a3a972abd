"""Path replay as classes that scripts derive from: Mitsuba's images and derivatives, number by number."""

from __future__ import annotations

import operator
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import SceneError
from djpt.jit.types import Bool, Color3f, TensorXf

RED = "red.reflectance.value"
SIZE = 12
CLASSES = {
    "prb": djpt.ad.integrators.prb.PRBIntegrator,
    "prb_basic": djpt.ad.integrators.prb_basic.BasicPRBIntegrator,
}


def made(name: str, **settings: Any) -> Any:
    """An integrator of one of the classes."""
    props = djpt.Properties(name)
    for key, value in settings.items():
        props[key] = value
    return CLASSES[name](props)


def room(mi: Any) -> Any:
    box = mi.cornell_box()
    box["sensor"]["film"].update(width=SIZE, height=SIZE, rfilter={"type": "box"})
    return mi.load_dict(box)


def derivatives(mi: Any, integrator: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An image, the gradient of its mean by the red wall's colour, and its change with the red of it."""
    scene = room(mi)
    image = np.array(integrator.render(scene, seed=3, spp=16))
    params = mi.traverse(scene)
    dr.enable_grad(params[RED])
    params.update()
    integrator.render_backward(scene, params, dr.full(mi.TensorXf, 1 / image.size, image.shape), seed=4, spp=32)
    gradient = np.array(dr.grad(params[RED])).ravel()
    dr.set_grad(params[RED], mi.Color3f(1, 0, 0))
    return image, gradient, np.array(integrator.render_forward(scene, params, seed=4, spp=32))


@pytest.mark.parametrize("name", CLASSES)
@pytest.mark.sparse(2)
def test_images_and_derivatives_are_mitsubas(mi: Any, name: str) -> None:
    """So they are with Russian roulette, which begins at depth 2 here."""
    settings = {"max_depth": 5} | ({"rr_depth": 2} if name == "prb" else {})
    mine = derivatives(djpt, made(name, **settings))
    his = derivatives(mi, mi.load_dict({"type": name} | settings))
    np.testing.assert_allclose(mine[0], his[0], rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(mine[1], his[1], rtol=1e-3)
    np.testing.assert_allclose(mine[2], his[2], rtol=1e-3, atol=1e-4)
    assert mine[2].mean() == pytest.approx(mine[1][0], rel=1e-3)  # forward and backward


class Watched(djpt.ad.integrators.prb.PRBIntegrator):
    """Says in which modes it was asked."""

    def sample(self, mode, scene, sampler, ray, δL, state_in, active, **kwargs):  # type: ignore[no-untyped-def]
        self.modes = [*getattr(self, "modes", []), mode]
        return super().sample(mode, scene, sampler, ray, δL, state_in, active, **kwargs)


def test_scripts_derive_from_it() -> None:
    djpt.register_integrator("watched", lambda props: Watched(props))
    scene, own = room(djpt), djpt.load_dict({"type": "watched", "max_depth": 4})
    params, color = djpt.traverse(scene), Color3f(0.5, 0.1, 0.1)
    dr.enable_grad(color)
    params[RED] = color
    params.update()
    image = djpt.render(scene, params, integrator=own, spp=8, seed=1)
    plain = djpt.render(scene, integrator=djpt.load_dict({"type": "prb", "max_depth": 4}), spp=8, seed=1)
    np.testing.assert_allclose(np.array(dr.detach(image)), np.array(dr.detach(plain)), rtol=1e-4, atol=1e-5)
    dr.backward(dr.mean(image.array))
    mine, mode = np.array(dr.grad(color)), dr.ADMode
    assert own.modes == [mode.Primal, mode.Primal, mode.Backward]
    dr.clear_grad(color)
    dr.backward(dr.mean(plain.array))
    np.testing.assert_allclose(mine, np.array(dr.grad(color)), rtol=1e-3)


def test_a_parameter_without_effect_has_no_gradient() -> None:
    scene = room(djpt)
    params = djpt.traverse(scene)
    dr.enable_grad(params[RED])
    params.update()
    dark = made("prb", max_depth=1)
    dark.render_backward(scene, params, dr.ones(TensorXf, (SIZE, SIZE, 3)), spp=2)
    assert np.array(dr.grad(params[RED])).tolist() == [[0], [0], [0]]


def test_images_by_bounces_are_refused() -> None:
    with pytest.raises(SceneError, match="'bounces' isn't supported by 'PRBIntegrator': use the plugin 'path'"):
        made("prb", bounces=True)


def test_rays_pass_lamps() -> None:
    scene, up = room(djpt), djpt.Ray3f([0, 0, 0], [0, 1, 0])
    lamp, ceiling = scene.ray_intersect(up), djpt.load_dict({"type": "path"}).skip_area_emitters(scene, up, True, True)
    assert lamp.t[0] == pytest.approx(0.99) and ceiling.t[0] == pytest.approx(1)
    assert not djpt.load_dict({"type": "path"}).skip_area_emitters(scene, up, True, Bool(False)).is_valid()[0]


def test_names_are_mitsubas(mi: Any) -> None:
    modules = ("integrators.common", "integrators.prb", "integrators.prb_basic", "optimizers", "largesteps", "loaders")
    for name in modules:
        for ad in (djpt.ad, mi.ad):
            assert operator.attrgetter(name)(ad)
        assert name.split(".")[-1] in dir(djpt.ad) and getattr(djpt.ad, name.split(".")[-1])
    assert issubclass(djpt.ad.common.ADIntegrator, djpt.CppADIntegrator)
    assert djpt.ad.common.mis_weight(djpt.Float(1), djpt.Float(1)) == 0.5
    with pytest.raises(AttributeError, match=r"module 'djpt\.mitsuba\.ad' has no attribute 'Adamm'"):
        djpt.ad.Adamm  # noqa: B018


def test_bodies_absorb() -> None:
    box = djpt.cornell_box()
    box["sensor"]["film"].update(width=SIZE, height=SIZE, rfilter={"type": "box"})
    box["small-box"] = {
        "type": "sphere",
        "center": [0, -0.4, 0.3],
        "radius": 0.4,
        "bsdf": {"type": "dielectric", "absorption": {"type": "rgb", "value": [3.0, 0.1, 2.0]}},
    }
    scene = djpt.load_dict(box)
    images = [djpt.render(scene, integrator=i, spp=8, seed=1) for i in (made("prb"), djpt.load_dict({"type": "prb"}))]
    np.testing.assert_allclose(*(np.array(image) for image in images), rtol=1e-4, atol=1e-5)

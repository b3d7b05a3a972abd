"""Radiance fields of ellipsoids: Mitsuba's images and derivatives, number by number."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.jit.types import Bool
from tests.kit.derivatives import by_both

COUNT, SIZE = 10, 12
NAMES = ("cloud.opacities", "cloud.sh_coeffs", "cloud.data")


def field(mi: Any, shape: str = "ellipsoids", degree: int = 1, **settings: Any) -> dict[str, Any]:
    """Ellipsoids in a heap, of which rays meet several."""
    rng = np.random.default_rng(2)
    q = rng.normal(size=(COUNT, 4))
    data = np.concatenate(
        [rng.uniform(-0.5, 0.5, (COUNT, 3)), rng.uniform(0.1, 0.3, (COUNT, 3)), q / np.linalg.norm(q, axis=1)[:, None]],
        1,
    )
    numbers = {
        "data": data,
        "opacities": rng.uniform(0.3, 0.9, (COUNT, 1)),
        "sh_coeffs": rng.uniform(-0.3, 0.5, (COUNT, 3 * (degree + 1) ** 2)),
    }
    return {
        "type": "scene",
        "integrator": {"type": "volprim_rf_basic", **settings},
        "sensor": {
            "type": "perspective",
            "fov": 40,
            "to_world": mi.ScalarTransform4f().look_at([0, 0.3, 4], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}},
        },
        "cloud": {"type": shape, **{key: mi.TensorXf(v.astype(np.float32)) for key, v in numbers.items()}},
    }


def image(mi: Any, scene: Any, **more: Any) -> np.ndarray:
    return np.array(mi.render(mi.load_dict(scene), spp=4, seed=1, **more))


@pytest.mark.parametrize("shape", ["ellipsoids", "ellipsoidsmesh"])
@pytest.mark.parametrize("settings", [{}, {"max_depth": 2, "srgb_primitives": False}], ids=["encoded", "two"])
@pytest.mark.sparse(2)
def test_images_are_mitsubas(mi: Any, shape: str, settings: dict[str, Any]) -> None:
    mine, his = image(djpt, field(djpt, shape, **settings)), image(mi, field(mi, shape, **settings))
    assert mine.mean() > 5e-3
    # At the rim of an ellipsoid rounding decides whether it is met.
    different = np.abs(mine - his).max(axis=2) > 1e-4
    assert different.mean() < 0.05 and mine.mean() == pytest.approx(his.mean(), rel=2e-3)


@pytest.mark.parametrize("degree", [0, 2])
def test_colours_by_direction(mi: Any, degree: int) -> None:
    mine, his = image(djpt, field(djpt, degree=degree)), image(mi, field(mi, degree=degree))
    assert np.median(np.abs(mine - his)) < 1e-5 and mine.mean() == pytest.approx(his.mean(), rel=2e-3)


def derivatives(mi: Any, name: str, **settings: Any) -> tuple[np.ndarray, np.ndarray]:
    """The gradient of the mean by a parameter, and the change of the image as all its numbers rise together."""
    scene = mi.load_dict(field(mi, **settings))
    params, integrator = mi.traverse(scene), scene.integrator()
    dr.enable_grad(params[name])
    params.update()
    weight = dr.full(mi.TensorXf, 1 / (3 * SIZE**2), (SIZE, SIZE, 3))
    integrator.render_backward(scene, params, weight, seed=3, spp=4)
    gradient = np.array(dr.grad(params[name])).ravel()
    dr.set_grad(params[name], dr.full(mi.Float, 1, gradient.size))
    return gradient, np.array(integrator.render_forward(scene, params, seed=3, spp=4))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.sparse(2)
def test_derivatives_are_mitsubas(mi: Any, name: str) -> None:
    """Without the decoding of sRGB, which has no derivative there."""
    mine, his = (derivatives(kind, name, srgb_primitives=False) for kind in (djpt, mi))
    np.testing.assert_allclose(mine[0], his[0], rtol=2e-2, atol=2e-3 * np.abs(his[0]).max())
    assert mine[1].mean() == pytest.approx(mine[0].sum(), rel=1e-3)
    assert mine[1].mean() == pytest.approx(his[1].mean(), rel=2e-2)


@pytest.mark.parametrize("name", NAMES[:2])
def test_derivatives_are_differences(name: str) -> None:
    """Of `djpt.render`, with the decoding of sRGB."""
    scene = djpt.load_dict(field(djpt))
    entries = np.array(djpt.traverse(scene)[name]).size
    along = np.random.default_rng(5).uniform(0, 1, entries)
    found, expected = by_both(scene, name, 1e-2, along, seed=1, spp=4)
    assert found == pytest.approx(expected, rel=1e-2)


def test_parts_are_what_scripts_call(mi: Any) -> None:
    found = []
    for kind in (djpt, mi):
        scene = kind.load_dict(field(kind))
        ray = kind.Ray3f(kind.Point3f(0, 0.3, 4), kind.Vector3f(dr.normalize(kind.Vector3f([0, 0.02], -0.07, -1))))
        si, integrator = scene.ray_intersect(ray), scene.integrator()
        parts = integrator.eval_transmission(si, ray, Bool(True)), integrator.eval_sh_emission(si, ray, Bool(True))
        found.append([np.array(part) for part in parts])
        assert str(integrator) == "BasicVolumetricPrimitiveRadianceFieldIntegrator[]"
    for mine, his in zip(*found, strict=True):
        np.testing.assert_allclose(mine, his, rtol=1e-4)


def test_other_shapes_end_rays() -> None:
    scene = field(djpt) | {"wall": {"type": "rectangle", "to_world": djpt.ScalarTransform4f().translate([0, 0, 3])}}
    assert image(djpt, scene).max() == 0

"""Matter as dense as numbers get: every flight ends, and what it finds is finite."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.integrators.base import PathIntegrator
from djpt.integrators.volpath import VolumetricPath
from tests.kit.media_scenes import colour, fog, lit_ball
from tests.media.test_heterogeneous import in_cube, smoke

INTEGRATORS = ("volpath", "volpathmis", "prbvolpath")
HALF = np.repeat(np.float32([[[0, 0, 1, 1]]]), 4, axis=0).repeat(4, axis=1)


def rendered(description: dict[str, Any], integrator: str, spp: int = 4, **options: Any) -> np.ndarray:
    description["integrator"] = {"type": integrator}
    description["sensor"]["film"].update(width=4, height=4)
    return np.array(djpt.render(djpt.load_dict(description), spp=spp, **options))


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("schedule", ["flat", "machine"])
@pytest.mark.parametrize("filter_type", ["trilinear", "nearest"])
@pytest.mark.sparse(6)
def test_flights_beside_dense_matter_end(integrator: str, schedule: str, filter_type: str) -> None:
    """Where there is nothing, collisions with a majorant of 1e38 took steps of no length."""
    medium = smoke(HALF * 1e38, 0.75)
    medium["sigma_t"]["filter_type"] = filter_type
    image = rendered(in_cube({**medium, "scale": 1.0}), integrator, schedule=schedule)
    assert np.isfinite(image).all() and 0 < image.min() < image.max() <= 1.01


@pytest.mark.parametrize("sigma_t", [1e6, 3e37, 1e38, 3e38])
def test_dense_matter_is_as_opaque_as_less_dense(sigma_t: float) -> None:
    """Half a space that scatters looks the same on any scale: its light is that at a mean free path of 1e-4."""
    images = [
        rendered(in_cube({**smoke(np.full((4, 4, 4), x, np.float32), 0.75), "scale": 1.0}), "volpath", spp=256)
        for x in (1e4, sigma_t)
    ]
    assert images[1].mean() == pytest.approx(images[0].mean(), rel=0.02)


def test_a_scale_beyond_all_numbers() -> None:
    image = rendered(in_cube({**smoke(HALF * 1e38, 0.75), "scale": 1e10}), "volpath")
    assert np.isfinite(image).all()


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("sigma_t", [1e38, colour(1e38, 1e38, 1e38), colour(3e38, 1e20, 1.0)], ids=str)
@pytest.mark.sparse(4)
def test_dense_fog(integrator: str, sigma_t: Any) -> None:
    """The closed form: squares of densities overflowed. Its derivatives are numbers, too."""
    scene = djpt.load_dict(lit_ball(fog(sigma_t, 0.75), integrator=integrator, size=4))
    assert np.isfinite(np.array(djpt.render(scene, spp=4))).all()
    params = djpt.traverse(scene)
    (key,) = (key for key in params if "sigma_t" in key)
    dr.enable_grad(params[key])
    params.update()
    dr.backward(dr.mean(djpt.render(scene, params, spp=4), axis=None))
    assert np.isfinite(np.array(dr.grad(params[key]))).all()


def test_searches_that_end_with_the_flight_find_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rays of paths in a medium end where light is scattered: bits of images don't change."""
    glass = {"type": "dielectric", "int_ior": 1.3}
    medium = {"type": "homogeneous", "sigma_t": {"type": "rgb", "value": [3, 5, 8]}, "albedo": 0.95}
    scene = djpt.load_dict({
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 16},
        "sensor": {
            "type": "perspective",
            "to_world": djpt.ScalarTransform4f().look_at(origin=[0, 0, 5], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 16, "height": 16},
        },
        "sky": {"type": "constant"},
        "body": {"type": "cube", "bsdf": glass, "interior": medium},
        "ball": {"type": "sphere", "radius": 0.5, "bsdf": {"type": "diffuse"}},
    })  # fmt: skip
    bounded = np.array(djpt.render(scene, spp=8))
    monkeypatch.setattr(VolumetricPath, "trace", lambda self, *arguments: PathIntegrator.trace(self, *arguments))
    np.testing.assert_array_equal(np.array(djpt.render(scene, spp=8)), bounded)

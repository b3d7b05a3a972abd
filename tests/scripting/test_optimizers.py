"""Optimisers under Mitsuba's names."""

from __future__ import annotations

import drjit as dr
import drjit.opt
import numpy as np
import pytest

import djpt
from djpt.jit.types import Color3f, Float

KEYS = ["floor.bsdf.reflectance.value", "light.radiance.value"]


def scene() -> djpt.Scene:
    return djpt.load_dict(
        {
            "type": "scene",
            "floor": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": 0.2}},
            "light": {"type": "constant"},
            "sensor": {
                "type": "orthographic",
                "to_world": djpt.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 2, "height": 2},
            },
            "integrator": {"type": "direct"},
        }
    )


@pytest.mark.parametrize("name", ["Adam", "AdamW", "RMSProp", "SGD"])
def test_all_parameters_of_a_scene_may_be_given(name: str) -> None:
    """Those without a derivative are left out, such as the camera's clipping planes."""
    kind = getattr(djpt.ad, name)
    optimizer = kind(lr=0.1, params=djpt.traverse(scene()))
    assert sorted(optimizer.keys()) == KEYS
    assert isinstance(optimizer, djpt.ad.optimizers.Optimizer) and isinstance(optimizer, getattr(drjit.opt, name))
    assert list(kind(lr=0.1, params={"x": Float(1)}).keys()) == ["x"]


def test_parameters_are_recovered() -> None:
    """The reflectance of a floor under a white sky is its brightness."""
    lit = scene()
    params = djpt.traverse(lit)
    optimizer = djpt.ad.Adam(lr=0.1)
    optimizer[KEYS[0]] = params[KEYS[0]]
    for step in range(40):
        params.update(optimizer)
        image = djpt.render(lit, params, spp=16, seed=step)
        dr.backward(dr.mean(dr.square(image - 0.6), axis=None))
        optimizer.step()
        optimizer[KEYS[0]] = dr.clip(optimizer[KEYS[0]], 0, 1)
    np.testing.assert_allclose(np.array(Color3f(dr.detach(optimizer[KEYS[0]]))).ravel(), 0.6, atol=0.02)

"""Filters evaluated in loops: equal to unrolled ones, to Mitsuba's, and their derivatives."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.rfilters import base
from tests.kit.renders import box, ours, pixels, theirs

WIDE = {"type": "gaussian", "stddev": 5.0}


@pytest.fixture
def always_in_loops(monkeypatch: pytest.MonkeyPatch) -> Any:
    return lambda: monkeypatch.setattr(base, "UNROLLED", 1)


@pytest.mark.parametrize("options", [{}, {"schedule": "wave"}, {"pass_spp": 1}], ids=["flat", "wave", "passes"])
def test_loops_compute_what_is_unrolled(options: dict[str, Any], always_in_loops: Any) -> None:
    scene = box((20, 14), {"type": "gaussian", "stddev": 0.8}, {"type": "path", "max_depth": 3})
    unrolled = ours(scene, 4, 2)
    always_in_loops()
    np.testing.assert_allclose(ours(scene, 4, 2, **options), unrolled, rtol=2e-5, atol=1e-6)


def test_passes_change_nothing() -> None:
    scene = box((16, 12), WIDE, {"type": "path", "max_depth": 3})
    np.testing.assert_array_equal(ours(scene, 4, 2), ours(scene, 4, 2, pass_spp=1))


def test_splats_compute_what_is_unrolled(always_in_loops: Any) -> None:
    scene = box((16, 16), {"type": "gaussian", "stddev": 0.8}, {"type": "ptracer", "max_depth": 3})
    unrolled = ours(scene, 4, 2)
    always_in_loops()
    np.testing.assert_allclose(ours(scene, 4, 2), unrolled, rtol=1e-4, atol=1e-6)


def gradient(scene: Any, params: Any, key: str) -> np.ndarray:
    dr.clear_grad(params[key])
    dr.enable_grad(params[key])
    params.update()
    image = djpt.render(scene, params=params, spp=4, seed=2)
    dr.backward(dr.sum(image * image, axis=None))
    return pixels(params[key].grad)


def test_gradients_in_loops(always_in_loops: Any) -> None:
    scene = djpt.load_dict(box((12, 10), {"type": "gaussian", "stddev": 0.8}, {"type": "path", "max_depth": 3}))
    params, key = djpt.traverse(scene), "white.reflectance.value"
    unrolled = gradient(scene, params, key)
    always_in_loops()
    np.testing.assert_allclose(gradient(scene, params, key), unrolled, rtol=1e-4)


def test_equal_pixels() -> None:
    pytest.importorskip("mitsuba")
    scene = box((16, 12), WIDE, {"type": "path", "max_depth": 3})
    np.testing.assert_allclose(ours(scene, 4, 1), theirs(scene, 4, 1), rtol=2e-3)


def test_limits() -> None:
    film = djpt.load_dict({"type": "hdrfilm", "filter": {"type": "gaussian", "stddev": 18.5}})
    assert film.rfilter().radius() == 74
    with pytest.raises(djpt.SceneError, match=r"'stddev' must lie in \(0, 64\], found 65"):
        djpt.load_dict({"type": "gaussian", "stddev": 65.0})
    block = djpt.ImageBlock([8, 8], [0, 0], 3, djpt.load_dict(WIDE))
    with pytest.raises(djpt.RenderError, match="the filter reaches 41 pixels along an axis"):
        block.put(djpt.Point2f(4, 4), [djpt.Float(1)] * 3)

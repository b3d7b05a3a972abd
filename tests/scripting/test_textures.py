"""What scripts ask textures: Mitsuba's answers."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import RenderError
from djpt.jit.types import Point2f, Vector3f
from tests.kit.arrays import in_numpy, rows
from tests.kit.materials import interaction

TEXELS = np.random.default_rng(0).random((4, 5, 3)).astype(np.float32)


def texture(module: Any, name: str) -> Any:
    data = {"bitmap": TEXELS, "grey bitmap": TEXELS[..., :1], "nearest": TEXELS}
    if name in data:
        more = {"filter_type": "nearest"} if name == "nearest" else {}
        return module.load_dict({"type": "bitmap", "data": module.TensorXf(data[name]), "raw": True, **more})
    return module.load_dict(
        {"rgb": {"type": "rgb", "value": [0.1, 0.2, 0.6]}, "uniform": {"type": "uniform", "value": 0.3}}.get(
            name, {"type": name}
        )
    )


NAMES = ("rgb", "uniform", "bitmap", "grey bitmap", "nearest", "checkerboard")


@pytest.mark.parametrize("name", NAMES)
def test_textures_answer_as_mitsubas(mi: Any, name: str) -> None:
    mine, his = (texture(module, name) for module in (djpt, mi))
    assert mine.is_spatially_varying() == his.is_spatially_varying()
    assert list(mine.resolution()) == list(his.resolution())
    assert mine.mean()[0] == pytest.approx(his.mean()[0], rel=1e-5)
    own, theirs = interaction(Vector3f(0, 0, 1)), dr.zeros(mi.SurfaceInteraction3f)
    theirs.uv = mi.Point2f(0.31, 0.62)
    for question in ("eval", "eval_1", "eval_3", "eval_1_grad"):
        try:
            expected = getattr(his, question)(theirs)
        except RuntimeError:
            continue  # Mitsuba has no answer
        np.testing.assert_allclose(in_numpy(getattr(mine, question)(own)), in_numpy(expected), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_positions_are_mitsubas(mi: Any, name: str) -> None:
    samples = np.random.default_rng(1).random((2, 30))
    drawn = []
    for module, point in ((djpt, Point2f), (mi, mi.Point2f)):
        its = texture(module, name)
        uv, pdf = its.sample_position(point(*rows(samples)))
        drawn.append([in_numpy(x) for x in (uv, pdf, its.pdf_position(uv))])
    for mine, his in zip(*drawn, strict=True):
        np.testing.assert_allclose(np.broadcast_to(mine, his.shape), his, rtol=1e-4, atol=1e-5)


def test_largest_values() -> None:
    largest = {name: texture(djpt, name).max() for name in ("rgb", "uniform", "bitmap", "checkerboard")}
    expected = {"rgb": 0.6, "uniform": 0.3, "bitmap": float(TEXELS.max()), "checkerboard": 0.4}
    assert largest == pytest.approx(expected)


def test_spectra_are_refused() -> None:
    with pytest.raises(RenderError, match="has no wavelengths: use eval"):
        texture(djpt, "rgb").pdf_spectrum(None)
    assert djpt.Texture.D65(2.0).max() == 2

"""Image blocks and films that scripts fill: the pixels of Mitsuba's."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import RenderError
from tests.kit.arrays import in_numpy, rows

COUNT = 40
FILTERS = (None, "box", "tent", "gaussian", "mitchell", "lanczos")


def filled(module: Any, name: str | None, channels: int, active: bool = False, **options: Any) -> Any:
    """A block with random samples, some of them beside it."""
    rng = np.random.default_rng(7)
    rfilter = None if name is None else module.load_dict({"type": name})
    block = module.ImageBlock([9, 6], [2, 3], channels, rfilter, **options)
    position = module.Point2f(*rows(rng.random((2, COUNT)) * np.array([[13], [11]])))
    values = [module.Float(*rows([v])) for v in rng.random((channels, COUNT))]
    lanes = [module.Bool(rng.random(COUNT) < 0.5)] if active else []
    block.put(position, values, *lanes)
    return block


@pytest.mark.sparse(6)
@pytest.mark.parametrize(
    "options",
    [{}, {"border": True}, {"normalize": True}, {"coalesce": False}, {"coalesce": False, "normalize": True}],
    ids=str,
)
@pytest.mark.parametrize("name", FILTERS)
def test_sums_are_mitsubas(mi: Any, name: str | None, options: dict[str, bool]) -> None:
    for channels, active in ((4, False), (2, True)):
        mine, his = (filled(module, name, channels, active, **options) for module in (djpt, mi))
        assert mine.tensor().shape == his.tensor().shape
        for question in ("width", "height", "channel_count", "border_size", "has_border", "normalize", "coalesce"):
            assert getattr(mine, question)() == getattr(his, question)()
        assert (list(mine.size()), list(mine.offset())) == (list(his.size()), list(his.offset()))
        np.testing.assert_allclose(mine.tensor().numpy(), his.tensor().numpy(), rtol=2e-4, atol=2e-5)


@pytest.mark.sparse(3)
@pytest.mark.parametrize("normalize", [False, True])
@pytest.mark.parametrize("name", ["box", "tent", "gaussian"])
def test_reading_is_mitsubas(mi: Any, name: str, normalize: bool) -> None:
    position, read = np.random.default_rng(3).random((2, COUNT)) * 8 + 2, []
    for module in (djpt, mi):
        block = filled(module, name, 3, normalize=normalize)
        read.append(block.read(module.Point2f(*rows(position))))
    for mine, his in zip(*read, strict=True):
        np.testing.assert_allclose(in_numpy(mine), in_numpy(his), rtol=2e-4, atol=2e-5)


def test_blocks_are_added_as_mitsubas(mi: Any) -> None:
    sums = []
    for module in (djpt, mi):
        whole = module.ImageBlock([12, 10], [0, 1], 4)
        for options in ({}, {"border": True}):
            whole.put_block(filled(module, "tent", 4, **options))
        sums.append(whole.tensor().numpy())
    np.testing.assert_allclose(*sums, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("channels", [4, 5])
def test_colours_are_put_as_mitsubas(mi: Any, channels: int) -> None:
    sums = []
    for module in (djpt, mi):
        block = module.ImageBlock([4, 4], [0, 0], channels)
        block.put(module.Point2f(1.5, 2.5), [], module.Color3f(1, 2, 3), alpha=0.5, weight=2)
        sums.append(block.tensor().numpy())
    np.testing.assert_array_equal(*sums)


def test_a_tensor_becomes_a_block(mi: Any) -> None:
    values = np.random.default_rng(0).random((7, 8, 2)).astype(np.float32)
    blocks = [
        module.ImageBlock(module.TensorXf(values), [1, 2], module.load_dict({"type": "gaussian"}), border=True)
        for module in (djpt, mi)
    ]
    for block in blocks:
        assert (list(block.size()), list(block.offset()), block.border_size()) == ([4, 3], [1, 2], 2)
        np.testing.assert_array_equal(block.tensor().numpy(), values)
    blocks[0].clear()
    assert blocks[0].tensor().numpy().max() == 0


FORMATS = ("luminance", "luminance_alpha", "rgb", "rgba", "xyz", "xyza")


@pytest.mark.sparse(3)
@pytest.mark.parametrize("pixel_format", FORMATS)
def test_films_develop_as_mitsubas(mi: Any, pixel_format: str) -> None:
    developed = []
    for module in (djpt, mi):
        film = module.load_dict({"type": "hdrfilm", "width": 5, "height": 4, "pixel_format": pixel_format})
        film.prepare(["x", "y"])
        block = film.create_block()
        rng = np.random.default_rng(1)
        values = [module.Float(*rows([v])) for v in rng.random((block.channel_count(), COUNT))]
        block.put(module.Point2f(*rows(rng.random((2, COUNT)) * 5)), values)
        film.put_block(block)
        developed.append((film.develop().numpy(), film.develop(raw=True).numpy()))
    for mine, his in zip(*developed, strict=True):
        np.testing.assert_allclose(mine, his, rtol=2e-4, atol=2e-5)


@pytest.mark.sparse(3)
@pytest.mark.parametrize("pixel_format", FORMATS)
def test_rendered_channels_are_mitsubas(mi: Any, pixel_format: str) -> None:
    images = []
    for module in (djpt, mi):
        box = module.cornell_box()
        box["sensor"]["film"] = {"type": "hdrfilm", "width": 8, "height": 8, "pixel_format": pixel_format}
        box["sensor"]["film"]["rfilter"] = {"type": "box"}
        scene = module.load_dict({**box, "integrator": {"type": "direct"}})
        images.append(np.array(module.render(scene, spp=4)))
    np.testing.assert_allclose(*images, rtol=1e-3, atol=1e-4)


def test_derivatives_pass_through_blocks_and_films() -> None:
    film = djpt.load_dict({"type": "hdrfilm", "width": 3, "height": 3, "rfilter": {"type": "tent"}})
    film.prepare()
    value = djpt.Float(2)
    dr.enable_grad(value)
    block = film.create_block()
    block.put(djpt.Point2f(1.5, 1.5), [value, value * 3, value, djpt.Float(1)])
    film.put_block(block)
    dr.backward(dr.sum(film.develop(), axis=None))
    assert value.grad[0] == pytest.approx(5)


def test_mistakes() -> None:
    block = djpt.ImageBlock([2, 2], [0, 0], 3)
    with pytest.raises(RenderError, match="3 values are expected, one per channel, found 2"):
        block.put(djpt.Point2f(1), values=[1, 2])
    with pytest.raises(RenderError, match="a colour has 4 or 5 channels, the block has 3"):
        block.put(djpt.Point2f(1), [], djpt.Color3f(1))
    with pytest.raises(RenderError, match="a block of 3 channels is expected, found 4"):
        block.put_block(djpt.ImageBlock([2, 2], [0, 0], 4))
    with pytest.raises(TypeError, match="'borders' can't be given"):
        djpt.ImageBlock([2, 2], [0, 0], 3, borders=True)

"""Adaptive renders: more samples where there is more noise, the same bits however they are cut, and no bias."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import FileError, RenderError
from djpt.rendering.progressive.accumulation import AdaptiveAccumulation
from djpt.rendering.progressive.tiles import LEAST, Tiles, TileSums, is_survey, shares, surveys
from djpt.scene.scene import Scene
from tests.long_renders.test_passes import SAMPLERS, box, last

RED_GREEN_BLUE = np.array([0.212671, 0.715160, 0.072169])


def corner(rfilter: str = "box", size: int = 48, sampler: str = "independent") -> Scene:
    """A glowing floor without noise, and in one corner a wide lamp just above it."""
    T = djpt.ScalarTransform4f
    grey = {"type": "diffuse", "reflectance": 0.5}
    return djpt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "sensor": {
                "type": "orthographic",
                "to_world": T().look_at(origin=[0, 3, 0], target=[0, 0, 0], up=[0, 0, 1]),
                "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": rfilter}},
                "sampler": {"type": sampler},
            },
            "floor": {
                "type": "rectangle",
                "to_world": T().rotate([1, 0, 0], -90).scale(2),
                "bsdf": grey,
                "emitter": {"type": "area", "radiance": 0.3},
            },
            "lamp": {
                "type": "rectangle",
                "to_world": T().translate([0.8, 0.05, 0.8]).rotate([1, 0, 0], 90).scale(0.3),
                "emitter": {"type": "area", "radiance": 5.0},
            },
        }
    )


def luminance(found: djpt.Accumulation) -> Any:
    """The luminance of the pixels, float64."""
    return found.image().numpy().astype(np.float64) @ RED_GREEN_BLUE


# ---- bits ------------------------------------------------------------------------------------


@pytest.mark.parametrize("sampler", ["independent", pytest.param("multijitter", marks=pytest.mark.slow)])
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.sparse(2)
def test_going_on_gives_the_bits_of_a_longer_render(tmp_path: Path, sampler: str, rfilter: str) -> None:
    scene = box(sampler, rfilter, size=35)
    options: dict[str, Any] = {"adaptive": True, "seed": 3}
    at_once = list(djpt.render_passes(scene, spp=32, round_spp=4, **options))
    for begun in (at_once[2], at_once[4]):
        begun.save(tmp_path / "a.djpt")
        read = djpt.Accumulation.load(tmp_path / "a.djpt")
        *_, resumed = djpt.render_passes(scene, spp=32, resume_from=read, **options)
        assert isinstance(resumed, AdaptiveAccumulation)
        for name in AdaptiveAccumulation.stored:
            np.testing.assert_array_equal(getattr(resumed, name), getattr(at_once[-1], name))
        assert resumed.error().overall == at_once[-1].error().overall


def test_a_last_round_is_smaller() -> None:
    """The samples are those that were asked for, and a render that goes on takes the round anew in full."""
    scene, options = corner(), {"adaptive": True, "round_spp": 8, "seed": 3}
    found = last(scene, spp=53, **options)
    assert found.counts == (8, 8, 8, 8, 8, 8, 5)
    assert found.samples().numpy().mean() == pytest.approx(53, abs=0.2)
    at_once = last(scene, spp=64, **options)
    longer = last(scene, spp=64, resume_from=found, **options)
    np.testing.assert_array_equal(longer.image().numpy(), at_once.image().numpy())
    assert longer.error().overall == at_once.error().overall
    for spp in (1, 5, 6, 8, 15, 17, 100):
        assert last(box(size=9), spp=spp, adaptive=True).spp == spp


def test_without_a_filter_surveys_are_plain_rounds() -> None:
    scene = box(size=35)
    even, adaptive = (last(scene, spp=32, round_spp=8, seed=5, adaptive=adaptive) for adaptive in (False, True))
    np.testing.assert_allclose(adaptive.image().numpy(), even.image().numpy(), rtol=1e-6, atol=1e-7)
    assert adaptive.error().overall == pytest.approx(even.error().overall, rel=1e-6)
    np.testing.assert_array_equal(adaptive.samples().numpy(), even.samples().numpy())


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.sparse(10)
def test_one_round_is_a_plain_render(sampler: str, rfilter: str) -> None:
    scene = box(sampler, rfilter, size=21)
    found = next(djpt.render_passes(scene, round_spp=8, spp=64, seed=5, adaptive=True))
    np.testing.assert_allclose(found.image().numpy(), djpt.render(scene, spp=8, seed=5).numpy(), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    "integrator",
    [
        {"type": "depth"},
        {"type": "aov", "aovs": "d:depth,n:sh_normal", "image": {"type": "path"}},
    ],
    ids=lambda node: node["type"],
)
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.sparse(2)
def test_other_integrators_can_be_adaptive(integrator: dict[str, Any], rfilter: str) -> None:
    scene, chosen = box(rfilter=rfilter, size=21), djpt.load_dict(integrator)
    found = next(djpt.render_passes(scene, integrator=chosen, spp=64, round_spp=4, adaptive=True))
    image = djpt.render(scene, integrator=chosen, spp=4)
    assert found.channels == djpt.channel_names(scene, integrator=chosen)
    np.testing.assert_allclose(found.image().numpy(), image.numpy(), rtol=1e-3, atol=1e-4)


def test_a_film_with_a_border_is_sampled_there() -> None:
    description = djpt.cornell_box()
    film = {"width": 21, "height": 19, "rfilter": {"type": "gaussian"}, "sample_border": True}
    description["sensor"]["film"].update(film)
    scene = djpt.load_dict(description)
    found = next(djpt.render_passes(scene, spp=64, round_spp=4, adaptive=True))
    np.testing.assert_allclose(found.image().numpy(), djpt.render(scene, spp=4).numpy(), rtol=1e-4, atol=1e-5)


def test_render_gives_the_last_image() -> None:
    scene = corner(size=32)
    image = djpt.render(scene, spp=64, seed=2, adaptive=True)
    np.testing.assert_array_equal(image.numpy(), last(scene, spp=64, seed=2, adaptive=True).image().numpy())
    np.testing.assert_array_equal(scene.sensors()[0].film().develop().numpy(), image.numpy())


# ---- what is gained --------------------------------------------------------------------------


def test_samples_are_where_the_noise_is() -> None:
    found = last(corner(), spp=128, round_spp=8, adaptive=True)
    samples = found.samples().numpy()
    assert samples.mean() == pytest.approx(found.spp, rel=1e-3)
    noise = found.error().pixels.numpy() * np.sqrt(samples)
    assert samples.flat[noise.argmax()] > 2 * samples.mean() > 6 * samples.min()


@pytest.mark.parametrize("rfilter", ["box", pytest.param("gaussian", marks=pytest.mark.slow)])
def test_the_error_is_less_and_known(rfilter: str) -> None:
    """Over some seeds the error is 1.5 times less than with equal numbers of samples, and is what is estimated."""
    scene, seeds = corner(rfilter), range(1, 7)
    truth = luminance(last(scene, spp=8192, round_spp=1024, seed=100))
    errors = {}
    for adaptive in (False, True):
        found = [last(scene, spp=256, round_spp=16, seed=seed, adaptive=adaptive) for seed in seeds]
        squares = [np.mean((luminance(one) - truth) ** 2) for one in found]
        errors[adaptive] = np.sqrt(np.mean(squares)) / truth.mean()
        estimated = np.sqrt(np.mean([one.error().overall ** 2 for one in found]))
        assert estimated == pytest.approx(errors[adaptive], rel=0.2)
    assert errors[True] < errors[False] / 1.5


@pytest.mark.slow
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_there_is_no_bias(rfilter: str) -> None:
    """Means over 8 x 8 pixels of 200 renders, whose surveys have one sample per pixel, are those of the image."""
    scene, count = corner(rfilter), 200
    reference = last(scene, spp=65536, round_spp=4096, seed=2**31)

    def blocks(image: Any) -> Any:
        return image.reshape(6, 8, 6, 8).mean((1, 3))

    found = np.stack([blocks(luminance(last(scene, spp=16, round_spp=1, seed=k, adaptive=True))) for k in range(count)])
    of_reference = blocks(reference.error().pixels.numpy().astype(np.float64) ** 2) / 64
    error = np.sqrt(found.var(0, ddof=1) / count + of_reference)
    difference = np.abs(found.mean(0) - blocks(luminance(reference)))
    assert (difference < 4 * error + 1e-6).all()
    assert error.max() < 0.01 * luminance(reference).mean()


# ---- tiles -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("width", "height", "border", "reach"), [(5, 3, 0, 0), (35, 17, 0, 2), (20, 33, 2, 2)])
def test_films_of_tiles_add_up_to_an_image(width: int, height: int, border: int, reach: int) -> None:
    tiles = Tiles((width + 2 * border, height + 2 * border), border, reach)
    image = np.random.default_rng(1).random((height, width))
    windows = tiles.parted(image)
    assert windows.shape == (tiles.count, *tiles.film)
    covered = tiles.joined(np.ones_like(windows))
    np.testing.assert_allclose(tiles.joined(windows) / covered, image)
    of_tiles = np.random.default_rng(2).random(tiles.count)
    np.testing.assert_allclose(tiles.means(tiles.spread(of_tiles)), of_tiles)


def test_the_films_of_a_tile_come_together(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("djpt.rendering.progressive.tiles.TOGETHER", 3)
    random = np.random.default_rng(3)
    places = np.repeat(np.arange(9), [1, 0, 5, 2, 11, 1, 1, 0, 3])
    channels = random.random((2, len(places), 4, 4)).astype(np.float32)
    parts = [[channel[start : start + 7] for channel in channels] for start in range(0, len(places), 7)]
    found = list(TileSums(places, parts, np.zeros((8, 8, 0), np.float32)).by_tiles())
    np.testing.assert_array_equal(np.concatenate([some for some, _ in found]), places)
    np.testing.assert_array_equal(np.concatenate([films for _, films in found], axis=1), channels)
    assert len(found) > 3
    assert all(before[-1] < after[0] for (before, _), (after, _) in itertools.pairwise(found))


def test_rounds_take_what_is_missing() -> None:
    tiles = Tiles((40, 40), 0, 0)
    variances = np.zeros(25)
    variances[6] = 1.0
    taken = np.full(25, 2)
    for _ in range(50):
        counts = shares(tiles, taken, variances, tiles.count)
        assert counts.sum() == 25
        assert (counts >= 0).all()
        taken = taken + counts
    around = taken[[0, 1, 2, 5, 7, 10, 11, 12]]
    far = taken[[3, 4, 13, 14, 20, 24]]
    assert taken[6] > 3 * around.max()
    assert around.min() > 2 * far.max()
    assert far.min() == pytest.approx(LEAST * taken.mean(), rel=0.5)
    np.testing.assert_array_equal(shares(tiles, taken, np.zeros(25), 25), np.ones(25))
    for places in (1, 7, 24):
        assert shares(tiles, taken, np.zeros(25), places).sum() == places
        assert shares(tiles, taken, variances, places).sum() == places
    assert [surveys(4, half) for half in (0, 1)] == [2, 2]
    assert [number for number in range(40) if is_survey(number)] == [0, 1, 2, 3, 16, 17, 32, 33]


# ---- what can't be ----------------------------------------------------------------------------


def test_adaptive_renders_are_added_up() -> None:
    scene = box(size=35)
    parts = [last(scene, spp=32, round_spp=4, seed=seed, adaptive=True) for seed in (0, 1)]
    both = parts[0] + parts[1]
    assert both.spp == 64
    assert both.error().overall < min(part.error().overall for part in parts)
    np.testing.assert_array_equal(both.samples().numpy(), sum(part.samples().numpy() for part in parts))
    with pytest.raises(RenderError, match="one is adaptive"):
        both + last(scene, spp=8, round_spp=4, seed=7)


def test_renders_go_on_as_they_began() -> None:
    scene = box(size=20)
    for adaptive in (False, True):
        found = last(scene, spp=8, round_spp=4, adaptive=adaptive)
        with pytest.raises(RenderError, match="begun with adaptive=True"):
            djpt.render_passes(scene, spp=16, resume_from=found, adaptive=not adaptive)


def test_damaged_tiles_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.djpt"
    last(box(size=20), spp=8, round_spp=4, adaptive=True).save(path)
    data = path.read_bytes()
    for place in range(60, len(data), len(data) // 20):
        path.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        with pytest.raises(FileError, match=r"a\.djpt"):
            djpt.Accumulation.load(path)


def test_what_has_no_tiles_is_refused() -> None:
    for integrator in ({"type": "ptracer"}, {"type": "bdpt"}):
        with pytest.raises(RenderError, match="adaptive"):
            djpt.render_passes(box(), integrator=djpt.load_dict(integrator), spp=8, adaptive=True)
    scene = box()
    parameters = djpt.traverse(scene)
    dr.enable_grad(parameters["red.reflectance.value"])
    parameters.update()
    with pytest.raises(RenderError, match="adaptive images have no derivatives"):
        djpt.render(scene, spp=8, adaptive=True)

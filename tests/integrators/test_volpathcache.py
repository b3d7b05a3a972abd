"""`volpathcache`: the cells of its cache and the light in them, furnaces, the means of `volpathmis`, and less noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.errors import SceneError
from djpt.integrators.guiding.light_cache import VISITS, LightCells
from djpt.integrators.volpathcache import CachedVolumetricPath
from djpt.jit.types import Bool, Point3f, UInt32, Vector3f
from djpt.rendering.image import make_job
from djpt.rendering.schedules.learning import JobTrainingPaths
from djpt.rendering.settings import RenderSettings
from tests.kit.convergence import assert_equal_means, images
from tests.kit.threads import assert_same_for_any_threads

GLASS = {"type": "dielectric", "int_ior": 1.35, "ext_ior": 1.0}
MILK = {"type": "homogeneous", "sigma_t": 8.0, "albedo": {"type": "rgb", "value": [0.999, 0.995, 0.98]}}
CACHED = {"type": "volpathcache", "max_depth": 256, "rr_depth": 256}
PLAIN = {**CACHED, "type": "volpathmis"}


def lit(body: dict[str, Any] | None, radiance: float = 1.0, **others: Any) -> dict[str, Any]:
    """A body at the origin under a sky."""
    scene = {
        "type": "scene",
        "sky": {"type": "constant", "radiance": radiance},
        "sensor": {
            "type": "perspective",
            "fov": 20,
            "to_world": djpt.ScalarTransform4f().look_at(origin=[0, 0, 6], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
        },
        **others,
    }
    return scene if body is None else {**scene, "body": body}


def ball(medium: dict[str, Any], bsdf: dict[str, Any]) -> dict[str, Any]:
    """A unit ball of a medium."""
    return {"type": "sphere", "bsdf": bsdf, "interior": medium}


def glass_of_milk() -> dict[str, Any]:
    """Milk in a ball of glass, a lamp beside it."""
    place = djpt.ScalarTransform4f().look_at(origin=[4, 3, 2], target=[0, 0, 0], up=[0, 1, 0])
    emitter = {"type": "area", "radiance": 4.0}
    lamp = {"type": "rectangle", "to_world": place.scale(1.5), "emitter": emitter}
    return lit(ball(MILK, GLASS), 0.3, lamp=lamp)


def trained(scene: dict[str, Any], **keys: Any) -> CachedVolumetricPath:
    """The integrator with its cache, for an image of 64 spp."""
    plugin, loaded = djpt.load_dict({**CACHED, **keys}), djpt.load_dict(scene)
    job = make_job(loaded, RenderSettings.of(loaded, integrator=plugin, seed=1, spp=64))
    found = plugin.trained(JobTrainingPaths(job))
    assert isinstance(found, CachedVolumetricPath)
    return found


# ---------------------------------------------------------------- cells


def test_cells() -> None:
    """Each cell of a body has its own number; beside the body, in other media and in the vacuum there is none."""
    scene = djpt.load_dict(lit(ball(MILK, GLASS))).replace(all_media=True)
    cells, number = LightCells(scene), scene.media.number(scene.shapes()[0].interior_medium())
    side = 16  # the ball is as many free paths wide
    centres = (np.indices([side] * 3).reshape(3, -1) + 0.5) / side * 2 - 1
    found, there = cells.at(UInt32(number), Point3f(centres.astype(np.float32)), Vector3f(0), Bool(True))
    assert np.array(there).all() and len(set(np.array(found))) == side**3
    assert np.array(found).max() < cells.count
    _, outside = cells.at(UInt32(number), Point3f([0, 1.2, np.inf], [-1.3, 0, 0], 0), Vector3f(0), Bool(True))
    assert not np.array(outside).any()
    _, vacuum = cells.at(UInt32(scene.media.vacuum), Point3f(0), Vector3f(0), Bool(True))
    assert not np.array(vacuum).any()


def test_cells_are_no_wider_than_light_gets() -> None:
    """Of a body that is too wide for its cells, no point has one; of one just small enough, the centre has."""
    for sigma_t, has in ((15.9, True), (16.1, False)):
        scene = djpt.load_dict(lit(ball({**MILK, "sigma_t": sigma_t}, GLASS))).replace(all_media=True)
        number = scene.media.number(scene.shapes()[0].interior_medium())
        _, there = LightCells(scene).at(UInt32(number), Point3f(0), Vector3f(0), Bool(True))
        assert bool(np.array(there)[0]) == has


@pytest.mark.parametrize("radiance", [1.0, 1e-3, 1e4])
def test_cached_light_of_a_furnace(radiance: float) -> None:
    """Within white matter under a sky, all light is the sky's; behind glass of index n there is n^2 as much."""
    white = {"type": "homogeneous", "sigma_t": 4.0, "albedo": 1.0}
    for bsdf, square in (({"type": "null"}, 1.0), (GLASS, 1.35**2)):
        table = np.array(trained(lit(ball(white, bsdf), radiance), practice=1.0).cache.table).reshape(-1, 4)
        known = table[:, 3] > 0
        assert 500 < known.sum() < len(known)
        np.testing.assert_allclose(table[known, :3].mean(0), radiance * square, rtol=2e-2)
        np.testing.assert_array_equal(table[:, 3], known)
    assert VISITS > 1


# ---------------------------------------------------------------- images


@pytest.mark.parametrize("after", [1, 2])
def test_furnace(after: int) -> None:
    """White matter can't be seen under a white sky."""
    scene = lit(ball({"type": "homogeneous", "sigma_t": 4.0, "albedo": 1.0}, GLASS))
    image = np.stack(images(scene, {**CACHED, "after": after}, 64))
    assert image.mean() == pytest.approx(1, abs=0.01)


def test_fog_without_end_has_no_cache() -> None:
    """A medium that is inside of nothing is rendered as by `volpathmis`, with the same random numbers."""
    scene = lit(None, fog={"type": "homogeneous", "id": "fog", "sigma_t": 0.5, "albedo": 0.8})
    scene["sensor"]["medium"] = {"type": "ref", "id": "fog"}
    scene["lamp"] = {"type": "sphere", "emitter": {"type": "area", "radiance": 2.0}}
    ours, theirs = (images(scene, {**plugin, "max_depth": 6}, 16)[0] for plugin in (CACHED, PLAIN))
    np.testing.assert_array_equal(ours, theirs)


@pytest.mark.slow
def test_mean_and_noise_in_milk() -> None:
    """An error of less than a percent of the light, in no part more than three, and less than half of the variance."""
    scene = glass_of_milk()
    ours, theirs = (np.stack(images(scene, plugin, 256)) for plugin in ({**CACHED, "practice": 0.5}, PLAIN))
    middle = (slice(None), slice(5, 11), slice(5, 11))
    assert ours[middle].mean() == pytest.approx(theirs[middle].mean(), rel=0.01)
    parts = [a[middle].mean((0, 3)).reshape(2, 3, 2, 3).mean((1, 3)) for a in (ours, theirs)]
    np.testing.assert_allclose(*parts, rtol=0.03)
    assert ours[middle].var(0).mean() < theirs[middle].var(0).mean() / 2


@pytest.mark.slow
def test_late_ends_converge() -> None:
    """Where paths end after many scatterings, the mean is that of `volpathmis`."""
    scene = glass_of_milk()
    assert_equal_means(images(scene, {**CACHED, "after": 16}, 128), images(scene, PLAIN, 128, 100))


def test_smoke() -> None:
    """Media that vary and are tracked have a cache, too."""
    grid = np.full((4, 4, 4), 6.0, np.float32)
    place = djpt.ScalarTransform4f().translate([-0.5] * 3)
    smoke = {"type": "heterogeneous", "sigma_t": {"type": "gridvolume", "data": grid, "to_world": place}, "albedo": 0.9}
    cube = {"type": "cube", "to_world": djpt.ScalarTransform4f().scale(0.51), "bsdf": {"type": "null"}}
    scene = lit({**cube, "interior": smoke})
    ours, theirs = (np.stack(images(scene, plugin, 64)) for plugin in (CACHED, PLAIN))
    assert ours.mean() == pytest.approx(theirs.mean(), rel=0.01)


def test_images_repeat_with_any_number_of_threads() -> None:
    scene, plugin = djpt.load_dict(glass_of_milk()), djpt.load_dict(CACHED)
    assert_same_for_any_threads(lambda: np.array(djpt.render(scene, integrator=plugin, spp=4, seed=2)))


def test_bounces_are_refused() -> None:
    with pytest.raises(SceneError, match="bounces"):
        djpt.load_dict({**CACHED, "max_depth": 4, "bounces": True})

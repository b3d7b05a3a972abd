"""Ray queries against meshes: odd rays, and the same answers for one ray, a thousand and a million."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.records import Ray3f
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import SceneError
from djpt.jit.types import Bool, Float, Point3f, Vector3f
from tests.kit.axes import unit
from tests.kit.mesh_scenes import ball, ball_file, gallery

pytestmark = pytest.mark.cuda

NAN, INF = np.nan, np.inf


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("meshes")


def mixed(folder: Path) -> Any:
    return djpt.load_dict(gallery(folder))


def meshes(folder: Path) -> Any:
    """No analytic shapes."""
    scene = gallery(folder)
    for name in ("floor", "ball", "block", "panel"):
        del scene[name]
    return djpt.load_dict(scene)


def instances(folder: Path) -> Any:
    scene = gallery(folder)
    scene["g"] = {"type": "shapegroup", "m": {"type": "ply", "filename": ball_file(folder)}}
    for i in range(3):
        place = T().translate([i - 1, 0.3 * i, 0.5]).rotate(unit(i, 1, 0), 40 * i).scale([0.4, 0.3, -0.2])
        scene[f"i{i}"] = {"type": "instance", "to_world": place, "r": {"type": "ref", "id": "g"}}
    return djpt.load_dict(scene)


SCENES = {"mixed": mixed, "meshes": meshes, "instances": instances}


def rays(o: Any, d: Any, maxt: Any = INF) -> Ray3f:
    """Rays from (N, 3) origins and directions."""
    o, d = (np.asarray(v, np.float32).reshape(-1, 3).T for v in (o, d))
    return Ray3f(Point3f(o), Vector3f(d), maxt=Float(np.broadcast_to(np.float32(maxt), o.shape[1:]).copy()))


def random_rays(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Origins around the gallery, directions to it of any length, and ends, some of them near."""
    rng = np.random.default_rng(seed)
    o = rng.uniform(-3, 3, (count, 3)) * 10 ** rng.uniform(-1, 1, (count, 1))
    d = (rng.uniform(-1.5, 1.5, (count, 3)) - o) * 10 ** rng.uniform(-2, 2, (count, 1))
    maxt = np.where(rng.random(count) < 0.3, 2 * rng.random(count) / np.linalg.norm(d, axis=1), INF)
    return o.astype(np.float32), d.astype(np.float32), maxt.astype(np.float32)


# ---------------------------------------------------------------- odd rays

NOT_NUMBERS = [
    ([NAN, 0, 0], [0, 0, 1]), ([0, 0, 5], [NAN, 0, -1]), ([INF, 0, 0], [-1, 0, 0]), ([0, 0, -INF], [0, 0, 1]),
    ([0, 0, 5], [0, 0, -INF]), ([0, 0, 5], [INF, -INF, 1]), ([0, 0, 5], [0, 0, 0]), ([NAN] * 3, [NAN] * 3),
]  # fmt: skip


@pytest.mark.parametrize("kind", SCENES)
def test_rays_that_are_none_hit_nothing(folder: Path, kind: str) -> None:
    """Nor do they disturb their neighbours."""
    scene = SCENES[kind](folder)
    o, d, maxt = random_rays(1000)
    expected = np.array(scene.ray_intersect(rays(o, d, maxt)).t)
    places = 7 + 100 * np.arange(len(NOT_NUMBERS))
    for place, (origin, direction) in zip(places, NOT_NUMBERS, strict=True):
        o[place], d[place], expected[place] = origin, direction, INF
    si = scene.ray_intersect(rays(o, d, maxt))
    np.testing.assert_array_equal(np.array(si.t), expected)
    assert not np.array(si.is_valid())[places].any()
    assert not np.array(scene.ray_test(rays(o, d, maxt)))[places].any()
    np.testing.assert_array_equal(np.array(si.shape_index)[places], 0)


@pytest.mark.parametrize("kind", SCENES)
def test_ends_that_are_odd(folder: Path, kind: str) -> None:
    """`maxt` of 0, below 0 or NaN: nothing lies before it."""
    scene = SCENES[kind](folder)
    for maxt in (0.0, -1.0, -INF, NAN):
        ray = rays([[-0.9, -0.3, 5]] * 3, [[0, 0, -1]] * 3, maxt)
        assert not np.array(scene.ray_test(ray)).any()
        assert not np.array(scene.ray_intersect(ray).is_valid()).any()


@pytest.mark.parametrize("kind", SCENES)
def test_rays_along_axes(folder: Path, kind: str) -> None:
    """Zeros of both signs among the directions; compared with rays turned by next to nothing."""
    scene = SCENES[kind](folder)
    rng = np.random.default_rng(1)
    axes = np.repeat(np.eye(3), 400, axis=0) * rng.choice([-1, 1], (1200, 1))
    axes[rng.random(axes.shape) < 0.3] *= -1
    o = rng.uniform(-1, 1, (1200, 3)) - 6 * axes
    straight = np.array(scene.ray_intersect(rays(o, axes)).t)
    tilted = np.array(scene.ray_intersect(rays(o, axes + 1e-6 * rng.normal(size=axes.shape))).t)
    assert np.isfinite(straight).mean() > 0.2
    different = np.abs(np.where(np.isfinite(straight), straight, -1) - np.where(np.isfinite(tilted), tilted, -1))
    assert np.mean(different > 1e-3) < 0.01


@pytest.mark.parametrize("kind", SCENES)
def test_rays_that_start_on_surfaces(folder: Path, kind: str) -> None:
    """A spawned ray doesn't meet the surface that it leaves; back to the origin nothing is in the way."""
    scene = SCENES[kind](folder)
    o, d, _ = random_rays(4000, 2)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    si = scene.ray_intersect(rays(o, d))
    hit = np.array(si.is_valid())
    assert hit.mean() > 0.2
    away = si.spawn_ray(dr.select(dr.dot(si.n, Vector3f(d.T)) > 0, -si.n, si.n))
    t = np.array(scene.ray_intersect(away, si.is_valid()).t)
    assert t[hit].min() > 1e-3
    back = ~scene.ray_test(si.spawn_ray_to(Point3f(o.T)), si.is_valid())
    assert np.array(back)[hit].mean() > 0.999


def test_hits_from_afar_lie_on_the_ray(folder: Path) -> None:
    """From 10^4 sizes away the error of points is that of single precision here, not there."""
    scene = meshes(folder)
    rng = np.random.default_rng(4)
    target, d = rng.uniform(-1, 1, (4000, 3)), rng.normal(size=(4000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o, d = (target - 1e4 * d).astype(np.float32), d.astype(np.float32)
    si = scene.ray_intersect(rays(o, d))
    hit = np.array(si.is_valid())
    assert hit.mean() > 0.1
    from_origin = (np.array(si.p).T - o.astype(np.float64))[hit]
    across = (
        np.cross(from_origin, d[hit].astype(np.float64)) / np.linalg.norm(d[hit].astype(np.float64), axis=1)[:, None]
    )
    assert np.linalg.norm(across, axis=1).max() < 3e-6


# ---------------------------------------------------------------- many rays


@pytest.mark.parametrize("count", [270_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.sparse(6)
def test_many_rays_at_once(folder: Path, kind: str, count: int) -> None:
    """From 2^18 rays on lanes take ray after ray; a thousand have a lane each, and so has one."""
    from djpt.geometry.bvh.steps.trees import BATCH

    assert count >= 2 * BATCH
    scene = SCENES[kind](folder)
    o, d, maxt = random_rays(count, 5)
    o[123], d[count - 5] = NAN, 0
    si = scene.ray_intersect(rays(o, d, maxt))
    fields = {name: np.array(getattr(si, name)) for name in ("t", "p", "n", "uv", "shape_index", "prim_index")}
    test = np.array(scene.ray_test(rays(o, d, maxt)))
    hit = np.isfinite(fields["t"])
    assert 0.1 < hit.mean() < 0.9
    assert np.mean(test != hit) < 1e-5
    some = np.sort(np.random.default_rng(0).choice(count, 1000, replace=False))
    some[[0, -1]] = 123, count - 5
    few = scene.ray_intersect(rays(o[some], d[some], maxt[some]))
    np.testing.assert_array_equal(np.array(few.t), fields["t"][some])
    valid = hit[some]
    for name, whole in fields.items():
        np.testing.assert_allclose(
            np.array(getattr(few, name))[..., valid], whole[..., some][..., valid], rtol=1e-5, atol=1e-5
        )
    np.testing.assert_array_equal(np.array(scene.ray_test(rays(o[some], d[some], maxt[some]))), test[some])
    for i in some[:40:4]:
        one = scene.ray_intersect(rays(o[i], d[i], maxt[i]))
        assert dr.width(one.t) == 1
        np.testing.assert_array_equal(np.array(one.t), fields["t"][i : i + 1])
        assert bool(np.array(scene.ray_test(rays(o[i], d[i], maxt[i])))[0]) == test[i]


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.sparse(2)
def test_masks_for_many_and_for_few(folder: Path, kind: str) -> None:
    scene = SCENES[kind](folder)
    for count in (1000, 300_000):
        o, d, maxt = random_rays(count, 6)
        active = np.random.default_rng(1).random(count) < 0.5
        everything = np.array(scene.ray_test(rays(o, d, maxt)))
        masked = np.array(scene.ray_test(rays(o, d, maxt), Bool(active)))
        np.testing.assert_array_equal(masked, everything & active)
        t = np.array(scene.ray_intersect(rays(o, d, maxt), Bool(active)).t)
        assert np.isinf(t[~active]).all()
        assert np.isfinite(t[everything & active]).mean() > 0.9999


# ---------------------------------------------------------------- scenes with nothing in them


def test_meshes_that_lose_all_triangles_are_explained(folder: Path) -> None:
    data = ball(6)
    flat = {**data, "positions": np.ones_like(data["positions"])}
    from tests.kit.meshes import write_binary_ply

    path = write_binary_ply(folder / "flat.ply", flat)
    with warnings.catch_warnings(), pytest.raises(SceneError, match=r"flat\.ply"):
        warnings.simplefilter("ignore")
        djpt.load_dict({"type": "scene", "m": {"type": "ply", "filename": str(path)}})


def test_scenes_without_surfaces() -> None:
    scene = djpt.load_dict({"type": "scene", "sky": {"type": "constant"}})
    assert not np.array(scene.ray_test(rays([[0, 0, 0]] * 2, [[0, 0, 1]] * 2))).any()
    assert np.isinf(np.array(scene.ray_intersect(rays([[0, 0, 0]] * 2, [[0, 0, 1]] * 2)).t)).all()


def test_a_miss_has_zeros(folder: Path) -> None:
    # Lanes of a packet that searches leave as they are must not show what was in memory.
    o = Point3f(np.linspace(50, 60, 40), 50, 50)
    d = Vector3f(0, dr.select(dr.arange(Float, 40) < 33, 1.0, -1.0), 0)
    pi = meshes(folder).ray_intersect_preliminary(Ray3f(o, d))
    assert not dr.any(pi.is_valid())
    for field in (pi.prim_uv.x, pi.prim_uv.y, pi.prim_index, pi.shape_index):
        assert dr.all(field == 0)

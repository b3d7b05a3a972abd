"""Grids of distances against Mitsuba and against closed forms."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import FileError, ParameterError, SceneError
from djpt.jit.types import Float, Point3f, Vector3f
from djpt.validation import agreement
from tests.kit.renders import box, ours, theirs

CENTER, RADIUS = np.array([0.5, 0.45, 0.55]), 0.3


def ball(nx: int, ny: int, nz: int) -> np.ndarray:
    """Distances to a sphere, (Z, Y, X, 1)."""
    z, y, x = np.meshgrid(*(np.linspace(0, 1, n) for n in (nz, ny, nx)), indexing="ij")
    distance = np.sqrt((x - CENTER[0]) ** 2 + (y - CENTER[1]) ** 2 + (z - CENTER[2]) ** 2) - RADIUS
    return distance.astype(np.float32)[..., None]


def bumps(n: int, seed: int = 0) -> np.ndarray:
    """Smooth random values."""
    coarse = np.random.default_rng(seed).normal(size=(n, n, n))
    for axis in range(3):
        coarse = coarse + np.roll(coarse, 1, axis) + np.roll(coarse, -1, axis)
    return coarse.astype(np.float32)[..., None]


def load(grid: np.ndarray, **parameters: Any) -> Any:
    shape = {"type": "sdfgrid", "grid": djpt.TensorXf(grid), **parameters}
    return djpt.load_dict({"type": "scene", "shape": shape, "light": {"type": "point"}})


def rays(count: int = 20000, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(3, count))
    d /= np.linalg.norm(d, axis=0)
    return (rng.uniform(0, 1, (3, count)) - 3 * d).astype(np.float32), d.astype(np.float32)


def shot(scene: Any, o: np.ndarray, d: np.ndarray) -> Any:
    return scene.ray_intersect(djpt.Ray3f(Point3f(o), Vector3f(d), maxt=Float(np.inf)))


@pytest.mark.parametrize("normals", ["smooth", "analytic"])
@pytest.mark.parametrize("grid", [bumps(6), ball(12, 12, 12)], ids=["bumps", "ball"])
@pytest.mark.sparse(4)
def test_surface_is_mitsubas(grid: np.ndarray, normals: str) -> None:
    mi = pytest.importorskip("mitsuba")
    o, d = rays()
    to_world = T().translate([0.2, 0, 0.1]).scale([1, 0.8, 1.2])
    mine = shot(load(grid, normals=normals, to_world=to_world), o, d)
    mi.set_variant("llvm_ad_rgb")
    matrix = mi.ScalarTransform4f(to_world.matrix)
    shape = {"type": "sdfgrid", "grid": mi.TensorXf(grid), "normals": normals, "to_world": matrix}
    scene = mi.load_dict({"type": "scene", "shape": shape})
    other = scene.ray_intersect(mi.Ray3f(mi.Point3f(o), mi.Vector3f(d)))
    valid, expected = np.array(mine.is_valid()), np.array(other.is_valid())
    assert np.mean(valid != expected) < 2e-3
    both = valid & expected
    assert both.mean() > 0.2
    t, reference = np.array(mine.t)[both], np.array(other.t)[both]
    assert np.quantile(np.abs(t - reference), 0.995) < 2e-4
    # Where cells meet the analytic normal jumps.
    for a, b in ((mine.sh_frame.n, other.sh_frame.n), (mine.sh_frame.s, other.sh_frame.s)):
        error = np.abs(np.array(a) - np.array(b))[:, both].max(axis=0)
        assert np.quantile(error, 0.99) < 2e-3
    assert not np.array(mine.uv).any()


@pytest.mark.parametrize("shape", [(20, 20, 20), (12, 24, 17)])
def test_a_ball(shape: tuple[int, int, int]) -> None:
    """Hits lie where the interpolant is 0, at most a chord's height inside of the sphere."""
    o, d = rays()
    si = shot(load(ball(*shape)), o, d)
    valid = np.array(si.is_valid())
    p = np.array(si.p, np.float64).T[valid]
    away = np.linalg.norm(p - CENTER, axis=1) - RADIUS
    height = (1 / (min(shape) - 1)) ** 2 / RADIUS
    assert -height < away.min()
    assert away.max() < 1e-5
    outward = (p - CENTER) / np.linalg.norm(p - CENTER, axis=1, keepdims=True)
    assert ((np.array(si.sh_frame.n).T[valid] * outward).sum(axis=1)).min() > 0.98
    # Seen from outside: as many hits as the sphere has.
    sphere = {"type": "sphere", "center": CENTER.tolist(), "radius": RADIUS}
    whole = np.array(shot(djpt.load_dict({"type": "scene", "shape": sphere}), o, d).is_valid())
    assert np.mean(valid != whole) < 0.03
    assert not np.any(valid & ~whole)


def test_equal_seeds_give_equal_pixels(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    (tmp_path / "ball.vol").write_bytes(volume(ball(16, 16, 16)))

    def edit(scene: dict[str, Any]) -> None:
        del scene["small-box"], scene["large-box"]
        white = {"type": "ref", "id": "white"}
        place = T().translate([-0.6, -0.9, -0.5]).scale(1.1)
        scene["blob"] = {"type": "sdfgrid", "filename": str(tmp_path / "ball.vol"), "to_world": place, "bsdf": white}

    description = box(48, "box", {"type": "path", "max_depth": 4}, edit)
    image, reference = ours(description, 4, 3), theirs(description, 4, 3)
    assert agreement(image, reference, 2e-3).share >= 0.97
    assert image.mean() == pytest.approx(reference.mean(), rel=3e-3)


def test_edits() -> None:
    scene = load(ball(10, 10, 10))
    params = djpt.traverse(scene)
    assert [key for key in params if "shape" in key and "bsdf" not in key] == [
        "shape.silhouette_sampling_weight",
        "shape.to_world",
        "shape.grid",
    ]
    o, d = rays(2000)
    params["shape.grid"] = djpt.TensorXf(bumps(7))
    params.update()
    a, b = shot(scene, o, d), shot(load(bumps(7)), o, d)
    np.testing.assert_array_equal(np.array(a.t), np.array(b.t))
    params["shape.grid"] = djpt.TensorXf(1 + np.zeros((3, 3, 3, 1), np.float32))
    with pytest.raises(ParameterError, match="no surface"):
        params.update()
    np.testing.assert_array_equal(np.array(shot(scene, o, d).t), np.array(b.t))


def test_two_grids_do_not_mix() -> None:
    first, second = ({"type": "sdfgrid", "grid": djpt.TensorXf(g)} for g in (ball(12, 12, 12), ball(12, 12, 12)[::-1]))
    second["to_world"] = T().translate([2, 0, 0])
    scene = djpt.load_dict({"type": "scene", "first": first, "second": second})
    o = np.array([[CENTER[0], CENTER[0] + 2], [CENTER[1]] * 2, [-3, -3]], np.float32)
    si = shot(scene, o, np.array([[0, 0], [0, 0], [1, 1]], np.float32))
    height = [CENTER[2] - RADIUS, 1 - CENTER[2] - RADIUS]
    np.testing.assert_allclose(np.array(si.p)[2], height, atol=5e-3)
    np.testing.assert_allclose(np.array(si.sh_frame.n), [[0, 0], [0, 0], [-1, -1]], atol=0.03)


# ---------------------------------------------------------------- files and errors


def volume(grid: np.ndarray, kind: int = 1, version: int = 3) -> bytes:
    nz, ny, nx, channels = grid.shape
    header = b"VOL" + bytes([version]) + struct.pack("<5i6f", kind, nx, ny, nz, channels, 0, 0, 0, 1, 1, 1)
    return header + grid.astype("<f4").tobytes()


def from_file(path: Path) -> Any:
    return djpt.load_dict({"type": "scene", "shape": {"type": "sdfgrid", "filename": str(path)}})


def test_volume_files(tmp_path: Path) -> None:
    grid = ball(9, 7, 8)
    (tmp_path / "ball.vol").write_bytes(volume(grid))
    o, d = rays(1000)
    a, b = (np.array(shot(scene, o, d).t) for scene in (from_file(tmp_path / "ball.vol"), load(grid)))
    np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"nothing", "isn't a volume file"),
        (volume(ball(4, 4, 4), version=2), "version 3"),
        (volume(ball(4, 4, 4), kind=2), "numbers of type 2"),
        (volume(np.zeros((3, 3, 3, 3), np.float32)), "found 3"),
        (volume(ball(4, 4, 4))[:-4], "ends too early for 4 x 4 x 4"),
    ],
)
def test_broken_files(data: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / "bad.vol").write_bytes(data)
    with pytest.raises(FileError, match=message):
        from_file(tmp_path / "bad.vol")


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"grid": djpt.TensorXf(np.ones((3, 3, 3, 1), np.float32))}, "no surface"),
        ({"grid": djpt.TensorXf(np.ones((3, 3, 3, 2), np.float32))}, r"shape \(Z, Y, X, 1\)"),
        ({"grid": djpt.TensorXf(np.ones((1, 3, 3, 1), np.float32))}, "at least 2"),
        ({"grid": djpt.TensorXf(np.full((2, 2, 2, 1), np.nan, np.float32))}, "finite"),
        ({"grid": "text"}, "must be numbers"),
        ({}, "'filename' must be given"),
        ({"grid": djpt.TensorXf(ball(3, 3, 3)), "normals": "flat"}, "'normals' can't be 'flat'"),
    ],
)
def test_errors(parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict({"type": "scene", "shape": {"type": "sdfgrid", **parameters}})

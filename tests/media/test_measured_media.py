"""Shadow rays that one search measures: closed forms, the walk between surfaces, edits, and what isn't measured."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest
from numpy.typing import NDArray

import djpt
from djpt.core.records import Ray3f
from djpt.core.transforms import ScalarTransform4f as T
from djpt.geometry.aggregate import MeasuredMedia
from djpt.geometry.bvh.calls import searches
from djpt.geometry.engines import ray_queries
from djpt.geometry.triangles import Triangles
from djpt.integrators.paths.transmittance import are_null, null_transmittance
from djpt.jit.types import Color3f, Float, Point3f, UInt32, Vector3f
from djpt.media.differentials import own_stream
from djpt.scene.scene import Scene
from tests.kit.media_scenes import NULL, colour, fog
from tests.kit.triangle_soups import sphere

pytestmark = [
    pytest.mark.narrow,
    pytest.mark.skipif(searches.why_not("rings") is not None, reason="only rings measure media"),
]

Floats = NDArray[np.float64]
Box = tuple[list[float], list[float], int]
"""The corners of a box, and the number of the medium in it."""

QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
SIGMA = np.array([[1.0, 0.5, 0.2], [0.3, 0.3, 0.9], [0.7, 0.1, 0.4]])
"""The extinction of media, by number and channel."""

NESTED: list[Box] = [([-1, -1, -1], [1, 1, 1], 0), ([-0.6, -0.7, -0.5], [0.5, 0.6, 0.7], 1)]
OVERLAPPING: list[Box] = [*NESTED, ([0.2, 0.1, -0.3], [1.7, 1.4, 1.2], 2), ([-1.6, -1.5, -1.4], [-0.8, 1.1, 0.3], 1)]
ROW: list[Box] = [([-2 + 0.1 * k, -1, -1], [-1.95 + 0.1 * k, 1, 1], k % 3) for k in range(40)]
"""Boxes that hold 80 boundaries: more than there is room for in a list, several times."""


def box(low: list[float], high: list[float], **props: Any) -> djpt.Mesh:
    """A box of twelve triangles."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
    corners = np.float32(low) + corners * (np.float32(high) - np.float32(low))
    faces = [face for a, b, c, d in QUADS for face in ((a, b, c), (a, c, d))]
    return djpt.Mesh("box", corners, np.array(faces), props={"bsdf": NULL, **props})


def media() -> list[Any]:
    """Media with the extinctions of `SIGMA`."""
    return [djpt.load_dict(fog(colour(*sigma))) for sigma in SIGMA]


def scene_of(boxes: list[Box], **more: Any) -> Scene:
    """A scene of boxes; what has the same number is the same medium."""
    made = media()
    shapes = {f"b{i}": box(low, high, interior=made[k]) for i, (low, high, k) in enumerate(boxes)}
    return djpt.load_dict({"type": "scene", **shapes, **more})


def segments(count: int, reach: float = 3.0, seed: int = 0) -> tuple[Floats, Floats]:
    """The ends of segments through the boxes, both outside of all."""
    rng = np.random.default_rng(seed)
    middle, d = rng.uniform(-0.9, 0.9, (count, 3)), rng.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return middle - reach * 2 * d, middle + reach * 2 * d


def shadow_ray(o: Floats, end: Floats) -> Ray3f:
    """The segments as shadow rays."""
    return Ray3f(Point3f(*o.T), Vector3f(*(end - o).T), maxt=Float(1 - 1e-4))


def transmittance(scene: Scene, ray: Ray3f) -> Floats:
    """The transmittance of shadow rays that begin in the vacuum, (N, 3)."""
    view = scene.replace(all_media=True)
    ray = ray.replaced(medium=UInt32(view.media.vacuum) + dr.zeros(UInt32, dr.width(ray)))
    return np.array(null_transmittance(view, own_stream(ray, ray.maxt), ray, Color3f(1)), np.float64).T


def is_measured(scene: Scene) -> bool:
    """Whether the media of a scene are measured by one search."""
    view = scene.replace(all_media=True)
    return MeasuredMedia(view.geometry, are_null(view), view.media.plugins).are_measured


def expected(boxes: list[Box], o: Floats, end: Floats) -> Floats:
    """Beer and Lambert: behind a boundary is what stands on its far side, whatever was before."""
    length = np.linalg.norm(end - o, axis=1)
    d = (end - o) / length[:, None]
    result = np.ones((len(o), 3))
    planes = []
    for low, high, _ in boxes:
        # As the meshes have them.
        near, far = (np.float32(low) - o) / d, (np.float32(high) - o) / d
        planes.append((np.minimum(near, far).max(axis=1), np.maximum(near, far).min(axis=1)))
    for ray in range(len(o)):
        crossings = []
        for (first, last), (_, _, medium) in zip(planes, boxes, strict=True):
            if first[ray] < last[ray]:
                crossings += [(first[ray], medium), (last[ray], None)]
        crossings.sort(key=lambda crossing: crossing[0])
        tau = np.zeros(3)
        for (begin, medium), (after, _) in zip(crossings, [*crossings[1:], (length[ray], None)], strict=True):
            if medium is not None:
                tau += SIGMA[medium] * (after - begin)
        result[ray] = np.exp(-tau)
    return result


@pytest.mark.parametrize("boxes", [NESTED, OVERLAPPING, ROW], ids=["nested", "overlapping", "many"])
def test_beer_and_lambert(boxes: list[Box]) -> None:
    scene = scene_of(boxes)
    o, end = segments(3000)
    if boxes is ROW:
        o[:, 0], end[:, 0] = -4, 4  # through all of them
    assert is_measured(scene)
    found = transmittance(scene, shadow_ray(o, end))
    assert np.abs(found - expected(boxes, o, end)).max() < 2e-5


def test_opaque_surfaces_hide_also_behind_many_others() -> None:
    o, end = segments(2000)
    o[:, 0], end[:, 0] = -4, 4
    plain = scene_of(ROW)
    wall = box([2.5, 0, -9], [2.6, 9, 9], bsdf={"type": "diffuse"})
    ball = {"type": "sphere", "center": [3, -0.5, 0], "radius": 0.3}
    scene = scene_of(ROW, wall=wall, ball=ball)
    assert is_measured(scene)
    hidden = np.array(scene_of([], wall=wall, ball=ball).ray_test(shadow_ray(o, end)))
    found = transmittance(scene, shadow_ray(o, end))
    assert 0.2 < hidden.mean() < 0.9
    assert np.mean((found.max(axis=1) == 0) != hidden) < 2e-3
    error = np.abs(found - transmittance(plain, shadow_ray(o, end)))[found.max(axis=1) > 0]
    assert error.max() < 1e-5


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("flipped", [False, True])
def test_the_walk_from_surface_to_surface_has_the_same_value(
    mirrored: bool, flipped: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    corners = sphere(1500)
    place = T().scale([-1 if mirrored else 1, 0.9, 0.7])
    shapes: dict[str, Any] = {}
    made = media()
    for i, smooth in enumerate((False, True)):
        p = corners.reshape(-1, 3) * np.float32(1 - 0.5 * i)
        normals = p / np.linalg.norm(p, axis=1, keepdims=True)
        props = {"bsdf": NULL, "interior": made[i], "to_world": place, "flip_normals": flipped}
        faces = np.arange(len(p)).reshape(-1, 3)
        shapes[f"ball{i}"] = djpt.Mesh("ball", p, faces, normals if smooth else None, props=props)
    scene = scene_of(OVERLAPPING[2:], **shapes, post=box([0, 0, 0], [0.1, 0.1, 2], bsdf={"type": "diffuse"}))
    ray = shadow_ray(*segments(4000, 1.0, seed=3))
    assert is_measured(scene)
    measured = transmittance(scene, ray)
    monkeypatch.setattr(Triangles, "can_measure", False)
    assert not is_measured(scene)
    walked = transmittance(scene, ray)
    # The walk leaves out an epsilon at each surface, and with it whatever lies so close behind.
    error = np.abs(measured - walked).max(axis=1)
    assert np.median(error) < 3e-4
    assert np.mean(error > 6e-3) < 2e-3
    assert measured.mean() == pytest.approx(walked.mean(), rel=1e-3)
    assert 0.02 < np.mean(measured == 0) < 0.5


def test_no_bit_depends_on_the_rays_beside() -> None:
    scene = scene_of(OVERLAPPING + ROW[:12])
    o, end = segments(999)
    order = np.random.default_rng(1).permutation(999)
    found = transmittance(scene, shadow_ray(o, end))
    assert np.array_equal(found[order], transmittance(scene, shadow_ray(o[order], end[order])))


def lit_floor(medium: Any, integrator: str = "volpath") -> Any:
    """A floor whose light comes through a layer of a medium, over 1.25 units of length; the camera is below it."""
    return {
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": 2},
        "sensor": {
            "type": "orthographic",
            "to_world": T().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0]) @ T().scale(0.5),
            "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}},
        },
        "light": {"type": "directional", "direction": [0, 0.6, -0.8], "irradiance": 1.0},
        "floor": {"type": "rectangle", "to_world": T().scale(20)},
        "fog": box([-9, -9, 4], [9, 9, 5], interior=medium),
    }


def test_edits_of_media_take_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(OVERLAPPING)
    o, end = segments(500)
    before = transmittance(scene, shadow_ray(o, end))
    params = djpt.traverse(scene)
    key = next(name for name in params if name.startswith("b1.interior_medium.sigma_t"))
    monkeypatch.setitem(globals(), "SIGMA", SIGMA * [[1], [3], [1]])
    params[key] = djpt.Color3f(SIGMA[1].tolist())
    params.update()
    after = transmittance(scene, shadow_ray(o, end))
    assert not np.array_equal(before, after)
    assert np.abs(after - expected(OVERLAPPING, o, end)).max() < 2e-5


def test_edits_of_media_compile_nothing() -> None:
    scene = djpt.load_dict(lit_floor(fog(0.8)))
    assert is_measured(scene)
    params = djpt.traverse(scene)
    key = next(name for name in params if "sigma_t" in name)
    images = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        for sigma in (1.0, 2.0):
            params[key] = Float(sigma)
            params.update()
            dr.kernel_history_clear()
            images.append(djpt.render(scene, spp=4).numpy())
        kernels = [kernel for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT]
    assert kernels and all(kernel["cache_hit"] for kernel in kernels)
    assert images[1].mean() == pytest.approx(images[0].mean() * np.exp(-1.25), rel=1e-3)


def test_records_follow_edits_of_bsdfs_and_vertices() -> None:
    scene = scene_of(OVERLAPPING)
    o, end = segments(1000)
    mesh: Any = scene.shapes()[-1]
    params = djpt.traverse(scene)
    key = next(name for name in params if name.startswith("b3.") and name.endswith("vertex_positions"))
    params[key] = Float(params[key]) + 0.05
    params.update()
    low, high, medium = OVERLAPPING[-1]
    moved = [*OVERLAPPING[:-1], ([x + 0.05 for x in low], [x + 0.05 for x in high], medium)]
    assert np.abs(transmittance(scene, shadow_ray(o, end)) - expected(moved, o, end)).max() < 2e-5
    invisible = mesh.bsdf()
    mesh.set_bsdf(djpt.load_dict({"type": "diffuse"}))
    found = transmittance(scene, shadow_ray(o, end))
    near, far = (np.sort([(np.float32(p) - o) / (end - o) for p in moved[-1][:2]], axis=0)[k] for k in (0, 1))
    hidden = near.max(axis=1) < far.min(axis=1)
    assert is_measured(scene)
    assert np.array_equal(found.max(axis=1) == 0, hidden)
    mesh.set_bsdf(invisible)
    assert np.abs(transmittance(scene, shadow_ray(o, end)) - expected(moved, o, end)).max() < 2e-5


def test_from_far_away_nothing_is_lost() -> None:
    scene = scene_of(NESTED)
    o, end = segments(1000, reach=300)
    view = scene.replace(geometry=scene.geometry.seen_from([np.full(3, 1e5)]))
    assert view.geometry is not scene.geometry
    assert np.abs(transmittance(view, shadow_ray(o, end)) - expected(NESTED, o, end)).max() < 2e-3
    sides = transmittance(scene, shadow_ray(o, end))
    assert np.abs(transmittance(view, shadow_ray(o, end)) - sides).max() < 2e-3


GRID = {"type": "gridvolume", "data": np.ones((2, 2, 2, 1), np.float32)}
OTHERS: dict[str, dict[str, Any]] = {
    "mask": {"x": box([9, 9, 9], [10, 10, 10], bsdf={"type": "mask", "opacity": 0.5, "b": {"type": "diffuse"}})},
    "thindielectric": {"x": box([9, 9, 9], [10, 10, 10], bsdf={"type": "thindielectric"})},
    "analytic": {"x": {"type": "sphere", "center": [9, 9, 9], "bsdf": NULL}},
    "heterogeneous": {"x": box([9, 9, 9], [10, 10, 10], interior={"type": "heterogeneous", "sigma_t": GRID})},
    "five media": {f"x{k}": box([9, 9, 9 + k], [10, 10, 10 + k], interior=fog(0.1 + k)) for k in range(2)},
    "instances": {
        "g": {"type": "shapegroup", "id": "g", "a": box([0, 0, 0], [1, 1, 1], bsdf={"type": "diffuse"})},
        "i": {"type": "instance", "to_world": T().translate([9, 9, 9]), "g": {"type": "ref", "id": "g"}},
    },
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_scenes_are_walked(name: str) -> None:
    scene = scene_of(OVERLAPPING, **OTHERS[name])
    o, end = segments(500)
    assert not is_measured(scene)
    error = np.abs(transmittance(scene, shadow_ray(o, end)) - expected(OVERLAPPING, o, end)).max(axis=1)
    assert np.mean(error > 3e-3) < 0.01


@pytest.mark.parametrize("way", ["call", "steps"])
def test_other_searches_walk(way: str) -> None:
    with ray_queries(way):
        assert not is_measured(scene_of(NESTED))


def test_derivatives_by_extinction_are_those_of_the_closed_form() -> None:
    lit = djpt.load_dict(lit_floor(fog(0.8, 0.0), "prbvolpath"))
    assert is_measured(lit)
    params = djpt.traverse(lit)
    name = next(name for name in params if "sigma_t" in name)
    sigma = type(params[name])(params[name])
    dr.enable_grad(sigma)
    params[name] = sigma
    params.update()
    mean = dr.mean(djpt.render(lit, params, spp=64, seed=1), axis=None)
    dr.backward(mean)
    # The fog is above the camera: exp(-sigma / 0.8) of the light comes through.
    assert float(np.sum(dr.grad(sigma))) == pytest.approx(-1.25 * float(mean.array[0]), rel=2e-3)

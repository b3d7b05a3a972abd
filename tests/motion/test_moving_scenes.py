"""Shapes, lights and cameras that move: the image at one moment, and images with an open shutter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import djpt
from djpt import AnimatedTransform4f as A
from djpt.core.transforms import ScalarTransform4f as T
from tests.kit.kernels import kernels

RED = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.2, 0.2]}}


def turned(angle: float, size: float = 0.5, x: float = 0.0, y: float = 0.0) -> T:
    """A place in front of the camera."""
    return T().translate([x, y, 0]).rotate([0, 0, 1], angle).scale(size)


def view(*keys: Any, width: int = 32) -> dict[str, Any]:
    """A camera that looks at the origin, or moves through `keys`."""
    to_world = A(dict(enumerate(keys))) if keys else T().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": width, "height": width, "rfilter": {"type": "box"}}
    return {"type": "perspective", "fov": 40, "shutter_close": 1.0, "to_world": to_world, "film": film}


def described(**parts: Any) -> dict[str, Any]:
    """A scene with a floor and a sky."""
    floor = {"type": "rectangle", "to_world": T().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(4)}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4},
        "sensor": view(),
        "sky": {"type": "constant"},
        "floor": floor,
        **parts,
    }


def bump(**keys: Any) -> djpt.Mesh:
    """A mesh without symmetry."""
    n = 10
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, n), np.linspace(0.05, np.pi - 0.05, n))
    r = 1 + 0.2 * np.sin(3 * u) * np.sin(2 * v)
    p = np.stack([r * np.sin(v) * np.cos(u), r * np.cos(v), r * np.sin(v) * np.sin(u)], -1).reshape(-1, 3)
    i = np.arange(n * n).reshape(n, n)
    a, b, c, d = (x.ravel() for x in (i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    keys = {name: djpt.load_dict(value) if isinstance(value, dict) else value for name, value in keys.items()}
    return djpt.Mesh("bump", p, faces, props=djpt.Properties("mesh", "bump", keys))


def solids() -> dict[str, Any]:
    return described(
        ball={"type": "sphere", "radius": 0.4, "bsdf": RED, "to_world": A({0: turned(0, 1, -1), 1: turned(0, 0.5, 1)})},
        box={"type": "cube", "to_world": A({0: turned(0, 0.3, 0, -0.6), 1: turned(80, 0.3, 0, -0.4)})},
        glass={"type": "sphere", "bsdf": {"type": "dielectric"}, "to_world": A({0: turned(0, 0.4), 1: turned(9, 0.4)})},
        roll={"type": "cylinder", "radius": 0.2, "to_world": A({0: turned(0, 0.8, -0.5, 1), 1: turned(90, 0.8, -0.5)})},
    )


def meshes() -> dict[str, Any]:
    keys = {0: turned(0), 0.3: turned(50, 0.4, -0.5), 0.6: turned(100, 0.6, 0.5), 1: turned(170, 0.5, 0.2, 0.5)}
    return described(moving=bump(to_world=A(keys), bsdf=RED), still=bump(to_world=T().translate([1, 0, -1]).scale(0.4)))


def deformed() -> dict[str, Any]:
    """A mesh through three shapes, one of which also turns."""
    sets = {name: bump(to_world=T().scale(size)) for name, size in (("a", [1, 1, 1]), ("b", [0.6, 1.3, 1]))}
    sets["c"] = bump(to_world=T().rotate([0, 1, 0], 40).scale([1, 0.5, 1]))
    soft = {"type": "deforming", **sets, "times": [0, 0.4, 1], "to_world": turned(0, 0.4, -0.8), "bsdf": RED}
    moving = {"type": "deforming", **sets, "to_world": A({0: turned(0, 0.4, 0.5), 1: turned(60, 0.4, 0.8)})}
    return described(soft=soft, moving=moving, ball={"type": "sphere", "radius": 0.3})


def instances() -> dict[str, Any]:
    group = {"type": "shapegroup", "a": bump(to_world=turned(0, 0.4, 0.5)), "b": {"type": "sphere", "radius": 0.3}}
    shown = {"g": {"type": "ref", "id": "group"}, "type": "instance"}
    return described(
        group=group,
        one={**shown, "to_world": A({0: turned(0, 1, -0.7), 1: turned(90, 1, -0.4)})},
        two={**shown, "to_world": A({0: turned(0, 1, 0.7), 1: turned(-90, 0.5, 0.9)})},
        still={**shown, "to_world": turned(0, 0.5, 0, 1)},
    )


def lamps() -> dict[str, Any]:
    above = T().translate([-1, 1.5, 0]).rotate([1, 0, 0], 90).scale(0.3)
    lamp = {"type": "area", "radiance": 6.0}
    return described(
        sky={"type": "constant", "radiance": 0.05},
        lamp={"type": "rectangle", "to_world": A({0: above, 1: T().translate([2, 0, 0]) @ above}), "e": lamp},
        bulb=bump(to_world=A({0: turned(0, 0.2, 1.5), 1: turned(50, 0.3, 1.5, 0.8)}), emitter=lamp),
        ball={"type": "sphere", "radius": 0.4},
    )


def beams() -> dict[str, Any]:
    left = T().look_at([-2, 2, 1], [-0.5, 0, 0], [0, 1, 0])
    right = T().look_at([2, 2, 1], [0.5, 0, 0], [0, 1, 0])
    across = A({0: left, 1: right})
    texels = np.full((16, 32, 3), 0.1, np.float32)
    texels[3:5, 6:9] = 30
    return described(
        sky={"type": "envmap", "bitmap": djpt.Bitmap(texels), "to_world": A({0: T(), 1: T().rotate([0, 1, 0], 90)})},
        spot={"type": "spot", "to_world": across, "intensity": 20.0, "cutoff_angle": 30.0},
        point={"type": "point", "to_world": across, "intensity": 2.0},
        sun={"type": "directional", "to_world": across, "irradiance": 1.0},
        ball={"type": "sphere", "radius": 0.4},
    )


def cameras() -> dict[str, Any]:
    here, there = T().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]), T().look_at([1, 0.5, 5], [0.3, 0, 0], [0.1, 1, 0])
    moving = A({0: turned(0, 0.3, -0.8), 1: turned(60, 0.3, -0.9)})
    return described(sensor=view(here, there), box={"type": "cube", "to_world": moving}, ball={"type": "sphere"})


SCENES: dict[str, Callable[[], dict[str, Any]]] = {
    f.__name__: f for f in (solids, meshes, deformed, instances, lamps, beams, cameras)
}


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.sparse(9)
def test_a_closed_shutter_sees_the_still_scene(name: str) -> None:
    """The same samples find the same, whether rays are carried to what moves, or what moves is placed."""
    scene = djpt.load_dict(SCENES[name]())
    params = djpt.traverse(scene)
    params["sensor.shutter_open"], params["sensor.shutter_open_time"] = 0.37, 0.0
    params.update()
    carried = np.array(djpt.render(scene, spp=8, seed=5))
    placed = np.array(djpt.render(scene.at_time(0.37), spp=8, seed=5))
    differs = np.abs(carried - placed).max(-1) > 1e-3 * (placed.max(-1) + 0.1)
    assert differs.mean() < 0.005
    assert carried.mean() == pytest.approx(placed.mean(), rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_an_open_shutter_sees_the_mean_of_still_scenes(name: str) -> None:
    """256 still renders at stratified moments against blurred ones, in blocks of pixels."""
    scene, rounds, moments = djpt.load_dict(SCENES[name]()), 4, 64
    random = np.random.default_rng(3)
    blurred = np.array([np.array(djpt.render(scene, spp=256, seed=100 + k)) for k in range(rounds)])
    still = []
    for k in range(rounds):
        times = (np.arange(moments) + random.random(moments)) / moments
        images = [djpt.render(scene.at_time(t), spp=4, seed=1000 * k + i) for i, t in enumerate(times)]
        still.append(np.mean([np.array(image) for image in images], axis=0))
    a, b = (np.array(x).reshape(rounds, 4, 8, 4, 8, 3).mean((2, 4, 5)) for x in (blurred, still))
    spread = np.sqrt(((a.var(0, ddof=1) + b.var(0, ddof=1)) / rounds).mean())
    mean_spread = np.sqrt((a.mean((1, 2)).var(ddof=1) + b.mean((1, 2)).var(ddof=1)) / rounds)
    assert abs(a.mean() - b.mean()) < 4 * mean_spread + 1e-5
    # The spread of a block is known from few rounds only: all blocks together say what is usual.
    assert np.sqrt(((a - b).mean(0) ** 2).mean()) < 2 * spread


def test_what_stays_has_no_time() -> None:
    scene = djpt.load_dict(djpt.cornell_box())
    assert not scene.moves and not scene.in_time and not scene.geometry.moves


def test_keyframes_are_edited_without_a_new_kernel() -> None:
    scene = djpt.load_dict(solids())
    params = djpt.traverse(scene)
    djpt.render(scene, spp=2)

    def edit(x: float) -> np.ndarray:
        params["ball.to_world.translation"] = [-1, 0, 0, x, 0.2, 0]
        params.update()
        return np.array(djpt.render(scene, spp=2))

    before = kernels(lambda: edit(0.9))
    assert kernels(lambda: edit(0.5)) <= before
    fresh = solids()
    fresh["ball"]["to_world"] = A({0: turned(0, 1, -1), 1: turned(0, 0.5, 0.5, 0.2)})
    assert np.allclose(edit(0.5), np.array(djpt.render(djpt.load_dict(fresh), spp=2)), atol=1e-5)


@pytest.mark.slow
def test_integrators_without_time_render_slices() -> None:
    """Paths from both ends keep no time: they see the same as a path from the camera."""
    scene = djpt.load_dict(lamps())
    blurred = np.array(djpt.render(scene, spp=256))
    both = np.array(djpt.render(scene, spp=32, integrator=djpt.load_dict({"type": "bdpt", "max_depth": 4})))
    assert both.mean() == pytest.approx(blurred.mean(), rel=0.03)


def test_rays_of_scripts_see_what_is_there_at_their_time() -> None:
    moving = A({0: T().translate([-1, 0, 0]), 1: T().translate([1, 0, 0])})
    scene = djpt.load_dict(described(ball={"type": "sphere", "radius": 0.4, "to_world": moving}))
    rays = djpt.Ray3f(o=djpt.Point3f([-1, -1, 1, 1], 0, 5), d=djpt.Vector3f(0, 0, -1), time=djpt.Float([0, 1, 0, 1]))
    si = scene.ray_intersect(rays)
    assert np.array(si.is_valid()).tolist() == [True, False, False, True]
    assert np.allclose(np.array(si.n)[:, [0, 3]], [[0, 0], [0, 0], [1, 1]], atol=1e-5)
    assert np.array(scene.ray_test(rays)).tolist() == [True, False, False, True]


def test_vertex_sets_can_be_edited() -> None:
    scene = djpt.load_dict(deformed())
    params = djpt.traverse(scene)
    sets = np.array(params["soft.vertex_sets"])
    sets[1] *= 1.2
    params["soft.vertex_sets"] = djpt.TensorXf(sets)
    params.update()
    size = (np.array(djpt.render(scene.at_time(0.4), spp=16)) < 0.7).mean()
    assert size > (np.array(djpt.render(djpt.load_dict(deformed()).at_time(0.4), spp=16)) < 0.7).mean()


TENT = djpt.Mesh("tent", [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
WIDE = djpt.Mesh("wide", [[0, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]])


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"a": TENT}, "two or more"),
        ({"a": TENT, "b": {"type": "sphere"}}, "two or more"),
        ({"a": TENT, "b": WIDE}, "the same triangles"),
        ({"a": TENT, "b": TENT, "times": [1, 0]}, "ascending"),
        ({"a": TENT, "b": TENT, "times": [0, 1, 2]}, "2 ascending numbers"),
        ({"a": TENT, "b": TENT, "e": {"type": "area"}}, "can't emit light"),
    ],
)
def test_meshes_that_cannot_deform_say_so(parts: dict[str, Any], message: str) -> None:
    with pytest.raises(djpt.SceneError, match=message):
        djpt.load_dict({"type": "deforming", **parts})


def test_questions_about_what_moves_are_refused_by_name() -> None:
    scene = djpt.load_dict(cameras())
    box, camera = next(shape for shape in scene.shapes() if shape.moves), scene.sensors()[0]
    with pytest.raises(djpt.RenderError, match="at_time"):
        box.sample_position(0.0, djpt.Point2f(0.5))
    with pytest.raises(djpt.RenderError, match="at_time"):
        camera.sample_direction(djpt.Point3f(0), djpt.Point2f(0.5))
    still = scene.at_time(0.5)
    box = next(shape for shape in still.shapes() if shape.id() == box.id())
    assert np.isfinite(np.array(box.sample_position(0.0, djpt.Point2f(0.5)).p)).all()
    low, high = (np.array(corner) for corner in (scene.shapes()[-2].bbox().min, scene.shapes()[-2].bbox().max))
    assert (low < high).all()

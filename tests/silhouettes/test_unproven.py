"""Derivatives that are known to be wrong are refused with a reason, and only those."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import DjptError, RenderError
from djpt.jit.types import Float, TensorXf
from djpt.rendering.gradients.unproven import CASES
from djpt.rendering.gradients.unproven_cameras import CAMERA_CASES
from djpt.scene.intersecting_shapes import between, is_convex, may_intersect
from tests.kit import materials
from tests.silhouettes.test_projective import SCENES, globe, octahedron

ROOT = Path(__file__).parents[2]
INTEGRATORS = ("direct_projective", "prb_projective")
PLASTER = {"type": "diffuse"}
LAMP = {
    "type": "rectangle",
    "to_world": T().translate([0, 0, 9]).rotate([1, 0, 0], 180).scale(0.5),
    "emitter": {"type": "area", "radiance": 20.0},
}
BLOBS = {"type": "metaballs", "balls": [[-0.5, 0, 0, 1], [0.5, 0, 0, 1]]}
"""A surface whose outlines aren't followed."""
BUMPS = {"type": "bitmap", "data": TensorXf(np.random.default_rng(0).random((4, 4, 1)).astype(np.float32)), "raw": True}
SPOTS = {"type": "bitmap", "data": TensorXf(np.random.default_rng(1).random((4, 4, 3)).astype(np.float32)), "raw": True}
NORMALS = {"type": "normalmap", "normalmap": materials.bitmap(materials.normals(4, 4))}
VOXELS = TensorXf(np.random.default_rng(2).random((3, 3, 3, 3)).astype(np.float32))
COARSE_VOLUME = {
    "type": "volume",
    "volume": {"type": "gridvolume", "data": VOXELS, "raw": True, "filter_type": "nearest", "to_world": T().scale(9)},
}
FLOOR = {"type": "rectangle", "to_world": T().translate([0, 0, -1.5]).scale(4)}
GLASS = {"type": "dielectric"}
SENSOR = {
    "type": "perspective",
    "fov": 40,
    "to_world": T().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0]),
    "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}, "pixel_format": "rgb"},
}


def room(**nodes: Any) -> dict[str, Any]:
    """A ball over a floor in the light of a lamp, seen from above."""
    parts = {"floor": FLOOR, "lamp": LAMP, "moving": {"type": "sphere", "bsdf": PLASTER}, "sensor": SENSOR, **nodes}
    return {"type": "scene", **{name: node for name, node in parts.items() if node is not None}}


def moved(description: dict[str, Any]) -> tuple[Any, Float]:
    """The scene, and the parameter that moves its shape `moving` to the right."""
    scene, theta = djpt.load_dict(description), Float(0)
    params = djpt.traverse(scene)
    dr.enable_grad(theta)
    if "moving.vertex_positions" in params:
        params["moving.vertex_positions"] = Float(params["moving.vertex_positions"]) + theta
    else:
        params["moving.to_world"] = djpt.Transform4f().translate([theta, 0, 0]) @ djpt.Transform4f(
            params["moving.to_world"]
        )
    params.update()
    return scene, theta


def integrator(kind: str = "direct_projective", **settings: Any) -> Any:
    return djpt.load_dict({"type": kind, "max_depth": 2, "sppi": 0, **settings})


def ball(bsdf: Any = PLASTER, **more: Any) -> dict[str, Any]:
    return {"type": "sphere", "bsdf": bsdf, **more}


def smooth_mesh(bsdf: dict[str, Any]) -> Any:
    """A mesh with interpolated normals."""
    data = globe().data()
    return djpt.Mesh("moving", data.positions, data.indices, data.normals, props={"bsdf": bsdf})


MIRROR_BEHIND = {"type": "disk", "bsdf": {"type": "conductor"}, "to_world": T().translate([0, 3, 0])}
REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "a smooth mesh like a mirror": (
        {"moving": smooth_mesh({"type": "conductor"})},
        r"'moving' has the BSDF '.*' .conductor., and the edges at which rays leave.*'face_normals'",
    ),
    "a ring and a mirror": (
        {"other": MIRROR_BEHIND, "ring": {"type": "torus", "to_world": T().translate([3, 0, 0]).scale(0.3)}},
        "'ring' is of the type 'torus', 'other' has the BSDF .*conductor.*, and its parts aren't told apart",
    ),
    "blobs and glass": (
        {"moving": ball(GLASS), "blobs": {**BLOBS, "to_world": T().translate([3, 0, -2]).scale(0.1)}},
        "'blobs' is of the type 'metaballs', 'moving' has the BSDF .*dielectric",
    ),
    "bump map": (
        {"moving": ball({"type": "twosided", "n": {"type": "bumpmap", "t": BUMPS, "nested": PLASTER}})},
        "'moving' has the BSDF '.*' .bumpmap., and where slopes change from texel to texel",
    ),
    "a normal map that cuts off light": (
        {"moving": ball({**NORMALS, "use_shadowing_function": False, "nested": PLASTER})},
        "'moving' has the BSDF '.*' .normalmap., and where slopes.* or bent normals cut off light",
    ),
    "a normal map on a mirror": (
        {"moving": ball({**NORMALS, "nested": {"type": "conductor"}})},
        "'moving' has the BSDF '.*' .normalmap., and where slopes",
    ),
    "a normal map on a smooth mesh": (
        {"moving": smooth_mesh({**NORMALS, "nested": PLASTER})},
        "'moving' has the BSDF '.*' .normalmap., and where slopes",
    ),
    "a coarse volume": (
        {"moving": ball({"type": "diffuse", "reflectance": COARSE_VOLUME})},
        "'moving' has the volume '.*' .gridvolume., and the edges between its colours",
    ),
    "a coarse projector": (
        {"light": {"type": "projector", "irradiance": {**BUMPS, "filter_type": "nearest"}}},
        "'light' has the texture '.*' .bitmap., and the edges between its colours",
    ),
    "directionalarea": (
        {"panel": {"type": "disk", "to_world": T().translate([0, 3, 3]), "emitter": {"type": "directionalarea"}}},
        r"directionalarea. shines",
    ),
    "a far plane": (
        {"sensor": {**SENSOR, "far_clip": 7.0}},
        r"'floor' reaches beyond the 'far_clip' .7. of 'sensor' .perspective., and what ends there isn't followed",
    ),
    "a far sphere": (
        {"sensor": {**SENSOR, "type": "fisheye", "far_clip": 7.0}},
        r"'floor' reaches beyond the 'far_clip' .7. of 'sensor' .fisheye.",
    ),
    "blobs in front of a lamp": (
        {"roof": {**BLOBS, "to_world": T().translate([0, 0, 7]).scale(0.2)}},
        r"'roof' .metaballs. may hide 'lamp.*' .area. from a shape that moves, and its outlines and",
    ),
    "blobs in front of a light": (
        {
            "roof": {**BLOBS, "to_world": T().translate([0, 0, 4]).scale(0.2)},
            "lamp": None,
            "sun": {"type": "directional", "direction": [0, 0, -1]},
        },
        r"'roof' .metaballs. may hide 'sun' .directional. from",
    ),
    "blobs under a sky": (
        {"box": {**BLOBS, "to_world": T().translate([3, 0, 0])}, "lamp": None, "sky": {"type": "constant"}},
        r"'box' .metaballs. may hide 'sky' .constant. from",
    ),
}


LAMPS: dict[str, tuple[dict[str, Any], str]] = {
    "a coarse lamp": (
        {"moving": {"type": "rectangle", "emitter": {"type": "area", "radiance": {**SPOTS, "filter_type": "nearest"}}}},
        "'moving' has the texture '.*' .bitmap., and the edges between its colours",
    ),
    "a lamp with a seam": (
        {"moving": {"type": "sphere", "emitter": {"type": "area", "radiance": {**SPOTS, "wrap_mode": "clamp"}}}},
        "'moving' has the light .*whose texture doesn't end as it begins",
    ),
    "a lamp in a floor": (
        {"moving": {"type": "sphere", "center": [0, 0, -1.2], "emitter": {"type": "area"}}},
        "'moving' and 'floor' intersect or touch, and the light near the curve",
    ),
}


@pytest.mark.parametrize("name", LAMPS)
def test_edges_that_only_paths_follow(name: str) -> None:
    nodes, message = LAMPS[name]
    scene, _ = moved(room(**nodes))
    with pytest.raises(RenderError, match=f"{message}.*or.* render with 'prb_projective'"):
        djpt.render(scene, integrator=integrator("direct_projective"), spp=1)
    assert dr.grad_enabled(djpt.render(scene, integrator=integrator("direct_projective", max_depth=1), spp=1))
    assert dr.grad_enabled(djpt.render(scene, integrator=integrator("prb_projective"), spp=1))


SMOOTH: dict[str, dict[str, Any]] = {
    "a mirror": {"other": MIRROR_BEHIND},
    "glass": {"moving": ball(GLASS)},
    "thin glass": {"moving": ball({"type": "thindielectric"})},
    "glass of ours": {"moving": ball({"type": "glass"})},
    "a mirror on two sides": {"moving": ball({"type": "twosided", "nested": {"type": "conductor"}})},
    "smooth plastic": {"moving": ball({"type": "plastic"})},
    "a mask": {"moving": ball({"type": "mask", "opacity": 0.5, "nested": PLASTER})},
    "nothing": {"moving": ball({"type": "null"})},
}


@pytest.mark.parametrize("name", SMOOTH)
def test_smooth_surfaces_and_the_light_of_points(name: str) -> None:
    """Their shadows aren't followed where smooth surfaces show them: not by paths of two edges."""
    spot = {"type": "spot", "to_world": T().translate([0, 0, 6])}
    scene, _ = moved(room(**SMOOTH[name], light=spot))
    for kind in INTEGRATORS:
        assert dr.grad_enabled(djpt.render(scene, integrator=integrator(kind), spp=1))
    with pytest.raises(RenderError, match=r"has the BSDF .*'light' .spot. shines, and the edges of shadows aren't"):
        djpt.render(scene, integrator=integrator("prb_projective", max_depth=3), spp=1)
    scene, _ = moved(room(**SMOOTH[name]))
    assert dr.grad_enabled(djpt.render(scene, integrator=integrator("prb_projective", max_depth=3), spp=1))


@pytest.mark.parametrize("name", REFUSED)
@pytest.mark.parametrize("kind", INTEGRATORS)
def test_known_wrong_derivatives_are_refused(kind: str, name: str) -> None:
    nodes, message = REFUSED[name]
    scene, _ = moved(room(**nodes))
    with pytest.raises(RenderError, match=f"^'moving' moves .*{message}.*'unproven_gradients'"):
        djpt.render(scene, integrator=integrator(kind), spp=1)
    grad = dr.zeros(TensorXf, (4, 4, 3))
    for derivative in (
        lambda: integrator(kind).render_forward(scene, None, spp=1),
        lambda: integrator(kind).render_backward(scene, None, grad, spp=1),
    ):
        with pytest.raises(RenderError, match=message):
            derivative()


MESH_ROOM = octahedron((0, 0, 0), 9)
PROVEN: dict[str, dict[str, Any]] = {
    "a ball over a floor": {},
    "a ball that stands on a floor": {"floor": {**FLOOR, "to_world": T().translate([0, 0, -1]).scale(4)}},
    "a picture twice around": {
        "moving": ball({"type": "diffuse", "reflectance": {**SPOTS, "to_uv": T().scale([2, 1.5, 1])}})
    },
    "a picture that ends somewhere": {
        "moving": ball({"type": "diffuse", "reflectance": {**SPOTS, "wrap_mode": "clamp"}})
    },
    "a picture and a half around": {
        "moving": ball({"type": "diffuse", "reflectance": {**SPOTS, "to_uv": T().scale([1.5, 1, 1])}})
    },
    "a checkerboard": {"moving": ball({"type": "diffuse", "reflectance": {"type": "checkerboard"}})},
    "a normal map": {"moving": ball({**NORMALS, "nested": PLASTER})},
    "a rough mirror": {"moving": ball({"type": "roughconductor"})},
    "rough plastic": {"other": {**MIRROR_BEHIND, "bsdf": {"type": "roughplastic"}}},
    "a floor that cuts": {"floor": {**FLOOR, "to_world": T().translate([0, 0, -0.9]).scale(4)}},
    "half of a ball alone": {
        "lamp": None,
        "floor": None,
        "moving": ball({"type": "mask", "opacity": 0.5, "nested": PLASTER}),
        "sky": {"type": "constant"},
    },
    "a point": {"light": {"type": "point", "position": [1, 1, 5]}},
    "a spot": {"light": {"type": "spot", "to_world": T().translate([0, 0, 6])}},
    "parallel light": {"light": {"type": "directional", "direction": [0, 0, -1]}},
    "a shadow on the shape": {"roof": {"type": "disk", "to_world": T().translate([0, 0, 7]).scale(0.2)}},
    "blobs out of the way": {"box": {**BLOBS, "to_world": T().translate([3, 0, 0])}},
    "a cube before a lamp": {"roof": {"type": "cube", "to_world": T().translate([0, 0, 7]).scale(0.2)}},
    "a cone under a sky": {
        "lamp": None,
        "sky": {"type": "constant"},
        "cone": {"type": "cone", "to_world": T().translate([0, 3, 0])},
    },
    "an instance": {
        "lamp": None,
        "group": {"type": "shapegroup", "ball": {"type": "sphere"}, "mesh": octahedron((0, 0, 3), 1)},
        "moving": {"type": "instance", "group": {"type": "ref", "id": "group"}},
        "sky": {"type": "constant"},
    },
    "a mesh with flat facets": {"lamp": None, "moving": octahedron((0, 0, 3), 1), "sky": {"type": "constant"}},
    "rough glass": {"moving": ball({"type": "roughdielectric"})},
    "glass alone": {"lamp": None, "floor": None, "moving": ball(GLASS), "sky": {"type": "constant"}},
    "a textured lamp": {"moving": {"type": "rectangle", "emitter": {"type": "area", "radiance": SPOTS}}},
    "a bitmap": {"moving": ball({"type": "diffuse", "reflectance": SPOTS})},
    "in a cube": {"lamp": None, "floor": None, "room": {"type": "cube", "to_world": T().scale(7)}},
    "in a sphere": {"lamp": None, "floor": None, "room": {"type": "sphere", "radius": 7.0, "flip_normals": True}},
    "in a mesh": {"lamp": None, "floor": None, "room": MESH_ROOM},
    "under a sky": {"lamp": None, "sky": {"type": "constant"}},
    "a lamp that moves": {"moving": {"type": "sphere", "emitter": {"type": "area"}}},
}


@pytest.mark.sparse(24)
@pytest.mark.parametrize("name", PROVEN)
def test_other_derivatives_are_not_refused(name: str) -> None:
    scene, theta = moved(room(**PROVEN[name]))
    image = djpt.render(scene, integrator=integrator(), spp=1)
    assert dr.grad_enabled(image)
    dr.forward(theta)
    assert np.isfinite(np.array(dr.grad(image))).all()


@pytest.mark.sparse(3)
@pytest.mark.parametrize("name", SCENES)
def test_what_is_compared_with_differences_is_not_refused(name: str) -> None:
    parts = SCENES[name]()
    scene, _ = moved({**room(floor=None, lamp=None, moving=None), **parts})
    assert dr.grad_enabled(djpt.render(scene, integrator=integrator(), spp=1))


def test_who_knows_can_go_on() -> None:
    nodes, _ = REFUSED["a coarse projector"]
    scene, theta = moved(room(**nodes))
    image = djpt.render(scene, integrator=integrator(unproven_gradients=True), spp=4)
    dr.forward(theta)
    assert np.abs(np.array(dr.grad(image))).max() > 0
    chosen = integrator()
    chosen.unproven_gradients = True
    assert np.abs(np.array(chosen.render_forward(moved(room(**nodes))[0], None, spp=4))).shape == (4, 4, 3)


def test_images_and_other_derivatives_are_not_refused() -> None:
    """A shape that moves without gradients, and gradients of a colour."""
    nodes, _ = REFUSED["a coarse projector"]
    scene = djpt.load_dict(room(**nodes))
    params = djpt.traverse(scene)
    params["moving.to_world"] = djpt.ScalarTransform4f().translate([0.1, 0, 0])
    dr.enable_grad(params["moving.bsdf.reflectance.value"])
    params.update()
    image = djpt.render(scene, integrator=integrator(), spp=4)
    dr.backward(dr.sum(image, axis=None))
    assert np.array(dr.grad(params["moving.bsdf.reflectance.value"])).sum() > 0


@pytest.mark.parametrize("kind", INTEGRATORS)
def test_hidden_lamps(kind: str) -> None:
    """The picture is that of other integrators."""
    description = room(
        near={**LAMP, "to_world": T().translate([0.5, 0, 3]).scale(0.7)}, sky={"type": "constant", "radiance": 0.2}
    )
    hidden = {"hide_emitters": True, "max_depth": 2}
    mine = djpt.render(djpt.load_dict(description), integrator=integrator(kind, **hidden), spp=512)
    path = djpt.render(djpt.load_dict(description), integrator=djpt.load_dict({"type": "path", **hidden}), spp=512)
    shown = djpt.render(djpt.load_dict(description), integrator=integrator(kind), spp=512)
    assert np.array(shown).mean() > 2 * np.array(path).mean()
    np.testing.assert_allclose(np.array(mine), np.array(path), rtol=0.15)
    assert np.array(mine).mean() == pytest.approx(np.array(path).mean(), rel=0.02)


def test_integrators_without_silhouettes_are_refused() -> None:
    scene, _ = moved(room())
    with pytest.raises(RenderError, match="the integrator 'PRBIntegrator' follows no silhouettes"):
        djpt.ad.integrators.prb.PRBIntegrator(djpt.Properties("prb", "prb", {})).render_forward(scene, None, spp=1)


MOVING_LIGHTS: dict[str, tuple[dict[str, Any], str, str]] = {
    "an integrator": ({}, "path", "the integrator 'Path' follows no silhouettes"),
    "paths from lights": ({"light": {"type": "envmap", "data": np.ones((4, 4, 3), np.float32)}}, "bdpt", "begin|paths"),
    "a sharp spot": (
        {"light": {"type": "spot", "beam_width": 20.0, "cutoff_angle": 20.0}},
        "direct_projective",
        "the beam of 'light' .spot. ends within",
    ),
    "squares": (
        {"light": {"type": "spot", "texture": {"type": "checkerboard"}}},
        "direct_projective",
        "'light' has the texture",
    ),
    "blobs": (
        {"box": {**BLOBS, "to_world": T().translate([3, 0, 0])}},
        "direct_projective",
        r"'box' .metaballs. may hide 'light' .point., which moves",
    ),
    "bumps": (
        {"moving": ball({"type": "bumpmap", "t": BUMPS, "nested": PLASTER})},
        "prb_projective",
        "'moving' has the BSDF.*where slopes change",
    ),
}


def with_moving_light(**nodes: Any) -> Any:
    """The scene, whose light has gradients by its place."""
    scene = djpt.load_dict(room(**{"lamp": None, "light": {"type": "point", "position": [1, 1, 5]}, **nodes}))
    params, theta = djpt.traverse(scene), Float(0)
    dr.enable_grad(theta)
    if "light.position" in params:
        params["light.position"] = djpt.Point3f(1, 1, 5) + djpt.Vector3f(theta, 0, 0)
    else:
        params["light.to_world"] = djpt.Transform4f().rotate([0, 1, 0], theta)
    params.update()
    return scene


@pytest.mark.parametrize("name", MOVING_LIGHTS)
def test_lights_that_move_are_refused(name: str) -> None:
    nodes, kind, message = MOVING_LIGHTS[name]
    how = djpt.load_dict({"type": kind, "max_depth": 2})
    with pytest.raises(RenderError, match=f"^'light' moves .*{message}"):
        djpt.render(with_moving_light(**nodes), integrator=how, spp=1)


@pytest.mark.parametrize("kind", ["path", "prb_projective"])
def test_skies_that_turn_are_not_refused(kind: str) -> None:
    """Nothing has an edge that moves: neither mirrors nor boxes matter."""
    sky = {"type": "envmap", "data": np.random.default_rng(0).random((4, 4, 3), np.float32)}
    scene = with_moving_light(light=sky, other=MIRROR_BEHIND, box={**BLOBS, "to_world": T().scale(0.1)})
    assert dr.grad_enabled(djpt.render(scene, integrator=djpt.load_dict({"type": kind, "max_depth": 3}), spp=1))


@pytest.mark.parametrize("plugin", ["sunsky", "timed_sunsky"])
def test_lights_that_do_not_turn(plugin: str) -> None:
    params, theta = djpt.traverse(djpt.load_dict({"type": plugin})), Float(0)
    dr.enable_grad(theta)
    with pytest.raises(DjptError, match="to_world: gradients with respect to this parameter aren't available"):
        params["to_world"] = djpt.Transform4f().rotate([0, 0, 1], theta)


def test_steering_the_sun_of_many_days() -> None:
    """Nothing of it has derivatives."""
    params = djpt.traverse(djpt.load_dict({"type": "timed_sunsky"}))
    steering = ("to_world", "latitude", "longitude", "timezone", "window_start_time", "window_end_time")
    assert not any(params.flags(key).differentiable for key in steering)


def shape(description: Any) -> Any:
    loaded = djpt.load_dict(description) if isinstance(description, dict) else description
    return djpt.load_dict({"type": "scene", "x": loaded}).shapes()[0]


def pairs() -> list[Any]:
    wall = {"type": "rectangle", "to_world": T().scale(3)}
    found = []
    turned = T().rotate([0, 1, 0], 45).scale([1, 1, 0.1])
    for name, a, b, expected in (
        ("a ball in a wall", {"type": "sphere"}, wall, True),
        ("a ball on a wall", {"type": "sphere", "center": [0, 0, 1]}, wall, False),
        ("balls that touch", {"type": "sphere"}, {"type": "sphere", "center": [1.2, 0, 1.6]}, False),
        ("balls that overlap", {"type": "sphere"}, {"type": "sphere", "center": [1.2, 0, 1.5]}, True),
        ("a ball by a corner", {"type": "sphere"}, {"type": "cube", "to_world": T().translate([1.7, 1.7, 1.7])}, False),
        (
            "a board on a wall",
            {"type": "rectangle", "to_world": T().translate([0, 0, 1]).rotate([1, 0, 0], 90)},
            wall,
            True,
        ),
        ("a box on a wall", {"type": "cube", "to_world": T().translate([0, 0, 1])}, wall, True),
        ("a box above a wall", {"type": "cube", "to_world": T().translate([0, 0, 1.01])}, wall, False),
        (
            "slabs side by side",
            {"type": "cube", "to_world": turned},
            {"type": "cube", "to_world": T().translate([0.3, 0, 0.3]) @ turned},
            False,
        ),
        ("a plane below", {"type": "sphere"}, {"type": "plane", "to_world": T().translate([0, 0, -2])}, False),
        ("a plane through", {"type": "sphere"}, {"type": "plane"}, True),
        ("a ball in a ball", {"type": "sphere"}, {"type": "sphere", "radius": 3.0}, False),
        ("a ball through a ball", {"type": "sphere", "center": [2.5, 0, 0]}, {"type": "sphere", "radius": 3.0}, True),
        ("a ball in a mesh", {"type": "sphere"}, octahedron((0, 0, 0), 4.0), False),
        ("a ball through a mesh", {"type": "sphere"}, octahedron((0, 0, 0), 1.5), True),
        ("a mesh in a mesh", octahedron((0, 0, 0), 0.3), globe(), False),
        ("meshes that cut", octahedron((0.9, 0, 0), 0.3), globe(), True),
    ):
        found.append(pytest.param(a, b, expected, id=name))
    return found


@pytest.mark.parametrize(("a", "b", "expected"), pairs())
def test_which_shapes_may_intersect(a: Any, b: Any, expected: bool) -> None:
    first, second = shape(a), shape(b)
    assert may_intersect(first, second) is may_intersect(second, first) is expected


def test_what_is_convex() -> None:
    two = djpt.Mesh("two", np.array(globe().positions), np.array(globe().indices))
    points = np.concatenate([two.positions, two.positions + np.array([3, 0, 0])])
    pair = djpt.Mesh("pair", points, np.concatenate([two.indices, two.indices + len(two.positions)]))
    assert is_convex(shape({"type": "sphere"})) and is_convex(globe()) and is_convex(octahedron((0, 0, 0), 1))
    assert not is_convex(pair)


def test_what_stands_between_boxes() -> None:
    a, b = (np.array([-1.0, -1, 0]), np.array([1.0, 1, 0])), (np.array([3.0, 0, 4]), np.array([3.0, 0, 4]))
    for center, expected in (((2, 0, 2), True), ((0, 0, 2), False), ((3, 0, 4.2), False), ((0, 0, -0.2), False)):
        assert between(shape({"type": "sphere", "center": list(center), "radius": 0.1}), a, b) is expected


def test_the_guide_lists_the_cases() -> None:
    guide = (ROOT / "docs" / "guides" / "gradients.md").read_text()
    for case in (*CASES, *CAMERA_CASES):
        assert f"| {case.name} | {case.reason} | {case.way_out} |" in guide


def test_curves_in_which_shapes_meet() -> None:
    """They are followed where the camera sees them, and in deeper paths."""
    cut = {"floor": {**FLOOR, "to_world": T().translate([0, 0, -0.9]).scale(4)}}
    for kind, depth in (("direct_projective", 6), ("prb_projective", 2), ("prb_projective", 3)):
        scene, _ = moved(room(**cut))
        assert dr.grad_enabled(djpt.render(scene, integrator=integrator(kind, max_depth=depth), spp=1))


def test_textures_that_jump() -> None:
    """They are followed in direct light and in deeper paths."""
    for depth in (2, 3):
        scene, _ = moved(room(moving=ball({"type": "diffuse", "reflectance": {"type": "checkerboard"}})))
        assert dr.grad_enabled(djpt.render(scene, integrator=integrator("prb_projective", max_depth=depth), spp=1))


@pytest.mark.parametrize(("gap", "cut"), [(0.9, True), (2.5, False)])
@pytest.mark.sparse(2)
def test_meshes_that_cut_themselves(gap: float, cut: bool) -> None:
    """Two balls in one mesh, that overlap or not."""
    ball = globe()
    points, faces = np.array(ball.vertex_positions).reshape(-1, 3), np.array(ball.faces_parameter).reshape(-1, 3)
    both = np.concatenate([points, points + np.array([gap, 0.1, 0.2])]).astype(np.float32)
    mesh = djpt.Mesh("balls", both, np.concatenate([faces, faces + len(points)]))
    camera = {"type": "perspective", "to_world": T().look_at([0, 0, 9], [0, 0, 0], [0, 1, 0])}
    scene = djpt.load_dict({"type": "scene", "balls": mesh, "sensor": camera, "sky": {"type": "constant"}})
    params = djpt.traverse(scene)
    key = next(key for key in params if key.endswith("vertex_positions"))
    dr.enable_grad(params[key])
    params.update()
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        djpt.render(scene, params, integrator=integrator("direct_projective"), spp=1)
    assert any("cuts itself" in str(warning.message) for warning in found) == cut

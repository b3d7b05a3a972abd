"""Meshes that are merged: which, under which names, and that the picture is that of the parts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from tests.kit.meshes import tetrahedron_file
from tests.kit.renders import ours, theirs


def mesh(x: float = 0.0, **keys: Any) -> dict[str, Any]:
    place = T().translate([x, 0, 0]).scale(0.7)
    return {"type": "ply", "filename": tetrahedron_file(), "face_normals": True, "to_world": place, **keys}


PAINT = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.4, 0.1]}}
BY_NAME = {"type": "ref", "id": "paint"}


def scene(**shapes: Any) -> dict[str, Any]:
    look = T().look_at(origin=[0.3, -5, 1.5], target=[0, 0, 0.2], up=[0, 0, 1])
    film = {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}}
    return {
        "type": "scene",
        "paint": PAINT,
        **shapes,
        "sky": {"type": "constant"},
        "integrator": {"type": "path"},
        "sensor": {"type": "perspective", "fov": 45, "to_world": look, "film": film},
    }


PARTS = {"left": mesh(-0.8, bsdf=BY_NAME), "right": mesh(0.9, bsdf=BY_NAME)}


def test_meshes_of_one_material_become_one() -> None:
    loaded = djpt.load_dict(scene(both={"type": "merge", **PARTS}))
    (shape,) = loaded.shapes()
    assert shape.id() == "both" and shape.face_count() == 8
    assert "both.vertex_positions" in djpt.traverse(loaded)


def test_a_shape_that_is_referred_to_twice_counts_once() -> None:
    for kind in ({"type": "sphere"}, mesh()):
        parts = {"once": kind, "a": {"type": "ref", "id": "both.once"}}
        (shape,) = djpt.load_dict({"type": "scene", "both": {"type": "merge", **parts}}).shapes()
        assert not isinstance(shape, djpt.Mesh) or shape.face_count() == 4


def test_the_picture_is_that_of_the_parts() -> None:
    whole, parts = scene(both={"type": "merge", **PARTS}), scene(**PARTS)
    np.testing.assert_allclose(ours(whole, 8, 3), ours(parts, 8, 3), rtol=1e-4, atol=1e-5)


def test_the_picture_is_mitsubas() -> None:
    pytest.importorskip("mitsuba")
    whole = scene(both={"type": "merge", **PARTS})
    assert djpt.validation.agreement(ours(whole, 8, 3), theirs(whole, 8, 3), 1e-3).share > 0.97


@pytest.mark.parametrize(
    "other",
    [
        mesh(0.9),
        mesh(0.9, bsdf=PAINT),
        mesh(0.9, bsdf=BY_NAME, flip_normals=True),
        mesh(0.9, bsdf=BY_NAME, face_normals=False),
        mesh(0.9, bsdf=BY_NAME, emitter={"type": "area"}),
        mesh(0.9, bsdf=BY_NAME, interior={"type": "homogeneous"}),
        {"type": "sphere", "center": [0.9, 0, 0.3], "radius": 0.3, "bsdf": BY_NAME},
    ],
    ids=["no BSDF", "another BSDF", "flipped", "smooth", "emitter", "medium", "sphere"],
)
@pytest.mark.filterwarnings("ignore:'Path' doesn't follow light through media")
def test_others_stay_apart(other: dict[str, Any]) -> None:
    group = {"type": "merge", "left": mesh(-0.8, bsdf=BY_NAME), "other": other}
    loaded = djpt.load_dict(scene(both=group))
    names = [shape.id() for shape in loaded.shapes()]
    if "flip_normals" in other:  # refused by Mitsuba
        assert names == ["left", "other"]
    else:  # in Mitsuba's order
        assert names == ["other", "both" if other["type"] == "sphere" else "left"]
    assert all(np.isfinite(ours(scene(both=group), 1)).ravel())


def test_a_merged_mesh_keeps_its_media() -> None:
    fog = {"type": "homogeneous", "sigma_t": 0.5}
    inside = {"bsdf": BY_NAME, "interior": {"type": "ref", "id": "fog"}}
    parts = {"left": mesh(-0.8, **inside), "right": mesh(0.9, **inside)}
    (shape,) = djpt.load_dict({**scene(both={"type": "merge", **parts}), "fog": fog}).shapes()
    assert shape.face_count() == 8
    assert shape.interior_medium() is not None and shape.exterior_medium() is None


def test_meshes_of_two_groups_are_in_mitsubas_order() -> None:
    paint = {"type": "ref", "id": "second"}
    parts = {f"part{i}": mesh(0.2 * i, bsdf=(BY_NAME, paint)[i % 2]) for i in range(4)}
    loaded = djpt.load_dict({**scene(both={"type": "merge", **parts}), "second": {"type": "diffuse"}})
    assert [(shape.id(), shape.face_count()) for shape in loaded.shapes()] == [("part1", 8), ("part0", 8)]


def test_merged_groups_can_be_instanced() -> None:
    group = {"type": "shapegroup", "both": {"type": "merge", **PARTS}}
    instance = {"type": "instance", "group": {"type": "ref", "id": "group"}, "to_world": T().translate([0, 0, 0.3])}
    found = ours(scene(group=group, instance=instance), 4, 1)
    lifted = {key: {**part, "to_world": T().translate([0, 0, 0.3]) @ part["to_world"]} for key, part in PARTS.items()}
    np.testing.assert_allclose(found, ours(scene(**lifted), 4, 1), rtol=1e-3, atol=1e-3)


def test_outside_of_a_scene() -> None:
    one = djpt.load_dict({"type": "merge", "child": mesh()})
    assert isinstance(one, djpt.Mesh) and one.id() == "child"
    two = djpt.load_dict({"type": "merge", "first": mesh(), "second": {"type": "sphere"}})
    assert [shape.id() for shape in two] == ["second", "first"]


def test_nothing_to_merge() -> None:
    with pytest.raises(djpt.SceneError, match=r"scene\.both: nothing to merge; nest shapes in it"):
        djpt.load_dict(scene(both={"type": "merge"}))

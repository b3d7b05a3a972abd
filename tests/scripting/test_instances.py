"""The instance of a hit, and the textures that a shape carries for scripts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import SceneError
from tests.scripting.kit import numbers, same

SQUARE = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
PLACES = {"left": [-0.5, -0.5, 0], "right": [0.5, -0.5, 0]}


def scene(m: Any, inner: dict[str, Any]) -> Any:
    """Two instances, and a square by itself."""
    description: dict[str, Any] = {"type": "scene", "group": {"type": "shapegroup", "inner": inner}}
    for name, place in PLACES.items():
        to_world = T().translate(place).scale(0.5)
        description[name] = {"type": "instance", "group": {"type": "ref", "id": "group"}, "to_world": to_world}
    description["alone"] = {"type": "rectangle", "to_world": T().translate([0.5, 0.5, 0]).scale(0.5)}
    return m.load_dict(description if m is djpt else djpt.validation.to_mitsuba(description))


@pytest.mark.parametrize("mesh", [False, True])
def test_a_hit_tells_its_instance(mesh: bool, tmp_path: Path, mi: Any) -> None:
    """Analytic shapes are copied for each instance, meshes stand in a tree of their own."""
    path = tmp_path / "square.ply"
    djpt.Mesh("square", SQUARE, [[0, 1, 2], [0, 2, 3]]).write_ply(path)
    found = []
    for m in (djpt, mi):
        place = scene(m, {"type": "ply", "filename": str(path)} if mesh else {"type": "sphere"})
        ray = m.Ray3f(m.Point3f([-0.5, 0.5, 0.5, 5], [-0.5, -0.5, 0.5, 0], -12), m.Vector3f(0, 0, 1))
        pi = place.ray_intersect_preliminary(ray)
        for hit in (place.ray_intersect(ray), pi, pi.compute_surface_interaction(ray)):
            ids = {shape.id(): shape for shape in place.shapes()}
            found.append([numbers(hit.instance == ids[name]) for name in PLACES] + [numbers(hit.instance == None)])  # noqa: E711
    assert all(entry == found[-1] for entry in found)
    assert found[-1] == [[True, False, False, False], [False, True, False, False], [False, False, True, True]]


def test_scenes_without_instances() -> None:
    si = djpt.load_dict(djpt.cornell_box()).ray_intersect(djpt.Ray3f([0, 0, 3], [0, 0, -1]))
    assert numbers(si.instance == dr.zeros(djpt.ShapePtr)) == [True]
    assert djpt.SurfaceInteraction3f().instance is None


def test_shapes_carry_textures(mi: Any) -> None:
    found = []
    for m in (djpt, mi):
        red = m.load_dict({"type": "rgb", "value": [0.5, 0.25, 0.125]})
        shape = m.load_dict({"type": "sphere", "vertex_tint": red})
        shape.add_texture_attribute("vertex_other", m.load_dict({"type": "uniform", "value": 0.5}))
        si = dr.zeros(m.SurfaceInteraction3f)
        assert shape.texture_attribute("vertex_tint") is red and "vertex_tint.value" in m.traverse(shape)
        value = shape.eval_attribute_1("vertex_other", si)
        tints = [shape.eval_attribute("vertex_tint", si), m.ShapePtr(shape).eval_attribute_3("vertex_tint", si)]
        shape.remove_attribute("vertex_tint")
        assert not dr.any(shape.has_attribute("vertex_tint")) and dr.all(shape.has_attribute("vertex_other"))
        found.append([*tints, value])
    for mine, other in zip(*found, strict=True):
        same(mine, other, tolerance=1e-5)


def test_what_is_no_texture_of_a_shape() -> None:
    shape = djpt.load_dict({"type": "sphere"})
    with pytest.raises(SceneError, match=r"sphere\.x: a texture is expected, found Diffuse"):
        shape.add_texture_attribute("x", djpt.load_dict({"type": "diffuse"}))
    for call in (shape.texture_attribute, shape.remove_attribute):
        with pytest.raises(SceneError, match="sphere: there is no texture 'x'"):
            call("x")
    mesh = djpt.Mesh("square", SQUARE, [[0, 1, 2]])
    mesh.add_texture_attribute("x", djpt.load_dict({"type": "uniform", "value": 1.0}))
    mesh.add_attribute("vertex_y", 1, np.zeros(4))
    mesh.remove_attribute("x")
    mesh.remove_attribute("vertex_y")
    assert not mesh.has_attribute("x") and not mesh.has_attribute("vertex_y")

"""Attributes of meshes as textures."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import SceneError
from djpt.jit.types import Float
from tests.kit.axes import unit
from tests.kit.mesh_scenes import ball
from tests.kit.renders import ours, theirs
from tests.kit.textured_room import close, room


@pytest.fixture(scope="module")
def painted(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A ball with a colour per vertex and a number per face."""
    shape, random = ball(8), np.random.default_rng(3)
    attributes = {
        "vertex_color": random.random((len(shape["positions"]), 3)),
        "face_heat": random.random((len(shape["faces"]), 1)),
    }
    mesh = djpt.Mesh("ball", shape["positions"], shape["faces"], shape["normals"], shape["texcoords"], None, attributes)
    path = tmp_path_factory.mktemp("painted") / "ball.ply"
    mesh.write_ply(str(path))
    return str(path)


def painted_room(file: str, texture: Any, **nodes: Any) -> dict[str, Any]:
    mesh = {"type": "ply", "filename": file, "bsdf": {"type": "diffuse", "reflectance": texture}}
    return room(0.5, **{"mesh": {**mesh, "to_world": T().translate([0, 0, 1]).scale(0.6)}, **nodes})


COLOR, HEAT = ({"type": "mesh_attribute", "name": name} for name in ("vertex_color", "face_heat"))


@pytest.mark.parametrize(
    "texture",
    [COLOR, {**HEAT, "scale": 0.7}, {"type": "checkerboard", "color0": COLOR, "color1": HEAT}],
    ids=["vertex", "face", "both"],
)
@pytest.mark.sparse(3)
def test_attributes_of_meshes_are_mitsubas(painted: str, texture: dict[str, Any]) -> None:
    pytest.importorskip("mitsuba")
    scene = painted_room(painted, texture)
    assert close(ours(scene, 8), theirs(scene, 8)) > 0.98


@pytest.mark.parametrize("texture", [COLOR, HEAT], ids=["vertex", "face"])
def test_instances_show_the_attributes_of_their_mesh(painted: str, texture: dict[str, Any]) -> None:
    place = T().translate([0.2, 0, 1]).rotate(unit(1, 2, 3), 40).scale([0.6, 0.4, 0.5])
    bsdf = {"type": "diffuse", "reflectance": texture}
    mesh = {"type": "ply", "filename": painted, "bsdf": bsdf}
    direct = room(0.5, mesh={**mesh, "to_world": place})
    group = {"type": "shapegroup", "mesh": mesh}
    placed = {"type": "instance", "group": {"type": "ref", "id": "group"}, "to_world": place}
    assert close(ours(room(0.5, group=group, placed=placed), 4), ours(direct, 4)) > 0.95


def test_attributes_follow_their_edits(painted: str) -> None:
    scene = djpt.load_dict(painted_room(painted, {**HEAT, "scale": 0.5}))
    params = djpt.traverse(scene)
    params["mesh.face_heat"] = Float(np.zeros_like(np.array(params["mesh.face_heat"])))
    params.update()
    black = np.array(djpt.render(scene, spp=4))
    expected = np.array(djpt.render(djpt.load_dict(painted_room(painted, 0.0)), spp=4))
    np.testing.assert_allclose(black, expected, atol=1e-6)


def test_attributes_must_be_there_and_in_range(painted: str) -> None:
    def problem(texture: dict[str, Any], **nodes: Any) -> str:
        with pytest.raises(SceneError) as error:
            djpt.load_dict(painted_room(painted, texture, **nodes))
        return str(error.value)

    missing = {"type": "mesh_attribute", "name": "vertex_colour"}
    meant = "did you mean 'vertex_color'? (possible: vertex_color, face_heat)"
    assert f"the mesh 'mesh' has no attribute 'vertex_colour'; {meant}" in problem(missing)
    sphere = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": COLOR}}
    assert "'other' isn't a mesh, and has no attribute 'vertex_color'" in problem(COLOR, other=sphere)
    assert "mesh: 'vertex_color' must lie in [0, 1], found " in problem({**COLOR, "scale": 3})
    with pytest.raises(SceneError, match="'name' must begin with 'vertex_' or 'face_', found 'color'"):
        djpt.load_dict({"type": "mesh_attribute", "name": "color"})
    with pytest.raises(SceneError, match="a mesh attribute can't be the colour of a light"):
        djpt.load_dict({"type": "area", "radiance": {"type": "checkerboard", "color0": COLOR}})


def test_gradients_by_the_scale_of_an_attribute(painted: str) -> None:
    scene = djpt.load_dict(painted_room(painted, {**HEAT, "scale": 0.5}))
    params = djpt.traverse(scene)
    name = "mesh.bsdf.reflectance.scale"

    def loss() -> Any:
        return dr.mean(djpt.render(scene, params, spp=4, seed=2, seed_grad=2), axis=None)

    dr.enable_grad(params[name])
    params.update()
    dr.backward(loss())
    gradient = dr.grad(params[name])[0]
    ends = []
    for value in (0.55, 0.45):
        params.update({name: value})
        ends.append(float(loss().array[0]))
    assert gradient == pytest.approx((ends[0] - ends[1]) / 0.1, rel=0.01)

"""Meshes that scripts fill and ask by numbers: the same calls in Mitsuba give the same."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import ParameterError, SceneError

POSITIONS = [0, 0, 0, 1, 0, 0.5, 1, 1, 0, 0, 1, 0, 2, 0, 0]
FACES = [0, 1, 2, 0, 2, 3, 1, 4, 2]
TEXCOORDS = [0, 0, 1, 0, 1, 1, 0, 1, 2, 0]


def filled(mi: Any, normals: bool = True, texcoords: bool = True) -> Any:
    """A mesh made as scripts do: of counts, then by its parameters."""
    mesh = mi.Mesh("sheet", 5, 3, has_vertex_normals=normals, has_vertex_texcoords=texcoords)
    params = mi.traverse(mesh)
    params["vertex_positions"] = POSITIONS
    params["faces"] = FACES
    if texcoords:
        params["vertex_texcoords"] = TEXCOORDS
    params.update()
    return mesh


@pytest.fixture(scope="module")
def both() -> tuple[Any, Any]:
    djpt.types  # noqa: B018  (LLVM is chosen before Mitsuba loads Dr.Jit)
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    return filled(djpt), filled(mi)


CALLS: dict[str, Callable[[Any], Any]] = {
    "vertex_count": lambda m: m.vertex_count(),
    "face_count": lambda m: m.face_count(),
    "has_vertex_normals": lambda m: m.has_vertex_normals(),
    "has_vertex_texcoords": lambda m: m.has_vertex_texcoords(),
    "has_mesh_attributes": lambda m: m.has_mesh_attributes(),
    "has_face_normals": lambda m: m.has_face_normals(),
    "faces_buffer": lambda m: m.faces_buffer(),
    "vertex_positions_buffer": lambda m: m.vertex_positions_buffer(),
    "vertex_normals_buffer": lambda m: m.vertex_normals_buffer(),
    "vertex_texcoords_buffer": lambda m: m.vertex_texcoords_buffer(),
    "face_indices": lambda m: m.face_indices(dr.arange(djpt.UInt32, 3)),
    "edge_indices": lambda m: m.edge_indices(djpt.UInt32(0, 1, 2), djpt.UInt32(2, 1, 0)),
    "vertex_position": lambda m: m.vertex_position(index=djpt.UInt32(4, 1), active=djpt.Bool(True, False)),
    "vertex_normal": lambda m: m.vertex_normal(djpt.UInt32(0, 4)),
    "vertex_texcoord": lambda m: m.vertex_texcoord(djpt.UInt32(3, 4)),
    "face_normal": lambda m: m.face_normal(dr.arange(djpt.UInt32, 3)),
    "one number": lambda m: m.vertex_position(2),
    "surface_area": lambda m: m.surface_area(),
}


@pytest.mark.parametrize("call", CALLS)
def test_the_same_as_mitsuba(both: tuple[Any, Any], call: str) -> None:
    mine, theirs = (np.array(CALLS[call](mesh)) for mesh in both)
    np.testing.assert_allclose(mine, theirs, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("call", CALLS)
def test_a_cube_answers_as_mitsubas_mesh(call: str) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    mine, theirs = (
        np.array(
            CALLS[call](m.load_dict({"type": "cube", "to_world": m.ScalarTransform4f().rotate([0.6, 0.8, 0], 30)}))
        )
        for m in (djpt, mi)
    )
    np.testing.assert_allclose(mine, theirs, rtol=1e-5, atol=1e-6)


def test_a_cube_is_written_and_read(tmp_path: Path) -> None:
    cube = djpt.load_dict({"type": "cube", "to_world": djpt.ScalarTransform4f().translate([1, 2, 3])})
    cube.write_ply(tmp_path / "cube.ply")
    read = djpt.load_dict({"type": "ply", "filename": str(tmp_path / "cube.ply")})
    for name in ("vertex_positions", "vertex_normals", "vertex_texcoords", "faces"):
        np.testing.assert_array_equal(np.array(djpt.traverse(read)[name]), np.array(djpt.traverse(cube)[name]))
    pointer = djpt.MeshPtr([cube, djpt.load_dict({"type": "sphere"}), read])
    assert list(pointer.vertex_count()) == [24, 0, 24]
    assert list(cube.opposite_dedge(dr.arange(djpt.UInt32, 36))) == list(
        read.opposite_dedge(dr.arange(djpt.UInt32, 36))
    )


def test_neighbours(both: tuple[Any, Any]) -> None:
    edges = dr.arange(djpt.UInt32, 9)
    for mesh in both:
        mesh.build_directed_edges()
    assert list(both[0].opposite_dedge(edges)) == list(both[1].opposite_dedge(edges))


def test_vertices_that_rounding_parts_are_one() -> None:
    """Two squares side by side: they share an edge if its ends differ by rounding, but not if there is a gap."""
    upper = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32)
    lower = np.array([[0, -6e-17, 1e-16], [1, -1e-17, 0], [0, -1, 0], [1, -1, 0]], np.float32)
    faces = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5]])
    for gap, expected in ((0, 11), (1e-5, 0xFFFFFFFF)):
        mesh = djpt.Mesh("two", np.concatenate([upper, lower - [0, gap, 0]]).astype(np.float32), faces)
        assert np.array(mesh.joints[0])[0] == expected


def test_parameters_are_mitsubas(both: tuple[Any, Any]) -> None:
    mi = pytest.importorskip("mitsuba")
    ours, theirs = djpt.traverse(both[0]), dict(mi.traverse(both[1]))
    assert set(ours) == set(theirs)
    # The material, which both get, is reported in another place.
    assert [key for key in ours if not key.startswith("bsdf")] == [key for key in theirs if not key.startswith("bsdf")]


def test_attributes() -> None:
    mesh = filled(djpt)
    mesh.add_attribute("vertex_color", 3, [0.5] * 15)
    mesh.add_attribute("face_weight", 1, np.arange(3.0))
    assert mesh.has_mesh_attributes() and list(mesh.attribute_buffer("face_weight")) == [0, 1, 2]
    assert {"vertex_color", "face_weight"} <= set(djpt.traverse(mesh))
    mesh.remove_attribute("face_weight")
    assert "face_weight" not in djpt.traverse(mesh)
    for name, size, error in (
        ("color", 3, "must begin with 'vertex_' or 'face_'"),
        ("vertex_color", 3, "has another meaning"),
        ("vertex_more", 2, r"must have the shape \(5, 2\)"),
    ):
        with pytest.raises(SceneError, match=error):
            mesh.add_attribute(name, size, [0.5] * 15)
    with pytest.raises(ParameterError, match="has no attribute 'vertex_colour'; did you mean 'vertex_color'"):
        mesh.remove_attribute("vertex_colour")


def test_a_filled_mesh_is_the_mesh_of_its_arrays() -> None:
    """In a scene, with a material from `Properties`: the same image as one that was made of arrays."""
    props = djpt.Properties()
    props["any_name"] = djpt.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.9, 0.1, 0.1]}})
    mesh = djpt.Mesh("sheet", vertex_count=5, face_count=3, props=props)
    params = djpt.traverse(mesh)
    params["vertex_positions"], params["faces"] = djpt.Float(POSITIONS), djpt.UInt32(FACES)
    params.update()
    other = djpt.Mesh("sheet", POSITIONS, FACES, props={"bsdf": props["any_name"]})

    def image(shape: Any) -> Any:
        camera = {
            "type": "perspective",
            "to_world": djpt.ScalarTransform4f().look_at([1, 0.5, 4], [1, 0.5, 0], [0, 1, 0]),
        }
        film = {"type": "hdrfilm", "width": 16, "height": 16}
        scene = {"type": "scene", "shape": shape, "light": {"type": "constant"}, "camera": {**camera, "film": film}}
        return np.array(djpt.render(djpt.load_dict(scene), spp=4))

    filled_image = image(mesh)
    assert filled_image[..., 0].max() > 0.5 > filled_image[..., 1].min()
    np.testing.assert_array_equal(filled_image, image(other))
    with pytest.raises(ParameterError, match="add_attribute must be called before load_dict"):
        mesh.add_attribute("vertex_color", 3, [0.5] * 15)


def test_meshes_of_nothing() -> None:
    assert djpt.Mesh("none", 0, 0).face_count() == djpt.Mesh(djpt.Properties()).vertex_count() == 0
    mesh = filled(djpt, normals=False, texcoords=False)
    for call in (mesh.vertex_normal, mesh.vertex_texcoord):
        with pytest.raises(ParameterError, match="the mesh has no"):
            call(0)


@pytest.mark.parametrize("wrong", [-1, 2**32, 2**70, float("nan"), 1.0, "3", None, True], ids=str)
def test_counts_that_are_none(wrong: Any) -> None:
    with pytest.raises(SceneError, match=r"^none: 'face_count' must"):
        djpt.Mesh("none", 0, wrong)
    with pytest.raises(SceneError, match=r"^none: 'vertex_count' must"):
        djpt.Mesh("none", vertex_count=wrong, face_count=0)


def test_two_meshes_become_one(tmp_path: Path) -> None:
    mesh = filled(djpt)
    double = mesh.merge(mesh)
    assert (double.vertex_count(), double.face_count()) == (10, 6) and double.has_vertex_texcoords()
    assert float(double.surface_area()[0]) == pytest.approx(2 * float(mesh.surface_area()[0]))
    double.write_ply(tmp_path / "double.ply")
    assert djpt.load_dict({"type": "ply", "filename": str(tmp_path / "double.ply")}).face_count() == 6


def test_normals_on_demand() -> None:
    mesh = filled(djpt, normals=False)
    mesh.recompute_vertex_normals()
    np.testing.assert_allclose(np.array(mesh.vertex_normal(4)), np.array(filled(djpt).vertex_normal(4)), rtol=1e-6)


@pytest.mark.parametrize("corner", ["{0}/", "{0}//", "{0}/{0}/", "{0}/{0}"])
def test_corners_of_obj_files_may_end_in_a_slash(tmp_path: Path, corner: str) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf " + " ".join(corner.format(i) for i in (1, 2, 3))
    (tmp_path / "a.obj").write_text(text)
    mesh = djpt.load_dict({"type": "obj", "filename": str(tmp_path / "a.obj")})
    assert mesh.vertex_count() == 3 and mesh.has_vertex_texcoords() == ("/{0}" in corner)

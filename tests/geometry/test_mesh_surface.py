"""Meshes: what kernels see of them, against Mitsuba's answers for the same triangles and weights."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.records import Ray3f
from djpt.core.records.flags import SurfaceDetail
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import ParameterError, SceneError
from djpt.geometry.bvh.leaves import MeshPart
from djpt.jit.types import Float, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.meshes.mesh_set import MeshSet
from tests.kit.axes import unit
from tests.kit.mesh_scenes import ball_file, gallery
from tests.kit.meshes import bumpy_sheet, write_binary_ply

Array = np.ndarray
TURNED = T().translate([1, 2, 3]).rotate(unit(1, 2, 0), 50).scale([1, 2, 0.5])
MIRRORED = T().translate([0, 0, 1]).scale([-1, 1, 2])


def weights(faces: int, seed: int = 1) -> tuple[Array, Array]:
    """Faces and barycentric weights (2, N)."""
    rng = np.random.default_rng(seed)
    b = np.sort(rng.random((2, 400)), axis=0)
    return rng.integers(0, faces, 400).astype(np.uint32), np.stack([b[0], b[1] - b[0]]).astype(np.float32)


def fields(si: Any) -> dict[str, Array]:
    found = {name: np.array(getattr(si, name)) for name in ("p", "n", "uv", "dp_du", "dp_dv")}
    return found | {f"sh_frame.{k}": np.array(getattr(si.sh_frame, k)) for k in "stn"}


CASES = [(n, uv, flip, t) for n in (False, True) for uv in (False, True) for flip, t in ((False, T()), (True, TURNED))]


@pytest.mark.sparse(6)
@pytest.mark.parametrize(("normals", "uv", "flip", "to_world"), [*CASES, (True, True, False, MIRRORED)])
def test_surface_points_are_those_of_mitsuba(
    mi: Any, tmp_path: Path, normals: bool, uv: bool, flip: bool, to_world: T
) -> None:
    path = write_binary_ply(tmp_path / "sheet.ply", bumpy_sheet(), normals=normals, uv=uv)
    description = {
        "type": "ply", "filename": str(path), "face_normals": not normals, "flip_normals": flip, "to_world": to_world
    }  # fmt: skip
    mesh = djpt.load_dict(description)
    face, b = weights(len(mesh.indices))
    meshes = MeshSet([mesh])
    own = UInt32(face)
    ours = fields(meshes.surface(own, meshes.vertices(own), Float(b[0]), Float(b[1])))

    reference = mi.load_dict({**description, "to_world": mi.ScalarTransform4f(to_world.matrix)})
    pi = dr.zeros(mi.PreliminaryIntersection3f, len(face))
    pi.t, pi.prim_index, pi.prim_uv = mi.Float(1), mi.UInt32(face), mi.Point2f(b)
    si = reference.compute_surface_interaction(dr.zeros(mi.Ray3f, len(face)), pi, mi.RayFlags.All)
    si.initialize_sh_frame()
    theirs = fields(si)
    for name, value in theirs.items():
        np.testing.assert_allclose(ours[name], value, atol=2e-5 * max(1, np.abs(value).max()), err_msg=name)


@pytest.mark.parametrize(("normals", "uv", "flip"), [(False, False, False), (True, True, True)])
def test_points_of_a_light_are_drawn_as_by_mitsuba(
    mi: Any, tmp_path: Path, normals: bool, uv: bool, flip: bool
) -> None:
    path = write_binary_ply(tmp_path / "sheet.ply", bumpy_sheet(), normals=normals, uv=uv)
    description = {
        "type": "ply", "filename": str(path), "face_normals": not normals, "flip_normals": flip,
        "emitter": {"type": "area", "radiance": 1.0},
    }  # fmt: skip
    mesh = djpt.load_dict(description)
    meshes = MeshSet([djpt.Mesh("other", *triangle()), mesh])
    sample = np.random.default_rng(2).random((2, 1000)).astype(np.float32)
    ours = mesh.sample_position(0, Point2f(sample))
    theirs = mi.load_dict(description).sample_position(0.0, mi.Point2f(sample))
    for name in ("p", "n", "uv"):
        a, b = np.array(getattr(ours, name)), np.array(getattr(theirs, name))
        close = (np.abs(a - b) < 1e-4).all(axis=0)
        # A sample on the border between two triangles may go to either.
        assert (~close).sum() <= 2, name
    np.testing.assert_allclose(np.array(ours.pdf), theirs.pdf[0], rtol=1e-5)
    assert meshes.first_face == [0, 1]


def triangle() -> tuple[Array, Array]:
    return np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])


def test_points_of_a_light_are_uniform_in_area() -> None:
    # Areas 0, 1/2, 2, 0: faces without area are never chosen, the others by their area.
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 5], [0, 2, 5], [0, 0, 5]])
    mesh = djpt.Mesh("light", corners, [[0, 1, 2], [5, 3, 4]], props={"emitter": {"type": "area"}})
    params = djpt.traverse(mesh)
    params["faces"] = [0, 0, 1, 0, 1, 2, 5, 3, 4, 3, 3, 4]
    params.update()
    MeshSet([mesh])
    n = 1 << 14
    u = Point2f(dr.arange(Float, n) / n, Float((dr.arange(UInt32, n) * 7919) & (n - 1)) / n)
    p = np.array(mesh.sample_position(0, u).p)
    assert abs((p[2] == 5).mean() - 0.8) < 1e-3
    assert abs(p[0][p[2] == 5].mean() - 2 / 3) < 1e-2
    assert np.isfinite(p).all()
    assert dr.allclose(mesh.surface_area(), 2.5)


def test_meshes_with_and_without_vertex_data_share_a_set() -> None:
    sheet = bumpy_sheet()
    args = (sheet["positions"], sheet["faces"])
    variants = [
        djpt.Mesh("plain", *args),
        djpt.Mesh("smooth", *args, vertex_normals=sheet["normals"]),
        djpt.Mesh("mapped", *args, vertex_texcoords=sheet["texcoords"], props={"flip_normals": True}),
    ]
    alone = []
    face, b = weights(len(sheet["faces"]))
    for mesh in variants:
        meshes, own = MeshSet([mesh]), UInt32(face)
        alone.append(fields(meshes.surface(own, meshes.vertices(own), Float(b[0]), Float(b[1]))))
    together = MeshSet(variants)
    assert together.face_count == 3 * len(sheet["faces"])
    for first, expected in zip(together.first_face, alone, strict=True):
        own = UInt32(face + first)
        found = fields(together.surface(own, together.vertices(own), Float(b[0]), Float(b[1])))
        for name, value in expected.items():
            np.testing.assert_allclose(found[name], value, atol=1e-5, err_msg=name)


def test_a_set_has_the_corners_and_meshes_of_all_faces() -> None:
    first, second = djpt.Mesh("a", *triangle()), djpt.Mesh("b", triangle()[0] + 3, [[2, 1, 0], [0, 1, 2]])
    meshes = MeshSet([first, second])
    part = MeshPart(meshes.meshes, np.array([7, 8], np.uint32), 0)
    assert part.label_of_face().tolist() == [7, 8, 8]
    corners = part.corners()
    assert corners.dtype == np.float32
    assert corners.shape == (3, 3, 3)
    np.testing.assert_array_equal(corners[1], triangle()[0][[2, 1, 0]] + 3)
    p0, _, p2 = meshes.vertices(UInt32(1, 2))
    np.testing.assert_array_equal(np.array(p0).T, corners[1:, 0])
    np.testing.assert_array_equal(np.array(p2).T, corners[1:, 2])


def test_attributes_are_interpolated_over_vertices_and_constant_on_faces() -> None:
    positions, faces = triangle()
    coloured = djpt.Mesh(
        "a", positions, [*faces, *faces],
        attributes={"vertex_color": np.eye(3), "vertex_heat": [1, 2, 3], "face_id": [[7], [8]]},
    )  # fmt: skip
    meshes = MeshSet([djpt.Mesh("b", positions, faces), coloured])
    face, b1, b2 = UInt32(0, 1, 2), Float(0.25), Float(0.5)
    np.testing.assert_allclose(np.array(meshes.attribute("vertex_color", face, b1, b2)).T[1:], [[0.25, 0.25, 0.5]] * 2)
    np.testing.assert_allclose(np.array(meshes.attribute("vertex_heat", face, b1, b2)), [0, 2.25, 2.25])
    np.testing.assert_allclose(np.array(meshes.attribute("face_id", face, b1, b2)), [0, 7, 8])
    with pytest.raises(SceneError, match="no mesh has the attribute 'vertex_colour'; did you mean 'vertex_color'"):
        meshes.attribute("vertex_colour", face, b1, b2)


@pytest.mark.parametrize("uv", [[0, 0, 0, 0, 0, 0], [0, 0, 1, 1, 2, 2]])
def test_frames_are_right_angled_whatever_the_vertex_data(uv: list[float]) -> None:
    positions, faces = triangle()
    # Normals along dp/du, against one another, and away from the triangle.
    for normals in ([[1, 0, 0]] * 3, [[0, 0, 1], [0, 0, -1], [0, 0, 0]], [[0, 1, 0], [1, 0, 1], [0, 0, -1]]):
        mesh = djpt.Mesh("a", positions, faces, vertex_normals=normals, vertex_texcoords=np.reshape(uv, (3, 2)))
        meshes = MeshSet([mesh])
        f = meshes.surface(UInt32(0), meshes.vertices(UInt32(0)), Float(0.25), Float(0.5)).sh_frame
        axes = np.array([np.array(v).ravel() for v in (f.s, f.t, f.n)])
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-5)


def test_vertices_without_a_normal_take_that_of_the_triangle() -> None:
    positions, faces = triangle()
    mesh = djpt.Mesh("a", positions, faces, vertex_normals=np.zeros((3, 3)))
    meshes = MeshSet([mesh])
    surface = meshes.surface(UInt32(0), meshes.vertices(UInt32(0)), Float(0.2), Float(0.3))
    assert np.array(surface.sh_frame.n).ravel().tolist() == [0, 0, 1]


def test_a_mesh_knows_whether_it_is_closed() -> None:
    # Each face of a tetrahedron has vertices of its own, one of them at -0.
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    loose = corners[faces].reshape(-1, 3)
    loose[0] *= -1
    assert djpt.Mesh("closed", loose, np.arange(12).reshape(4, 3)).is_closed()
    assert not djpt.Mesh("open", loose, np.arange(9).reshape(3, 3)).is_closed()


# ---------------------------------------------------------------- parameters


def test_parameters_have_the_names_and_values_of_mitsuba(mi: Any, tmp_path: Path) -> None:
    path = write_binary_ply(tmp_path / "sheet.ply", bumpy_sheet())
    description = {"type": "ply", "filename": str(path), "bsdf": {"type": "diffuse"}}
    ours = djpt.traverse(djpt.load_dict(description))
    theirs = mi.traverse(mi.load_dict(description))
    assert list(ours.keys()) == [key for key, _ in theirs.items()]
    for key in ("faces", "vertex_positions", "vertex_normals", "vertex_texcoords"):
        np.testing.assert_allclose(np.array(ours[key]), np.array(theirs[key]), atol=1e-6, err_msg=key)
        discontinuous = bool(theirs.flags(key) & int(mi.ParamFlags.Discontinuous))
        assert discontinuous == bool(ours.flags(key) & djpt.ParamFlags.Discontinuous), key
        # Mitsuba also marks normals and texture coordinates, with respect to which nothing here has derivatives.
        assert ours.flags(key).differentiable == (key == "vertex_positions"), key
        assert ours.flags(key).differentiable <= (not theirs.flags(key) & int(mi.ParamFlags.NonDifferentiable)), key


def test_moved_vertices_get_new_normals_as_in_mitsuba(mi: Any, tmp_path: Path) -> None:
    path = write_binary_ply(tmp_path / "sheet.ply", bumpy_sheet(), normals=False)
    description = {"type": "ply", "filename": str(path)}
    mesh = djpt.load_dict(description)
    ours, theirs = djpt.traverse(mesh), mi.traverse(mi.load_dict(description))
    moved = bumpy_sheet(seed=5)["positions"]
    meshes = MeshSet([mesh])
    ours["vertex_positions"] = moved
    ours.update()
    theirs["vertex_positions"] = mi.Float(moved.ravel())
    theirs.update()
    np.testing.assert_allclose(np.array(ours["vertex_normals"]), np.array(theirs["vertex_normals"]), atol=1e-5)
    np.testing.assert_array_equal(mesh.positions, moved)
    assert mesh.interval(np.array([0.0, 0.0, 1.0])) == pytest.approx((moved[:, 2].min(), moved[:, 2].max()))
    meshes.refresh()
    every = dr.arange(UInt32, len(mesh.indices))
    np.testing.assert_array_equal(np.stack([np.array(p).T for p in meshes.vertices(every)], 1), moved[mesh.indices])


def test_normals_that_come_with_moved_vertices_are_kept_as_in_mitsuba(mi: Any) -> None:
    """Of a mesh that a script fills, and moves later with its normals, and without."""
    found = []
    for m in (djpt, mi):
        mesh = m.Mesh("sheet", 4, 2, has_vertex_normals=True)
        params, normals = m.traverse(mesh), []
        for size, z in ((1, 0.8), (2, -0.8), (3, None)):
            if size == 1:
                params["faces"] = [0, 1, 2, 1, 3, 2]
            params["vertex_positions"] = [size * x for x in (0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0)]
            if z is not None:
                params["vertex_normals"] = [0.6, 0, z] * 4
            params.update()
            normals.append(np.array(params["vertex_normals"]))
        found.append(normals)
    np.testing.assert_allclose(found[0], found[1], atol=1e-6)
    np.testing.assert_allclose(found[0][1][:3], [0.6, 0, -0.8], atol=1e-6)


def test_a_mesh_can_get_another_size() -> None:
    mesh = djpt.Mesh("m", *triangle(), vertex_texcoords=np.ones((3, 2)))
    params = djpt.traverse(mesh)
    params["vertex_positions"] = bumpy_sheet()["positions"]
    params["faces"] = bumpy_sheet()["faces"]
    with pytest.warns(UserWarning, match="vertex_texcoords: the size of the mesh has changed"):
        params.update()
    assert mesh.indices.shape == (32, 3)
    assert not mesh.texcoords.any()
    assert MeshSet([mesh]).face_count == 32


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("vertex_positions", [0.0, 1.0], r"2 numbers don't make rows of 3"),
        ("vertex_positions", np.full(9, np.nan), r"must be finite"),
        ("faces", [0, 1, 3], r"m.faces: face 0 refers to vertex 3; there are 3"),
        ("faces", [0.5, 1, 2], r"must be integers"),
        ("vertex_texcoords", [0.0, 1.0], r"must be 3 rows of 2, found 1"),
        ("vertex_normals", np.ones(12), r"must be 3 rows of 3, found 4"),
    ],
)
def test_edits_that_do_not_fit_are_refused_and_leave_the_mesh_as_it_was(name: str, value: Any, message: str) -> None:
    mesh = djpt.Mesh("m", *triangle(), vertex_texcoords=np.ones((3, 2)), vertex_normals=np.ones((3, 3)))
    before = {key: np.array(value) for key, value in djpt.traverse(mesh).items() if key != "silhouette_sampling_weight"}
    params = djpt.traverse(mesh)
    with pytest.raises(ParameterError, match=message):
        params[name] = value
        params.update()
    for key, old in before.items():
        np.testing.assert_array_equal(np.array(djpt.traverse(mesh)[key]), old, err_msg=key)
    np.testing.assert_array_equal(mesh.positions, triangle()[0])
    assert mesh.indices.tolist() == [[0, 1, 2]]


# ---------------------------------------------------------------- parts of surface points


@pytest.mark.parametrize("instanced", [False, True])
@pytest.mark.sparse(2)
def test_what_is_read_from_rows_is_what_follows_from_corners(tmp_path: Path, instanced: bool) -> None:
    description = gallery(tmp_path)
    if instanced:
        group = {"type": "shapegroup", "ball": {"type": "ply", "filename": ball_file(tmp_path)}}
        description = {"group": group, **description}
        for i, turned in enumerate((T().rotate(unit(1, 2, 0), 50).scale([0.4, 0.7, 0.5]), T().scale([-0.6, 0.5, 0.5]))):
            place = T().translate([-0.5 + i, 0.2, 0.9])
            description[f"copy{i}"] = {
                "type": "instance",
                "ref": {"type": "ref", "id": "group"},
                "to_world": place @ turned,
            }
    scene = djpt.load_dict(description)
    u = np.random.default_rng(3).random((2, 4000)).astype(np.float32) - 0.5
    ray = Ray3f(Point3f(0.3, 1.2, 4.5), dr.normalize(Vector3f(0.9 * u[0], 0.7 * u[1] - 0.2, -1)))
    pi = scene.closest_hit(ray)
    met = np.array(pi.is_valid())
    whole = fields(scene.surface_interaction(ray, pi))
    for detail, names in ((SurfaceDetail.FRAME, ()), (SurfaceDetail.UV, ("uv",))):
        found = fields(scene.surface_interaction(ray, pi, detail))
        for name in ("p", "n", *names):
            np.testing.assert_allclose(found[name][:, met], whole[name][:, met], atol=3e-5, err_msg=name)
        # Where uv is constant along an edge, so is the tangent, whatever rounding says.
        aligned = (found["sh_frame.s"] * whole["sh_frame.s"]).sum(axis=0)[met] > 1 - 1e-4
        assert aligned.mean() > 0.999
        np.testing.assert_allclose(found["sh_frame.n"][:, met], whole["sh_frame.n"][:, met], atol=1e-4)


@pytest.mark.parametrize(
    ("bsdf", "read"),
    [
        ({"type": "diffuse"}, SurfaceDetail.FRAME),
        ({"type": "roughplastic"}, SurfaceDetail.FRAME),
        ({"type": "diffuse", "reflectance": {"type": "checkerboard"}}, SurfaceDetail.UV),
        ({"type": "twosided", "inner": {"type": "plastic", "nonlinear": True}}, SurfaceDetail.FRAME),
        ({"type": "bumpmap", "texture": {"type": "checkerboard"}, "bsdf": {"type": "diffuse"}}, SurfaceDetail.PARTIALS),
        ({"type": "diffuse", "reflectance": {"type": "stripes"}}, SurfaceDetail.PARTIALS),
    ],
)
def test_scenes_compute_what_their_materials_read(bsdf: dict[str, Any], read: SurfaceDetail) -> None:
    assert djpt.load_dict({"type": "scene", "ball": {"type": "sphere", "bsdf": bsdf}}).surface_detail is read


def test_points_are_drawn_on_meshes_larger_than_the_lights() -> None:
    """Searches for a face take as many steps as lights need, unless a script asks another mesh."""
    sheet = bumpy_sheet()
    sample = Point2f(np.random.default_rng(4).random((2, 1000)).astype(np.float32))
    alone = djpt.Mesh("alone", sheet["positions"], sheet["faces"])
    MeshSet([alone])
    lamp = djpt.load_dict({"type": "rectangle", "emitter": {"type": "area", "radiance": 1.0}})
    lit = djpt.Mesh("lit", *triangle(), props={"emitter": lamp.emitter()})
    other = djpt.Mesh("other", sheet["positions"], sheet["faces"])
    both = MeshSet([lit, other])
    assert both.areas.steps == (1, len(sheet["faces"]).bit_length())
    np.testing.assert_array_equal(
        np.array(other.sample_position(0, sample).p), np.array(alone.sample_position(0, sample).p)
    )

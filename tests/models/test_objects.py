"""Anything with triangles as a scene, and that scene in Mitsuba."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import djpt
from djpt.models.formats import read_model
from tests.kit.gltf import quad

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float64)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


class OfOpen3D:
    """What of a legacy mesh of Open3D is looked at."""

    vertices, triangles, vertex_colors = VERTICES, FACES, np.zeros((0, 3))


class OfOpen3DTensors:
    """What of a tensor mesh of Open3D is looked at."""

    def __init__(self):
        self.vertex = {"positions": SimpleNamespace(numpy=lambda: VERTICES)}
        self.triangle = {"indices": SimpleNamespace(numpy=lambda: FACES)}


class OfPyvista:
    """What of a data set of pyvista is looked at."""

    points, faces = VERTICES, np.insert(FACES, 0, 3, axis=1).ravel()

    def extract_surface(self):
        return self

    def triangulate(self):
        return self


def things(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.Trimesh(VERTICES, FACES)
    colored = trimesh.Trimesh(VERTICES, FACES, vertex_colors=np.arange(16).reshape(4, 4) * 16)
    painted = trimesh.Trimesh(VERTICES, FACES, face_colors=np.arange(16).reshape(4, 4) * 16)
    (tmp_path / "a.glb").write_bytes(quad().glb())
    (tmp_path / "a.gltf").write_bytes(quad().gltf())
    for suffix in ("obj", "stl", "off", "ply", "3mf"):
        mesh.export(tmp_path / f"a.{suffix}")
    for path in sorted(tmp_path.iterdir()):
        yield path.name, path
    yield "text", str(tmp_path / "a.glb")
    yield "mesh", mesh
    yield "colours of vertices", colored
    yield "colours of faces", painted
    yield "scene", trimesh.Scene([mesh, colored])
    yield "arrays", (VERTICES, FACES)
    yield "object", SimpleNamespace(vertices=VERTICES, faces=FACES)
    yield "Mesh", djpt.Mesh("m", VERTICES, FACES)
    yield "open3d", OfOpen3D()
    yield "open3d tensors", OfOpen3DTensors()
    yield "pyvista", OfPyvista()
    yield "description", djpt.cornell_box()
    yield "shape", {"type": "sphere", "radius": 3}
    yield "Scene", djpt.load_dict(djpt.cornell_box())


def test_scenes_are_made_of_all_kinds_of_things(tmp_path):
    count = 0
    for name, x in things(tmp_path):
        scene = djpt.scene_of(x)
        assert scene.sensors() and scene.emitters() and len(scene.shapes()) > 1, name
        count += 1
    assert count >= 15


def test_show_returns_a_picture_without_a_display():
    description = djpt.cornell_box()
    description["sensor"]["film"] |= {"width": 8, "height": 8}
    assert np.asarray(djpt.show(description, spp=1)).shape == (8, 8, 3)


def test_what_has_no_triangles_is_refused():
    with pytest.raises(djpt.SceneError, match="scene_of: can't show int 7"):
        djpt.scene_of(7)
    with pytest.raises(djpt.SceneError, match="unknown parameter 'uq'"):
        djpt.scene_of((VERTICES, FACES), uq="z")


def test_meshes_of_others_keep_their_colours_and_normals():
    class Painted(OfOpen3D):
        vertex_colors, vertex_normals = np.full((4, 3), 0.5), np.tile([0, 0, 2.0], (4, 1))

    tensors = OfOpen3DTensors()
    tensors.vertex |= {"colors": SimpleNamespace(numpy=lambda: np.full((4, 3), 128, np.uint8))}
    surface = OfPyvista()
    surface.point_data = {"RGB": np.full((4, 3), 128, np.uint8), "Normals": np.tile([0, 0, 1.0], (4, 1))}
    for x, smooth in ((Painted(), True), (tensors, False), (surface, False)):
        mesh = djpt.models.objects.description_of(x)["part_0"]["data"]
        assert np.allclose(mesh.attributes["vertex_color"], 0.2140, atol=3e-3)
        assert (mesh.normals is not None and (mesh.normals == (0, 0, 1)).all()) == smooth


def test_shapes_without_a_box_are_refused():
    with pytest.raises(djpt.SceneError, match="'plane' has no box"):
        djpt.scene_of({"type": "plane"})


def test_what_is_too_far_away_is_refused():
    with pytest.raises(djpt.SceneError, match=r"mesh: coordinates reach 1e\+37; at most 1e\+30"):
        djpt.scene_of((1e37 * VERTICES, FACES))


@pytest.mark.parametrize("up", ["x", "y", "z", "-x", "-y", "-z"])
def test_the_camera_frames_the_model_and_stands_above_the_ground(up):
    description = djpt.models.objects.description_of((VERTICES, FACES), up=up)
    sensor = djpt.load_dict({**description["sensor"]})
    axis = np.zeros(3)
    axis["xyz".index(up[-1])] = -1 if up[0] == "-" else 1
    origin = np.array(sensor.to_world.matrix)[:3, 3]
    assert (origin - VERTICES.mean(axis=0)) @ axis > 0
    matrix = np.linalg.inv(np.array(sensor.to_world.matrix))
    seen = VERTICES @ matrix[:3, :3].T + matrix[:3, 3]
    slopes = np.abs(seen[:, :2] / seen[:, 2:])
    assert (seen[:, 2] > 0).all() and slopes[:, 1].max() < np.tan(np.radians(17.5))
    assert description["ground"]["to_world"].matrix[:3, 3] @ axis < (VERTICES @ axis).min() + 1e-9


def test_mitsuba_renders_what_was_written(tmp_path):
    file = quad()
    rng = np.random.default_rng(1)
    base = {"baseColorTexture": file.texture(rng.integers(0, 256, (4, 4, 3))), "roughnessFactor": 0.4}
    file.material |= {"pbrMetallicRoughness": base, "alphaMode": "MASK", "emissiveFactor": [0.1, 0.2, 0]}
    file.material["normalTexture"] = file.texture(np.uint8([[[140, 120, 250], [120, 140, 250]]]))
    (tmp_path / "quad.glb").write_bytes(file.glb())
    description = read_model(tmp_path / "quad.glb")
    description["sensor"]["film"] |= {"width": 24, "height": 18}
    djpt.write_dict(tmp_path / "quad.xml", description)
    ours = np.array(djpt.render(djpt.load_dict(description, optimize=False), spp=16, seed=3))
    from djpt.description.xml.reading import read_file
    from djpt.validation.bridge import mitsuba_renderer

    theirs = mitsuba_renderer(read_file(tmp_path / "quad.xml"), optimize=False)(16, 3)
    equal = np.isclose(ours, theirs, rtol=1e-2, atol=1e-3).all(axis=-1)
    assert equal.mean() > 0.97
    again = djpt.load_file(tmp_path / "quad.xml", optimize=False)
    assert np.array_equal(ours, np.array(djpt.render(again, spp=16, seed=3)))


@pytest.mark.slow
def test_compare_takes_models(tmp_path, monkeypatch):
    from click.testing import CliRunner

    from djpt.apps.cli.main import app

    file = quad()
    pixels = np.random.default_rng(1).integers(0, 256, (4, 4, 3))
    file.material["pbrMetallicRoughness"] = {"baseColorTexture": file.texture(pixels)}
    file.material["emissiveFactor"] = [0.5, 0, 0]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quad.glb").write_bytes(file.glb())
    options = ["--spp", "8", "--width", "16", "--height", "12", "--no-picture", "--same-seed", "0.97"]
    result = CliRunner().invoke(app, ["compare", "quad.glb", *options])
    assert result.exit_code == 0, result.output
    assert [path.name for path in tmp_path.iterdir()] == ["quad.glb"]

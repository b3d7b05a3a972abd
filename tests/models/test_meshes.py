"""Models that trimesh reads: OBJ with MTL."""

from __future__ import annotations

import warnings
import zipfile

import numpy as np
import pytest
from PIL import Image

import djpt
from djpt.models.formats import read_model
from djpt.models.objects import description_of
from tests.kit.gltf import png

pytest.importorskip("trimesh")

TWO_TRIANGLES = """mtllib a.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0.5 0.5
vn 0 0 1
vn 0 1 0
usemtl a
f 1/1/1 2/2/1 3/3/1
f 1/4/2 3/3/2 4/1/2
"""


def read(folder, mtl, obj=TWO_TRIANGLES):
    (folder / "a.mtl").write_text("newmtl a\nKd 0.2 0.4 0.6\n" + mtl)
    (folder / "a.obj").write_text(obj)
    return read_model(folder / "a.obj")


def material(description):
    (name,) = (key for key in description if key.startswith("material"))
    return description[name]


def test_corners_keep_their_texture_coordinates_and_normals(tmp_path):
    mesh = read(tmp_path, "")["part_0"]["data"]
    corners = mesh.indices.ravel()
    uv = np.float32([[0, 0], [1, 0], [1, 1], [0.5, 0.5], [1, 1], [0, 0]])
    assert np.array_equal(mesh.texcoords[corners] * (1, -1) + (0, 1), uv)
    assert np.array_equal(mesh.normals[corners], np.float32([[0, 0, 1]] * 3 + [[0, 1, 0]] * 3))


@pytest.mark.parametrize(
    ("mtl", "opacity"),
    [("", None), ("d 1", None), ("d 0.25", 0.25), ("Tr 0.25", 0.75), ("Tr 1", None), ("Tr 1\nd 0.5", 0.5), ("d", None)],
)
def test_opacity(tmp_path, mtl, opacity):
    assert material(read(tmp_path, mtl)).get("opacity") == opacity


def test_a_texture_is_found_and_a_missing_one_is_said(tmp_path):
    (tmp_path / "a.png").write_bytes(png([[[255, 0, 0]]]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = material(read(tmp_path, "map_Kd .\\a.png"))
    assert found["bsdf"]["base_color"]["bitmap"].tolist() == [[[255, 0, 0]]]
    with pytest.warns(UserWarning, match="texture is left out: 'b.png' doesn't exist"):
        lacking = material(read(tmp_path, "map_Kd b.png"))
    assert np.allclose(lacking["bsdf"]["base_color"]["value"], [0.2, 0.4, 0.6], atol=1 / 255)


def test_texture_coordinates_without_a_material_are_grey(tmp_path):
    found = material(read(tmp_path, "", TWO_TRIANGLES.replace("mtllib a.mtl", "").replace("usemtl a", "")))
    assert found["bsdf"]["base_color"] == {"type": "rgb", "value": [0.6] * 3}


def test_colours_of_3mf_are_said_to_be_left_out(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box().export(tmp_path / "a.3mf")
    with zipfile.ZipFile(tmp_path / "a.3mf") as archive:
        text = archive.read("3D/3dmodel.model").decode()
    with zipfile.ZipFile(tmp_path / "a.3mf", "a") as archive:
        archive.writestr("3D/other.model", text.replace("<resources>", "<resources><!-- colorgroup -->"))
    with pytest.warns(UserWarning, match="materials and colours of 3MF are left out"):
        read_model(tmp_path / "a.3mf")


def test_emission(tmp_path):
    assert read(tmp_path, "Ke 0 2 1")["part_0"]["emitter"]["radiance"]["value"] == [0, 2, 1]
    assert "emitter" not in read(tmp_path, "Ke 0 0 0")["part_0"]


@pytest.mark.parametrize("huge", [False, True])
def test_textures_that_cant_be_decoded_are_named(tmp_path, huge):
    (tmp_path / "m.mtl").write_text("newmtl a\nmap_Kd t.png\n")
    (tmp_path / "m.obj").write_text("mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\n")
    if huge:
        Image.new("1", (5000, 5000)).save(tmp_path / "t.png")
        with pytest.warns(UserWarning, match=r"left out: t\.png has 5000 x 5000 pixels, too many for its size"):
            read_model(tmp_path / "m.obj")
        return
    (tmp_path / "t.png").write_bytes(png(np.random.default_rng(0).integers(0, 255, (16, 16, 3)))[:200])
    with pytest.raises(djpt.SceneError, match=r"m\.obj: a texture can't be read"):
        read_model(tmp_path / "m.obj")


def test_a_metallic_roughness_material_of_trimesh_is_that_of_gltf():
    trimesh = pytest.importorskip("trimesh")
    images = {
        "baseColorTexture": [[[255, 0, 0, 255], [0, 255, 0, 0]]],
        "metallicRoughnessTexture": [[[0, 255, 255, 255], [0, 0, 0, 255]]],
        "normalTexture": [[[128, 228, 200, 255], [128, 128, 255, 255]]],
        "emissiveTexture": [[[255, 255, 255, 255], [0, 0, 0, 255]]],
    }
    material = trimesh.visual.material.PBRMaterial(
        **{name: Image.fromarray(np.uint8(pixels)) for name, pixels in images.items()},
        **{"roughnessFactor": 0.5, "emissiveFactor": [0, 2, 0], "alphaMode": "MASK"},
    )
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]]
    uv = [[0, 0], [1, 0], [0, 1], [0, 0], [-1, 0], [0, 1]]  # the second triangle has a mirrored texture
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    scene = description_of(trimesh.Trimesh(corners, [[0, 1, 2], [3, 4, 5]], visual=visual, process=False))
    nodes = [scene[scene[f"part_{i}"]["bsdf"]["id"]] for i in range(2)]
    assert [node["opacity"]["bitmap"].ravel().tolist() for node in nodes] == [[255, 0]] * 2
    normals = [node["bsdf"]["bsdf"]["normalmap"]["bitmap"][0, 0].tolist() for node in nodes]
    assert normals == [[128, 228, 200], [128, 27, 200]]
    node = nodes[0]["bsdf"]["bsdf"]["bsdf"]
    assert node["roughness"]["bitmap"].ravel().tolist() == [128, 0]
    assert node["metallic"]["bitmap"].ravel().tolist() == [255, 0]
    assert scene["part_0"]["emitter"]["radiance"]["data"][0].tolist() == [[0, 2, 0], [0, 0, 0]]
    plain = trimesh.visual.material.PBRMaterial(baseColorFactor=[0.2, 0.4, 0.6, 1], metallicFactor=0)
    visual = trimesh.visual.TextureVisuals(material=plain)
    color = description_of(trimesh.Trimesh(corners, [[0, 1, 2]], visual=visual))["material_0"]["bsdf"]["base_color"]
    assert np.allclose(color["value"], [0.2, 0.4, 0.6], atol=1e-6)  # linear, as in glTF

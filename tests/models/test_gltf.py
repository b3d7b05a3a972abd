"""Models in glTF: each feature by what it makes of a quad."""

from __future__ import annotations

import json
import math
import warnings

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.models.atlas import resolve_coordinates
from djpt.models.folder import Folder
from djpt.models.formats import read_model
from djpt.models.gltf import read_gltf
from tests.kit.gltf import glb, quad

CHECKS = np.uint8([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]])


def read(file, tmp_path, **parameters):
    model = read_gltf(file.glb(), Folder(tmp_path), "quad.glb", **parameters)
    resolve_coordinates(model)
    return model


def bsdf(model):
    node = model.nodes[model.parts[0].bsdf]
    while "bsdf" in node:
        node = node["bsdf"]
    return node


def test_both_containers_give_the_same_mesh(tmp_path):
    file = quad()
    a = read(file, tmp_path)
    b = read_gltf(file.gltf(), Folder(tmp_path), "quad.gltf")
    assert np.array_equal(a.parts[0].mesh.positions, b.parts[0].mesh.positions)
    assert a.parts[0].mesh.indices.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_a_model_renders_the_texture_the_right_way_up(tmp_path):
    file = quad()
    file.material["pbrMetallicRoughness"] = {"baseColorTexture": file.texture(CHECKS, magFilter=9728)}
    file.json["cameras"] = [{"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "znear": 0, "zfar": 9}}]
    file.json["nodes"].append({"camera": 0, "translation": [0, 0, 3]})
    file.json["scenes"][0]["nodes"].append(1)
    (tmp_path / "quad.glb").write_bytes(file.glb())
    scene = read_model(tmp_path / "quad.glb")
    scene["sensor"]["film"] |= {"width": 8, "height": 8}
    scene["integrator"] = {"type": "aov", "aovs": "c:albedo"}
    # 4:3 is the aspect of the camera; the quad is its middle.
    image = np.array(djpt.render(djpt.load_dict(scene), spp=4))[..., -3:]
    corners = image[2, 2], image[2, 5], image[5, 2], image[5, 5]
    assert np.allclose(corners, [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], atol=0.01)


def test_metallic_roughness_multiplies_factors_and_channels(tmp_path):
    file = quad()
    rough = np.zeros((1, 2, 3), np.uint8)
    rough[..., 1], rough[..., 2] = (100, 200), 51
    base = {"metallicRoughnessTexture": file.texture(rough), "roughnessFactor": 0.5, "baseColorFactor": [0.2, 1, 1, 1]}
    file.material["pbrMetallicRoughness"] = base
    node = bsdf(read(file, tmp_path))
    assert node["roughness"]["bitmap"].ravel().tolist() == [50, 100]
    assert node["metallic"] == pytest.approx(0.2)
    assert node["base_color"]["value"] == [0.2, 1, 1]


@pytest.mark.parametrize(("mode", "opacity"), [("OPAQUE", None), ("MASK", 0.0), ("BLEND", 0.25)])
def test_alpha_modes(tmp_path, mode, opacity):
    file = quad()
    file.material |= {"alphaMode": mode, "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.25]}}
    model = read(file, tmp_path)
    assert model.nodes[model.parts[0].bsdf].get("opacity") == opacity


def test_the_index_of_refraction_and_the_specular_factor_give_the_reflectance(tmp_path):
    file = quad()
    file.material["extensions"] = {"KHR_materials_ior": {"ior": 2}, "KHR_materials_specular": {"specularFactor": 0.25}}
    eta = bsdf(read(file, tmp_path))["eta"]
    assert ((eta - 1) / (eta + 1)) ** 2 == pytest.approx(0.25 / 9)


def test_a_reflection_has_its_colour_on_a_dark_dielectric(tmp_path):
    file = quad()
    file.material["extensions"] = {"KHR_materials_specular": {"specularColorFactor": [1, 1, 0]}}
    base = file.material.setdefault("pbrMetallicRoughness", {})
    base |= {"baseColorFactor": [0, 0, 0, 1], "metallicFactor": 0}
    node = bsdf(read(file, tmp_path))
    color = np.array(node["base_color"]["value"])
    assert node["spec_tint"] == 1 and color[0] == color[1] > color[2] == 0
    reflectance = ((node["eta"] - 1) / (node["eta"] + 1)) ** 2 * color / (color @ (0.212671, 0.715160, 0.072169))
    assert np.allclose(reflectance, [0.04, 0.04, 0])


def test_a_sheen_has_its_colour_on_dark_cloth_and_is_white_on_bright_one(tmp_path):
    file = quad()
    sheen = np.array([0.05, 0.17, 0.5])
    file.material["extensions"] = {"KHR_materials_sheen": {"sheenColorFactor": sheen.tolist()}}
    base = file.material.setdefault("pbrMetallicRoughness", {})
    base |= {"baseColorFactor": [0.01, 0.01, 0.01, 1], "metallicFactor": 0}
    node = bsdf(read(file, tmp_path))
    color = np.array(node["base_color"]["value"])
    weights = np.array([0.212671, 0.715160, 0.072169])
    assert node["sheen_tint"] == 1 and 0 < (color @ weights) < 0.01
    assert np.allclose(node["sheen"] * color / (color @ weights), sheen)
    base["baseColorTexture"] = file.texture(np.uint8([[[9, 9, 9], [40, 40, 40]]]))
    base["baseColorFactor"] = [1, 1, 1, 1]
    texels = bsdf(read(file, tmp_path))["base_color"]["bitmap"].astype(int)
    assert (texels[..., 2] > texels[..., 1]).all() and (texels[..., 1] > texels[..., 0]).all()
    del base["baseColorTexture"]
    base["baseColorFactor"] = [0.8, 0.7, 0.6, 1]
    with pytest.warns(UserWarning, match="sheen is replaced by white"):
        node = bsdf(read(file, tmp_path))
    assert "sheen_tint" not in node and node["sheen"] == pytest.approx(0.24)


def test_a_volume_absorbs_what_its_colour_says(tmp_path):
    file = quad()
    volume = {"thicknessFactor": 1, "attenuationDistance": 2, "attenuationColor": [0.5, 1, 0.25]}
    file.material["extensions"] = {
        "KHR_materials_transmission": {"transmissionFactor": 1},
        "KHR_materials_volume": volume,
    }
    model = read(file, tmp_path)
    medium = model.nodes[model.parts[0].interior]
    sigma = medium["scale"] * np.array(medium["sigma_t"]["value"])
    assert np.allclose(np.exp(-2 * sigma), [0.5, 1, 0.25])
    assert bsdf(model)["type"] == "principled" and bsdf(model)["spec_trans"] == 1


def test_a_sheet_without_thickness_is_thin(tmp_path):
    file = quad()
    file.material["pbrMetallicRoughness"] = {"metallicFactor": 0}
    file.material["extensions"] = {"KHR_materials_transmission": {"transmissionFactor": 0.5}}
    assert bsdf(read(file, tmp_path))["type"] == "principledthin"


def test_mirrored_triangles_have_a_normal_map_of_their_own(tmp_path):
    file = quad()
    file.material["normalTexture"] = file.texture(np.uint8([[[128, 200, 255]]]))
    file.primitive["attributes"]["TEXCOORD_0"] = file.accessor(np.float32([[0, 1], [1, 1], [1, 0], [2, 1]]), "VEC2")
    model = read(file, tmp_path)
    greens = {int(model.nodes[part.bsdf]["bsdf"]["normalmap"]["bitmap"][0, 0, 1]) for part in model.parts}
    assert len(model.parts) == 2 and greens == {200, 55}
    assert sum(len(part.mesh.indices) for part in model.parts) == 2


def test_a_texture_transform_moves_the_lookup(tmp_path):
    file = quad()
    moved = {"offset": [0.25, 0], "rotation": math.pi / 2, "scale": [2, 1]}
    reference = file.texture(CHECKS) | {"extensions": {"KHR_texture_transform": moved}}
    file.material["pbrMetallicRoughness"] = {"baseColorTexture": reference}
    matrix = bsdf(read(file, tmp_path))["base_color"]["to_uv"].matrix
    assert np.allclose((matrix @ [0.5, 0, 0, 1])[:2], [0.25, -1])


def test_quantised_and_sparse_accessors(tmp_path):
    file = quad()
    plain = np.int16([[-32767, -32767, 0], [32767, -32767, 0], [32767, 32767, 0], [0, 0, 0]])
    sparse = {"count": 1, "indices": {"bufferView": file.view(np.uint8([3]).tobytes()), "componentType": 5121}}
    sparse["values"] = {"bufferView": file.view(np.int16([-32767, 32767, 0]).tobytes())}
    positions = file.accessor(plain, "VEC3", normalized=True, sparse=sparse)
    file.primitive["attributes"]["POSITION"] = positions
    found = read(file, tmp_path).parts[0].mesh.positions
    assert np.allclose(found, [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])


def test_an_animation_is_read_at_a_time(tmp_path):
    file = quad()
    times = file.accessor(np.float32([0, 2]), "SCALAR")
    half = math.sqrt(0.5)
    turns = file.accessor(np.float32([[0, 0, 0, 1], [0, 0, half, half]]), "VEC4")
    channel = {"sampler": 0, "target": {"node": 0, "path": "rotation"}}
    file.json["animations"] = [{"channels": [channel], "samplers": [{"input": times, "output": turns}]}]
    place = read(file, tmp_path, time=1.0).parts[0].places[0]
    assert np.allclose(place[:2, 0], [half, half])
    assert np.allclose(read(file, tmp_path).parts[0].places[0], np.eye(4))


def test_skins_and_morph_targets(tmp_path):
    file = quad()
    attributes = file.primitive["attributes"]
    attributes["JOINTS_0"] = file.accessor(np.uint8([[0, 1, 0, 0]] * 4), "VEC4")
    attributes["WEIGHTS_0"] = file.accessor(np.float32([[0.5, 0.5, 0, 0]] * 4), "VEC4")
    shift = np.float32([[0, 0, 1]] * 4)
    file.primitive["targets"] = [{"POSITION": file.accessor(shift, "VEC3")}]
    file.node |= {"skin": 0, "weights": [2], "translation": [9, 9, 9]}  # a skinned node's own place doesn't count
    file.json["nodes"] += [{"translation": [4, 0, 0]}, {"translation": [0, 2, 0]}]
    file.json["scenes"][0]["nodes"] += [1, 2]
    file.json["skins"] = [{"joints": [1, 2]}]
    part = read(file, tmp_path).parts[0]
    assert np.allclose(part.mesh.positions[0], [-1 + 2, -1 + 1, 2])
    assert np.allclose(part.places[0], np.eye(4))


def test_nodes_of_one_mesh_are_places_of_one_part(tmp_path):
    file = quad()
    file.json["nodes"].append({"mesh": 0, "translation": [3, 0, 0]})
    file.json["scenes"][0]["nodes"].append(1)
    part = read(file, tmp_path).parts
    assert len(part) == 1 and [place[0, 3] for place in part[0].places] == [0, 3]


def test_variants_and_lights(tmp_path):
    file = quad()
    file.json["materials"].append({"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}})
    file.json["extensions"] = {
        "KHR_materials_variants": {"variants": [{"name": "red"}]},
        "KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 5, "color": [1, 0.5, 0]}]},
    }
    mapping = {"material": 1, "variants": [0]}
    file.primitive["extensions"] = {"KHR_materials_variants": {"mappings": [mapping]}}
    file.node["extensions"] = {"KHR_lights_punctual": {"light": 0}}
    model = read(file, tmp_path, variant="red")
    assert bsdf(model)["base_color"]["value"] == [1, 0, 0]
    assert [light["intensity"]["value"] for light in model.lights.values()] == [[5, 2.5, 0]]
    with pytest.raises(djpt.SceneError, match=r"no variant 'blue'; found: red"):
        read(file, tmp_path, variant="blue")


def test_vertex_colours(tmp_path):
    file = quad()
    colors = np.float32([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
    file.primitive["attributes"]["COLOR_0"] = file.accessor(colors, "VEC3")
    model = read(file, tmp_path)
    assert np.array_equal(model.parts[0].mesh.attributes["vertex_color"], colors)
    assert bsdf(model)["base_color"] == {"type": "mesh_attribute", "name": "vertex_color"}


def test_what_is_left_out_is_said_once(tmp_path):
    file = quad()
    file.json["materials"] *= 2
    file.material["extensions"] = {"KHR_materials_iridescence": {"iridescenceFactor": 1}}
    file.json["meshes"][0]["primitives"].append({**file.primitive, "material": 1})
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        read(file, tmp_path)
    assert [str(w.message) for w in found] == [
        "quad.glb: 'KHR_materials_iridescence' is left out: a plain interface stands in its place"
    ]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.json.update(extensionsRequired=["X_y"]), "requires X_y, which can't be read"),
        (lambda f: f.json["nodes"][0].update(children=[0]), r"nodes\[0\] stands in two places"),
        (lambda f: f.json["accessors"][0].update(count=10**6), "reaches over the end"),
        (lambda f: f.node.update(mesh=7), r"meshes\[7\] doesn't exist; there are 1"),
        (lambda f: f.json["asset"].update(version="1.0"), r"is glTF 1\.0; version 2 can be read"),
    ],
)
def test_damage_is_named(tmp_path, change, message):
    file = quad()
    change(file)
    with pytest.raises(djpt.SceneError, match=f"^quad.glb: .*{message}"):
        read(file, tmp_path)


@pytest.mark.parametrize("name", ["../secret.bin", "/etc/passwd", "link.bin"])
def test_no_file_outside_of_the_folder_is_read(tmp_path, name):
    (tmp_path / "secret.bin").write_bytes(b"\0" * 1000)
    folder = tmp_path / "model"
    folder.mkdir()
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    file = quad()
    file.json["buffers"] = [{"byteLength": 1000, "uri": name}]
    (folder / "quad.gltf").write_text(json.dumps(file.json))
    with pytest.raises(djpt.SceneError, match="which a model may not leave"):
        djpt.load_file(folder / "quad.gltf")


def test_parameters_are_checked(tmp_path):
    (tmp_path / "quad.glb").write_bytes(quad().glb())
    with pytest.raises(djpt.SceneError, match="unknown parameter 'tme'; did you mean 'time'"):
        djpt.load_file(tmp_path / "quad.glb", tme=1)
    with pytest.raises(djpt.SceneError, match="'up' must be one of"):
        djpt.load_file(tmp_path / "quad.glb", up="w")


def test_an_empty_file_has_nothing_to_see(tmp_path):
    (tmp_path / "empty.glb").write_bytes(glb({"asset": {"version": "2.0"}}, b""))
    with pytest.raises(djpt.SceneError, match="nothing to see"):
        djpt.load_file(tmp_path / "empty.glb")


def test_errors_of_the_scene_name_the_file(tmp_path):
    file = quad()
    file.primitive["attributes"]["POSITION"] = file.accessor(np.zeros((4, 3), np.float32), "VEC3")
    (tmp_path / "flat.glb").write_bytes(file.glb())
    with pytest.raises(djpt.SceneError, match=r"flat\.glb.*part_0.*2 without area"):
        djpt.load_file(tmp_path / "flat.glb")


@pytest.mark.parametrize("u", ["clamp", "mirror", "repeat"])
@pytest.mark.parametrize("v", ["clamp", "mirror", "repeat"])
def test_textures_wrap_by_themselves_along_u_and_v(tmp_path, u, v):
    codes = {"clamp": 33071, "mirror": 33648, "repeat": 10497}
    file = quad()
    pixels = np.random.default_rng(2).integers(0, 256, (3, 2, 3))
    info = file.texture(pixels, wrapS=codes[u], wrapT=codes[v], magFilter=9728)
    file.material["pbrMetallicRoughness"] = {"baseColorTexture": info}
    node = bsdf(read(file, tmp_path))["base_color"]
    texture = djpt.load_dict({**node, "raw": True})
    # Texel centres of the nine periods around [0, 1]^2.
    x, y = np.meshgrid(np.arange(-2, 4), np.arange(-3, 6))
    si = dr.zeros(djpt.SurfaceInteraction3f, x.size)
    si.uv = djpt.Point2f(((x.ravel() + 0.5) / 2).astype(np.float32), ((y.ravel() + 0.5) / 3).astype(np.float32))
    found = np.array(texture.eval(si)).T if node["type"] == "bitmap" else None

    def wrapped(index, count, mode):
        if mode == "clamp":
            return np.clip(index, 0, count - 1)
        period = index % (2 * count)
        return np.where(period < count, period, 2 * count - 1 - period) if mode == "mirror" else index % count

    expected = pixels[wrapped(y.ravel(), 3, v), wrapped(x.ravel(), 2, u)] / 255
    assert np.allclose(found, expected, atol=1e-5)


def test_specular_glossiness_becomes_metallic_roughness_texel_by_texel(tmp_path):
    file = quad()
    # A red dielectric, and gold.
    diffuse = file.texture(np.uint8([[[200, 0, 0], [0, 0, 0]]]))
    specular = file.texture(np.uint8([[[56, 56, 56, 51], [255, 200, 90, 204]]]))
    gloss = {"diffuseTexture": diffuse, "specularGlossinessTexture": specular}
    file.material["extensions"] = {"KHR_materials_pbrSpecularGlossiness": gloss}
    node = bsdf(read(file, tmp_path))
    texels = {name: node[name]["bitmap"][0] for name in ("base_color", "metallic", "roughness")}
    assert np.allclose(texels["base_color"], [[200, 0, 0], [255, 200, 90]], atol=3)
    assert np.allclose(texels["metallic"][:, 0], [0, 255], atol=3)
    assert texels["roughness"][:, 0].tolist() == [204, 51]


def test_a_clear_coat_is_as_rough_as_its_texture(tmp_path):
    file = quad()
    rough = np.zeros((1, 2, 3), np.uint8)
    rough[0, 1, 1] = 255
    coat = {"clearcoatFactor": 1, "clearcoatRoughnessFactor": 0.2, "clearcoatRoughnessTexture": file.texture(rough)}
    file.material["extensions"] = {"KHR_materials_clearcoat": coat}
    gloss = bsdf(read(file, tmp_path))["clearcoat_gloss"]["bitmap"].ravel() / 255
    assert 0.1 + gloss[0] * (0.001 - 0.1) == pytest.approx(0.001, abs=1e-3)
    assert 0.1 + gloss[1] * (0.001 - 0.1) == pytest.approx(0.2**2, abs=1e-3)


def test_a_body_that_absorbs_one_colour_not_at_all_is_finite(tmp_path):
    file = quad()
    volume = {"thicknessFactor": 1, "attenuationColor": [0.1, 0.5, 1], "attenuationDistance": 0.1}
    transmission = {"transmissionFactor": 1}
    file.material["extensions"] = {"KHR_materials_volume": volume, "KHR_materials_transmission": transmission}
    (tmp_path / "quad.glb").write_bytes(file.glb())
    scene = read_model(tmp_path / "quad.glb")
    scene["sensor"]["film"] |= {"width": 8, "height": 6}
    assert np.isfinite(np.array(djpt.render(djpt.load_dict(scene), spp=8))).all()


@pytest.mark.parametrize(("kind", "staged"), [("directional", True), ("point", False)])
def test_distant_lights_alone_leave_the_sky(tmp_path, kind, staged):
    file = quad()
    file.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": kind}]}}
    file.node["extensions"] = {"KHR_lights_punctual": {"light": 0}}
    (tmp_path / "quad.glb").write_bytes(file.glb())
    assert ("sky" in read_model(tmp_path / "quad.glb")) == staged


def aov(description, what, size=8):
    """An image of the quad's diffuse colour (``albedo``) or its normals (``sh_normal``), seen from above."""
    camera = {"type": "orthographic", "to_world": djpt.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0])}
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    shape = description["part_0"]
    surface = description[shape["bsdf"]["id"]]["bsdf"]  # within `twosided`
    if what == "albedo":
        surface = {"type": "diffuse", "reflectance": surface["base_color"]}
    integrator = {"type": "aov", "aovs": f"x:{what}"}
    scene = {"type": "scene", "shape": {**shape, "bsdf": surface}, "sensor": {**camera, "film": film}}
    return np.array(djpt.render(djpt.load_dict({**scene, "integrator": integrator}), spp=64, seed=1))[..., -3:]


def test_two_sets_of_texture_coordinates_become_one_atlas(tmp_path):
    file = quad()
    image = np.random.default_rng(0).integers(60, 200, (4, 4, 3))
    file.material["pbrMetallicRoughness"] = {"baseColorTexture": file.texture(image), "roughnessFactor": 1}
    (tmp_path / "quad.glb").write_bytes(file.glb())
    plain = aov(read_model(tmp_path / "quad.glb"), "albedo")
    file.primitive["attributes"]["TEXCOORD_1"] = file.accessor(np.float32([[0, 2], [2, 2], [2, 0], [0, 0]]), "VEC2")
    rough = file.texture(np.random.default_rng(1).integers(0, 255, (4, 4, 3))) | {"texCoord": 1}
    file.material["pbrMetallicRoughness"]["metallicRoughnessTexture"] = rough
    file.material["pbrMetallicRoughness"]["metallicFactor"] = 0
    (tmp_path / "quad.glb").write_bytes(file.glb())
    description = read_model(tmp_path / "quad.glb")
    mesh = description["part_0"]["data"]
    assert len(mesh.positions) == 6 and mesh.texcoords.min() >= 0 and mesh.texcoords.max() <= 1
    # The atlas has texels of its own, between which it interpolates, over twice the texture's: colours are near.
    assert np.abs(aov(description, "albedo") - plain).max() < 0.03


def test_colours_of_vertices_multiply_textures(tmp_path):
    file = quad()
    texture = np.full((2, 2, 3), 255)
    texture[0, :, 1:] = 0
    base = {"baseColorTexture": file.texture(texture, magFilter=9728), "metallicFactor": 0}
    file.material["pbrMetallicRoughness"] = base
    colors = np.float32([[1, 1, 1], [0, 0, 0], [0, 0, 0], [1, 1, 1]])  # black at the right
    file.primitive["attributes"]["COLOR_0"] = file.accessor(colors, "VEC3")
    (tmp_path / "quad.glb").write_bytes(file.glb())
    found = aov(read_model(tmp_path / "quad.glb"), "albedo", 4)
    ramp = 1 - (np.arange(4) + 0.5) / 4
    assert np.allclose(found[0, :, 0], ramp, atol=0.02) and np.allclose(found[0, :, 1:], 0, atol=0.02)
    assert np.allclose(found[3], ramp[:, None], atol=0.02)


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [1, 2, 3, 0], [3, 2, 1, 0]])
def test_an_atlas_keeps_the_normals_of_normal_maps(tmp_path, order):
    file = quad()
    file.material["normalTexture"] = file.texture(np.uint8([[[180, 150, 230]]]))
    corners = np.float32([[0, 1], [1, 1], [1, 0], [0, 0]])[order]
    file.primitive["attributes"]["TEXCOORD_0"] = file.accessor(corners, "VEC2")
    (tmp_path / "quad.glb").write_bytes(file.glb())
    plain = aov(read_model(tmp_path / "quad.glb"), "sh_normal")
    file.primitive["attributes"]["TEXCOORD_1"] = file.accessor(corners[::-1].copy(), "VEC2")
    file.material["emissiveTexture"] = file.texture(np.uint8([[[9, 9, 9]]])) | {"texCoord": 1}
    file.material["emissiveFactor"] = [1, 1, 1]
    (tmp_path / "quad.glb").write_bytes(file.glb())
    description = read_model(tmp_path / "quad.glb")
    assert len(description["part_0"]["data"].positions) == 6
    assert np.abs(plain[4, 4] - [0, 0, 1]).max() > 0.3
    assert np.allclose(aov(description, "sh_normal"), plain, atol=0.02)


def test_what_faces_away_is_left_out_on_request(tmp_path):
    file = quad()
    file.json["nodes"].append({"mesh": 0, "translation": [0, 0, -1], "scale": [1, 1, -1]})
    file.json["scenes"][0]["nodes"].append(1)
    (tmp_path / "quad.glb").write_bytes(file.glb())
    parts = [key for key in read_model(tmp_path / "quad.glb", cull=True) if key.startswith("part")]
    assert len(parts) == 1  # the mirrored one shows its back
    file.material["doubleSided"] = True
    (tmp_path / "quad.glb").write_bytes(file.glb())
    assert len([key for key in read_model(tmp_path / "quad.glb", cull=True) if key.startswith("part")]) == 2

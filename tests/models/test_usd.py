"""Models in USD."""

from __future__ import annotations

import zipfile

import numpy as np
import pytest

import djpt
from djpt.models.folder import Folder
from djpt.models.formats import read_model
from djpt.models.stage import staged
from djpt.models.usd_stage import distinct, read_stage
from tests.kit.gltf import png

pytest.importorskip("pxr")

QUAD = """
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
    texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (
        interpolation = "faceVarying"
    )
    uniform token subdivisionScheme = "none"
"""

MATERIAL = """
def Material "M"
{
    token outputs:surface.connect = </M/S.outputs:surface>
    def Shader "S"
    {
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor.connect = </M/T.outputs:rgb>
        float inputs:roughness = 0.25
        float inputs:metallic = 1
        float inputs:opacity = 0.5
        token outputs:surface
    }
    def Shader "T"
    {
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @a.png@
        token inputs:wrapS = "mirror"
        token inputs:wrapT = "mirror"
        float2 inputs:st.connect = </M/P.outputs:result>
        float3 outputs:rgb
    }
    def Shader "P"
    {
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "st"
        float2 outputs:result
    }
}
"""

BOUND = 'def Mesh "A" (prepend apiSchemas = ["MaterialBindingAPI"]) {' + QUAD + "rel material:binding = </M>}"


def usda(body, head=""):
    """A layer; statements end with their line."""
    return f"#usda 1.0\n{head}\n{body}".replace("}", "\n}")


def read(folder, body, head='(upAxis = "Z")', name="a.usda", time=None):
    (folder / name).write_text(usda(body, head))
    return staged(read_stage(Folder(folder), name, time, 2048))


def test_a_quad_is_two_triangles_that_stand_upright(tmp_path):
    scene = read(
        tmp_path,
        f'def Xform "X" {{ double3 xformOp:translate = (1, 2, 3)\n'
        f'uniform token[] xformOpOrder = ["xformOp:translate"]\ndef Mesh "A" {{{QUAD}}} }}',
    )
    mesh = scene["part_0"]["data"]
    assert mesh.positions[mesh.indices].shape == (2, 3, 3)
    assert scene["part_0"]["to_world"].matrix[:3, 3].tolist() == [1, 2, 3]
    assert scene["sensor"]["to_world"].matrix[2, 3] > 3  # above, with z up
    corner = mesh.positions[:, :2].tolist().index([-1, -1])
    assert mesh.texcoords[corner].tolist() == [0, 1]  # the first row of pixels is at v = 0 here


def test_a_preview_surface_is_a_principled_material(tmp_path):
    pixels = np.uint8([[[255, 0, 0], [0, 255, 0]]])
    (tmp_path / "a.png").write_bytes(png(pixels))
    node = read(tmp_path, MATERIAL + BOUND)["material_0"]
    assert node["opacity"] == 0.5
    node = node["bsdf"]["bsdf"]
    assert node["roughness"] == 0.25 and node["metallic"] == 1
    assert np.array_equal(node["base_color"]["bitmap"], pixels) and node["base_color"]["wrap_mode"] == "mirror"


def test_display_colours_vary_over_a_mesh_without_a_material(tmp_path):
    colors = "color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)] (\n"
    scene = read(tmp_path, f'def Mesh "A" {{{QUAD}{colors}interpolation = "vertex"\n) }}')
    assert scene["material_0"]["bsdf"]["base_color"] == {"type": "mesh_attribute", "name": "vertex_color"}
    mesh = scene["part_0"]["data"]
    corner = mesh.positions[:, :2].tolist().index([1, -1])
    assert mesh.attributes["vertex_color"][corner].tolist() == [0, 1, 0]
    one = colors.replace(", (0, 1, 0), (0, 0, 1), (1, 1, 1)", "")
    plain = read(tmp_path, f'def Mesh "A" {{{QUAD}{one}interpolation = "constant"\n) }}', name="b.usda")
    assert plain["material_0"]["bsdf"]["base_color"] == {"type": "rgb", "value": [1, 0, 0]}


def test_a_material_may_have_the_colours_of_points(tmp_path):
    reader = MATERIAL.replace("</M/T.outputs:rgb>", "</M/P.outputs:result>").replace('float2"', 'float3"')
    reader = reader.replace('varname = "st"', 'varname = "paint"')
    paint = "color3f[] primvars:paint = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)] (\ninterpolation = "
    scene = read(tmp_path, reader + BOUND.replace("rel material", paint + '"vertex"\n)\nrel material'))
    assert scene["material_0"]["bsdf"]["bsdf"]["base_color"] == {"type": "mesh_attribute", "name": "vertex_color"}
    assert sorted(scene["part_0"]["data"].attributes["vertex_color"].sum(axis=1)) == [1, 1, 1, 3]
    lacking = read(tmp_path, reader + BOUND, name="b.usda")["part_0"]["data"].attributes["vertex_color"]
    assert np.allclose(lacking, 0.18)


def test_layers_in_formats_without_a_reader_are_left_out(tmp_path):
    (tmp_path / "m.mtlx").write_text("<materialx/>")
    with pytest.warns(UserWarning, match="layers in the format 'mtlx'"):
        scene = read(tmp_path, f'def "X" (prepend references = @m.mtlx@</M>) {{}}\ndef Mesh "A" {{{QUAD}}}')
    assert "part_0" in scene


def test_textures_have_factors_and_wrap_as_they_say(tmp_path):
    (tmp_path / "a.png").write_bytes(png([[[255, 0, 51], [0, 255, 255]]]))
    more = (
        'float4 inputs:scale = (0.5, 0.5, 0.5, 1)\ntoken inputs:sourceColorSpace = "raw"\ntoken inputs:wrapT = "clamp"'
    )
    body = MATERIAL.replace('token inputs:wrapT = "mirror"', more)
    node = read(tmp_path, body + BOUND)["material_0"]["bsdf"]["bsdf"]["base_color"]
    assert node["raw"] and node["wrap_mode"] == "clamp" and node["bitmap"].shape == (1, 12, 3)  # mirrored, three times
    assert node["bitmap"][0, 4].tolist() == [128, 0, 26]
    body = MATERIAL.replace("float inputs:opacity = 0.5", "float inputs:opacity.connect = </M/T.outputs:b>")
    body = body.replace("float3 outputs:rgb", "float3 outputs:rgb\nfloat outputs:b")
    body = body.replace("float inputs:roughness", "float inputs:opacityThreshold = 0.5\nfloat inputs:roughness")
    assert read(tmp_path, body + BOUND, name="b.usda")["material_0"]["opacity"]["bitmap"].ravel().tolist() == [0, 255]


def test_a_normal_map_is_turned_over_where_it_is_mirrored(tmp_path):
    (tmp_path / "a.png").write_bytes(png([[[128, 228, 200], [128, 28, 200]]]))
    body = MATERIAL.replace("color3f inputs:diffuseColor", "normal3f inputs:normal")
    bound = BOUND.replace("(0, 0), (1, 0), (1, 1), (0, 1)]", "(0, 0), (1, 0), (1, 1), (2, 1)]")
    scene = read(tmp_path, body + bound)
    rows = [scene[scene[f"part_{i}"]["bsdf"]["id"]]["bsdf"]["bsdf"]["normalmap"]["bitmap"] for i in range(2)]
    assert [x[0, 0].tolist() for x in rows] == [[128, 228, 200], [128, 27, 200]]
    halves = [scene[f"part_{i}"]["data"] for i in range(2)]
    assert [sorted(map(tuple, x.positions[:, :2])) for x in halves] == [
        [(-1, -1), (1, -1), (1, 1)],
        [(-1, -1), (-1, 1), (1, 1)],
    ]


def test_textures_by_several_sets_of_coordinates_become_an_atlas(tmp_path):
    (tmp_path / "a.png").write_bytes(png([[[255, 0, 0], [0, 0, 0]]]))
    second = MATERIAL[MATERIAL.index('    def Shader "T"') :].replace("/P.", "/P2.").replace('"P"', '"P2"')
    second = second.replace('"T"', '"T2"').replace('varname = "st"', 'varname = "st1"').rstrip().removesuffix("}")
    body = MATERIAL.replace("float inputs:roughness = 0.25", "float inputs:roughness.connect = </M/T2.outputs:rgb>")
    body = body.rstrip().removesuffix("}") + second + "}\n"
    sets = QUAD[QUAD.index("    texCoord2f") : QUAD.index("    uniform")]
    scene = read(tmp_path, body + BOUND.replace(sets, sets + sets.replace(":st", ":st1")))
    node = scene[scene["part_0"]["bsdf"]["id"]]["bsdf"]["bsdf"]
    assert node["base_color"]["bitmap"].shape[:2] == node["roughness"]["bitmap"].shape[:2] != (1, 2)


def test_a_package_holds_its_textures(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.usdz", "w") as archive:
        archive.writestr("a.usda", usda(MATERIAL + BOUND))
        archive.writestr("a.png", png([[[255, 0, 0], [0, 0, 0]]]))
    node = read_model(tmp_path / "a.usdz")["material_0"]["bsdf"]["bsdf"]
    assert node["base_color"]["bitmap"].tolist() == [[[255, 0, 0], [0, 0, 0]]]


def test_a_cage_is_smooth_and_said(tmp_path):
    body = f'def Mesh "A" {{{QUAD.replace("none", "catmullClark")}}}'
    with pytest.warns(UserWarning, match="rendered as their cages"):
        scene = read(tmp_path, body)
    assert np.allclose(scene["part_0"]["data"].normals, [0, 0, 1])


def test_instances_and_points_share_one_mesh(tmp_path):
    body = f"""
    def Xform "P" {{ def Mesh "A" {{{QUAD}}} }}
    def Xform "I" (instanceable = true
        prepend references = </P>) {{ double3 xformOp:translate = (5, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"] }}
    def PointInstancer "Q" {{ int[] protoIndices = [0, 0, 0]
        point3f[] positions = [(0, 0, 1), (0, 0, 2), (0, 0, 3)]
        rel prototypes = </Q/B>
        def Mesh "B" {{{QUAD}}} }}"""
    scene = read(tmp_path, body)
    places = sorted(tuple(x["to_world"].matrix[:3, 3]) for key, x in scene.items() if key.startswith("part_"))
    assert places == [(0, 0, 0), (0, 0, 1), (0, 0, 2), (0, 0, 3), (5, 0, 0)]
    parts = {id(x["data"]) for key, x in scene.items() if key.startswith("part_2")}
    assert len(parts) == 1


def test_subsets_have_their_own_material(tmp_path):
    (tmp_path / "a.png").write_bytes(png([[[255, 0, 0]]]))
    two = QUAD.replace("[4]", "[3, 3]").replace("[0, 1, 2, 3]", "[0, 1, 2, 0, 2, 3]")
    two = two.replace("[(0, 0), (1, 0), (1, 1), (0, 1)]", "[(0, 0), (1, 0), (1, 1), (0, 0), (1, 1), (0, 1)]")
    body = f"""def Mesh "A" {{{two}
        def GeomSubset "S" (prepend apiSchemas = ["MaterialBindingAPI"]) {{
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = [1]
            rel material:binding = </M>
        }} }}"""
    scene = read(tmp_path, MATERIAL + body)
    assert [len(scene[f"part_{i}"]["data"].indices) for i in range(2)] == [1, 1]
    assert scene["part_0"]["bsdf"]["id"] != scene["part_1"]["bsdf"]["id"]


def test_lights_and_cameras(tmp_path):
    body = f"""def Mesh "A" {{{QUAD}}}
    def RectLight "L" {{ float inputs:width = 2
        float inputs:height = 4
        float inputs:intensity = 3
        float inputs:exposure = 1
        double3 xformOp:translate = (0, 0, 5)
        uniform token[] xformOpOrder = ["xformOp:translate"] }}
    def Camera "C" {{ float focalLength = 50
        float verticalAperture = 25
        double3 xformOp:translate = (0, 0, 9)
        uniform token[] xformOpOrder = ["xformOp:translate"] }}"""
    scene = read(tmp_path, body)
    assert "sky" not in scene
    light = djpt.load_dict(scene["light_0"])
    assert np.array(light.surface_area()).item() == pytest.approx(8)
    si = light.sample_position(0.0, djpt.Point2f(0.5, 0.5))
    assert np.allclose(np.array(si.n).ravel(), [0, 0, -1]) and np.allclose(np.array(si.p).ravel(), [0, 0, 5])
    assert scene["light_0"]["emitter"]["radiance"]["value"] == [6, 6, 6]
    assert scene["sensor"]["fov"] == pytest.approx(2 * np.degrees(np.arctan(0.25)))


def test_lights_of_another_exposure_are_scaled(tmp_path):
    body = f'def Mesh "A" {{{QUAD}}}\ndef DomeLight "L" {{ float inputs:intensity = 1e5 }}'
    with pytest.warns(UserWarning, match="lights are scaled by 9.55e-06"):
        scene = read(tmp_path, body)
    assert np.allclose(scene["light_0"]["radiance"]["value"], 3 / np.pi)


def test_time_moves_what_is_animated(tmp_path):
    body = f"""def Mesh "A" {{{QUAD}
        double3 xformOp:translate.timeSamples = {{ 0: (0, 0, 0), 24: (0, 0, 8) }}
        uniform token[] xformOpOrder = ["xformOp:translate"] }}"""
    head = "(timeCodesPerSecond = 24)"
    assert read(tmp_path, body, head, time=0.5)["part_0"]["to_world"].matrix[2, 3] == 4
    assert read(tmp_path, body, head, name="b.usda")["part_0"]["to_world"].matrix[2, 3] == 0


def test_layers_and_textures_outside_of_the_folder_are_not_read(tmp_path):
    (tmp_path / "a.png").write_bytes(png([[[255, 0, 0], [0, 0, 0]]]))
    (tmp_path / "b.usda").write_text(usda(f'def Mesh "A" {{{QUAD}}}'))
    inner = tmp_path / "inner"
    inner.mkdir()
    with pytest.raises(djpt.FileError, match="which a model may not leave"):
        read(inner, 'def "A" (prepend references = @../b.usda@</A>) {}')
    with pytest.warns(UserWarning, match="texture is left out"):
        node = read(inner, MATERIAL.replace("@a.png@", "@../a.png@") + BOUND, name="c.usda")["material_0"]
    assert node["bsdf"]["bsdf"]["base_color"]["type"] == "rgb"


@pytest.mark.parametrize(
    ("suffix", "data"), [("usd", b""), ("usda", b"#usda 1.0\ndef"), ("usdc", b"PXR-USDC" + bytes(80)), ("usdz", b"PK")]
)
@pytest.mark.sparse(4)
def test_damaged_files_are_errors(tmp_path, suffix, data):
    (tmp_path / f"a.{suffix}").write_bytes(data)
    with pytest.raises(djpt.DjptError, match=f"a.{suffix}"):
        read_model(tmp_path / f"a.{suffix}")


def test_a_process_that_dies_is_an_error(tmp_path, monkeypatch):
    (tmp_path / "a.usda").write_text("#usda 1.0\n")
    monkeypatch.setattr("djpt.models.usd.CHILD", "import os; os.abort()")
    with pytest.raises(djpt.SceneError, match="the library ended with the code -6"):
        read_model(tmp_path / "a.usda")


def test_what_is_said_in_the_process_is_said_here(tmp_path):
    (tmp_path / "a.usda").write_text(usda(f'def Mesh "A" {{{QUAD.replace("none", "loop")}}}'))
    with pytest.warns(UserWarning, match="a.usda: subdivision surfaces are rendered as their cages"):
        read_model(tmp_path / "a.usda")


def test_rows_are_told_apart():
    rows = np.random.default_rng(0).integers(0, 3, (500, 4)).astype(np.uint32) << 29
    first, inverse = distinct(rows)
    assert np.array_equal(rows[first][inverse], rows) and len(first) == len(np.unique(rows, axis=0))

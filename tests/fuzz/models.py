"""Small valid models of all formats, with the files that they name, to be damaged."""

from __future__ import annotations

import functools
import importlib.util
import json
import tempfile
from pathlib import Path

import numpy as np

from tests.kit.gltf import Quad, png, quad

__all__ = ["gltf_model", "model_files"]

MTL = """newmtl red
Kd 1 0.5 0.5
Ns 20
d 0.5
map_Kd t.png
newmtl lamp
Ke 3 2 1
"""
OBJ = """mtllib m.mtl
v -1 -1 0
v 1 -1 0
v 1 1 0
v -1 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vn 0 0 1
usemtl red
f 1/1/1 2/2/1 3/3/1
usemtl lamp
f 1/1/1 3/3/1 4/4/1
"""
USDA = """#usda 1.0
(
    upAxis = "Y"
)
def Xform "root"
{
    def Mesh "quad" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        point3f[] points = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)] (interpolation = "vertex")
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")
        rel material:binding = </root/red>
    }
    def Material "red"
    {
        token outputs:surface.connect = </root/red/shader.outputs:surface>
        def Shader "shader"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </root/red/image.outputs:rgb>
            float inputs:roughness = 0.4
            token outputs:surface
        }
        def Shader "image"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @t.png@
            float2 inputs:st.connect = </root/red/st.outputs:result>
            float3 outputs:rgb
        }
        def Shader "st"
        {
            uniform token info:id = "UsdPrimvarReader_float2"
            token inputs:varname = "st"
            float2 outputs:result
        }
    }
    def Xform "copy" (references = @part.usda@</part>)
    {
        double3 xformOp:translate = (3, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def RectLight "lamp"
    {
        float inputs:intensity = 5
        double3 xformOp:translate = (0, 0, 4)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Camera "camera"
    {
        float focalLength = 30
        double3 xformOp:translate = (0, 0, 8)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
"""
PART = """#usda 1.0
def Mesh "part"
{
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
}
"""


@functools.cache
def model_files() -> dict[str, dict[str, bytes]]:
    """The files of each model by name; the model is the first one of its name."""
    texture = {"t.png": png(np.arange(48).reshape(4, 4, 3))}
    file = gltf_model()
    apart = json.loads(file.gltf())
    apart["buffers"][0]["uri"] = "m.bin"
    models = {
        "m.glb": {"m.glb": file.glb()},
        "m.gltf": {"m.gltf": file.gltf()},
        "apart.gltf": {"apart.gltf": json.dumps(apart, indent=1).encode(), "m.bin": file.data},
        "m.obj": {"m.obj": OBJ.encode(), "m.mtl": MTL.encode(), **texture},
    }
    with tempfile.TemporaryDirectory(prefix="djpt-") as name:
        folder = Path(name)
        if importlib.util.find_spec("trimesh"):
            import trimesh

            box = trimesh.creation.box()
            for suffix in ("stl", "off", "3mf", "ply"):
                box.export(folder / f"m.{suffix}")
                models[f"m.{suffix}"] = {f"m.{suffix}": (folder / f"m.{suffix}").read_bytes()}
        if importlib.util.find_spec("pxr"):
            models |= usd_files(folder, texture)
    return models


def usd_files(folder: Path, texture: dict[str, bytes]) -> dict[str, dict[str, bytes]]:
    """Models of USD: a text, its binary form, and a package of all files."""
    from pxr import Sdf, UsdUtils

    others = {"part.usda": PART.encode(), **texture}
    for name, content in {"m.usda": USDA.encode(), **others}.items():
        (folder / name).write_bytes(content)
    Sdf.Layer.FindOrOpen(str(folder / "m.usda")).Export(str(folder / "m.usdc"))
    UsdUtils.CreateNewUsdzPackage(str(folder / "m.usda"), str(folder / "m.usdz"))
    found = {f"m.{suffix}": (folder / f"m.{suffix}").read_bytes() for suffix in ("usda", "usdc", "usdz")}
    return {name: {name: data, **({} if name == "m.usdz" else others)} for name, data in found.items()}


def gltf_model() -> Quad:
    """A model with textures, two sets of coordinates, colours of vertices, and all that can move or shine."""
    file = quad()
    attributes = file.primitive["attributes"]
    base = {"baseColorTexture": file.texture(np.arange(48).reshape(4, 4, 3))}
    file.material |= {"pbrMetallicRoughness": base, "alphaMode": "BLEND", "extensions": {}}
    file.material["emissiveTexture"] = file.texture(np.arange(12).reshape(2, 2, 3)) | {"texCoord": 1}
    file.material["emissiveFactor"] = [1, 1, 1]
    attributes["TEXCOORD_1"] = file.accessor(np.float32([[0, 0], [2, 0], [2, 2], [0, 2]]), "VEC2")
    attributes["COLOR_0"] = file.accessor(
        np.uint8([[255, 0, 0, 255]] * 2 + [[9, 9, 9, 9]] * 2), "VEC4", normalized=True
    )
    file.material["extensions"]["KHR_materials_clearcoat"] = {"clearcoatFactor": 0.5}
    attributes["JOINTS_0"] = file.accessor(np.uint8([[0, 1, 0, 0]] * 4), "VEC4")
    attributes["WEIGHTS_0"] = file.accessor(np.float32([[0.5, 0.5, 0, 0]] * 4), "VEC4")
    file.primitive["targets"] = [{"POSITION": file.accessor(np.float32([[0, 0, 1]] * 4), "VEC3")}]
    file.node |= {"skin": 0, "weights": [0.5]}
    file.json["nodes"] += [
        {"translation": [4, 0, 0]},
        {"camera": 0, "extensions": {"KHR_lights_punctual": {"light": 0}}},
    ]
    file.json["scenes"][0]["nodes"] += [1, 2]
    file.json["skins"] = [{"joints": [1, 2]}]
    file.json["cameras"] = [{"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1}}]
    file.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "spot", "intensity": 5}]}}
    times, moves = np.float32([0, 1]), np.float32([[0, 0, 0], [1, 0, 0]])
    sampler = {"input": file.accessor(times, "SCALAR"), "output": file.accessor(moves, "VEC3")}
    channel = {"sampler": 0, "target": {"node": 1, "path": "translation"}}
    file.json["animations"] = [{"channels": [channel], "samplers": [sampler]}]
    return file

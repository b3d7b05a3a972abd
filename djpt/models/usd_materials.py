"""Materials of USD, UsdPreviewSurface, as nodes of the `principled` BSDF, with their textures.

Pixar, "UsdPreviewSurface Specification", version 2.6.
"""

from __future__ import annotations

import io
import math
import os
import zipfile
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.errors import FileError, SceneError
from djpt.models.folder import LARGEST_FILE, Folder
from djpt.models.images import decoded_image
from djpt.models.model import Matrix, Model
from djpt.models.normal_maps import normals_of
from djpt.models.principled import eta_of, gloss_of
from djpt.models.textures import LINEAR, Bitmaps, Lookup

__all__ = ["GREY", "Materials", "Surface", "displayed"]

TINTED: dict[str, Any] = {"type": "rgb", "value": [1.0] * 3, "tint": "vertex_color"}
"""The colour that points have."""
WRAP = {"clamp": "clamp", "mirror": "mirror", "repeat": "repeat", "black": "clamp", "useMetadata": "repeat"}
CHANNELS = {"r": 0, "g": 1, "b": 2, "a": 3}
GREY = 0.18
"""The diffuse colour of a surface that has none."""
MOST_STEPS = 32
"""The longest chain of shaders that is followed."""


@dataclass(frozen=True)
class Surface:
    """What a mesh has to know of its material."""

    name: str
    """That of its node."""
    uv_sets: tuple[str, ...] = ("st",)
    """The primvars of the texture coordinates that it uses."""
    normal_set: str | None = None
    """The one of its normal map, or None."""
    emission: dict[str, Any] | None = None
    """The light that it emits, or None."""
    tint: str | None = None
    """The primvar of the colours of the mesh's points by which its own is multiplied, or None."""


class Materials:
    """The materials of a stage.

    Args:
        folder: where textures may be.
        model: what is made of the stage; its `nodes` get the materials.
        largest: textures with more rows or columns are made smaller.
    """

    def __init__(self, folder: Folder, model: Model, largest: int) -> None:
        self.folder, self.model, self.largest = folder, model, largest
        self.bitmaps = Bitmaps(model)
        self._made: dict[Any, Surface] = {}
        self._images: dict[str, NDArray[np.uint8] | None] = {}

    def made(self, material: Any, plain: dict[str, Any], mirrored: bool = False) -> Surface:
        """The surface of a material, whose node is made once.

        Args:
            material: a `UsdShade.Material`, or an invalid one.
            plain: the colour of meshes without a material.
            mirrored: whether it is for triangles with a mirrored texture.
        """
        shader = material.ComputeSurfaceSource()[0] if material else None
        if material and (not shader or shader.GetShaderId() != "UsdPreviewSurface"):
            what = shader.GetShaderId() if shader else None
            self.model.say(f"materials of the kind '{what or 'none'}' are plain: only UsdPreviewSurface is read")
            shader = None
        tint = plain.get("tint")
        key: Any = (str(material.GetPath()), mirrored) if shader else (tint, *plain["value"])
        if key not in self._made:
            name = f"material_{len(self._made)}"
            if shader:
                self._made[key] = self._surface(name, shader, mirrored)
            else:
                self._add(name, {"type": "principled", "base_color": plain})
                self._made[key] = Surface(name, tint=None if tint is None else "displayColor")
        return self._made[key]

    def _add(self, name: str, node: dict[str, Any]) -> None:
        self.model.nodes[name] = {"type": "twosided", "bsdf": node}

    # ---- surfaces --------------------------------------------------------------------------

    def _surface(self, name: str, shader: Any, mirrored: bool) -> Surface:
        """Add the node of a UsdPreviewSurface."""
        inputs = Inputs(self, shader)
        node: dict[str, Any] = {"type": "principled", "base_color": inputs.color("diffuseColor", (GREY,) * 3)}
        node["roughness"] = inputs.number("roughness", 0.5)
        if inputs.plain("useSpecularWorkflow", 0):
            specular = inputs.color("specularColor", (0.0,) * 3)
            mean = np.mean(specular["value"]) if specular["type"] == "rgb" else 0.04
            self.model.say("the specular workflow is replaced by an index of refraction of the same mean reflectance")
            node["eta"] = eta_of(float(mean))
        else:
            node["metallic"] = inputs.number("metallic", 0.0)
            node["eta"] = float(np.clip(inputs.plain("ior", 1.5) or 1.5, 1.01, 5.0))
        coat = inputs.number("clearcoat", 0.0)
        if coat != 0.0:
            rough = float(inputs.plain("clearcoatRoughness", 0.01))
            node |= {"clearcoat": coat, "clearcoat_gloss": float(gloss_of(rough))}
        normal = inputs.texture("normal")
        if normal is not None:
            down = normal.scale[1] < 0  # as programs for DirectX write them
            turned = normals_of(normal.pixels, 1.0, mirrored != down)
            bitmap = self.bitmaps.node((normal.key, mirrored), turned, normal.lookup, raw=True)
            node = {"type": "normalmap", "normalmap": bitmap, "bsdf": node}
        if inputs.connected("displacement"):
            self.model.say("displacement is left out")
        self._add(name, node)
        opacity = inputs.number("opacity", 1.0, float(inputs.plain("opacityThreshold", 0.0) or 0.0))
        if opacity != 1.0:
            self.model.nodes[name] = {"type": "mask", "opacity": opacity, "bsdf": self.model.nodes[name]}
        emission = inputs.color("emissiveColor", (0.0,) * 3, shines=True)
        dark = emission["type"] == "rgb" and not any(emission["value"])
        normal_set = None if normal is None else normal.lookup.uv_set
        return Surface(name, tuple(inputs.uv_sets) or ("st",), normal_set, None if dark else emission, inputs.tint)

    # ---- textures --------------------------------------------------------------------------

    def _bytes(self, resolved: str) -> bytes:
        """The contents of a file in the folder, or of one in a package."""
        outer, inner = resolved.partition("[")[::2]
        data = self.folder.read(outer)
        if not inner:
            return data
        try:
            with zipfile.ZipFile(io.BytesIO(data)) as archive:
                entry = archive.getinfo(inner.rstrip("]"))
                if entry.file_size > LARGEST_FILE:
                    raise FileError(f"'{inner}' has {entry.file_size} bytes; at most {LARGEST_FILE}")
                return archive.read(entry)
        except (KeyError, zipfile.BadZipFile, NotImplementedError, OSError, RuntimeError) as error:
            raise FileError(f"'{inner}' can't be read: {error}") from None

    def image(self, asset: Any) -> NDArray[np.uint8] | None:
        """The pixels of a texture's file, (H, W, 4); None, with a warning, if it can't be read."""
        name = str(asset.resolvedPath or asset.path)
        if name not in self._images:
            self._images[name] = None
            try:
                pixels, smaller = decoded_image(
                    self._bytes(name), self.largest, os.path.basename(name)[:100].rstrip("]")
                )
            except (FileError, SceneError) as error:
                self.model.say(f"a texture is left out: {error}")
                return None
            if smaller:
                self.model.say(f"textures are made smaller, to {self.largest} pixels: see 'texture_size'")
            self._images[name] = pixels
        return self._images[name]

    def environment(self, asset: Any) -> dict[str, Any] | None:
        """The pixels of a dome light as entries of an `envmap`; None without a file that can be read."""
        if asset is None or not asset.path:
            return None
        name = str(asset.resolvedPath or asset.path)
        if name.lower().endswith((".exr", ".hdr")) and "[" not in name:
            try:
                return {"filename": str(self.folder.find(name))}
            except FileError as error:
                self.model.say(f"a texture is left out: {error}")
                return None
        pixels = self.image(asset)
        if pixels is None:
            return None
        return {"bitmap": LINEAR.astype(np.float32)[pixels[..., :3]]}


@dataclass(frozen=True)
class Texture:
    """A UsdUVTexture."""

    key: str
    """Its file."""
    pixels: NDArray[np.uint8]
    """(H, W, 4)."""
    lookup: Lookup
    scale: Matrix
    """Factors of its channels, (4,)."""
    raw: bool
    """Whether bytes are numbers, not colours of sRGB."""
    output: str
    """What is used of it: ``rgb`` or a channel."""


def displayed(colors: NDArray[np.float32] | None) -> dict[str, Any]:
    """The colour of a mesh without a material by its display colours, (C, 3)."""
    if colors is None or not len(colors):
        return {"type": "rgb", "value": [GREY] * 3}
    colors = np.clip(colors, 0, 1)
    return {"type": "rgb", "value": colors[0].tolist()} if (colors == colors[0]).all() else TINTED


class Inputs:
    """The inputs of one UsdPreviewSurface."""

    def __init__(self, materials: Materials, shader: Any) -> None:
        self.materials, self.shader = materials, shader
        self.uv_sets: dict[str, None] = {}
        """The primvars of the texture coordinates of its textures."""
        self.tint: str | None = None
        """The primvar that is its diffuse colour, or None."""

    def connected(self, name: str) -> bool:
        """True if an input comes from another shader."""
        found = self.shader.GetInput(name)
        return bool(found) and found.HasConnectedSource()

    def plain(self, name: str, default: Any, shader: Any = None) -> Any:
        """The value of an input that isn't a texture."""
        found = (shader or self.shader).GetInput(name)
        for _ in range(MOST_STEPS):  # through the interfaces of node graphs
            if not found or not found.HasConnectedSource():
                break
            source, output, _kind = found.GetConnectedSource()
            inner = source.GetInput(output)
            if not inner:
                break
            found = inner
        value = found.Get() if found else None
        return default if value is None else value

    def _source(self, name: str, shader: Any = None) -> tuple[Any, str]:
        """The shader behind an input, and the output that is used; None without one."""
        found = (shader or self.shader).GetInput(name)
        for _ in range(MOST_STEPS):
            if not found or not found.HasConnectedSource():
                return None, ""
            from pxr import UsdShade

            source, output, kind = found.GetConnectedSource()
            if kind == UsdShade.AttributeType.Output and source.GetPrim().IsA(UsdShade.Shader):
                return UsdShade.Shader(source.GetPrim()), str(output)
            found = source.GetOutput(output) if kind == UsdShade.AttributeType.Output else source.GetInput(output)
        return None, ""

    def color(self, name: str, default: tuple[float, ...], shines: bool = False) -> dict[str, Any]:
        """A colour, or a radiance if it `shines`: a texture, linear numbers, or the colours of points."""
        reader, _ = self._source(name)
        if name == "diffuseColor" and reader is not None and reader.GetShaderId() == "UsdPrimvarReader_float3":
            self.tint = str(self.plain("varname", "displayColor", reader))
            return TINTED
        texture = self.texture(name)
        if texture is None:
            value = np.nan_to_num(np.array(self.plain(name, default), np.float64).ravel())
            return {"type": "rgb", "value": np.clip(np.resize(value, 3), 0, 1e6 if shines else 1.0).tolist()}
        pixels, scale = texture.pixels, np.clip(np.nan_to_num(texture.scale[:3]), 0, 1e6)
        if texture.output != "rgb":
            pixels = pixels[..., [CHANNELS.get(texture.output, 0)] * 3]
        bitmaps, key = self.materials.bitmaps, (texture.key, texture.output)
        make = bitmaps.light if shines else bitmaps.color
        return make(key, pixels, scale, texture.lookup, raw=texture.raw)

    def number(self, name: str, default: float, threshold: float = 0.0) -> Any:
        """A number in [0, 1], or a texture of such; 0 or 1 if there is a threshold."""
        texture = self.texture(name)
        if texture is None:
            value = float(np.clip(np.nan_to_num(np.ravel(self.plain(name, default))[0]), 0, 1))
            return float(value >= threshold) if threshold > 0 else value
        channel = CHANNELS.get(texture.output, 0)
        bitmaps, factor = self.materials.bitmaps, float(np.nan_to_num(texture.scale[channel]))
        if threshold > 0:
            return bitmaps.cutout(texture.key, texture.pixels, channel, factor, threshold, texture.lookup)
        return bitmaps.channel(texture.key, texture.pixels, channel, factor, texture.lookup)

    def texture(self, name: str) -> Texture | None:
        """The texture of an input; None without one."""
        shader, output = self._source(name)
        if shader is None:
            return None
        kind = shader.GetShaderId()
        asset = self.plain("file", None, shader)
        if kind != "UsdUVTexture" or asset is None:
            self.materials.model.say(f"'{name}' by '{kind}' is left out")
            return None
        pixels = self.materials.image(asset)
        if pixels is None:
            return None
        lookup = self._lookup(shader)
        self.uv_sets[lookup.uv_set] = None
        scale = np.resize(np.array(self.plain("scale", (1, 1, 1, 1), shader), np.float64), 4)
        if name != "normal" and np.any(np.array(self.plain("bias", (0, 0, 0, 0), shader))):
            self.materials.model.say("the bias of textures is left out")
        raw = str(self.plain("sourceColorSpace", "auto", shader)) == "raw"
        return Texture(str(asset.resolvedPath or asset.path), pixels, lookup, scale, raw, output)

    def _lookup(self, shader: Any) -> Lookup:
        """How a texture is wrapped, and by which coordinates it is looked up."""
        u, v = (WRAP.get(str(self.plain(key, "useMetadata", shader)), "repeat") for key in ("wrapS", "wrapT"))
        found = np.eye(4)
        flip = np.diag([1.0, -1.0, 1.0, 1.0])
        flip[1, 3] = 1
        source, _ = self._source("st", shader)
        for _ in range(MOST_STEPS):
            if source is None or source.GetShaderId() != "UsdTransform2d":
                break
            angle = math.radians(float(self.plain("rotation", 0.0, source)))
            c, s = math.cos(angle), math.sin(angle)
            matrix = np.eye(4)
            matrix[:2, :2] = np.array([[c, -s], [s, c]]) * np.array(self.plain("scale", (1, 1), source))
            matrix[:2, 3] = np.array(self.plain("translation", (0, 0), source))
            found = found @ flip @ matrix @ flip
            source, _ = self._source("in", source)
        name = str(self.plain("varname", "st", source)) if source is not None else "st"
        return Lookup(name, (u, v), found)

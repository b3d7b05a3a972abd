"""Materials of USD, UsdPreviewSurface, as nodes of the `principled` BSDF, with their textures.

Pixar, "UsdPreviewSurface Specification", version 2.6.
"""

from __future__ import annotations

import io
import math
import os
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f
from djpt.errors import FileError, SceneError
from djpt.images.srgb import decoded
from djpt.models.folder import LARGEST_FILE, Folder
from djpt.models.images import decoded_image
from djpt.models.model import Model

__all__ = ["Materials"]

WRAP = {"clamp": "clamp", "mirror": "mirror", "repeat": "repeat", "black": "clamp", "useMetadata": "repeat"}
CHANNELS = {"r": 0, "g": 1, "b": 2, "a": 3}
GREY = 0.18
"""The diffuse colour of a surface without a material."""
COAT = 0.1
"""The largest alpha of the coat of `principled`."""
MOST_STEPS = 32
"""The longest chain of shaders that is followed."""


class Materials:
    """The materials of a stage.

    Args:
        folder: where textures may be.
        model: what is made of the stage; its `nodes` get the materials.
        largest: textures with more rows or columns are made smaller.
        path: the file of the stage.
    """

    def __init__(self, folder: Folder, model: Model, largest: int, path: str) -> None:
        self.folder, self.model, self.largest, self.path = folder, model, largest, path
        self._made: dict[Any, tuple[str, str, dict[str, Any] | None]] = {}
        self._images: dict[str, NDArray[np.uint8] | None] = {}
        self._pixels: dict[Any, NDArray[Any]] = {}
        """Pixels of textures by all that they depend on, which equal nodes share."""

    def made(self, material: Any, display_color: Any) -> tuple[str, str, dict[str, Any] | None]:
        """The name of a material's node, that of the texture coordinates it uses, and the light that it emits.

        Args:
            material: a `UsdShade.Material`, or an invalid one.
            display_color: colours of a mesh without a material; their mean is used.
        """
        color = None
        if not material and display_color is not None and len(display_color):
            mean = np.nan_to_num(np.asarray(display_color, np.float64).reshape(-1, 3).mean(axis=0))
            color = tuple(np.clip(mean, 0, 1))
            if len(np.unique(np.asarray(display_color), axis=0)) > 1:
                self.model.say("display colours of points are replaced by their mean")
        key = str(material.GetPath()) if material else color
        if key not in self._made:
            name = f"material_{len(self._made)}"
            shader = material.ComputeSurfaceSource()[0] if material else None
            if material and (not shader or shader.GetShaderId() != "UsdPreviewSurface"):
                what = shader.GetShaderId() if shader else None
                self.model.say(f"materials of the kind '{what or 'none'}' are grey: only UsdPreviewSurface is read")
                shader = None
            if shader:
                self._made[key] = (name, *self._surface(name, shader))
            else:
                rgb = {"type": "rgb", "value": [GREY] * 3 if color is None else [float(x) for x in color]}
                self._add(name, {"type": "principled", "base_color": rgb})
                self._made[key] = (name, "st", None)
        return self._made[key]

    def _add(self, name: str, node: dict[str, Any]) -> None:
        self.model.nodes[name] = {"type": "twosided", "bsdf": node}

    # ---- surfaces --------------------------------------------------------------------------

    def _surface(self, name: str, shader: Any) -> tuple[str, dict[str, Any] | None]:
        """Add the node of a UsdPreviewSurface; the name of its texture coordinates, and its emission."""
        inputs = Inputs(self, shader)
        node: dict[str, Any] = {"type": "principled", "base_color": inputs.color("diffuseColor", (GREY,) * 3)}
        node["roughness"] = inputs.number("roughness", 0.5)
        if inputs.plain("useSpecularWorkflow", 0):
            specular = inputs.color("specularColor", (0.0,) * 3)
            mean = np.mean(specular["value"]) if specular["type"] == "rgb" else 0.04
            self.model.say("the specular workflow is replaced by an index of refraction of the same mean reflectance")
            root = math.sqrt(min(float(mean), 0.9))
            node["eta"] = max((1 + root) / (1 - root), 1.01)
        else:
            node["metallic"] = inputs.number("metallic", 0.0)
            node["eta"] = float(np.clip(inputs.plain("ior", 1.5) or 1.5, 1.01, 5.0))
        coat = inputs.number("clearcoat", 0.0)
        if coat != 0.0:
            rough = float(inputs.plain("clearcoatRoughness", 0.01))
            node |= {"clearcoat": coat, "clearcoat_gloss": float(np.clip((COAT - rough**2) / (COAT - 0.001), 0, 1))}
        normal = inputs.texture("normal")
        if normal is not None:
            node = {"type": "normalmap", "normalmap": normal, "bsdf": node}
        if inputs.connected("displacement"):
            self.model.say("displacement is left out")
        self._add(name, node)
        opacity = inputs.number("opacity", 1.0)
        threshold = float(inputs.plain("opacityThreshold", 0.0) or 0.0)
        if isinstance(opacity, float) and threshold > 0:
            opacity = float(opacity >= threshold)
        elif threshold > 0:
            opacity = {**opacity, "bitmap": np.where(opacity["bitmap"] >= 255 * threshold, 255, 0).astype(np.uint8)}
        if opacity != 1.0:
            self.model.nodes[name] = {"type": "mask", "opacity": opacity, "bsdf": self.model.nodes[name]}
        emission = inputs.color("emissiveColor", (0.0,) * 3, largest=1e6)
        dark = emission["type"] == "rgb" and not any(emission["value"])
        return inputs.uv_name or "st", None if dark else emission

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
                pixels, smaller = decoded_image(self._bytes(name), self.largest, os.path.basename(name)[:100])
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
        return {"bitmap": np.asarray(decoded(pixels[..., :3].astype(np.float32) / 255), np.float32)}

    def shared(self, key: Any, pixels: NDArray[Any]) -> NDArray[Any]:
        """The first pixels of a key."""
        return self._pixels.setdefault(key, pixels)


class Inputs:
    """The inputs of one UsdPreviewSurface."""

    def __init__(self, materials: Materials, shader: Any) -> None:
        self.materials, self.shader = materials, shader
        self.uv_name: str | None = None
        """The primvar of the texture coordinates of its first texture."""

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

    def color(self, name: str, default: tuple[float, ...], largest: float = 1.0) -> dict[str, Any]:
        """A colour: a texture, or linear numbers."""
        texture, output = self._texture_of(name)
        if texture is not None:
            pixels, scale, raw = texture
            values = pixels[..., :3] if output == "rgb" else pixels[..., [CHANNELS.get(output, 0)] * 3]
            if (scale[:3] != 1).any():
                linear = values / np.float32(255) if raw else decoded(values.astype(np.float32) / 255)
                return self._node(name, np.asarray(linear * scale[:3], np.float32), raw=True)
            return self._node(name, np.ascontiguousarray(values), raw=raw)
        value = np.nan_to_num(np.array(self.plain(name, default), np.float64).ravel())
        return {"type": "rgb", "value": np.clip(np.resize(value, 3), 0, largest).tolist()}

    def number(self, name: str, default: float) -> Any:
        """A number in [0, 1], or a texture of such."""
        texture, output = self._texture_of(name)
        if texture is None:
            value = np.ravel(self.plain(name, default))
            return float(np.clip(np.nan_to_num(value[0]), 0, 1))
        pixels, scale, _ = texture
        channel = CHANNELS.get(output, 0)
        values = np.clip(np.rint(pixels[..., channel : channel + 1] * scale[channel]), 0, 255).astype(np.uint8)
        if values.min() == values.max():
            return float(values.flat[0] / 255)
        return self._node(name, values, raw=True)

    def texture(self, name: str) -> dict[str, Any] | None:
        """A texture of directions; None without one."""
        found, _ = self._texture_of(name)
        return None if found is None else self._node(name, np.ascontiguousarray(found[0][..., :3]), raw=True)

    def _texture_of(self, name: str) -> tuple[Any, str]:
        """Pixels, scale and whether they are linear, of the texture of an input, and its output; None without one."""
        shader, output = self._source(name)
        if shader is None:
            return None, ""
        kind = shader.GetShaderId()
        asset = self.plain("file", None, shader)
        if kind != "UsdUVTexture" or asset is None:
            self.materials.model.say(f"'{name}' by '{kind}' is left out")
            return None, ""
        pixels = self.materials.image(asset)
        if pixels is None:
            return None, ""
        self._place_of(shader)
        self._key = (str(asset.resolvedPath or asset.path), name, output)
        space = str(self.plain("sourceColorSpace", "auto", shader))
        scale = np.array(self.plain("scale", (1, 1, 1, 1), shader), np.float64)
        if name != "normal" and np.any(np.array(self.plain("bias", (0, 0, 0, 0), shader))):
            self.materials.model.say("the bias of textures is left out")
        raw = space == "raw"
        return (pixels, np.ones(4) if name == "normal" else scale, raw), output

    def _place_of(self, shader: Any) -> None:
        """Find out how a texture is wrapped, and by which coordinates it is looked up."""
        wraps = [WRAP.get(str(self.plain(key, "useMetadata", shader)), "repeat") for key in ("wrapS", "wrapT")]
        if wraps[0] != wraps[1]:
            self.materials.model.say(f"textures wrap alike along u and v: '{wraps[0]}'")
        self._wrap, self._matrix = wraps[0], np.eye(4)
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
            self._matrix = self._matrix @ flip @ matrix @ flip
            source, _ = self._source("in", source)
        name = str(self.plain("varname", "st", source)) if source is not None else "st"
        if self.uv_name is None:
            self.uv_name = name
        elif self.uv_name != name:
            self.materials.model.say(f"textures by '{name}' use the texture coordinates '{self.uv_name}'")

    def _node(self, name: str, pixels: NDArray[Any], raw: bool) -> dict[str, Any]:
        """The node of the texture that was found last."""
        node: dict[str, Any] = {"type": "bitmap", "wrap_mode": self._wrap, "raw": raw or pixels.dtype != np.uint8}
        node["bitmap" if pixels.dtype == np.uint8 else "data"] = self.materials.shared((self._key, raw), pixels)
        if (self._matrix != np.eye(4)).any():
            node["to_uv"] = ScalarTransform4f(self._matrix)
        return node

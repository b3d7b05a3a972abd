"""Materials of glTF as nodes of the `principled` BSDF, with their textures."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f
from djpt.models.gltf_file import GltfFile, numbers, scalar
from djpt.models.model import Model, Part
from djpt.shapes.meshes.data import MeshData

__all__ = ["Materials"]

WRAP = {33071: "clamp", 33648: "mirror", 10497: "repeat"}
NEAREST = 9728
COAT = 0.1
"""The largest alpha of the coat of `principled`."""
SMALLEST_ETA = 1.01
"""An interface that reflects nothing would be none, for metals as well."""

Pixels = NDArray[np.floating[Any]]


class Materials:
    """The materials of a file.

    Args:
        file: the file.
        model: what is made of it; its `nodes` get the materials.
        largest: textures with more rows or columns are made smaller.
    """

    def __init__(self, file: GltfFile, model: Model, largest: int) -> None:
        self.file, self.model, self.largest = file, model, largest
        self._textures: dict[Any, Any] = {}
        """Nodes of textures by all that they depend on: textures that are alike share their pixels."""
        self._sets: dict[int | None, int] = {}

    # ---- textures --------------------------------------------------------------------------

    def uv_set(self, number: int | None) -> int:
        """The set of texture coordinates that a material uses; a mesh has one here."""
        if number is None:
            return 0
        if number not in self._sets:
            used: dict[int, str] = {}
            for name, info in self._infos(self.file.at("materials", number)).items():
                used.setdefault(self._set_of(info), name)
            self._sets[number] = next(iter(used), 0)
            if len(used) > 1:
                kept, *others = used.values()
                self.model.say(f"'{others[0]}' has texture coordinates of its own; it uses those of '{kept}'")
        return self._sets[number]

    def _infos(self, material: dict[str, Any]) -> dict[str, Any]:
        """The references to textures that are used, the most important one first."""
        base = self._base(material)
        gloss = self.file.extension(material, "KHR_materials_pbrSpecularGlossiness")
        found = {"baseColorTexture": base.get("baseColorTexture"), "diffuseTexture": gloss.get("diffuseTexture")}
        found |= {"normalTexture": material.get("normalTexture")}
        found |= {"metallicRoughnessTexture": base.get("metallicRoughnessTexture")}
        found |= {"emissiveTexture": material.get("emissiveTexture")}
        for name in ("transmission", "clearcoat", "sheen", "specular", "anisotropy"):
            for key, value in self.file.extension(material, f"KHR_materials_{name}").items():
                if key in ("transmissionTexture", "clearcoatTexture", "clearcoatRoughnessTexture"):
                    found[key] = value
        return {key: info for key, info in found.items() if isinstance(info, dict) and "index" in info}

    def _base(self, material: dict[str, Any]) -> dict[str, Any]:
        base = material.get("pbrMetallicRoughness", {})
        if not isinstance(base, dict):
            raise self.file.error("'pbrMetallicRoughness' must be an object")
        return base

    def _set_of(self, info: dict[str, Any]) -> int:
        moved = self.file.extension(info, "KHR_texture_transform")
        found = moved.get("texCoord", info.get("texCoord", 0))
        return found if isinstance(found, int) and 0 <= found < 100 else 0

    def _pixels(self, info: Any) -> Any:
        """The pixels that a reference to a texture leads to, (H, W, 4); None if there are none."""
        if not isinstance(info, dict) or "index" not in info:
            return None
        texture = self.file.at("textures", info["index"])
        source = self.file.extension(texture, "EXT_texture_webp").get("source", texture.get("source"))
        if source is None:
            if self.file.extension(texture, "KHR_texture_basisu"):
                raise self.file.error("textures of the form 'KHR_texture_basisu' (KTX 2) can't be read")
            self.model.say("textures without an image are left out")
            return None
        pixels, smaller = self.file.image(source, self.largest)
        if smaller:
            self.model.say(f"textures are made smaller, to {self.largest} pixels: see 'texture_size'")
        return pixels

    def _texture(self, info: Any, pixels: NDArray[Any], key: Any, raw: bool) -> dict[str, Any]:
        """The node of a texture of these pixels, bytes or linear numbers, at the place that `info` says."""
        texture = self.file.at("textures", info["index"])
        sampler = self.file.at("samplers", texture["sampler"]) if "sampler" in texture else {}
        wraps = [WRAP.get(sampler.get(name, 10497), "repeat") for name in ("wrapS", "wrapT")]
        if wraps[0] != wraps[1]:
            self.model.say(f"textures wrap alike along u and v: '{wraps[0]}'")
        node: dict[str, Any] = {"type": "bitmap", "wrap_mode": wraps[0]}
        # Equal pixels are one array, which equal nodes of a scene share.
        node |= {"bitmap" if pixels.dtype == np.uint8 else "data": self._textures.setdefault(key, pixels)}
        node["raw"] = raw or pixels.dtype != np.uint8
        if sampler.get("magFilter") == NEAREST:
            node["filter_type"] = "nearest"
        moved = self.file.extension(info, "KHR_texture_transform")
        if moved:
            offset, scale = numbers(moved.get("offset"), (0, 0)), numbers(moved.get("scale"), (1, 1))
            angle = scalar(moved.get("rotation"), 0.0)
            c, s = math.cos(angle), math.sin(angle)
            matrix = np.eye(4)
            matrix[:2, :2] = np.array([[c, s], [-s, c]]) * np.where(scale == 0, 1e-6, scale)
            matrix[:2, 3] = offset
            node["to_uv"] = ScalarTransform4f(matrix)
        return node

    def _channel(self, info: Any, channel: int, factor: float, what: str) -> Any:
        """A scalar texture from one channel of a texture, times a factor; a number without a texture."""
        pixels = self._pixels(info)
        if pixels is None:
            return float(np.clip(factor, 0, 1))
        values = pixels[..., channel : channel + 1]
        if values.min() == values.max():
            return float(np.clip(factor * (values.flat[0] / 255), 0, 1))
        if factor != 1:
            values = np.clip(np.rint(values * np.clip(factor, 0, 1)), 0, 255).astype(np.uint8)
        key = (what, info["index"], channel, factor)
        return self._texture(info, np.ascontiguousarray(values), key, raw=True)

    def _color(self, info: Any, factor: NDArray[np.float64]) -> Any:
        """A colour texture times a linear factor, in [0, 1]."""
        pixels = self._pixels(info)
        if pixels is None:
            return {"type": "rgb", "value": np.clip(factor, 0, 1).tolist()}
        key = ("color", info["index"], tuple(factor))
        if (factor == 1).all():
            return self._texture(info, np.ascontiguousarray(pixels[..., :3]), key, raw=False)
        # A table of 256 colours for each channel: most exact, and fast.
        table = np.clip(encoded(decoded(np.arange(256)[:, None] / 255) * factor) * 255 + 0.5, 0, 255).astype(np.uint8)
        values = np.stack([table[pixels[..., i], i] for i in range(3)], axis=-1)
        return self._texture(info, values, key, raw=False)

    # ---- parts -----------------------------------------------------------------------------

    def parts(self, number: int | None, mesh: MeshData, colors: NDArray[np.float32] | None, where: str) -> list[Part]:
        """The parts of a mesh with a material."""
        material = {} if number is None else self.file.at("materials", number)
        tint, opacity = np.ones(3), 1.0
        if colors is not None:
            if (colors == colors[0]).all():
                tint, opacity = colors[0, :3].astype(np.float64), float(colors[0, 3])
                colors = None
            elif self._pixels(self._base(material).get("baseColorTexture")) is not None:
                self.model.say("vertex colours on a texture are replaced by their mean")
                tint, opacity = colors[:, :3].mean(axis=0), float(colors[:, 3].mean())
                colors = None
        if colors is not None:
            factor = numbers(self._base(material).get("baseColorFactor"), (1, 1, 1, 1))
            mesh.attributes["vertex_color"] = np.clip(colors[:, :3] * factor[:3], 0, 1).astype(np.float32)
            if colors[:, 3].min() < 1:
                mesh.attributes["vertex_opacity"] = np.clip(colors[:, 3:] * factor[3], 0, 1).astype(np.float32)
        alpha = "vertex_opacity" in mesh.attributes
        result = []
        for half, mirrored in self._halves(material, mesh):
            key = (number, mirrored, colors is not None, alpha, tuple(tint), opacity)
            name = "material_" + ("default" if number is None else str(number))
            name = self._named(
                name, key, lambda m=mirrored: self._node(material, m, colors is not None, alpha, tint, opacity)
            )
            part = Part(str(material.get("name") or where)[:100], half, name, [], self._emission(material, where))
            if self.file.extension(material, "KHR_materials_volume"):
                part.interior = self._interior(material, number)
            result.append(part)
        return result

    def _named(self, name: str, key: Any, make: Any) -> str:
        """The name of a node that is made once for each key."""
        if key not in self._textures:
            free, count = name, 1
            while free in self.model.nodes:
                count += 1
                free = f"{name}_{count}"
            self.model.nodes[free] = make()
            self._textures[key] = free
        found: str = self._textures[key]
        return found

    def _halves(self, material: dict[str, Any], mesh: MeshData) -> list[tuple[MeshData, bool]]:
        """The triangles whose texture isn't mirrored, and those whose is: normal maps tell left from right."""
        if not isinstance(material.get("normalTexture"), dict) or mesh.texcoords is None:
            return [(mesh, False)]
        a, b, c = (mesh.texcoords[mesh.indices[:, i]] for i in range(3))
        u, v = b - a, c - a
        mirrored = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] > 0  # v points down in images
        share = float(mirrored.mean())
        if share in (0.0, 1.0):
            return [(mesh, share == 1)]
        halves = []
        for side in (False, True):
            own = MeshData(mesh.positions, np.ascontiguousarray(mesh.indices[mirrored == side]), mesh.normals)
            own.texcoords, own.attributes = mesh.texcoords, dict(mesh.attributes)
            halves.append((compacted(own), side))
        return halves

    # ---- nodes -----------------------------------------------------------------------------

    def _node(
        self, material: dict[str, Any], mirrored: bool, colored: bool, alpha: bool, tint: Any, opacity: float
    ) -> dict[str, Any]:
        """The BSDF of a material."""
        node, transmits = self._lobes(material, colored, tint)
        normal: Any = material.get("normalTexture")
        pixels = self._pixels(normal)
        if pixels is not None:
            strength = scalar(normal.get("scale"), 1.0)
            key = ("normal", normal["index"], strength, mirrored)
            texture = self._texture(normal, normals_of(pixels, strength, mirrored), key, raw=True)
            node = {"type": "normalmap", "normalmap": texture, "bsdf": node}
        if not transmits:
            node = {"type": "twosided", "bsdf": node}
        mode = material.get("alphaMode", "OPAQUE")
        if mode in ("MASK", "BLEND"):
            covered = self._opacity(material, mode, alpha, opacity)
            if not isinstance(covered, float) or covered < 1:
                node = {"type": "mask", "opacity": covered, "bsdf": node}
        return node

    def _opacity(self, material: dict[str, Any], mode: str, alpha: bool, opacity: float) -> Any:
        """How much of the surface is there: a number or a texture."""
        base = self._base(material)
        info: Any = base.get("baseColorTexture")
        gloss = self.file.extension(material, "KHR_materials_pbrSpecularGlossiness")
        factor = float(numbers(base.get("baseColorFactor"), (1, 1, 1, 1))[3]) * opacity
        if gloss:
            info, factor = gloss.get("diffuseTexture"), float(numbers(gloss.get("diffuseFactor"), (1, 1, 1, 1))[3])
        cutoff = scalar(material.get("alphaCutoff"), 0.5)
        pixels = self._pixels(info)
        if pixels is None:
            if alpha and mode == "BLEND":
                return {"type": "mesh_attribute", "name": "vertex_opacity"}
            return float(np.clip(factor, 0, 1)) if mode == "BLEND" else float(factor >= cutoff)
        if mode == "BLEND":
            return self._channel(info, 3, factor, "opacity")
        values = np.where(pixels[..., 3:] * (factor / 255) >= cutoff, 255, 0).astype(np.uint8)
        if values.min() == values.max():
            return float(values.flat[0] / 255)
        return self._texture(info, values, ("mask", info["index"], cutoff, factor), raw=True)

    def _lobes(self, material: dict[str, Any], colored: bool, tint: Any) -> tuple[dict[str, Any], bool]:
        """The principled BSDF, and whether it lets light through."""
        base = self._base(material)

        def extension(name: str) -> dict[str, Any]:
            return self.file.extension(material, f"KHR_materials_{name}")

        if self.file.has_extension(material, "KHR_materials_unlit"):
            return {"type": "diffuse", "reflectance": 0.0}, False
        factor = numbers(base.get("baseColorFactor"), (1, 1, 1, 1))[:3] * tint
        gloss = extension("pbrSpecularGlossiness")
        if gloss:
            return self._glossy(gloss, tint), False
        rough = base.get("metallicRoughnessTexture")
        node: dict[str, Any] = {
            "type": "principled",
            "base_color": self._color(base.get("baseColorTexture"), factor),
            "roughness": self._channel(rough, 1, scalar(base.get("roughnessFactor"), 1.0), "rough"),
            "metallic": self._channel(rough, 2, scalar(base.get("metallicFactor"), 1.0), "metal"),
        }
        if colored:
            node["base_color"] = {"type": "mesh_attribute", "name": "vertex_color"}
        transmission, clearcoat, sheen = extension("transmission"), extension("clearcoat"), extension("sheen")
        transmits = scalar(transmission.get("transmissionFactor"), 0.0) > 0
        node["eta"] = self._eta(extension("ior"), extension("specular"), transmits)
        strength = scalar(clearcoat.get("clearcoatFactor"), 0.0)
        if strength > 0:
            node["clearcoat"] = self._channel(clearcoat.get("clearcoatTexture"), 0, strength, "coat")
            rough_coat = scalar(clearcoat.get("clearcoatRoughnessFactor"), 0.0)
            if self._pixels(clearcoat.get("clearcoatRoughnessTexture")) is not None:
                self.model.say("the texture of a clear coat's roughness is replaced by its factor")
            if rough_coat**2 > COAT:
                self.model.say("clear coats are smoother: their roughness is at most 0.32")
            if clearcoat.get("clearcoatNormalTexture"):
                self.model.say("a clear coat has the normals of what it covers")
            node["clearcoat_gloss"] = float(np.clip((COAT - rough_coat**2) / (COAT - 0.001), 0, 1))
        color = np.clip(numbers(sheen.get("sheenColorFactor"), (0, 0, 0)), 0, 1)
        if color.any():
            if color.min() < color.max() or sheen.get("sheenColorTexture"):
                self.model.say("the colour of a sheen is replaced by white of the same strength")
            node["sheen"] = float(color.mean())
        anisotropy = extension("anisotropy")
        if anisotropy:
            self._add_anisotropy(node, anisotropy)
        for name, instead in (("iridescence", "a plain interface"), ("dispersion", "one index of refraction")):
            if extension(name):
                self.model.say(f"'KHR_materials_{name}' is left out: {instead} stands in its place")
        if transmits:
            node = self._transparent(node, material, transmission)
        return {key: value for key, value in node.items() if key in KEEP or value != 0.0}, transmits

    def _transparent(self, node: dict[str, Any], material: dict[str, Any], transmission: Any) -> dict[str, Any]:
        """The same surface, letting light through: a body that has a volume, or a thin sheet."""
        factor = scalar(transmission.get("transmissionFactor"), 0.0)
        node["spec_trans"] = self._channel(transmission.get("transmissionTexture"), 0, factor, "transmission")
        thick = scalar(self.file.extension(material, "KHR_materials_volume").get("thicknessFactor"), 0.0) > 0
        if thick or node["metallic"] != 0.0:
            return node
        if "clearcoat" in node:
            self.model.say("the clear coat of a thin transparent sheet is left out")
        kept = {key: value for key, value in node.items() if key not in ("metallic", "clearcoat", "clearcoat_gloss")}
        return {**kept, "type": "principledthin"}

    def _add_anisotropy(self, node: dict[str, Any], anisotropy: dict[str, Any]) -> None:
        strength = float(np.clip(scalar(anisotropy.get("anisotropyStrength"), 0.0), 0, 1))
        if scalar(anisotropy.get("anisotropyRotation"), 0.0) or anisotropy.get("anisotropyTexture"):
            self.model.say("anisotropy runs along u: its rotation and its texture are left out")
        rough = node["roughness"]
        alpha = max(rough**2 if isinstance(rough, float) else 0.16, 1e-3)
        # glTF widens the lobe along the tangent, from alpha to alpha + (1 - alpha) strength^2.
        ratio = alpha / (alpha + (1 - alpha) * strength**2)
        node["anisotropic"] = float(np.clip((1 - ratio) / 0.9, 0, 1))
        if isinstance(rough, float):
            node["roughness"] = float(min(1.0, math.sqrt(alpha / math.sqrt(ratio))))

    def _eta(self, ior: dict[str, Any], specular: dict[str, Any], transmits: bool) -> float:
        """The relative index of refraction that gives the reflectance at normal incidence."""
        eta = scalar(ior.get("ior"), 1.5)
        eta = float(np.clip(eta, 1.0, 5.0)) if eta else 5.0  # 0 stands for infinity
        strength = float(np.clip(scalar(specular.get("specularFactor"), 1.0), 0, 1))
        color = np.clip(numbers(specular.get("specularColorFactor"), (1, 1, 1)), 0, None)
        if specular.get("specularTexture") or specular.get("specularColorTexture"):
            self.model.say("textures of 'KHR_materials_specular' are replaced by its factors")
        if color.min() < color.max():
            self.model.say("the colour of a dielectric's reflection is replaced by its mean")
        if transmits:  # the index bends light, too
            return max(eta, SMALLEST_ETA)
        reflectance = min(((eta - 1) / (eta + 1)) ** 2 * strength * float(color.mean()), 0.9)
        root = math.sqrt(reflectance)
        return max((1 + root) / (1 - root), SMALLEST_ETA)

    def _glossy(self, gloss: dict[str, Any], tint: Any) -> dict[str, Any]:
        """The material of KHR_materials_pbrSpecularGlossiness, with the mean of its specular colour."""
        diffuse = numbers(gloss.get("diffuseFactor"), (1, 1, 1, 1))[:3] * tint
        specular = np.clip(numbers(gloss.get("specularFactor"), (1, 1, 1)), 0, 1)
        glossiness = float(np.clip(scalar(gloss.get("glossinessFactor"), 1.0), 0, 1))
        pixels = self._pixels(gloss.get("specularGlossinessTexture"))
        if pixels is not None:
            self.model.say("the texture of specular colours and glossiness is replaced by its mean")
            specular = specular * decoded(pixels[..., :3].mean(axis=(0, 1)) / 255)
            glossiness *= float(pixels[..., 3].mean()) / 255
        root = math.sqrt(min(float(specular.mean()), 0.9))
        return {
            "type": "principled",
            "base_color": self._color(gloss.get("diffuseTexture"), diffuse),
            "roughness": 1 - glossiness,
            "eta": max((1 + root) / (1 - root), SMALLEST_ETA),
        }

    # ---- light and matter ------------------------------------------------------------------

    def _emission(self, material: dict[str, Any], where: str) -> dict[str, Any] | None:
        """The radiance of a material that shines; None for others."""
        if self.file.has_extension(material, "KHR_materials_unlit"):
            self.model.say("unlit materials shine by themselves, with their colour")
            base = self._base(material)
            found = self._color(base.get("baseColorTexture"), numbers(base.get("baseColorFactor"), (1, 1, 1, 1))[:3])
            return dict(found)
        factor = np.clip(numbers(material.get("emissiveFactor"), (0, 0, 0)), 0, 1e6)
        strength = self.file.extension(material, "KHR_materials_emissive_strength")
        factor = factor * min(max(scalar(strength.get("emissiveStrength"), 1.0), 0.0), 1e9)
        if not factor.any():
            return None
        info: Any = material.get("emissiveTexture")
        pixels = self._pixels(info)
        if pixels is None:
            return {"type": "rgb", "value": factor.tolist()}
        if not pixels[..., :3].any():
            return None
        key = ("emission", info["index"], tuple(factor))
        if key not in self._textures:
            table = (decoded(np.arange(256)[:, None] / 255) * factor).astype(np.float32)
            self._textures[key] = np.stack([table[pixels[..., i], i] for i in range(3)], axis=-1)
        return self._texture(info, self._textures[key], key, raw=True)

    def _interior(self, material: dict[str, Any], number: int | None) -> str | None:
        """The name of the medium in a body that absorbs; None without one."""
        volume = self.file.extension(material, "KHR_materials_volume")
        transmission = self.file.extension(material, "KHR_materials_transmission")
        distance = scalar(volume.get("attenuationDistance"), math.inf)
        color = np.clip(numbers(volume.get("attenuationColor"), (1, 1, 1)), 1e-4, 1)
        thick = scalar(volume.get("thicknessFactor"), 0.0) > 0 and scalar(transmission.get("transmissionFactor"), 0) > 0
        if not thick or not 0 < distance < math.inf or (color == 1).all():
            return None
        sigma = np.minimum(-np.log(color) / distance, 1e6)

        def medium() -> dict[str, Any]:
            return {"type": "homogeneous", "albedo": 0.0, "sigma_t": {"type": "rgb", "value": sigma.tolist()}}

        return self._named(f"medium_{number}", ("medium", number), medium)


KEEP = ("type", "base_color", "roughness", "eta")
"""Entries that stay whatever their value."""


def decoded(values: Pixels) -> Pixels:
    """Linear values of sRGB's, in [0, 1]."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def encoded(values: Pixels) -> Pixels:
    """sRGB's values of linear ones, in [0, 1]."""
    values = np.clip(values, 0, 1)
    return np.where(values <= 0.0031308, values * 12.92, 1.055 * values ** (1 / 2.4) - 0.055)


def normals_of(pixels: NDArray[np.uint8], strength: float, mirrored: bool) -> NDArray[np.uint8]:
    """The pixels of a normal map, stronger or weaker, and turned over for triangles with a mirrored texture."""
    result = np.ascontiguousarray(pixels[..., :3])
    if strength != 1:
        xy = np.clip((result[..., :2] / 127.5 - 1) * strength, -1, 1)
        result[..., :2] = np.rint((xy + 1) * 127.5)
    if mirrored:
        result = result.copy()
        result[..., 1] = 255 - result[..., 1]
    return result


def compacted(mesh: MeshData) -> MeshData:
    """The same triangles without the vertices that none of them uses."""
    used, indices = np.unique(mesh.indices, return_inverse=True)
    result = MeshData(mesh.positions[used], indices.reshape(-1, 3).astype(np.uint32))
    result.normals = None if mesh.normals is None else mesh.normals[used]
    result.texcoords = None if mesh.texcoords is None else mesh.texcoords[used]
    result.attributes = {name: values[used] for name, values in mesh.attributes.items()}
    return result

"""Materials of glTF as nodes of the `principled` BSDF, with their textures."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.models.gltf_file import GltfFile, numbers, scalar
from djpt.models.gltf_textures import Pixels, Textures, decoded, encoded
from djpt.models.model import Model, Part
from djpt.shapes.meshes.data import MeshData

__all__ = ["Materials"]

COAT = 0.1
"""The largest alpha of the coat of `principled`."""
SMALLEST_ETA = 1.01
"""An interface that reflects nothing would be none, for metals as well."""


class Materials:
    """The materials of a file.

    Args:
        file: the file.
        model: what is made of it; its `nodes` get the materials.
        largest: textures with more rows or columns are made smaller.
    """

    def __init__(self, file: GltfFile, model: Model, largest: int) -> None:
        self.file, self.model = file, model
        self.textures = Textures(file, model, largest)
        self._made: dict[Any, Any] = {}
        """Names of nodes, and pixels of emission, by all that they depend on."""
        self._sets: dict[int | None, int] = {}

    # ---- texture coordinates ---------------------------------------------------------------

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
        found |= {"specularGlossinessTexture": gloss.get("specularGlossinessTexture")}
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

    # ---- parts -----------------------------------------------------------------------------

    def parts(self, number: int | None, mesh: MeshData, colors: NDArray[np.float32] | None, where: str) -> list[Part]:
        """The parts of a mesh with a material."""
        material = {} if number is None else self.file.at("materials", number)
        tint, opacity = np.ones(3), 1.0
        if colors is not None:
            if (colors == colors[0]).all():
                tint, opacity = colors[0, :3].astype(np.float64), float(colors[0, 3])
                colors = None
            elif self.textures.pixels(self._base(material).get("baseColorTexture")) is not None:
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
        if key not in self._made:
            free, count = name, 1
            while free in self.model.nodes:
                count += 1
                free = f"{name}_{count}"
            self.model.nodes[free] = make()
            self._made[key] = free
        found: str = self._made[key]
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
        pixels = self.textures.pixels(normal)
        if pixels is not None:
            strength = scalar(normal.get("scale"), 1.0)
            key = ("normal", normal["index"], strength, mirrored)
            texture = self.textures.node(normal, normals_of(pixels, strength, mirrored), key, raw=True)
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
        pixels = self.textures.pixels(info)
        if pixels is None:
            if alpha and mode == "BLEND":
                return {"type": "mesh_attribute", "name": "vertex_opacity"}
            return float(np.clip(factor, 0, 1)) if mode == "BLEND" else float(factor >= cutoff)
        if mode == "BLEND":
            return self.textures.channel(info, 3, factor, "opacity")
        values = np.where(pixels[..., 3:] * (factor / 255) >= cutoff, 255, 0).astype(np.uint8)
        if values.min() == values.max():
            return float(values.flat[0] / 255)
        return self.textures.node(info, values, ("mask", info["index"], cutoff, factor), raw=True)

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
            "base_color": self.textures.color(base.get("baseColorTexture"), factor),
            "roughness": self.textures.channel(rough, 1, scalar(base.get("roughnessFactor"), 1.0), "rough"),
            "metallic": self.textures.channel(rough, 2, scalar(base.get("metallicFactor"), 1.0), "metal"),
        }
        if colored:
            node["base_color"] = {"type": "mesh_attribute", "name": "vertex_color"}
        transmission, clearcoat, sheen = extension("transmission"), extension("clearcoat"), extension("sheen")
        transmits = scalar(transmission.get("transmissionFactor"), 0.0) > 0
        node["eta"] = self._eta(extension("ior"), extension("specular"), transmits)
        strength = scalar(clearcoat.get("clearcoatFactor"), 0.0)
        if strength > 0:
            node["clearcoat"] = self.textures.channel(clearcoat.get("clearcoatTexture"), 0, strength, "coat")
            if scalar(clearcoat.get("clearcoatRoughnessFactor"), 0.0) ** 2 > COAT:
                self.model.say("clear coats are smoother: their roughness is at most 0.32")
            if clearcoat.get("clearcoatNormalTexture"):
                self.model.say("a clear coat has the normals of what it covers")
            node["clearcoat_gloss"] = self._coat_gloss(clearcoat)
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

    def _coat_gloss(self, clearcoat: dict[str, Any]) -> Any:
        """The gloss of a clear coat, of which `principled` makes alpha = 0.1 + gloss (0.001 - 0.1)."""
        factor = float(np.clip(scalar(clearcoat.get("clearcoatRoughnessFactor"), 0.0), 0, 1))
        info: Any = clearcoat.get("clearcoatRoughnessTexture")
        pixels = self.textures.pixels(info)
        rough = np.array([[[factor]]]) if pixels is None else pixels[..., 1:2] * (factor / 255)
        gloss = np.clip((COAT - rough**2) / (COAT - 0.001), 0, 1)
        if gloss.min() == gloss.max():
            return float(gloss.flat[0])
        return self.textures.node(
            info, np.rint(255 * gloss).astype(np.uint8), ("gloss", info["index"], factor), raw=True
        )

    def _transparent(self, node: dict[str, Any], material: dict[str, Any], transmission: Any) -> dict[str, Any]:
        """The same surface, letting light through: a body that has a volume, or a thin sheet."""
        factor = scalar(transmission.get("transmissionFactor"), 0.0)
        node["spec_trans"] = self.textures.channel(transmission.get("transmissionTexture"), 0, factor, "transmission")
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
        """The material of KHR_materials_pbrSpecularGlossiness, as a metallic-roughness one texel by texel."""
        factor = numbers(gloss.get("diffuseFactor"), (1, 1, 1, 1))[:3] * tint
        specular = np.clip(numbers(gloss.get("specularFactor"), (1, 1, 1)), 0, 1)
        glossiness = float(np.clip(scalar(gloss.get("glossinessFactor"), 1.0), 0, 1))
        infos: list[Any] = [gloss.get("diffuseTexture"), gloss.get("specularGlossinessTexture")]
        first, second = (self.textures.pixels(info) for info in infos)
        if second is None:  # then only the diffuse colour varies
            base, metallic = metallic_of(factor[None], specular[None])
            color = self.textures.color(infos[0], base[0] if first is None or metallic[0, 0] > 0.5 else factor)
            node = {"type": "principled", "base_color": color, "metallic": float(metallic[0, 0])}
            return node | {"roughness": 1 - glossiness}
        if first is None:
            first = np.full((1, 1, 4), 255, np.uint8)
        height, width = (max(first.shape[axis], second.shape[axis]) for axis in (0, 1))
        first, second = stretched(first, height, width), stretched(second, height, width)
        base, metallic = metallic_of(decoded(first[..., :3] / 255) * factor, decoded(second[..., :3] / 255) * specular)
        rough = 1 - glossiness * second[..., 3:] / 255
        info = infos[0] if isinstance(infos[0], dict) else infos[1]
        key = ("gloss", *(i.get("index") if isinstance(i, dict) else None for i in infos), *factor, *specular)
        images = {"base_color": encoded(base), "metallic": metallic, "roughness": rough}
        node = {"type": "principled"}
        for name, values in images.items():
            texels = np.rint(255 * np.clip(values, 0, 1)).astype(np.uint8)
            node[name] = self.textures.node(info, texels, (*key, glossiness, name), raw=name != "base_color")
        return node

    # ---- light and matter ------------------------------------------------------------------

    def _emission(self, material: dict[str, Any], where: str) -> dict[str, Any] | None:
        """The radiance of a material that shines; None for others."""
        if self.file.has_extension(material, "KHR_materials_unlit"):
            self.model.say("unlit materials shine by themselves, with their colour")
            base = self._base(material)
            found = self.textures.color(
                base.get("baseColorTexture"), numbers(base.get("baseColorFactor"), (1, 1, 1, 1))[:3]
            )
            return dict(found)
        factor = np.clip(numbers(material.get("emissiveFactor"), (0, 0, 0)), 0, 1e6)
        strength = self.file.extension(material, "KHR_materials_emissive_strength")
        factor = factor * min(max(scalar(strength.get("emissiveStrength"), 1.0), 0.0), 1e9)
        if not factor.any():
            return None
        info: Any = material.get("emissiveTexture")
        pixels = self.textures.pixels(info)
        if pixels is None:
            return {"type": "rgb", "value": factor.tolist()}
        if not pixels[..., :3].any():
            return None
        key = ("emission", info["index"], tuple(factor))
        if key not in self._made:
            table = (decoded(np.arange(256)[:, None] / 255) * factor).astype(np.float32)
            self._made[key] = np.stack([table[pixels[..., i], i] for i in range(3)], axis=-1)
        return self.textures.node(info, self._made[key], key, raw=True)

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
        # Free paths of a colour that isn't absorbed at all would be infinite, and their transmittance undefined.
        scale = float(sigma.max())
        relative = np.maximum(sigma / scale, 1e-6).tolist()  # Mitsuba takes colours up to 1 here

        def medium() -> dict[str, Any]:
            return {
                "type": "homogeneous",
                "albedo": 0.0,
                "sigma_t": {"type": "rgb", "value": relative},
                "scale": scale,
            }

        return self._named(f"medium_{number}", ("medium", number), medium)


KEEP = ("type", "base_color", "roughness", "eta")
"""Entries that stay whatever their value."""


DIELECTRIC = 0.04
"""The reflectance of a dielectric of glTF at normal incidence."""


def metallic_of(diffuse: Pixels, specular: Pixels) -> tuple[Pixels, Pixels]:
    """The base colour (.., 3) and the metalness (.., 1) of diffuse and specular colours, linear, (.., 3).

    With the metalness m, the base colour b and the reflectance r = 0.04 of dielectrics, diffuse = (1 - m) (1 - r) b /
    (1 - max(specular)), specular = (1 - m) r + m b; solved for m with luminances, as the registry of glTF proposes for
    KHR_materials_pbrSpecularGlossiness.
    """
    weights = np.sqrt([0.299, 0.587, 0.114])
    d, s = (np.linalg.norm(x * weights, axis=-1, keepdims=True) for x in (diffuse, specular))
    rest = 1 - specular.max(axis=-1, keepdims=True)
    b = d * rest / (1 - DIELECTRIC) + s - 2 * DIELECTRIC
    root = np.sqrt(np.maximum(b * b - 4 * DIELECTRIC * (DIELECTRIC - s), 0))
    metallic = np.where(s < DIELECTRIC, 0.0, np.clip((root - b) / (2 * DIELECTRIC), 0, 1))
    of_diffuse = diffuse * rest / ((1 - DIELECTRIC) * np.maximum(1 - metallic, 1e-4))
    of_specular = (specular - DIELECTRIC * (1 - metallic)) / np.maximum(metallic, 1e-4)
    share = metallic**2
    return np.clip((1 - share) * of_diffuse + share * of_specular, 0, 1), metallic


def stretched(pixels: NDArray[np.uint8], height: int, width: int) -> NDArray[np.uint8]:
    """Pixels as an image of another size, each texel kept."""
    rows, columns = np.arange(height) * pixels.shape[0] // height, np.arange(width) * pixels.shape[1] // width
    return pixels[rows[:, None], columns]


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

"""Materials of glTF as nodes of the `principled` BSDF, with their textures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.models.gltf_file import GltfFile, numbers, scalar
from djpt.models.gltf_textures import Textures
from djpt.models.model import Matrix, Model, Part
from djpt.models.normal_maps import halves, normals_of
from djpt.models.principled import COAT, SHEEN, SMALLEST_ETA, eta_of, gloss_of, luminance, of_hue
from djpt.models.textures import LINEAR, Lookup, encoded_bytes, linear, stored
from djpt.shapes.meshes.data import MeshData

__all__ = ["Materials"]

Vertices = dict[str, NDArray[np.float32]]
"""Values of vertices, (V, C), by name."""


@dataclass(frozen=True)
class Paint:
    """What the colours of a mesh's vertices make of its material."""

    color: tuple[float, ...] = (1.0, 1.0, 1.0)
    """The colour of all vertices, if it is the same."""
    opacity: float = 1.0
    names: tuple[str, ...] = ()
    """Those of `Part.tints` that vary."""

    def on(self, value: Any, name: str) -> Any:
        """A colour, a number or a texture, times the tint of a name if there is one."""
        if name not in self.names:
            return value
        node = {"type": "uniform", "value": value} if isinstance(value, float) else value
        return {**node, "tint": name}


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

    def _base(self, material: dict[str, Any]) -> dict[str, Any]:
        base = material.get("pbrMetallicRoughness", {})
        if not isinstance(base, dict):
            raise self.file.error("'pbrMetallicRoughness' must be an object")
        return base

    # ---- parts -----------------------------------------------------------------------------

    def parts(
        self,
        number: int | None,
        mesh: MeshData,
        coordinates: Vertices,
        colors: NDArray[np.float32] | None,
        where: str,
    ) -> list[Part]:
        """The parts of a mesh with a material.

        Args:
            number: that of the material; None for the one that stands where there is none.
            mesh: the mesh.
            coordinates: its sets of texture coordinates by number.
            colors: those of its vertices, (V, 4), linear, or None.
            where: for messages.
        """
        material = {} if number is None else self.file.at("materials", number)
        paint = Paint()
        tints: Vertices = {}
        if colors is not None and (colors == colors[0]).all():
            paint = Paint(tuple(colors[0, :3].tolist()), float(colors[0, 3]))
        elif colors is not None:
            opacity = float(colors[:, 3].mean()) if material.get("alphaMode") == "MASK" else 1.0
            tints = {"vertex_color": np.ascontiguousarray(colors[:, :3])}
            if colors[:, 3].min() < 1 and material.get("alphaMode") == "BLEND":
                tints["vertex_opacity"] = np.ascontiguousarray(colors[:, 3:])
            paint = Paint(opacity=opacity, names=tuple(tints))
        part = Part(str(material.get("name") or where)[:100], mesh, "", [], self._emission(material, paint))
        part.coordinates, part.tints = coordinates, tints
        part.one_sided = material.get("doubleSided") is not True
        if self.file.extension(material, "KHR_materials_volume"):
            part.interior = self._interior(material, number)
        normal = material.get("normalTexture")
        found = halves(part, self.textures.uv_set(normal) if isinstance(normal, dict) else None)
        name = "material_" + ("default" if number is None else str(number))
        for half, mirrored in found:
            half.bsdf = self._named(name, (number, mirrored, paint), lambda m=mirrored: self._node(material, m, paint))
        return [half for half, _ in found]

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

    # ---- nodes -----------------------------------------------------------------------------

    def _node(self, material: dict[str, Any], mirrored: bool, paint: Paint) -> dict[str, Any]:
        """The BSDF of a material."""
        node, transmits = self._lobes(material, paint)
        normal: Any = material.get("normalTexture")
        pixels = self.textures.pixels(normal)
        if pixels is not None:
            strength = scalar(normal.get("scale"), 1.0)
            key = ("normal", strength, mirrored)
            texture = self.textures.node(normal, normals_of(pixels, strength, mirrored), key, raw=True)
            node = {"type": "normalmap", "normalmap": texture, "bsdf": node}
        if not transmits:
            node = {"type": "twosided", "bsdf": node}
        mode = material.get("alphaMode", "OPAQUE")
        if mode in ("MASK", "BLEND"):
            covered = self._opacity(material, mode, paint)
            if not isinstance(covered, float) or covered < 1:
                node = {"type": "mask", "opacity": covered, "bsdf": node}
        return node

    def _opacity(self, material: dict[str, Any], mode: str, paint: Paint) -> Any:
        """How much of the surface is there: a number or a texture."""
        base = self._base(material)
        info: Any = base.get("baseColorTexture")
        gloss = self.file.extension(material, "KHR_materials_pbrSpecularGlossiness")
        factor = float(numbers(base.get("baseColorFactor"), (1, 1, 1, 1))[3]) * paint.opacity
        if gloss:
            info, factor = gloss.get("diffuseTexture"), float(numbers(gloss.get("diffuseFactor"), (1, 1, 1, 1))[3])
        cutoff = scalar(material.get("alphaCutoff"), 0.5)
        pixels = self.textures.pixels(info)
        if mode == "BLEND":
            return paint.on(self.textures.channel(info, 3, factor), "vertex_opacity")
        if pixels is None:
            return float(factor >= cutoff)
        return self.textures.bitmaps.cutout(info["index"], pixels, 3, factor, cutoff, self.textures.lookup(info))

    def _lobes(self, material: dict[str, Any], paint: Paint) -> tuple[dict[str, Any], bool]:
        """The principled BSDF, and whether it lets light through."""
        base = self._base(material)

        def extension(name: str) -> dict[str, Any]:
            return self.file.extension(material, f"KHR_materials_{name}")

        if self.file.has_extension(material, "KHR_materials_unlit"):
            return {"type": "diffuse", "reflectance": 0.0}, False
        factor = numbers(base.get("baseColorFactor"), (1, 1, 1, 1))[:3] * paint.color
        gloss = extension("pbrSpecularGlossiness")
        if gloss:
            return self._glossy(gloss, paint), False
        rough = base.get("metallicRoughnessTexture")
        node: dict[str, Any] = {
            "type": "principled",
            "base_color": paint.on(self.textures.color(base.get("baseColorTexture"), factor), "vertex_color"),
            "roughness": self.textures.channel(rough, 1, scalar(base.get("roughnessFactor"), 1.0)),
            "metallic": self.textures.channel(rough, 2, scalar(base.get("metallicFactor"), 1.0)),
        }
        transmission, clearcoat, sheen = extension("transmission"), extension("clearcoat"), extension("sheen")
        transmits = scalar(transmission.get("transmissionFactor"), 0.0) > 0
        strength = scalar(clearcoat.get("clearcoatFactor"), 0.0)
        if strength > 0:
            node["clearcoat"] = self.textures.channel(clearcoat.get("clearcoatTexture"), 0, strength)
            if scalar(clearcoat.get("clearcoatRoughnessFactor"), 0.0) ** 2 > COAT:
                self.model.say("clear coats are smoother: their roughness is at most 0.32")
            if clearcoat.get("clearcoatNormalTexture"):
                self.model.say("a clear coat has the normals of what it covers")
            node["clearcoat_gloss"] = self._coat_gloss(clearcoat)
        color = np.clip(numbers(sheen.get("sheenColorFactor"), (0, 0, 0)), 0, 1)
        if color.any():
            self._add_sheen(node, color, bool(sheen.get("sheenColorTexture")))
        self._add_eta(node, extension("ior"), extension("specular"), transmits)
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
        """The gloss of a clear coat: a number or a texture."""
        factor = float(np.clip(scalar(clearcoat.get("clearcoatRoughnessFactor"), 0.0), 0, 1))
        info: Any = clearcoat.get("clearcoatRoughnessTexture")
        pixels = self.textures.pixels(info)
        rough = np.array([[[factor]]]) if pixels is None else pixels[..., 1:2] * (factor / 255)
        gloss = gloss_of(rough)
        if gloss.min() == gloss.max():
            return float(gloss.flat[0])
        return self.textures.node(info, np.rint(255 * gloss).astype(np.uint8), ("coat", factor), raw=True)

    def _transparent(self, node: dict[str, Any], material: dict[str, Any], transmission: Any) -> dict[str, Any]:
        """The same surface, letting light through: a body that has a volume, or a thin sheet."""
        factor = scalar(transmission.get("transmissionFactor"), 0.0)
        node["spec_trans"] = self.textures.channel(transmission.get("transmissionTexture"), 0, factor)
        thick = scalar(self.file.extension(material, "KHR_materials_volume").get("thicknessFactor"), 0.0) > 0
        if thick or node["metallic"] != 0.0:
            return node
        if "clearcoat" in node:
            self.model.say("the clear coat of a thin transparent sheet is left out")
        kept = {key: value for key, value in node.items() if key not in ("metallic", "clearcoat", "clearcoat_gloss")}
        return {**kept, "type": "principledthin"}

    def _add_sheen(self, node: dict[str, Any], color: Matrix, has_texture: bool) -> None:
        """A sheen, which is white here, or has the hue of the base colour."""
        node["sheen"] = float(color.mean())
        if color.min() == color.max() and not has_texture:
            return
        if not has_texture and take_hue(node, color, SHEEN):
            node |= {"sheen": luminance(color), "sheen_tint": 1.0}
        else:
            self.model.say("the colour of a sheen is replaced by white of the same strength")

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

    def _add_eta(self, node: dict[str, Any], ior: dict[str, Any], specular: dict[str, Any], transmits: bool) -> None:
        """The relative index of refraction that gives the reflectance at normal incidence, and the hue of that."""
        eta = scalar(ior.get("ior"), 1.5)
        eta = float(np.clip(eta, 1.0, 5.0)) if eta else 5.0  # 0 stands for infinity
        strength = float(np.clip(scalar(specular.get("specularFactor"), 1.0), 0, 1)) * ((eta - 1) / (eta + 1)) ** 2
        color = np.clip(numbers(specular.get("specularColorFactor"), (1, 1, 1)), 0, None)
        if specular.get("specularTexture") or specular.get("specularColorTexture"):
            self.model.say("textures of 'KHR_materials_specular' are replaced by its factors")
        if transmits:  # the index bends light, too
            node["eta"] = max(eta, SMALLEST_ETA)
        elif color.min() < color.max() and "sheen_tint" not in node and take_hue(node, color, strength):
            node |= {"eta": eta_of(strength * luminance(color)), "spec_tint": 1.0}
        else:
            if color.min() < color.max():
                self.model.say("the colour of a dielectric's reflection is replaced by its mean")
            node["eta"] = eta_of(strength * float(color.mean()))

    def _glossy(self, gloss: dict[str, Any], paint: Paint) -> dict[str, Any]:
        """The material of KHR_materials_pbrSpecularGlossiness, as a metallic-roughness one texel by texel."""
        factor = numbers(gloss.get("diffuseFactor"), (1, 1, 1, 1))[:3] * paint.color
        specular = np.clip(numbers(gloss.get("specularFactor"), (1, 1, 1)), 0, 1)
        glossiness = float(np.clip(scalar(gloss.get("glossinessFactor"), 1.0), 0, 1))
        infos: list[Any] = [gloss.get("diffuseTexture"), gloss.get("specularGlossinessTexture")]
        first, second = (self.textures.pixels(info) for info in infos)
        if second is None:  # then only the diffuse colour varies
            base, metallic = metallic_of(factor[None], specular[None])
            color = self.textures.color(infos[0], base[0] if first is None or metallic[0, 0] > 0.5 else factor)
            node = {
                "type": "principled",
                "base_color": paint.on(color, "vertex_color"),
                "metallic": float(metallic[0, 0]),
            }
            return node | {"roughness": 1 - glossiness}
        if first is None:
            first = np.full((1, 1, 4), 255, np.uint8)
        height, width = (max(first.shape[axis], second.shape[axis]) for axis in (0, 1))
        first, second = stretched(first, height, width), stretched(second, height, width)
        base, metallic = metallic_of(LINEAR[first[..., :3]] * factor, LINEAR[second[..., :3]] * specular)
        rough = 1 - glossiness * second[..., 3:] / 255
        info = infos[0] if isinstance(infos[0], dict) else infos[1]
        key = ("gloss", *(i.get("index") if isinstance(i, dict) else None for i in infos), *factor, *specular)
        node = {"type": "principled"}
        colors = self.textures.node(info, encoded_bytes(base), (*key, "base_color"), raw=False)
        node["base_color"] = paint.on(colors, "vertex_color")
        for name, values in (("metallic", metallic), ("roughness", rough)):
            texels = np.rint(255 * np.clip(values, 0, 1)).astype(np.uint8)
            node[name] = self.textures.node(info, texels, (*key, glossiness, name), raw=True)
        return node

    # ---- light and matter ------------------------------------------------------------------

    def _emission(self, material: dict[str, Any], paint: Paint) -> dict[str, Any] | None:
        """The radiance of a material that shines; None for others."""
        if self.file.has_extension(material, "KHR_materials_unlit"):
            self.model.say("unlit materials shine by themselves, with their colour")
            base = self._base(material)
            factor = numbers(base.get("baseColorFactor"), (1, 1, 1, 1))[:3] * paint.color
            found = self.textures.color(base.get("baseColorTexture"), factor)
            if paint.names and found["type"] == "rgb":  # a light takes a texture as its factor, no attribute
                texel = encoded_bytes(np.array(found["value"]).reshape(1, 1, 3))
                found = self.textures.bitmaps.node(("unlit", *factor), texel, Lookup("0"), raw=False)
            return paint.on(found, "vertex_color")
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
        return self.textures.bitmaps.light(info["index"], pixels, factor, self.textures.lookup(info))

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


def take_hue(node: dict[str, Any], color: Matrix, albedo: float) -> bool:
    """Give the base colour the hue of a lobe, to which `principled` then gives that of the base colour.

    False, and nothing is done, where the base colour would change by more than a white lobe would be wrong.

    Args:
        node: a node of `principled`, which is changed.
        color: the colour of the lobe, (3,).
        albedo: roughly that of the lobe if it is white.
    """
    base = node["base_color"]
    if "tint" in base:
        return False
    values: Any = linear(base)[..., :3] if base["type"] == "bitmap" else np.array(base["value"])
    found = of_hue(values, color)
    changed = np.abs(found - values).reshape(-1, 3).mean(axis=0).max()
    if found.max() > 1 or changed > albedo * np.abs(color - color.mean()).max():
        return False
    node["base_color"] = (
        {"type": "rgb", "value": found.tolist()} if base["type"] == "rgb" else {**base, **stored(found, base)}
    )
    return True


def metallic_of(diffuse: Matrix, specular: Matrix) -> tuple[Matrix, Matrix]:
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
    """Matrix as an image of another size, each texel kept."""
    rows, columns = np.arange(height) * pixels.shape[0] // height, np.arange(width) * pixels.shape[1] // width
    return pixels[rows[:, None], columns]

"""Models in OBJ (with MTL), STL, OFF, 3MF and PLY files, read by trimesh; and meshes of trimesh in memory."""

from __future__ import annotations

import io
import logging
import warnings
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.files import shortened
from djpt.errors import FileError, SceneError
from djpt.models.folder import Folder
from djpt.models.images import check_file, decoding
from djpt.models.model import Model, Part
from djpt.models.normal_maps import halves, normals_of
from djpt.models.textures import Bitmaps, Lookup
from djpt.shapes.meshes.data import MeshData, unit

__all__ = ["of_arrays", "of_trimesh", "read_mesh"]

UP = {".stl": "z", ".3mf": "z"}
"""The axis that points up in formats of machine parts; elsewhere y."""


UV = "0"
"""The name of the only texture coordinates of a mesh."""


def trimesh_module() -> Any:
    """The module trimesh; raises `FileError` if it isn't installed."""
    try:
        import trimesh
    except ImportError:
        raise FileError("needs the package trimesh: pip install trimesh") from None
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    return trimesh


class Resolver:
    """The files that trimesh may ask for: those of the folder."""

    def __init__(self, folder: Folder) -> None:
        self.folder = folder
        self.missing: list[str] = []
        """Why files can't be read."""

    def get(self, name: Any) -> bytes:
        """The contents of a file; a missing one is what trimesh expects to happen."""
        try:
            name = name if isinstance(name, str) else bytes(name).decode("utf-8", "replace")
            data = self.folder.read(name)
            check_file(data, shortened(name))
            return data
        except (FileError, SceneError) as error:
            self.missing.append(str(error))
            raise KeyError(str(error)) from None

    __getitem__ = get

    def keys(self) -> list[str]:
        """No list: files are asked for by name."""
        return []

    def namespaced(self, namespace: str) -> Resolver:
        """The same folder for files of an archive."""
        return self


def read_mesh(data: bytes, folder: Folder, name: str) -> Model:
    """Read a file by trimesh.

    Raises:
        FileError: trimesh isn't installed.
        SceneError: the file is damaged.
    """
    trimesh = trimesh_module()
    suffix = "." + name.rpartition(".")[2].lower()
    colored = suffix == ".3mf" and check_archive(data, name)
    resolver = Resolver(folder)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            # Without `maintain_order`, for which trimesh gives corners that share a position one texture coordinate.
            loaded = trimesh.load(io.BytesIO(data), file_type=suffix[1:], resolver=resolver, process=False)
    except ModuleNotFoundError as error:
        raise FileError(f"{name}: needs the package {error.name}, see the extra 'models'") from None
    except MemoryError:
        raise SceneError(f"{name}: doesn't fit into memory") from None
    except Exception as error:  # parsers fail in many ways
        raise SceneError(f"{name}: can't be read: {str(error)[:200] or type(error).__name__}") from None
    try:
        model = of_trimesh(loaded, name, UP.get(suffix, "y"))
        if colored:
            model.say("materials and colours of 3MF are left out")
        for reason in resolver.missing:
            model.say(f"a material or texture is left out: {reason}")
        return model
    except (ValueError, IndexError, TypeError, KeyError, AttributeError) as error:
        if isinstance(error, SceneError):
            raise
        raise SceneError(f"{name}: can't be read: {str(error)[:200] or type(error).__name__}") from None


MOST_UNPACKED = 2**29
"""The most bytes in an archive."""


def check_archive(data: bytes, name: str) -> bool:
    """Whether a 3MF file has materials; raises `SceneError` for one that would become much larger when unpacked."""
    import zipfile

    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
        size = sum(entry.file_size for entry in archive.infolist())
        if size > MOST_UNPACKED:
            raise SceneError(f"{name}: has {size} bytes when unpacked; at most {MOST_UNPACKED}")
        texts = [archive.read(entry) for entry in archive.infolist() if entry.filename.endswith(".model")]
    except (zipfile.BadZipFile, zlib.error, ValueError, NotImplementedError, OSError, RuntimeError, EOFError) as error:
        raise SceneError(f"{name}: isn't an archive: {error}") from None
    return any(mark in text for text in texts for mark in (b"basematerials", b"colorgroup", b"texture2d"))


def of_trimesh(loaded: Any, name: str, up: str = "y") -> Model:
    """The model of a mesh or a scene of trimesh.

    Raises:
        SceneError: it is something else, such as a cloud of points, or has no triangles.
    """
    trimesh = trimesh_module()
    model = Model(name, up)
    bitmaps = Bitmaps(model)
    if isinstance(loaded, trimesh.Trimesh):
        places = {"mesh": (loaded, [np.eye(4)])}
    elif isinstance(loaded, trimesh.Scene):
        places = {}
        for node in loaded.graph.nodes_geometry:
            matrix, key = loaded.graph[node]
            places.setdefault(key, (loaded.geometry[key], []))[1].append(np.array(matrix, np.float64))
    else:
        raise SceneError(f"{name}: has no triangles, but is a {type(loaded).__name__} of trimesh")
    for key, (mesh, matrices) in places.items():
        if not isinstance(mesh, trimesh.Trimesh):
            model.say(f"{type(mesh).__name__}s, which have no triangles, are left out")
            continue
        if len(mesh.faces):
            model.parts += parts_of(model, bitmaps, str(key)[:100], mesh, matrices)
    return model


def parts_of(model: Model, bitmaps: Bitmaps, key: str, mesh: Any, matrices: list[NDArray[np.float64]]) -> list[Part]:
    """The parts of one mesh of trimesh: one, or two if a normal map is mirrored on some of it."""
    positions = np.asarray(mesh.vertices, np.float64).astype(np.float32)
    data = MeshData(positions, np.ascontiguousarray(mesh.faces, np.uint32))
    if "vertex_normals" in mesh._cache.cache and len(mesh.vertex_normals) == len(positions):
        data.normals = unit(np.asarray(mesh.vertex_normals))
    visual = mesh.visual
    kind = getattr(visual, "kind", None)
    part = Part(key, data, "", matrices)
    node: dict[str, Any] = {"type": "principled", "base_color": grey(0.6)}
    name = f"material_{len(model.nodes)}"
    if kind == "texture":
        uv = getattr(visual, "uv", None)
        if uv is not None and len(uv) == len(positions):
            flipped = np.nan_to_num(np.asarray(uv, np.float32)[:, :2], nan=0.0, posinf=0.0, neginf=0.0)
            part.coordinates = {UV: np.ascontiguousarray(flipped * (1, -1) + (0, 1), np.float32)}
        if hasattr(visual.material, "baseColorFactor"):
            found = Pbr(model, bitmaps, visual.material, bool(part.coordinates))
            part.emission = found.emission()
            halved = halves(part, UV if found.has_normals else None)
            for half, mirrored in halved:
                half.bsdf = f"{name}_mirrored" if mirrored else name
                model.nodes[half.bsdf] = found.node(mirrored)
            return [half for half, _ in halved]
        node = of_mtl(model, bitmaps, visual.material, bool(part.coordinates))
        part.emission = emitted(visual.material)
    elif kind == "vertex":
        data.attributes["vertex_color"] = decoded_bytes(np.asarray(visual.vertex_colors)[:, :3])
        node["base_color"] = {"type": "mesh_attribute", "name": "vertex_color"}
    elif kind == "face":
        colors = decoded_bytes(np.asarray(visual.face_colors)[:, :3])
        if (colors == colors[0]).all():
            node["base_color"] = {"type": "rgb", "value": colors[0].tolist()}
        else:
            data.attributes["face_color"] = colors
            node["base_color"] = {"type": "mesh_attribute", "name": "face_color"}
    part.bsdf = name
    model.nodes[name] = node if node["type"] == "mask" else {"type": "twosided", "bsdf": node}
    return [part]


class Pbr:
    """A metallic-roughness material of trimesh, whose entries and defaults are those of glTF.

    Args:
        model: for messages.
        bitmaps: makes the textures.
        material: a `trimesh.visual.material.PBRMaterial`.
        has_uv: whether the mesh has texture coordinates.
    """

    def __init__(self, model: Model, bitmaps: Bitmaps, material: Any, has_uv: bool) -> None:
        self.model, self.bitmaps, self.material, self.has_uv = model, bitmaps, material, has_uv
        self.has_normals = has_uv and material.normalTexture is not None

    def _pixels(self, name: str) -> tuple[Any, Any]:
        """What stands for a texture, and its pixels, (H, W, 4); None without one."""
        image = getattr(self.material, name)
        if image is None or not self.has_uv:
            return None, None
        with decoding(f"{self.model.name}: a texture"):
            return (name, id(image)), np.array(image.convert("RGBA"))

    def _channel(self, name: str, channel: int, factor: float | None) -> Any:
        value = float(np.clip(np.nan_to_num(1.0 if factor is None else factor), 0, 1))
        key, pixels = self._pixels(name)
        return value if pixels is None else self.bitmaps.channel(key, pixels, channel, value, Lookup(UV))

    def node(self, mirrored: bool) -> dict[str, Any]:
        """The BSDF, for triangles with a mirrored texture or for others."""
        material, lookup = self.material, Lookup(UV)
        factor = np.ones(4) if material.baseColorFactor is None else np.asarray(material.baseColorFactor) / 255
        key, pixels = self._pixels("baseColorTexture")
        node: dict[str, Any] = {"type": "principled", "base_color": {"type": "rgb", "value": factor[:3].tolist()}}
        if pixels is not None:
            node["base_color"] = self.bitmaps.color(key, pixels, factor[:3], lookup)
        node["roughness"] = self._channel("metallicRoughnessTexture", 1, material.roughnessFactor)
        node["metallic"] = self._channel("metallicRoughnessTexture", 2, material.metallicFactor)
        if self.has_normals:
            number, image = self._pixels("normalTexture")
            normals = self.bitmaps.node((number, mirrored), normals_of(image, 1.0, mirrored), lookup, raw=True)
            node = {"type": "normalmap", "normalmap": normals, "bsdf": node}
        node = {"type": "twosided", "bsdf": node}
        opacity: Any = 1.0
        if material.alphaMode in ("MASK", "BLEND"):
            opacity = float(factor[3])
            cutoff = 0.5 if material.alphaCutoff is None else float(material.alphaCutoff)
            if material.alphaMode == "BLEND":
                opacity = opacity if pixels is None else self.bitmaps.channel(key, pixels, 3, opacity, lookup)
            elif pixels is None:
                opacity = float(opacity >= cutoff)
            else:
                opacity = self.bitmaps.cutout(key, pixels, 3, opacity, cutoff, lookup)
        return node if opacity == 1.0 else {"type": "mask", "opacity": opacity, "bsdf": node}

    def emission(self) -> dict[str, Any] | None:
        """The radiance that it emits; None for none."""
        found = emitted(self.material)
        key, pixels = self._pixels("emissiveTexture")
        if found is None or pixels is None:
            return found
        return self.bitmaps.light(key, pixels, np.array(found["value"]), Lookup(UV)) if pixels[..., :3].any() else None


def of_mtl(model: Model, bitmaps: Bitmaps, material: Any, has_uv: bool) -> dict[str, Any]:
    """The BSDF of a material of MTL."""
    base: Any = np.full(3, 0.6)
    image = getattr(material, "image", None)
    given = getattr(material, "kwargs", {}) or {}
    node: dict[str, Any] = {"type": "principled"}
    if not is_default(material):
        base = np.asarray(material.diffuse, np.float64)[:3] / 255
        shininess = float(np.clip(np.nan_to_num(getattr(material, "glossiness", None) or 1.0), 0, 1e4))
        # The exponent of Phong's lobe as the width of a microfacet distribution: alpha^2 = 2 / (Ns + 2).
        node["roughness"] = float(np.clip((2 / (shininess + 2)) ** 0.25, 0.05, 1))
        unread = sorted(key for key in given if key.lower().startswith(("map_", "bump", "disp", "norm", "refl")))
        for key in unread:
            if key.lower() != "map_kd":
                model.say(f"the texture '{key}' of MTL is left out")
    node["base_color"] = {"type": "rgb", "value": np.clip(base, 0, 1).tolist()}
    if image is not None and has_uv and not is_default(material):
        with decoding(f"{model.name}: a texture"):
            pixels = np.array(image.convert("RGB"))
        node["base_color"] = bitmaps.node(id(image), pixels, Lookup(UV), raw=False)
    opacity = opacity_of(given)
    if opacity < 1:
        return {"type": "mask", "opacity": opacity, "bsdf": {"type": "twosided", "bsdf": node}}
    return node


def is_default(material: Any) -> bool:
    """True for the material that trimesh makes for texture coordinates without one: four pixels of its grey."""
    image = getattr(material, "image", None)
    if image is None or image.size != (2, 2):
        return False
    with decoding("a texture"):
        return bool((np.asarray(image.convert("RGB")) == 100).all())


def number_of(given: Mapping[str, Any], key: str) -> float | None:
    """The number after a keyword of MTL; None without one."""
    try:
        value = float(np.ravel(given[key])[0])
    except (KeyError, TypeError, ValueError, IndexError):
        return None
    return value if np.isfinite(value) else None


def opacity_of(given: Mapping[str, Any]) -> float:
    """The opacity of a material of MTL: ``d``, or else 1 - ``Tr``.

    Writers such as MeshLab give ``Tr 1`` to materials that are opaque; taken by the letter, these would be invisible.
    """
    dissolve, transparency = number_of(given, "d"), number_of(given, "tr")
    if dissolve is None:
        dissolve = 1.0 if transparency is None or transparency >= 1 else 1 - transparency
    return float(np.clip(dissolve, 0, 1))


def emitted(material: Any) -> dict[str, Any] | None:
    """The radiance that a material emits: ``Ke`` of MTL, the emission of a metallic-roughness one; None for none."""
    given = getattr(material, "kwargs", None) or {}
    color = given.get("ke", getattr(material, "emissiveFactor", None))
    try:
        value = np.nan_to_num(np.asarray(color, np.float64).ravel())
    except (TypeError, ValueError):
        return None
    if len(value) != 3 or not (value > 0).any():
        return None
    return {"type": "rgb", "value": np.clip(value, 0, 1e6).tolist()}


def grey(value: float) -> dict[str, Any]:
    """A grey."""
    return {"type": "rgb", "value": [value] * 3}


def decoded_bytes(colors: NDArray[Any]) -> NDArray[np.float32]:
    """Linear colours of sRGB's bytes."""
    from djpt.images.srgb import decoded

    return np.asarray(decoded(np.asarray(colors, np.float32) / 255), np.float32)


def of_arrays(positions: Any, faces: Any, name: str, colors: Any = None, normals: Any = None) -> Model:
    """The model of vertices (V, 3) and triangles (F, 3); `colors` are linear, (V, 3), `normals` (V, 3)."""
    from djpt.shapes.meshes.making import of_arrays as checked

    data = checked(name, positions, faces)[0]
    model = Model(name)
    node: dict[str, Any] = {"type": "principled", "base_color": grey(0.6)}
    for what, rows in (("colours", colors), ("normals", normals)):
        if rows is not None and np.shape(rows)[:1] != (len(data.positions),):
            raise SceneError(f"{name}: {what} of the shape {np.shape(rows)} for {len(data.positions)} vertices")
    if colors is not None:
        data.attributes["vertex_color"] = np.clip(np.asarray(colors, np.float32)[:, :3], 0, 1)
        node["base_color"] = {"type": "mesh_attribute", "name": "vertex_color"}
    if normals is not None:
        data.normals = unit(np.nan_to_num(np.asarray(normals, np.float64)))
    model.nodes["material"] = {"type": "twosided", "bsdf": node}
    model.parts.append(Part(name, data, "material", [np.eye(4)]))
    return model

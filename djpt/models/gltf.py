"""Models in glTF 2.0: nodes, meshes, skins, morph targets, animations, cameras and lights.

Khronos, "glTF 2.0 Specification", version 2.0.1 (ISO/IEC 12113:2022), and the extensions of the registry.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f
from djpt.models.folder import Folder
from djpt.models.gltf_animation import animated
from djpt.models.gltf_file import GltfFile, integer, numbers, scalar
from djpt.models.gltf_materials import Materials
from djpt.models.model import Camera, Matrix, Model, Part
from djpt.shapes.meshes.data import MeshData, unit

__all__ = ["read_gltf"]

KNOWN = frozenset(
    {
        *(f"KHR_materials_{name}" for name in ("transmission", "ior", "volume", "clearcoat", "sheen", "specular")),
        *(f"KHR_materials_{name}" for name in ("anisotropy", "emissive_strength", "unlit", "variants")),
        *("KHR_materials_pbrSpecularGlossiness", "KHR_texture_transform", "KHR_lights_punctual"),
        *("KHR_mesh_quantization", "EXT_texture_webp", "KHR_materials_iridescence", "KHR_materials_dispersion"),
        *("KHR_xmp_json_ld", "KHR_xmp", "EXT_mesh_gpu_instancing", "KHR_node_visibility"),
    }
)
"""Extensions that a file may require: they are read, or `Materials` says what stands in their place."""

MOST_NODES = 100_000
MOST_COPIES = 400_000


def read_gltf(
    data: bytes,
    folder: Folder,
    name: str,
    *,
    time: float | None = None,
    animation: int = 0,
    variant: str | None = None,
    texture_size: int = 2048,
) -> Model:
    """Read a .gltf or .glb file.

    Args:
        data: the file's contents.
        folder: where the files that it names are.
        name: for messages.
        time: the time of the animation in seconds; default: none, the pose without it.
        animation: which of the file's animations.
        variant: the name of a variant of its materials (KHR_materials_variants); default: none.
        texture_size: textures with more rows or columns are made smaller.

    Raises:
        SceneError: the file is damaged, or requires an extension that can't be read.
    """
    return Reader(GltfFile(data, folder, name), time, animation, variant, texture_size).model


class Reader:
    """One call of `read_gltf`."""

    def __init__(self, file: GltfFile, time: float | None, animation: int, variant: str | None, size: int) -> None:
        self.file = file
        self.model = Model(file.name)
        required = file.list("extensionsRequired")
        unknown = [str(x)[:60] for x in required if x not in KNOWN and x != "KHR_texture_basisu"]
        if unknown:
            raise file.error(f"requires {', '.join(unknown)}, which can't be read")
        self.materials = Materials(file, self.model, size)
        self.variant = self._variant(variant)
        self.pose = animated(file, time, animation) if time is not None else {}
        self.world: dict[int, Matrix] = {}
        """The place of each node of the scene."""
        self._place_nodes()
        self.copies = 0
        self.parts: dict[Any, list[Part]] = {}
        for index in self.world:
            self._add_node(index)
        self.model.parts = [part for parts in self.parts.values() for part in parts if part.places]
        self._say_unused()

    def _variant(self, name: str | None) -> int | None:
        """The number of a variant."""
        if name is None:
            return None
        listed = self.file.extension(self.file.json, "KHR_materials_variants").get("variants", [])
        names = [str(x.get("name")) for x in listed if isinstance(x, dict)] if isinstance(listed, list) else []
        if name not in names:
            raise self.file.error(f"there is no variant '{name}'; found: {', '.join(names) or 'none'}")
        return names.index(name)

    def _say_unused(self) -> None:
        for used in self.file.list("extensionsUsed"):
            if isinstance(used, str) and used not in KNOWN and used != "KHR_texture_basisu":
                self.model.say(f"the extension '{used[:60]}' is left out")

    # ---- nodes -----------------------------------------------------------------------------

    def _place_nodes(self) -> None:
        """Walk down from the roots of the scene; a node that is met twice is an error."""
        nodes = self.file.list("nodes")
        if len(nodes) > MOST_NODES:
            raise self.file.error(f"has {len(nodes)} nodes; at most {MOST_NODES}")
        scenes = self.file.list("scenes")
        if scenes:
            roots = self.file.at("scenes", self.file.json.get("scene", 0)).get("nodes", [])
        else:
            held = {
                child
                for node in nodes
                if isinstance(node, dict) and isinstance(node.get("children"), list)
                for child in node["children"]
                if isinstance(child, int)
            }
            roots = [i for i in range(len(nodes)) if i not in held]
        if not isinstance(roots, list):
            raise self.file.error("'nodes' of a scene must be a list")
        todo = [(root, np.eye(4)) for root in reversed(roots)]
        while todo:
            index, above = todo.pop()
            node = self.file.at("nodes", index)
            if index in self.world:
                raise self.file.error(f"nodes[{index}] stands in two places")
            if self.file.extension(node, "KHR_node_visibility").get("visible") is False:
                continue
            self.world[index] = above @ self._local(index, node)
            children = node.get("children", [])
            if not isinstance(children, list):
                raise self.file.error(f"nodes[{index}]: 'children' must be a list")
            todo += [(child, self.world[index]) for child in reversed(children)]

    def _local(self, index: int, node: dict[str, Any]) -> Matrix:
        """The place of a node in its parent's space, (4, 4)."""
        pose = self.pose.get(index, {})
        if "matrix" in node and not pose:
            return numbers(node["matrix"], tuple(np.eye(4).ravel())).reshape(4, 4).T
        translation = pose.get("translation", numbers(node.get("translation"), (0, 0, 0)))
        rotation = pose.get("rotation", numbers(node.get("rotation"), (0, 0, 0, 1)))
        scale = pose.get("scale", numbers(node.get("scale"), (1, 1, 1)))
        return trs(translation, rotation, scale)

    def _add_node(self, index: int) -> None:
        node = self.file.at("nodes", index)
        place = self.world[index]
        if "camera" in node:
            self._add_camera(node, place)
        if "mesh" in node:
            self._add_mesh(index, node, place)
        light = self.file.extension(node, "KHR_lights_punctual")
        if "light" in light:
            self._add_light(light["light"], place, index)

    def _add_camera(self, node: dict[str, Any], place: Matrix) -> None:
        camera = self.file.at("cameras", node["camera"])
        name = str(camera.get("name") or node.get("name") or f"camera {node['camera']}")[:100]
        lens = camera.get(str(camera.get("type")))
        if not isinstance(lens, dict):
            raise self.file.error(f"cameras[{node['camera']}] has neither 'perspective' nor 'orthographic'")
        if camera["type"] == "perspective":
            self.model.cameras.append(Camera(name, place, fov=math.degrees(scalar(lens.get("yfov"), 0.7))))
        else:
            self.model.cameras.append(Camera(name, place, height=2 * max(scalar(lens.get("ymag"), 1), 1e-6)))

    def _add_light(self, number: Any, place: Matrix, index: int) -> None:
        lights = self.file.extension(self.file.json, "KHR_lights_punctual").get("lights")
        if not isinstance(lights, list) or not 0 <= integer(number) < len(lights):
            raise self.file.error(f"nodes[{index}]: there is no light {str(number)[:20]}")
        light = lights[integer(number)]
        if not isinstance(light, dict):
            raise self.file.error(f"lights[{number}] must be an object")
        strength = np.clip(numbers(light.get("color"), (1, 1, 1)) * scalar(light.get("intensity"), 1), 0, 1e30)
        if not strength.any():
            return
        color = {"type": "rgb", "value": strength.tolist()}
        kind = light.get("type")
        ahead = place[:3, :3] @ np.array([0, 0, -1.0])
        origin = place[:3, 3]
        if not np.isfinite(place).all() or not ahead.any():
            raise self.file.error(f"nodes[{index}]: the light has no place")
        ahead /= np.linalg.norm(ahead)
        name = f"light_{index}"
        if kind == "directional":
            self.model.lights[name] = {"type": "directional", "direction": ahead.tolist(), "irradiance": color}
        elif kind == "point":
            self.model.lights[name] = {"type": "point", "position": origin.tolist(), "intensity": color}
        elif kind == "spot":
            cone: Any = light.get("spot") if isinstance(light.get("spot"), dict) else {}
            outer = math.degrees(scalar(cone.get("outerConeAngle"), math.pi / 4))
            inner = math.degrees(scalar(cone.get("innerConeAngle"), 0.0))
            outer = min(max(outer, 0.1), 90.0)
            side = [0, 0, 1] if abs(ahead[2]) < 0.9 else [0, 1, 0]
            to_world = ScalarTransform4f().look_at(origin.tolist(), (origin + ahead).tolist(), side)
            angles = {"cutoff_angle": outer, "beam_width": min(max(inner, 0.0), outer)}
            self.model.lights[name] = {"type": "spot", "to_world": to_world, "intensity": color, **angles}
        else:
            self.model.say(f"a light of the type '{str(kind)[:40]}' is left out")

    # ---- meshes ----------------------------------------------------------------------------

    def _add_mesh(self, index: int, node: dict[str, Any], place: Matrix) -> None:
        number = node["mesh"]
        mesh = self.file.at("meshes", number)
        primitives = mesh.get("primitives")
        if not isinstance(primitives, list):
            raise self.file.error(f"meshes[{number}]: 'primitives' must be a list")
        skin = node.get("skin")
        weights = self._weights(index, node, mesh)
        # Skinned vertices are in the space of the scene already.
        key = (number, None if skin is None else (skin, index), tuple(weights))
        places = [np.eye(4)] if skin is not None else self._instances(node, place)
        self.copies += len(places) * len(primitives)
        if self.copies > MOST_COPIES:
            raise self.file.error(f"has more than {MOST_COPIES} parts, instances included")
        places = [p for p in places if np.isfinite(p).all() and abs(np.linalg.det(p[:3, :3])) > 1e-30]
        if key not in self.parts:
            self.parts[key] = []
            for i, primitive in enumerate(primitives):
                if not isinstance(primitive, dict):
                    raise self.file.error(f"meshes[{number}].primitives[{i}] must be an object")
                self.parts[key] += self._primitive(primitive, f"meshes[{number}].primitives[{i}]", skin, weights)
        for part in self.parts[key]:
            part.places.extend(places)

    def _weights(self, index: int, node: dict[str, Any], mesh: dict[str, Any]) -> list[float]:
        """The weights of the morph targets."""
        found = self.pose.get(index, {}).get("weights")
        if found is None:
            found = node.get("weights", mesh.get("weights", []))
        if isinstance(found, np.ndarray):
            return [float(x) for x in found]
        return [scalar(x, 0.0) for x in found] if isinstance(found, list) else []

    def _instances(self, node: dict[str, Any], place: Matrix) -> list[Matrix]:
        """The places of a node's mesh: more than one with EXT_mesh_gpu_instancing."""
        attributes = self.file.extension(node, "EXT_mesh_gpu_instancing").get("attributes")
        if not isinstance(attributes, dict):
            return [place]
        given = {
            key: self.file.accessor(attributes[key], width).astype(np.float64)
            for key, width in (("TRANSLATION", 3), ("ROTATION", 4), ("SCALE", 3))
            if key in attributes
        }
        count = min((len(rows) for rows in given.values()), default=0)
        if count > MOST_COPIES:
            raise self.file.error(f"has more than {MOST_COPIES} instances")
        defaults = {"TRANSLATION": np.zeros(3), "ROTATION": np.array([0, 0, 0, 1.0]), "SCALE": np.ones(3)}
        return [
            place @ trs(*(given[key][i] if key in given else value for key, value in defaults.items()))
            for i in range(count)
        ]

    def _primitive(self, node: dict[str, Any], where: str, skin: Any, weights: list[float]) -> list[Part]:
        """The parts of a primitive: one, or two if some of its texture is mirrored; none without triangles."""
        mode = node.get("mode", 4)
        if mode in (0, 1, 2, 3):
            self.model.say("points and lines are left out")
            return []
        if self.file.has_extension(node, "KHR_draco_mesh_compression"):
            raise self.file.error(f"{where} is compressed by 'KHR_draco_mesh_compression', which can't be read")
        attributes = node.get("attributes")
        if not isinstance(attributes, dict):
            raise self.file.error(f"{where}: 'attributes' must be an object")
        if "POSITION" not in attributes:
            self.model.say("meshes without positions are left out")
            return []
        positions = self.file.accessor(attributes["POSITION"], 3).astype(np.float32)
        corners = self._corners(node, mode, len(positions), where)
        if not len(corners):
            self.model.say("meshes without triangles are left out")
            return []
        normals = self.file.accessor(attributes["NORMAL"], 3).astype(np.float32) if "NORMAL" in attributes else None
        positions, normals = self._morphed(node, weights, positions, normals, where)
        if skin is not None:
            positions, normals = self._skinned(attributes, skin, positions, normals, where)
        if normals is not None and len(normals) != len(positions):
            raise self.file.error(f"{where}: {len(normals)} normals for {len(positions)} vertices")
        data = MeshData(positions, corners, None if normals is None else unit(normals))
        colors = self._colors(attributes, len(positions), where)
        coordinates = {}
        for key, accessor in attributes.items():
            if key.startswith("TEXCOORD_"):
                texcoords = self.file.accessor(accessor, 2).astype(np.float32)
                if len(texcoords) != len(positions):
                    raise self.file.error(
                        f"{where}: {len(texcoords)} texture coordinates for {len(positions)} vertices"
                    )
                finite = np.nan_to_num(texcoords, nan=0.0, posinf=0.0, neginf=0.0)
                coordinates[key.removeprefix("TEXCOORD_")[:4]] = finite
        return self.materials.parts(self._material(node), data, coordinates, colors, where)

    def _material(self, node: dict[str, Any]) -> int | None:
        """The number of a primitive's material, in the chosen variant."""
        found = node.get("material")
        if self.variant is not None:
            mappings = self.file.extension(node, "KHR_materials_variants").get("mappings", [])
            for mapping in mappings if isinstance(mappings, list) else []:
                if isinstance(mapping, dict) and self.variant in (mapping.get("variants") or []):
                    found = mapping.get("material")
        if found is None:
            return None
        self.file.at("materials", found)
        return int(found)

    def _corners(self, node: dict[str, Any], mode: Any, count: int, where: str) -> NDArray[np.uint32]:
        """The corners of the triangles, (F, 3)."""
        if "indices" in node:
            indices = self.file.accessor(node["indices"], 1)[:, 0]
            if indices.dtype.kind != "u":
                raise self.file.error(f"{where}: indices must be unsigned integers")
            indices = indices.astype(np.uint32)
        else:
            indices = np.arange(count, dtype=np.uint32)
        if len(indices) and int(indices.max()) >= count:
            raise self.file.error(f"{where}: index {int(indices.max())} of {count} vertices")
        n = len(indices)
        if mode == 4:
            return np.ascontiguousarray(indices[: n - n % 3].reshape(-1, 3))
        if n < 3:
            return np.zeros((0, 3), np.uint32)
        if mode == 5:
            rows = np.stack([indices[:-2], indices[1:-1], indices[2:]], axis=1)
            rows[1::2] = rows[1::2][:, [1, 0, 2]]
        elif mode == 6:
            rows = np.stack([np.full(n - 2, indices[0]), indices[1:-1], indices[2:]], axis=1)
        else:
            raise self.file.error(f"{where}: there is no mode {str(mode)[:20]}")
        a, b, c = rows.T
        return np.ascontiguousarray(rows[(a != b) & (b != c) & (a != c)], np.uint32)

    def _colors(self, attributes: dict[str, Any], count: int, where: str) -> NDArray[np.float32] | None:
        """The colours of the vertices, (V, 4), linear; None if there are none."""
        if "COLOR_0" not in attributes:
            return None
        colors = self.file.accessor(attributes["COLOR_0"])
        if colors.dtype.kind != "f":  # written without the flag
            colors = colors / np.iinfo(colors.dtype).max
        if colors.shape[1] not in (3, 4) or len(colors) != count:
            raise self.file.error(f"{where}: colours of the shape {colors.shape} for {count} vertices")
        colors = np.clip(np.nan_to_num(colors.astype(np.float32), nan=1.0), 0, 1)
        return colors if colors.shape[1] == 4 else np.concatenate([colors, np.ones((count, 1), np.float32)], axis=1)

    # ---- shapes that change ----------------------------------------------------------------

    def _morphed(
        self, node: dict[str, Any], weights: list[float], positions: Any, normals: Any, where: str
    ) -> tuple[Any, Any]:
        targets = node.get("targets", [])
        if not isinstance(targets, list):
            raise self.file.error(f"{where}: 'targets' must be a list")
        for weight, target in zip(weights, targets, strict=False):
            if not weight or not isinstance(target, dict):
                continue
            if "POSITION" in target:
                positions = positions + np.float32(weight) * self._fitting(target["POSITION"], len(positions), where)
            if "NORMAL" in target and normals is not None:
                normals = normals + np.float32(weight) * self._fitting(target["NORMAL"], len(normals), where)
        return positions, normals

    def _fitting(self, index: Any, count: int, where: str) -> NDArray[np.float32]:
        rows = self.file.accessor(index, 3).astype(np.float32)
        if len(rows) != count:
            raise self.file.error(f"{where}: a morph target has {len(rows)} rows, the mesh {count}")
        return rows

    def _skinned(
        self, attributes: dict[str, Any], skin: Any, positions: Any, normals: Any, where: str
    ) -> tuple[Any, Any]:
        """The vertices moved by the joints of a skin, into the space of the scene."""
        node = self.file.at("skins", skin)
        joints = node.get("joints")
        if not isinstance(joints, list) or not joints:
            raise self.file.error(f"skins[{skin}] has no joints")
        try:
            places = np.array([self.world[joint] for joint in joints])
        except (KeyError, TypeError):
            raise self.file.error(f"skins[{skin}]: a joint isn't in the scene") from None
        if "inverseBindMatrices" in node:
            rows = self.file.accessor(node["inverseBindMatrices"], 16)
            if len(rows) < len(joints):
                raise self.file.error(f"skins[{skin}]: {len(rows)} matrices for {len(joints)} joints")
            places = places @ rows[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
        blend: Any = np.zeros((len(positions), 4, 4))
        total: Any = np.zeros(len(positions))
        for number in range(8):
            if f"JOINTS_{number}" not in attributes:
                break
            chosen = self.file.accessor(attributes[f"JOINTS_{number}"], 4)
            weights = self.file.accessor(attributes.get(f"WEIGHTS_{number}"), 4).astype(np.float64)
            if len(chosen) != len(positions) or len(weights) != len(positions):
                raise self.file.error(f"{where}: joints of {len(chosen)} vertices, of {len(positions)}")
            if chosen.dtype.kind != "u" or int(chosen.max(initial=0)) >= len(joints):
                raise self.file.error(f"{where}: there is no joint {chosen.max()}")
            for column in range(4):
                blend += places[chosen[:, column]] * weights[:, column, None, None]
            total += weights.sum(axis=1)
        if not total.any():
            return positions, normals
        blend /= np.where(total > 0, total, 1)[:, None, None]
        moved = np.einsum("nij,nj->ni", blend[:, :3, :3], positions) + blend[:, :3, 3]
        if normals is not None:
            normals = np.einsum("nij,nj->ni", blend[:, :3, :3], normals).astype(np.float32)
        return moved.astype(np.float32), normals


def trs(translation: Matrix, rotation: Matrix, scale: Matrix) -> Matrix:
    """The matrix that scales, rotates by the quaternion (x, y, z, w) and translates."""
    x, y, z, w = rotation / (float(np.linalg.norm(rotation)) or 1.0)
    result = np.eye(4)
    result[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    result[:3, :3] *= scale
    result[:3, 3] = translation
    return result

"""Export a Blender scene as a folder that djpt and Mitsuba render.

One file without djpt: run it in Blender (4.2 or newer) or with its Python module ``bpy``::

    blender scene.blend --background --python export_blender.py -- FOLDER
    python export_blender.py scene.blend FOLDER

FOLDER gets ``scene.xml``, a PLY file for each mesh and material, and the images. Of materials the Principled node is
read, with numbers and images at its inputs; other nodes are named in messages, and grey stands in their place.
"""

from __future__ import annotations

import math
import os
import sys
from typing import Any
from xml.sax.saxutils import quoteattr

import bpy
import numpy as np
from mathutils import Matrix

FLIP = Matrix.Diagonal((-1, 1, -1, 1))
"""Cameras of Blender look along -z, those of the file along +z."""


class Export:
    """One call of `export`.

    Args:
        folder: where the files are written.
    """

    def __init__(self, folder: str) -> None:
        self.folder = folder
        self.lines: list[str] = []
        self.said: set[str] = set()
        self.materials: dict[str, str] = {}
        """The lines of each material, by its name."""
        self.images: dict[str, str] = {}
        """The file of each image, by its name."""
        self.meshes: dict[Any, list[tuple[str, str, str]]] = {}
        """File, material and emission of the parts of a mesh."""

    def say(self, text: str) -> None:
        """Say once what isn't exported as it is in Blender."""
        if text not in self.said:
            self.said.add(text)
            print(f"export_blender: {text}", file=sys.stderr)

    def write(self) -> str:
        """Write all files; returns the name of the XML file."""
        os.makedirs(self.folder, exist_ok=True)
        scene = bpy.context.scene
        graph = bpy.context.evaluated_depsgraph_get()
        body: list[str] = []
        for instance in graph.object_instances:  # with modifiers, instances of collections and of particles
            if not instance.show_self:
                continue
            found, place = instance.object, instance.matrix_world.copy()
            if found.type in ("MESH", "CURVE", "SURFACE", "META", "FONT"):
                body += self.shapes(found, place)
            elif found.type == "LIGHT":
                body += self.light(found.data, place)
        body += self.world(scene.world)
        camera = self.camera(scene) if scene.camera else []
        if not camera:
            self.say("the scene has no camera")
        lines = [
            '<scene version="3.0.0">',
            '<integrator type="path"><integer name="max_depth" value="12"/></integrator>',
        ]
        text = "\n".join([*lines, *camera, *self.materials.values(), *body, "</scene>\n"])
        path = os.path.join(self.folder, "scene.xml")
        with open(path, "w", encoding="utf-8") as file:
            file.write(text)
        return path

    # ---- meshes ----------------------------------------------------------------------------

    def shapes(self, found: Any, place: Matrix) -> list[str]:
        """The shapes of an object, one for each of its materials."""
        key = (found.original.data.name_full, found.original.name_full if found.modifiers else "")
        if key not in self.meshes:
            mesh = found.to_mesh()
            self.meshes[key] = [] if mesh is None else self.parts(mesh, found)
            found.to_mesh_clear()
        lines = []
        for file, material, emission in self.meshes[key]:
            lines += [f'<shape type="ply"><string name="filename" value={quoteattr(file)}/>', transform(place)]
            lines += [f'<ref id="{material}"/>', emission, "</shape>"]
        return lines

    def parts(self, mesh: Any, found: Any) -> list[tuple[str, str, str]]:
        """Write the triangles of each material of a mesh to a file."""
        mesh.calc_loop_triangles()
        count = len(mesh.loop_triangles)
        if not count:
            return []
        loops, vertices, slots = np.empty(3 * count, np.int32), np.empty(3 * count, np.int32), np.empty(count, np.int32)
        mesh.loop_triangles.foreach_get("loops", loops)
        mesh.loop_triangles.foreach_get("vertices", vertices)
        mesh.loop_triangles.foreach_get("material_index", slots)
        points = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.vertices.foreach_get("co", points)
        normals = np.empty(3 * len(mesh.loops), np.float32)
        mesh.corner_normals.foreach_get("vector", normals)
        columns = [points.reshape(-1, 3)[vertices], normals.reshape(-1, 3)[loops]]
        names = ["x", "y", "z", "nx", "ny", "nz"]
        layer = mesh.uv_layers.active
        if layer is not None:
            uv = np.empty(2 * len(mesh.loops), np.float32)
            layer.uv.foreach_get("vector", uv)
            # The first row of an image lies at v = 0 in the file, at v = 1 in Blender.
            columns.append(uv.reshape(-1, 2)[loops] * (1, -1) + (0, 1))
            names += ["u", "v"]
        rows = np.hstack(columns).astype(np.float32)
        parts = []
        for slot in np.unique(slots):
            own, corners = np.unique(rows[np.repeat(slots == slot, 3)], axis=0, return_inverse=True)
            file = f"mesh_{sum(map(len, self.meshes.values())) + len(parts)}_{len(self.meshes)}.ply"
            write_ply(os.path.join(self.folder, file), names, own, corners.reshape(-1, 3))
            material = found.material_slots[slot].material if slot < len(found.material_slots) else None
            parts.append((file, *self.material(material)))
        return parts

    # ---- materials -------------------------------------------------------------------------

    def material(self, material: Any) -> tuple[str, str]:
        """The number of a material in the file, and the emitter of what it covers."""
        name = "" if material is None else material.name_full
        node = principled_of(material)
        if node is None and material is not None and material.use_nodes:
            self.say(f"the material '{name}' has no Principled node at its output: it is grey")
        known = list(self.materials)
        number = f"material_{known.index(name) if name in known else len(known)}"
        if name not in self.materials:
            self.materials[name] = self.bsdf(number, node, material)
        return number, "" if node is None else self.emission(node)

    def bsdf(self, number: str, node: Any, material: Any) -> str:
        """The lines of a material."""
        if node is None:
            color = (0.8, 0.8, 0.8) if material is None else tuple(material.diffuse_color)[:3]
            return f'<bsdf type="twosided" id="{number}"><bsdf type="diffuse">{rgb("reflectance", color)}</bsdf></bsdf>'
        inner = [self.input(node, "Base Color", "base_color", True), self.input(node, "Roughness", "roughness")]
        inner.append(self.input(node, "Metallic", "metallic"))
        transmission = float(node.inputs["Transmission Weight"].default_value)
        inner.append(f'<float name="eta" value="{max(float(node.inputs["IOR"].default_value), 1.01):.6g}"/>')
        inner += [self.input(node, "Transmission Weight", "spec_trans")] if transmission else []
        coat = float(node.inputs["Coat Weight"].default_value)
        if coat:
            gloss = (0.1 - float(node.inputs["Coat Roughness"].default_value) ** 2) / 0.099
            inner += [scalar("clearcoat", coat), scalar("clearcoat_gloss", min(max(gloss, 0.0), 1.0))]
        sheen = float(node.inputs["Sheen Weight"].default_value)
        inner += [scalar("sheen", sheen)] if sheen else []
        text = "".join(['<bsdf type="principled">', *inner, "</bsdf>"])
        normal = node.inputs["Normal"]
        if normal.is_linked:
            source = normal.links[0].from_node
            image = image_of(source.inputs["Color"]) if source.type == "NORMAL_MAP" else None
            if image is None:
                self.say(f"'{source.type}' at the input 'Normal' is left out")
            else:
                text = f'<bsdf type="normalmap">{self.texture("normalmap", image, True)}{text}</bsdf>'
        if not transmission:
            text = f'<bsdf type="twosided">{text}</bsdf>'
        alpha = node.inputs["Alpha"]
        if alpha.is_linked or alpha.default_value < 1:
            text = f'<bsdf type="mask">{self.input(node, "Alpha", "opacity")}{text}</bsdf>'
        return text.replace(">", f' id="{number}">', 1)

    def input(self, node: Any, name: str, key: str, color: bool = False) -> str:
        """An input of a node: a number, a colour or an image."""
        socket = node.inputs[name]
        if socket.is_linked:
            image = image_of(socket)
            if image is not None:
                return self.texture(key, image, not color)
            self.say(f"'{socket.links[0].from_node.type}' at the input '{name}' is left out")
        value = socket.default_value
        return rgb(key, tuple(value)[:3]) if color else scalar(key, float(value))

    def emission(self, node: Any) -> str:
        """The emitter of a Principled node; empty without one."""
        strength, socket = float(node.inputs["Emission Strength"].default_value), node.inputs["Emission Color"]
        if strength <= 0:
            return ""
        if socket.is_linked:
            image = image_of(socket)
            if image is not None and strength == 1:
                return f'<emitter type="area">{self.texture("radiance", image, False)}</emitter>'
            self.say("images at 'Emission Color' are read at the strength 1 only, other nodes not at all")
        color = [strength * x for x in tuple(socket.default_value)[:3]]
        return f'<emitter type="area">{rgb("radiance", color)}</emitter>' if any(color) else ""

    def texture(self, key: str, image: Any, raw: bool) -> str:
        """The lines of an image."""
        file = quoteattr(self.image(image))
        wanted = raw or image.colorspace_settings.name in ("Non-Color", "Raw", "Linear Rec.709")
        kind = f'<boolean name="raw" value="{str(wanted).lower()}"/>'
        return f'<texture type="bitmap" name="{key}"><string name="filename" value={file}/>{kind}</texture>'

    def image(self, image: Any) -> str:
        """Write an image to the folder; returns its name there."""
        if image.name_full not in self.images:
            deep = image.is_float
            file = f"image_{len(self.images)}.{'exr' if deep else 'png'}"
            copy = image.copy()
            copy.file_format = "OPEN_EXR" if deep else "PNG"
            copy.save(filepath=os.path.join(self.folder, file))
            bpy.data.images.remove(copy)
            self.images[image.name_full] = file
        return self.images[image.name_full]

    # ---- light and cameras -----------------------------------------------------------------

    def light(self, light: Any, place: Matrix) -> list[str]:
        """A light, whose strength Blender gives as a power in watts, and as an irradiance for suns."""
        color = [light.energy * x for x in light.color]
        if light.type == "SUN":
            ahead = place.to_3x3() @ Matrix.Identity(3).col[2] * -1
            vector = f'<vector name="direction" x="{ahead[0]:.9g}" y="{ahead[1]:.9g}" z="{ahead[2]:.9g}"/>'
            return [f'<emitter type="directional">{vector}{rgb("irradiance", color)}</emitter>']
        if light.type == "AREA":
            x, y = light.size, light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else light.size
            is_round = light.shape in ("DISK", "ELLIPSE")
            scale = place.to_scale()
            area = x * y * abs(scale[0] * scale[1]) * (math.pi / 4 if is_round else 1)
            radiance = [value / (math.pi * max(area, 1e-30)) for value in color]
            matrix = place @ Matrix.Diagonal((-x / 2, y / 2, -1, 1))  # it shines along its -z
            lines = [f'<shape type="{"disk" if is_round else "rectangle"}">', transform(matrix)]
            return [*lines, f'<emitter type="area">{rgb("radiance", radiance)}</emitter></shape>']
        if light.type == "SPOT":
            cutoff = math.degrees(light.spot_size / 2)
            intensity = [value / (4 * math.pi * math.pi) for value in color]
            inner = scalar("cutoff_angle", cutoff) + scalar("beam_width", cutoff * (1 - light.spot_blend))
            lines = ['<emitter type="spot">', transform(place.normalized() @ FLIP), rgb("intensity", intensity)]
            return [*lines, inner, "</emitter>"]
        center = place.translation
        if light.shadow_soft_size > 0:
            radius = light.shadow_soft_size
            radiance = [value / (4 * math.pi**2 * radius**2) for value in color]
            point = f'<point name="center" x="{center[0]:.9g}" y="{center[1]:.9g}" z="{center[2]:.9g}"/>'
            lines = ['<shape type="sphere">', point, scalar("radius", radius)]
            return [*lines, f'<emitter type="area">{rgb("radiance", radiance)}</emitter></shape>']
        intensity = [value / (4 * math.pi * math.pi) for value in color]
        point = f'<point name="position" x="{center[0]:.9g}" y="{center[1]:.9g}" z="{center[2]:.9g}"/>'
        return [f'<emitter type="point">{point}{rgb("intensity", intensity)}</emitter>']

    def world(self, world: Any) -> list[str]:
        """The light from afar: a colour or an image all around."""
        if world is None:
            return []
        if not world.use_nodes:
            return [f'<emitter type="constant">{rgb("radiance", world.color)}</emitter>']
        node = next((n for n in world.node_tree.nodes if n.type == "BACKGROUND"), None)
        if node is None:
            self.say("a world without a Background node is black")
            return []
        strength, socket = float(node.inputs["Strength"].default_value), node.inputs["Color"]
        if socket.is_linked:
            source = socket.links[0].from_node
            if source.type == "TEX_ENVIRONMENT" and source.image is not None:
                file = quoteattr(self.image(source.image))
                # Blender's images have -y in their middle and z up; those of the file -z, and y up.
                turned = Matrix(((0, 0, 1, 0), (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 0, 1)))
                lines = ['<emitter type="envmap">', f'<string name="filename" value={file}/>', transform(turned)]
                return [*lines, scalar("scale", strength), "</emitter>"]
            self.say(f"'{source.type}' at the world's colour is left out")
        color = [strength * x for x in tuple(socket.default_value)[:3]]
        return [f'<emitter type="constant">{rgb("radiance", color)}</emitter>'] if any(color) else []

    def camera(self, scene: Any) -> list[str]:
        """The camera and its film."""
        found, render = scene.camera, scene.render
        width = max(1, render.resolution_x * render.resolution_percentage // 100)
        height = max(1, render.resolution_y * render.resolution_percentage // 100)
        place = found.matrix_world.normalized() @ FLIP
        camera = found.data
        size = f'<integer name="width" value="{width}"/><integer name="height" value="{height}"/>'
        film = f'<film type="hdrfilm">{size}</film>'
        film += '<sampler type="independent"><integer name="sample_count" value="64"/></sampler>'
        clips = scalar("near_clip", camera.clip_start) + scalar("far_clip", camera.clip_end)
        if camera.type == "ORTHO":
            half = camera.ortho_scale / 2 * min(1, width / height)
            place = place @ Matrix.Diagonal((half, half, 1, 1))
            return ['<sensor type="orthographic">', transform(place), clips, film, "</sensor>"]
        if camera.type != "PERSP":
            self.say(f"a camera of the type '{camera.type}' is exported as a perspective one")
        lens = scalar("fov", math.degrees(camera.angle)) + '<string name="fov_axis" value="larger"/>'
        return ['<sensor type="perspective">', transform(place), lens, clips, film, "</sensor>"]


def principled_of(material: Any) -> Any:
    """The Principled node at the output of a material; None without one."""
    if material is None or not material.use_nodes:
        return None
    output = material.node_tree.get_output_node("CYCLES") or material.node_tree.get_output_node("ALL")
    if output is None or not output.inputs["Surface"].is_linked:
        return None
    node = output.inputs["Surface"].links[0].from_node
    return node if node.type == "BSDF_PRINCIPLED" else None


def image_of(socket: Any) -> Any:
    """The image at an input, also behind the node that separates colours; None for others."""
    node = socket.links[0].from_node if socket.is_linked else None
    return node.image if node is not None and node.type == "TEX_IMAGE" else None


def scalar(name: str, value: float) -> str:
    """A number."""
    return f'<float name="{name}" value="{value:.9g}"/>'


def rgb(name: str, color: Any) -> str:
    """A linear colour."""
    return f'<rgb name="{name}" value="{", ".join(f"{x:.6g}" for x in color)}"/>'


def transform(matrix: Matrix) -> str:
    """From the shape's space to the scene's."""
    numbers = " ".join(f"{matrix[i][j]:.9g}" for i in range(4) for j in range(4))
    return f'<transform name="to_world"><matrix value="{numbers}"/></transform>'


def write_ply(path: str, names: list[str], rows: Any, corners: Any) -> None:
    """Write a mesh; `rows` are its vertices, (V, C), called `names`."""
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    head += [f"property float {name}" for name in names]
    head += [f"element face {len(corners)}", "property list uchar int vertex_indices", "end_header", ""]
    faces = np.empty(len(corners), [("count", "u1"), ("corners", "<i4", (3,))])
    faces["count"], faces["corners"] = 3, corners
    with open(path, "wb") as file:
        file.write("\n".join(head).encode() + rows.astype("<f4").tobytes() + faces.tobytes())


def export(folder: str) -> str:
    """Export the open scene to a folder; returns the name of its XML file."""
    return Export(folder).write()


if __name__ == "__main__":
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    if len(arguments) == 2:
        bpy.ops.wm.open_mainfile(filepath=os.path.abspath(arguments[0]))
    if len(arguments) not in (1, 2):
        sys.exit("export_blender.py [FILE.blend] FOLDER")
    print(export(os.path.abspath(arguments[-1])))

"""Shapes, materials and textures."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

import djpt
from djpt import ScalarTransform4f as T
from djpt.scenes.gallery import GLASS, MATERIALS, Panel, sheet
from places import IMAGES

__all__ = ["glass", "materials", "shapes", "textures"]


def shapes() -> None:
    """One of each analytic shape on an infinite plane."""
    grid = np.indices((24, 24, 24)) / 11.5 - 1
    lump = np.linalg.norm(grid, axis=0) - 0.65 - 0.1 * np.sin(9 * grid).prod(axis=0)
    palette = [[0.8, 0.3, 0.2], [0.2, 0.5, 0.8], [0.85, 0.7, 0.2], [0.3, 0.7, 0.4], [0.7, 0.4, 0.7]]
    forms: list[dict[str, Any]] = [
        {"type": "sphere", "center": [0, 0, 0.8], "radius": 0.8},
        {"type": "cylinder", "p1": [0, 0, 1.5], "radius": 0.6},
        {"type": "cone", "apex": [0, 0, 1.7], "length": 1.7, "angle": 25},
        {"type": "cuboid", "min": [-0.6, -0.6, 0], "max": [0.6, 0.6, 1.2]},
        {"type": "disk", "to_world": T().translate([0, 0, 0.8]).rotate([1, 0, 0], 65).scale(0.8)},
        {"type": "torus", "major": 0.6, "minor": 0.25, "to_world": T().translate([0, 0, 0.85]).rotate([1, 0, 0], 75)},
        {"type": "metaballs", "balls": [[-0.3, 0, 0.6, 0.8], [0.4, 0.2, 0.8, 0.7], [0, -0.3, 1.3, 0.6]]},
        {"type": "sdfgrid", "grid": djpt.TensorXf(lump[..., None].astype(np.float32)),
         "to_world": T().translate([-1, -1, -0.2]).scale(2)},
    ]  # fmt: skip
    scene: dict[str, Any] = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 42,
            "to_world": T().look_at([0, -11, 6.5], [0, 0.2, 0.5], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": 720, "height": 360},
        },
        "integrator": {"type": "path", "max_depth": 6},
        "sky": {"type": "constant", "radiance": 0.6},
        "floor": {"type": "plane", "bsdf": {"type": "diffuse", "reflectance": 0.6}},
        "lamp": {
            "type": "disk",
            "to_world": T().look_at([-5, -4, 8], [0, 0, 0], [0, 0, 1]).scale(1.5),
            "emitter": {"type": "area", "radiance": 25.0},
        },
    }
    for i, form in enumerate(forms):
        place = T().translate([2.1 * (i % 4) - 3.15, 2.4 * (i // 4) - 1.2, 0])
        color = {"type": "rgb", "value": palette[i % len(palette)]}
        bsdf = {"type": "twosided", "inner": {"type": "diffuse", "reflectance": color}}
        scene[form["type"]] = {**form, "to_world": place @ form.get("to_world", T()), "bsdf": bsdf}
    djpt.write(IMAGES / "shapes.png", djpt.render(djpt.load_dict(scene), spp=512))


def materials() -> None:
    """What `djpt gallery` makes, without the glass that has a figure of its own."""
    djpt.write(IMAGES / "materials.png", sheet(list(MATERIALS.values()), size=200, spp=1024))


def glass() -> None:
    """Reflection and refraction, each alone and together, without and with a bend; coloured glass."""
    djpt.write(IMAGES / "glass.png", sheet(list(GLASS.values()), size=280, spp=2048, columns=3))


class MeshPanel(Panel):
    """A panel whose ball is a mesh that carries the colours of the rainbow at its vertices."""

    def scene(self, size: int) -> dict[str, Any]:
        """The scene with another ball."""
        rows, columns = 24, 48
        v, u = np.meshgrid(np.linspace(0, np.pi, rows + 1), 2 * np.pi * np.arange(columns) / columns, indexing="ij")
        p = np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], axis=-1).reshape(-1, 3)
        first = (np.arange(rows)[:, None] * columns + np.arange(columns)).ravel()
        right = (np.arange(rows)[:, None] * columns + np.roll(np.arange(columns), -1)).ravel()
        # At the poles one of the two triangles has no area.
        upper = np.stack([first, first + columns, right], axis=1)[columns:]
        lower = np.stack([right, first + columns, right + columns], axis=1)[:-columns]
        description = super().scene(size)
        place = T().translate(description["ball"]["center"])
        description["ball"] = djpt.Mesh(
            "ball",
            vertex_positions=p,
            faces=np.concatenate([upper, lower]),
            props={"bsdf": self.bsdf(), "to_world": place},
            attributes={"vertex_color": np.clip(0.5 + 0.45 * np.sin(3 * p + [0, 2, 4]), 0, 1)},
        )
        return description


def textures() -> None:
    """One of each texture."""
    random = np.random.default_rng(6)
    tiles = {"type": "bitmap", "data": (random.random((6, 12, 3)) ** 1.5).astype(np.float32)}
    patches = {"type": "checkerboard", "color0": 0.06, "color1": 0.35, "to_uv": T().scale([6, 3, 1])}
    squares = {
        "type": "checkerboard",
        "color0": 0.75,
        "color1": 0.15,
        "to_uv": T().rotate([0, 0, 1], 45).scale([12, 6, 1]),
    }
    shown: list[tuple[type[Panel], str, str, dict[str, Any]]] = [
        (Panel, "rgb", "three numbers", {"type": "rgb", "value": [0.6, 0.2, 0.1]}),
        (Panel, "checkerboard", "to_uv: turned and scaled", squares),
        (Panel, "bitmap", "bilinear", tiles),
        (Panel, "bitmap", "nearest", {**tiles, "filter_type": "nearest"}),
        (Panel, "checkerboard", "for a roughness", patches),
        (MeshPanel, "mesh_attribute", "colours of vertices", {"type": "mesh_attribute", "name": "vertex_color"}),
    ]

    def material(texture: dict[str, Any]) -> dict[str, Any]:
        if texture is patches:
            return {"type": "roughconductor", "material": "Cu", "alpha": texture}
        return {"type": "diffuse", "reflectance": texture}

    panels = [make(title, subtitle, partial(material, texture)) for make, title, subtitle, texture in shown]
    djpt.write(IMAGES / "textures.png", sheet(panels, size=200, spp=512))

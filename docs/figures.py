"""Make the pictures of the README and of the documentation: ``python docs/figures.py [NAME ..]``."""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import runpy
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from djpt import ScalarTransform4f as T
from djpt.images.sheets import captioned_sheet
from djpt.scenes.gallery import GLASS, MATERIALS, Panel, sheet
from djpt.validation.ladder.strips import samples

DOCS = Path(__file__).parent
IMAGES = DOCS / "images"


def cornell_box() -> None:
    """The Cornell box, as `djpt render cornell_box` makes it, with more pixels and samples."""
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=400, height=400)
    image = djpt.render(djpt.load_dict(description), spp=2048)
    djpt.write(IMAGES / "cornell_box.png", image)


def spheres() -> None:
    """The variant with two spheres."""
    description = djpt.scenes.cornell_box_spheres()
    image = djpt.render(djpt.load_dict(description), spp=1024)
    djpt.write(IMAGES / "spheres.png", image)


def albedo() -> None:
    """What the albedo example writes."""
    with patch.object(sys, "argv", ["albedo.py", "--out", str(IMAGES / "albedo.png")]):
        runpy.run_path(str(DOCS.parent / "examples" / "albedo.py"), run_name="__main__")


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


def cameras() -> None:
    """The stage before a row of small lamps: a pinhole, two lenses and no perspective, in one batch."""
    place = T().look_at(origin=[0.6, -7.5, 2.6], target=[0, 0, 0.85], up=[0, 0, 1])
    lens = {"type": "thinlens", "fov": 26, "aperture_radius": 0.3, "to_world": place}
    views = {
        "pinhole": {"type": "perspective", "fov": 26, "to_world": place},
        "near": {**lens, "focus_distance": 6.5},
        "far": {**lens, "focus_distance": 8.9},
        "parallel": {"type": "orthographic", "to_world": place @ T().scale([1.9, 1.9, 1])},
    }
    film = {"type": "hdrfilm", "width": 4 * 240, "height": 240, "rfilter": {"type": "box"}}
    scene = djpt.scenes.stage()
    scene["sensor"] = {"type": "batch", "film": film, **views}
    for i, x in enumerate(np.linspace(-1.6, 1.6, 5)):
        color = {"type": "rgb", "value": [[24, 13, 5], [5, 12, 24]][i % 2]}
        lamp = {"type": "sphere", "center": [float(x), 1.2, 2.0], "radius": 0.02}
        scene[f"lamp{i}"] = {**lamp, "emitter": {"type": "area", "radiance": color}}
    djpt.write(IMAGES / "cameras.png", djpt.render(djpt.load_dict(scene), spp=2048))


@dataclass(frozen=True)
class LightPanel:
    """The stage under one kind of light."""

    title: str
    subtitle: str
    lights: dict[str, Any]
    integrator: dict[str, Any] = field(default_factory=lambda: {"type": "path", "max_depth": 6})

    def scene(self, size: int) -> dict[str, Any]:
        """The description of the panel's scene."""
        return {**djpt.scenes.stage(self.lights, size), "integrator": self.integrator}


def lights() -> None:
    """The stage under one of each light."""
    near, far = [-2.4, -3.0, 4.0], [-5.0, -6.0, 9.0]

    def towards(origin: list[float]) -> T:
        return T().look_at(origin=origin, target=[0, 0, 0.6], up=[0, 0, 1])

    def bitmap(data: np.ndarray) -> dict[str, Any]:
        return {"type": "bitmap", "data": data.astype(np.float32)}

    dim = {"type": "constant", "radiance": 0.03}
    hues = 0.5 + 0.5 * np.cos(2 * np.pi * (np.arange(6)[:, None] / 6 + [0, 1 / 3, 2 / 3]))
    spiral = np.sqrt(np.arange(40) / 40) * np.exp(2.4j * np.arange(40))
    rainbow = np.tile(hues, (6, 1, 1))
    cross = np.full((9, 9, 3), 1.0)
    cross[4] = cross[:, 4] = 0.15
    window = {"type": "rectangle", "to_world": towards(near).scale(0.8)}
    beam = {"type": "disk", "to_world": towards([-1.6, -2.2, 3.0]).scale(0.45)}
    sky = djpt.scenes.sky(256)
    up = T().rotate([1, 0, 0], 90).rotate([0, 1, 0], 115)
    shown = [
        LightPanel("area", "a rectangle", {"lamp": {**window, "emitter": {"type": "area", "radiance": 25.0}}}),
        LightPanel(
            "area",
            "radiance: a bitmap",
            {"lamp": {**window, "emitter": {"type": "area", "radiance": bitmap(55 * rainbow)}}},
        ),
        LightPanel("point", "no size: hard shadows", {"lamp": {"type": "point", "position": near, "intensity": 65.0}}),
        LightPanel(
            "spot",
            "cutoff_angle 12",
            {"lamp": {"type": "spot", "to_world": towards(near), "intensity": 90.0, "cutoff_angle": 12}, "dim": dim},
        ),
        LightPanel(
            "projector",
            "irradiance: a bitmap",
            {
                "lamp": {
                    "type": "projector",
                    "to_world": towards([0.3, -6, 2.5]),
                    "irradiance": bitmap(cross),
                    "scale": 70,
                    "fov": 28,
                },
                "dim": dim,
            },
        ),
        LightPanel(
            "directional",
            "from far away",
            {
                "lamp": {
                    "type": "directional",
                    "to_world": towards(far),
                    "irradiance": {"type": "rgb", "value": [3.0, 2.6, 2.0]},
                },
                "dim": dim,
            },
        ),
        LightPanel(
            "directionalarea",
            "a beam, by ptracer",
            {"lamp": {**beam, "emitter": {"type": "directionalarea", "radiance": 6.0}}},
            {"type": "ptracer", "max_depth": 6},
        ),
        LightPanel("constant", "the same from all around", {"sky": {"type": "constant", "radiance": 0.9}}),
        LightPanel("envmap", "a clear day", {"sky": {"type": "envmap", "data": sky, "to_world": up, "scale": 0.16}}),
        LightPanel(
            "many points",
            "emitter_choice: tree",
            {
                f"lamp{i}": {
                    "type": "point",
                    "position": [2.2 * spiral.real[i], 1.2 * spiral.imag[i] - 0.6, 2],
                    "intensity": {"type": "rgb", "value": (0.6 * hues[i % 6]).tolist()},
                }
                for i in range(40)
            },
            {"type": "path", "max_depth": 6, "emitter_choice": "tree"},
        ),
    ]
    djpt.write(IMAGES / "lights.png", sheet(shown, size=220, spp=1024, columns=5))


def samplers() -> None:
    """A sphere under a white sky at 4 samples per pixel with three samplers, magnified; below, the same blurred."""
    rows: list[list[np.ndarray]] = [[], []]
    clay = {"type": "rgb", "value": [0.7, 0.3, 0.15]}
    for sampler in ({"type": "independent"}, {"type": "sobol"}, {"type": "sobol", "blue_noise": True}):
        film = {"type": "hdrfilm", "width": 80, "height": 60, "rfilter": {"type": "box"}}
        place = T().look_at(origin=[0, 1.2, 4], target=[0, -0.1, 0], up=[0, 1, 0])
        scene = {
            "type": "scene",
            "sensor": {"type": "perspective", "fov": 36, "to_world": place, "film": film, "sampler": sampler},
            "sky": {"type": "constant", "radiance": 0.9},
            "floor": {"type": "rectangle", "to_world": T().translate([0, -0.7, 0]).rotate([1, 0, 0], -90).scale(30)},
            "ball": {"type": "sphere", "radius": 0.7, "bsdf": {"type": "diffuse", "reflectance": clay}},
        }
        image = np.array(djpt.render(djpt.load_dict(scene), spp=4))
        weights = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
        blurred = np.pad(image, ((5, 5), (5, 5), (0, 0)), mode="edge")
        for axis in (0, 1):
            blurred = np.apply_along_axis(np.convolve, axis, blurred, weights / weights.sum(), mode="valid")
        for row, picture in zip(rows, (image, blurred), strict=True):
            row.append(np.kron(picture, np.ones((4, 4, 1))))
    picture = np.concatenate([np.concatenate(row, axis=1) for row in rows])
    djpt.write(IMAGES / "samplers.png", picture.astype(np.float32))


def tonemapping() -> None:
    """One image of bright and dark parts under the four operators, side by side."""
    glowing: dict[str, Any] = {"dim": {"type": "constant", "radiance": 0.08}}
    for i, (x, color) in enumerate([(-0.1, [90, 14, 5]), (1.65, [12, 20, 90]), (-1.4, [70, 55, 30])]):
        glowing[f"bulb{i}"] = {
            "type": "sphere",
            "center": [x, -1.0, 0.22],
            "radius": 0.22,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": color}},
        }
    image = np.array(djpt.render(djpt.load_dict(djpt.scenes.stage(glowing, size=240)), spp=2048))
    gap = np.ones((image.shape[0], 8, 3), np.float32)
    shown = [djpt.tonemap(image, operator, exposure=-1.0) for operator in ("srgb", "reinhard", "aces", "agx")]
    djpt.write(IMAGES / "tonemapping.png", np.concatenate([x for one in shown for x in (gap, one)][1:], axis=1))


@dataclass(frozen=True)
class Step:
    """The room of `benchmarks/ladder.py` by one algorithm."""

    title: str
    subtitle: str
    integrator: dict[str, Any]

    def scene(self, size: int) -> dict[str, Any]:
        """The description of the panel's scene."""
        return {**LADDER["room"](size), "integrator": self.integrator}


LADDER = runpy.run_path(str(DOCS.parent / "benchmarks" / "ladder.py"))


def ladder() -> None:
    """From ray casting to path tracing, step by step at 16 samples per pixel: three strips and two halves of one."""
    spp = 16
    strips = {
        "rays": ["raycast", "whitted", "distributed"],
        "paths": ["path_naive, uniform", "path_naive, cosine", "path_nee"],
        "strategies": ["direct, light samples", "direct, BSDF samples", "direct, both"],
        "ends": ["path", "ptracer"],
    }
    for strip, names in strips.items():
        panels = [Step(*(name + ", ").split(", ")[:2], LADDER["STEPS"][name]) for name in names]
        picture = sheet(panels, size=240, spp=spp, columns=3)
        if strip == "ends":
            last = Step("path", "4096 samples per pixel", LADDER["STEPS"]["path"])
            picture = np.concatenate([picture, sheet([last], size=240, spp=4096)[:, 12:]], axis=1)
        djpt.write(IMAGES / f"ladder_{strip}.png", picture)


def bounces() -> None:
    """The terms of the Neumann series from left to right; below, their sums so far."""
    size, terms = 150, 6
    integrator = {"type": "path", "max_depth": terms, "bounces": True}
    scene = djpt.load_dict({**LADDER["room"](size), "integrator": integrator})
    series = np.array(djpt.render(scene, spp=4096))[..., 3:].reshape(size, size, terms, 3)
    rows = [np.moveaxis(row, 2, 0) for row in (series, np.cumsum(series, axis=2))]
    framed = [np.pad(row, ((0, 0), (0, 4), (0, 4), (0, 0)), constant_values=1.0) for row in rows]
    djpt.write(IMAGES / "bounces.png", np.concatenate([np.concatenate(row, axis=1) for row in framed]))


def spp() -> None:
    """What `djpt spp cornell_box` makes: noise by the number of samples."""
    djpt.write(IMAGES / "spp.png", captioned_sheet(samples("cornell_box", width=160)))


FIGURES: dict[str, Callable[[], None]] = {
    f.__name__: f
    for f in (
        *(cornell_box, spheres, albedo, shapes, materials, glass, textures, lights, cameras, samplers, tonemapping),
        *(ladder, bounces, spp),
    )
}


def main() -> None:
    """Make all pictures, or those named on the command line."""
    IMAGES.mkdir(exist_ok=True)
    for name in sys.argv[1:] or FIGURES:
        FIGURES[name]()


if __name__ == "__main__":
    main()

"""Cameras, samplers and tone mapping."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import djpt
from djpt import ScalarTransform4f as T
from djpt.images.sheets import Tile, captioned_sheet, shown
from places import IMAGES

__all__ = ["cameras", "lenses", "photographs", "samplers", "tonemapping", "under_water", "wide"]


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


def lenses() -> None:
    """Lamps out of focus through three apertures; a floor through a lens without and with tilt."""
    rng = np.random.default_rng(5)
    night: dict[str, Any] = {"type": "scene", "integrator": {"type": "path", "max_depth": 2}}
    for i in range(16):
        x, y = rng.uniform(-2, 2, 2)
        lamp = {"type": "sphere", "center": [x, y, rng.uniform(7, 9)], "radius": 0.06}
        color = {"type": "rgb", "value": (rng.dirichlet([1.5, 1.5, 1.5]) * rng.uniform(40, 150)).tolist()}
        night[f"lamp{i}"] = {**lamp, "emitter": {"type": "area", "radiance": color}}
    film = {"type": "hdrfilm", "width": 210, "height": 210, "rfilter": {"type": "box"}}
    lens = {"type": "thinlens", "fov": 30, "aperture_radius": 0.3, "focus_distance": 2.5, "film": film}
    down = 25
    table: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4},
        "sky": {"type": "constant", "radiance": 0.9},
        "floor": {
            "type": "rectangle",
            "to_world": T().rotate([1, 0, 0], -90).scale(12),
            "bsdf": {
                "type": "diffuse",
                "reflectance": {"type": "checkerboard", "to_uv": T().scale([24, 24, 1]), "color0": 0.7, "color1": 0.25},
            },
        },
    }
    for i, (x, z) in enumerate((x, z) for z in (-3, -1, 1, 3, 5) for x in (-2, -1, 0, 1, 2)):
        clay = {"type": "rgb", "value": [[0.75, 0.3, 0.15], [0.2, 0.4, 0.6]][i % 2]}
        place = T().translate([x + 0.25, 0.06, z + 0.25]).scale([0.18, 0.06, 0.18])
        table[f"stone{i}"] = {"type": "cube", "to_world": place, "bsdf": {"type": "diffuse", "reflectance": clay}}
    height = 2.4
    distance = height / np.sin(np.radians(down))
    eye = T().translate([0, height, -distance * np.cos(np.radians(down))]).rotate([1, 0, 0], down)
    above = {**lens, "fov": 45, "aperture_radius": 0.25, "focus_distance": float(distance), "to_world": eye}

    def tile(title: str, subtitle: str, scene: dict[str, Any], camera: dict[str, Any], spp: int) -> Tile:
        image = djpt.render(djpt.load_dict({**scene, "camera": camera}), spp=spp)
        return Tile(title, subtitle, shown(np.array(image)))

    tiles = [
        tile("five blades", "", night, {**lens, "aperture_blades": 5}, 2048),
        tile("six blades", "rotation 15", night, {**lens, "aperture_blades": 6, "aperture_rotation": 15}, 2048),
        tile("five blades", "roundness 0.6", night, {**lens, "aperture_blades": 5, "aperture_roundness": 0.6}, 2048),
        tile("no tilt", "sharp in a plane across the axis", table, above, 256),
        tile(f"tilt {90 - down}", "the floor is sharp all over", table, {**above, "tilt": 90 - down}, 256),
    ]
    djpt.write(IMAGES / "lenses.png", captioned_sheet(tiles))


def wide() -> None:
    """The Cornell box from its middle: four fisheyes; below, a panorama and two lenses that distort."""
    room = djpt.load_dict(djpt.cornell_box())
    place = T().look_at(origin=[0, -0.2, 0.75], target=[0, -0.2, -1], up=[0, 1, 0])
    outside = T().look_at(origin=[0, 0, 3.9], target=[0, 0, 0], up=[0, 1, 0])

    def picture(camera: dict[str, Any], width: int = 240) -> np.ndarray:
        film = {"type": "hdrfilm", "width": width, "height": 240, "rfilter": {"type": "box"}}
        sensor = djpt.load_dict({"to_world": place, **camera, "film": film})
        return np.array(djpt.render(room, sensor=sensor, spp=1024))

    fisheye = {"type": "fisheye", "fov_axis": "diagonal", "fov": 180}
    projections = ("equidistant", "equisolid", "stereographic")
    above = [picture({**fisheye, "projection": projection}) for projection in projections]
    above.append(picture({**fisheye, "projection": "orthographic", "fov": 170}))
    lens = {"type": "perspective", "fov": 42, "to_world": outside}
    below = [
        picture({"type": "panorama"}, 480),
        picture({**lens, "k1": -0.45, "k2": 0.2}),
        picture({**lens, "k1": 0.6}),
    ]
    djpt.write(IMAGES / "wide-angles.png", np.vstack([np.hstack(above), np.hstack(below)]))


def photographs() -> None:
    """Photographs of the Cornell box by a lens that distorts; below, the box as a search begins, and as it ends."""
    room = djpt.cornell_box()
    room.pop("sensor")
    lens = {"w": 200, "h": 200, "fl_x": 270.0, "fl_y": 270.0, "cx": 100.0, "cy": 100.0, "k1": -0.3, "k2": 0.08}
    frames = []
    for i, x in enumerate((-1.6, 0.0, 1.6)):
        place = T().look_at(origin=[x, 0.3 * (1 - abs(x)), 3.4], target=[0, 0, 0], up=[0, 1, 0])
        frames.append({"file_path": f"{i}.exr", "transform_matrix": (place.matrix * [-1, 1, -1, 1]).tolist()})
    keys = [f"{wall}.reflectance.value" for wall in ("red", "green")]
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
        views = djpt.load_cameras(folder)
        truth = np.array(djpt.render(djpt.load_dict({**room, "sensor": views.batch()}), spp=512))
        for i, picture in enumerate(np.split(truth, 3, axis=1)):
            djpt.write(Path(folder, f"{i}.exr"), np.ascontiguousarray(picture))
        views = djpt.load_cameras(folder)
        scene = djpt.load_dict({**room, "sensor": views.batch(), "small": views.resized(25).batch()})
        params = djpt.traverse(scene)
        params.update(dict.fromkeys(keys, djpt.Color3f(0.5)))
        rows = [views.strip(), np.array(djpt.render(scene, spp=256))]
        options = {"views": [1], "iterations": 24, "spp": 64, "optimizer": "gauss_newton"}
        found = djpt.optimize(scene, keys, [views.resized(25).strip()], **options)
        params.update(found.average)
        rows.append(np.array(djpt.render(scene, spp=256)))
    djpt.write(IMAGES / "photographs.png", np.vstack(rows))


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


def under_water() -> None:
    """The Cornell box by a camera in air, and by one in water at the same place."""
    tiles = []
    for title, subtitle, more in (("in air", "", {}), ("in water", "larger by 1.33 near the middle", {"ior": "water"})):
        scene = djpt.cornell_box()
        scene["sensor"].update(more)
        scene["sensor"]["film"].update(width=280, height=280)
        tiles.append(Tile(title, subtitle, shown(np.array(djpt.render(djpt.load_dict(scene), spp=512)))))
    djpt.write(IMAGES / "under-water.png", captioned_sheet(tiles))

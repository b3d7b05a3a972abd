"""Scenes as people render them, whose cameras move: cells of the gradient matrix of which more is asked.

Each is rendered by 64 x 64 pixels and by the usual settings of integrators. Pixels are weighted by the blurred residual
of the image against a picture from where the camera would be a little later: the derivative is that of the loss that a
search for the camera begins with.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import Float
from tests.gradients.cells import Accuracy, Cell, Edit, Node
from tests.silhouettes.cases import SPOTS, ball, edit, placed, shift, sky
from tests.silhouettes.test_projective import globe

__all__ = ["cameras_of_scenes"]

SIZE = 64
ACCURACY = Accuracy(close=0.01, precise=0.02, nothing=0.0)
LATER = 0.2
"""The theta of the picture."""

# ---------------------------------------------------------------- cameras


def camera(
    kind: str = "perspective", origin: tuple[float, float, float] = (2.2, -6, 3), height: float = 0.6, **more: Any
) -> Node:
    """A camera that looks at the middle of the scene, z up."""
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    place = T().look_at(list(origin), [0, 0, height], [0, 0, 1])
    return {"type": kind, "to_world": place, "film": film, **more}


def head(degrees: float) -> Edit:
    """Turn the camera about an axis of its own."""

    def turn(params: Any, theta: Float) -> None:
        own = djpt.Transform4f().rotate([-0.6, 0.75, 0.28], degrees * theta)
        params["sensor.to_world"] = djpt.Transform4f(params["sensor.to_world"]) @ own

    return turn


MOTIONS = {"aside": shift("sensor.to_world", 0.5, 0.2, 0.3), "turn": head(8)}
ZOOM = {"x_fov": edit("sensor.x_fov", 8), "principal point": edit("sensor.principal_point_offset_x", 0.15)}
LENS = {
    "x_fov": ZOOM["x_fov"],
    "aperture": edit("sensor.aperture_radius", 0.3),
    "focus": edit("sensor.focus_distance", 2),
}
FISHEYE = {"focal length": edit("sensor.x_focal", 0.1), "principal point": ZOOM["principal point"]}

# ---------------------------------------------------------------- scenes


def painted(*colour: float) -> Node:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(colour)}}


def checked(n: int, dark: float = 0.15) -> Node:
    fields = {"type": "checkerboard", "to_uv": T().scale([n, n, 1]), "color0": dark, "color1": 0.75}
    return {"type": "diffuse", "reflectance": fields}


def floor(bsdf: Node) -> Node:
    return {"type": "rectangle", "to_world": T().scale(6), "bsdf": bsdf}


def lamp(radiance: float = 30.0) -> Node:
    place = T().look_at([-2, -1, 4.5], [0, 0, 0], [0, 1, 0]).scale(0.8)
    return {"type": "rectangle", "to_world": place, "emitter": {"type": "area", "radiance": radiance}}


def textured_mesh() -> Node:
    """A smooth mesh with a picture, over a floor, in the light of a point and a weak sky."""
    data = globe(24, 48).data()
    uv = 0.5 + 0.5 * data.positions[:, ::2]
    props = {"bsdf": {"type": "diffuse", "reflectance": SPOTS}}
    points = data.positions + np.array([0.1, 0.2, 1.2], np.float32)
    mesh = djpt.Mesh("mesh", points, data.indices, data.normals, uv, props=props)
    return {
        "mesh": mesh,
        "floor": floor(painted(0.5, 0.45, 0.4)),
        "light": {"type": "point", "position": [3, -4, 6], "intensity": 60.0},
        "fill": {"type": "constant", "radiance": 0.2},
    }


def glass() -> Node:
    """A ball of glass before a checkerboard, under a sky."""
    wall = T().translate([-1, 2.5, 0]).rotate([1, 0, 0], 90).scale(4)
    return {
        "ball": ball({"type": "dielectric"}, center=[0, 0, 1.1], radius=0.9),
        "wall": {"type": "rectangle", "to_world": wall, "bsdf": checked(8)},
        "floor": floor(painted(0.5, 0.45, 0.4)),
        "sky": sky(),
    }


def overlaps() -> Node:
    """Bodies that hide and cut each other."""
    return {
        "ball": ball(painted(0.8, 0.4, 0.3), center=[0.7, -0.8, 0.7], radius=0.6),
        "other": ball(painted(0.3, 0.5, 0.8), center=[-0.3, 0.4, 0.5], radius=0.8),
        "box": {
            "type": "cube",
            "to_world": T().translate([0.6, 1.0, 0.81]).rotate([0, 0, 1], 25).scale(0.8),
            "bsdf": painted(0.6, 0.7, 0.3),
        },
        "post": {"type": "cylinder", "p0": [-1.2, -1, 0.1], "p1": [-1.1, -0.9, 2], "radius": 0.2},
        "floor": floor(painted(0.5, 0.45, 0.4)),
        "sky": sky(),
    }


def soft_shadows() -> Node:
    """A box, a ball and a ring on a floor under an area light."""
    return {
        "box": {
            "type": "cube",
            "to_world": T().translate([0.7, 0.6, 0.61]).rotate([0, 0, 1], 25).scale(0.6),
            "bsdf": painted(0.6, 0.7, 0.3),
        },
        "ball": ball(painted(0.8, 0.4, 0.3), center=[-0.6, -0.4, 0.61], radius=0.6),
        "ring": {
            "type": "torus",
            "major": 0.5,
            "minor": 0.15,
            "to_world": T().translate([0.9, -0.9, 0.2]),
            "bsdf": painted(0.3, 0.5, 0.8),
        },
        "floor": floor(painted(0.5, 0.45, 0.4)),
        "lamp": lamp(),
    }


def rough_bodies() -> Node:
    """Rough and brushed metal, and a principled body with a picture, under an environment map."""
    principled = {"type": "principled", "roughness": 0.4, "metallic": 0.5, "base_color": SPOTS}
    return {
        "metal": ball({"type": "roughconductor", "material": "Au", "alpha": 0.25}, center=[-0.9, 0, 0.8], radius=0.7),
        "principled": ball(principled, center=[0.8, 0.3, 0.8], radius=0.7),
        "box": {
            "type": "cube",
            "to_world": T().translate([0.1, -1.2, 0.41]).rotate([0, 0, 1], 25).scale(0.4),
            "bsdf": {"type": "roughplastic", "alpha": 0.2, "diffuse_reflectance": 0.4},
        },
        "floor": floor(painted(0.5, 0.45, 0.4)),
        "sky": sky(),
    }


def mirror() -> Node:
    """A ball and a box before a mirror, lit by a lamp and a weak sky."""
    place = T().translate([-0.5, 2, 1.5]).rotate([0, 0, 1], -8).rotate([1, 0, 0], 90).scale([1.8, 1.4, 1])
    return {
        "mirror": {"type": "rectangle", "to_world": place, "bsdf": {"type": "conductor", "material": "Al"}},
        "ball": ball(painted(0.8, 0.4, 0.3), center=[-0.7, 0.2, 0.9], radius=0.6),
        "box": {
            "type": "cube",
            "to_world": T().translate([0.8, 0.3, 0.51]).rotate([0, 0, 1], 25).scale(0.5),
            "bsdf": painted(0.3, 0.5, 0.8),
        },
        "floor": floor(painted(0.5, 0.45, 0.4)),
        "lamp": lamp(),
        "fill": {"type": "constant", "radiance": 0.2},
    }


def room() -> Node:
    """The Cornell box."""
    return {key: node for key, node in djpt.cornell_box().items() if key not in ("type", "integrator", "sensor")}


def foggy() -> Node:
    """The same in fog, with the camera in it."""
    medium = {"type": "homogeneous", "sigma_t": 0.15, "albedo": 0.9, "phase": {"type": "hg", "g": 0.5}}
    fog = {"type": "cube", "to_world": T().scale(6), "bsdf": {"type": "null"}, "interior": medium}
    return {**room(), "fog": fog}


def instances() -> Node:
    """Copies of a group of shapes, in parallel light and under a sky."""
    first = placed("one", T().translate([-0.8, 0.2, 1.1]).rotate([0.6, 0.8, 0], 30))
    second = placed("two", T().translate([1.0, 0.6, 0.9]).rotate([0, 0.6, 0.8], 110).scale(0.8))
    return {
        **first,
        "two": second["two"],
        "floor": floor(painted(0.5, 0.45, 0.4)),
        "sun": {"type": "directional", "direction": [0.4, 0.6, -1.0], "irradiance": 1.5},
        "fill": {"type": "constant", "radiance": 0.3},
    }


# ---------------------------------------------------------------- the cells


class View(NamedTuple):
    """A scene, the camera before it, what becomes of the camera, and by which integrators it is seen."""

    nodes: Callable[[], Node]
    camera: Node
    edits: dict[str, Edit]
    integrators: tuple[Node, ...]
    step: float = 0.05
    """That of differences: small where bright edges lie on the borders of pixels, or move over that of the film."""
    spp_difference: int = 1024


DIRECT = {"type": "direct_projective"}


def paths(depth: int) -> Node:
    return {"type": "prb_projective", "max_depth": depth}


PINHOLE = camera(fov=25)
INSIDE = camera(fov=40, to_world=T().look_at([0.1, 0.2, 3.6], [0, 0, 0], [0, 1, 0]))
THICK = camera("thinlens", fov=25, aperture_radius=0.15, focus_distance=5.5)
WIDE = camera("fisheye", (1.0, -2.2, 2), fov=100)
IN_FOG: Node = {"type": "volpath", "max_depth": 4}
VIEWS = {
    "a textured mesh": View(textured_mesh, PINHOLE, MOTIONS | ZOOM, (DIRECT,)),
    "a ball of glass": View(glass, PINHOLE, MOTIONS | ZOOM, (paths(6),), step=0.02, spp_difference=4096),
    "overlapping bodies": View(overlaps, PINHOLE, MOTIONS | ZOOM, (paths(3),)),
    "soft shadows": View(soft_shadows, PINHOLE, MOTIONS | ZOOM, (DIRECT, paths(2)), spp_difference=4096),
    "rough metals": View(rough_bodies, PINHOLE, MOTIONS | ZOOM, (paths(3),)),
    "a mirror": View(mirror, PINHOLE, MOTIONS | ZOOM, (paths(4),), step=0.025, spp_difference=8192),
    "a room": View(room, INSIDE, MOTIONS | ZOOM, (paths(6),), spp_difference=8192),
    "a lens": View(overlaps, THICK, MOTIONS | LENS, (DIRECT,)),
    "a room in fog": View(foggy, INSIDE, MOTIONS | ZOOM, (IN_FOG,), spp_difference=8192),
    "instances": View(instances, WIDE, MOTIONS | FISHEYE, (paths(2),)),
}


def cameras_of_scenes() -> Iterator[Cell]:
    """Each number of the camera of each scene."""
    for scene, view in VIEWS.items():
        for integrator in view.integrators:
            for name, edit_camera in view.edits.items():
                yield Cell(
                    "a camera before a scene",
                    f"{scene}, {name}",
                    view.nodes,
                    edit_camera,
                    integrator,
                    step=view.step,
                    spp=256,
                    spp_difference=view.spp_difference,
                    camera=lambda view=view: view.camera,
                    picture=LATER,
                    settings={},
                    accuracy=ACCURACY,
                )

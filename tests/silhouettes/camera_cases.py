"""Cases of cameras that move, and of what they see, whose derivatives central differences check."""

from __future__ import annotations

from typing import Any

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import Float
from tests.silhouettes.cases import SIZE, SPOTS, SUN, Case, ball, edit, sensor, shift, slide, turn_head
from tests.silhouettes.test_projective import globe


def orbit(params: Any, theta: Float) -> None:
    """Turn the camera about the origin."""
    turn = djpt.Transform4f().rotate([0, 1, 0], 20 * theta)
    params["sensor.to_world"] = turn @ djpt.Transform4f(params["sensor.to_world"])


GROUND = {
    "type": "rectangle",
    "to_world": T().translate([0, 0, -1.5]).scale(3),
    "bsdf": {"type": "diffuse", "reflectance": SPOTS},
}
MOTIONS = {
    "step aside": shift("sensor.to_world"),
    "step back": shift("sensor.to_world", 0, 0, 1),
    "turn": turn_head,
    "field of view": edit("sensor.x_fov", 20),
    "principal point": edit("sensor.principal_point_offset_x", 0.3),
}
CASES: dict[str, Case] = {}
for motion, move in MOTIONS.items():
    CASES[f"a camera, {motion}: a globe"] = Case(
        lambda: {"globe": ball(radius=0.9, emitter={"type": "area", "radiance": SPOTS})}, move, settings={"sppi": 0}
    )
    CASES[f"a camera, {motion}: a floor under a sky"] = Case(
        lambda: {"floor": {**GROUND, "to_world": T().scale(9)}, "sky": {"type": "constant"}}, move, step=0.02
    )
    CASES[f"a camera, {motion}: the light of a point"] = Case(
        lambda: {
            "ball": ball({"type": "diffuse", "reflectance": SPOTS}, center=[0.5, 0.2, 0], radius=0.8),
            "floor": GROUND,
            "light": {"type": "point", "position": [1, 2, 6], "intensity": 40.0},
        },
        move,
        spp=512,
    )


def with_filter(name: str) -> dict[str, Any]:
    """The camera with a reconstruction filter."""
    found = sensor()
    found["film"] = {**found["film"], "rfilter": {"type": name}}
    return found


CASES["the edge of a lamp at the border of the film"] = Case(
    lambda: {
        "moving": {
            "type": "rectangle",
            "to_world": T().translate([-7.9, 0, 0]).scale(10),
            "emitter": {"type": "area", "radiance": 2.0},
        },
        "sensor": with_filter("gaussian"),
    },
    shift("moving.to_world"),
    step=0.01,
)
CASES["a camera, orbit: a smooth mesh"] = Case(
    lambda: {"globe": globe(), "light": {"type": "point", "position": [3, 2, 3], "intensity": 40.0}},
    orbit,
    spp=1024,
)
CASES["a camera, turn: a coarse smooth mesh"] = Case(
    lambda: {"globe": globe(6, 12), "light": {"type": "constant"}}, turn_head, spp=1024
)
CASES["a coarse smooth mesh"] = Case(lambda: {"moving": globe(6, 12), "light": {"type": "constant"}}, slide, spp=1024)
CASES["a camera, turn: a torus"] = Case(
    lambda: {"ring": {"type": "torus", "minor": 0.4, "to_world": T().rotate([0.6, 0.8, 0], 40)}, "light": SUN},
    turn_head,
    spp=512,
)


def parallel(params: Any, theta: Float) -> None:
    """Turn a camera and move it aside."""
    motion = djpt.Transform4f().rotate([0, 1, 0], 20 * theta) @ djpt.Transform4f().translate([0.5 * theta, 0, 0])
    params["sensor.to_world"] = motion @ djpt.Transform4f(params["sensor.to_world"])


ORTHOGRAPHIC = {
    **sensor(),
    "type": "orthographic",
    "to_world": T().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0]).scale([3, 3, 1]),
}
del ORTHOGRAPHIC["fov"]
CASES["parallel rays: a coarse smooth mesh"] = Case(
    lambda: {"moving": globe(6, 12), "light": {"type": "constant"}, "sensor": ORTHOGRAPHIC}, slide, spp=1024
)
CASES |= {
    f"parallel rays: {name}": Case(
        lambda: {
            "moving": ball({"type": "diffuse", "reflectance": SPOTS}, center=[0.5, 0.2, 0], radius=0.8),
            "floor": GROUND,
            "light": {"type": "point", "position": [1, 2, 6], "intensity": 40.0},
            "sensor": ORTHOGRAPHIC,
        },
        move,
        spp=512,
    )
    for name, move in (("a camera", parallel), ("a ball", shift("moving.to_world")))
}


def lens(scene: str) -> dict[str, Any]:
    """Scenes for cameras with a lens: a globe, and a ball over a floor."""
    camera = sensor(type="thinlens", aperture_radius=0.4, focus_distance=4.0)
    if scene == "a globe":
        return {"globe": ball(radius=0.9, emitter={"type": "area", "radiance": SPOTS}), "sensor": camera}
    return {
        "ball": ball({"type": "diffuse", "reflectance": SPOTS}, center=[0.5, 0.2, 1], radius=0.8),
        "floor": GROUND,
        "light": {"type": "point", "position": [1, 2, 6], "intensity": 40.0},
        "sensor": camera,
    }


LENS_MOTIONS = {
    "step aside": shift("sensor.to_world"),
    "turn": turn_head,
    "field of view": edit("sensor.x_fov", 20),
    "aperture": edit("sensor.aperture_radius", 1),
    "focus": edit("sensor.focus_distance", 3),
}
for motion, move in LENS_MOTIONS.items():
    for where in ("a globe", "the light of a point"):
        CASES[f"a lens, {motion}: {where}"] = Case(
            lambda where=where: lens(where), move, spp=512, settings={"sppi": 0} if where == "a globe" else {}
        )
BLADES = {"aperture_blades": 5, "aperture_rotation": 15, "aperture_roundness": 0.3, "tilt": 35, "swing": -20}


def view_camera(scene: str) -> dict[str, Any]:
    """The scenes of `lens` through a lens with blades, tilted."""
    nodes = lens(scene)
    return {**nodes, "sensor": {**nodes["sensor"], **BLADES}}


CASES |= {
    f"a view camera, {name}: {where}": Case(
        lambda where=where: view_camera(where), move, spp=512, settings={"sppi": 0} if where == "a globe" else {}
    )
    for name, where, move in (
        ("step aside", "the light of a point", shift("sensor.to_world")),
        ("tilt", "a globe", edit("sensor.tilt", 40)),
        ("swing", "the light of a point", edit("sensor.swing", 40)),
        ("shift", "a globe", edit("sensor.principal_point_offset_x", 0.3)),
    )
}
CASES["a lens: a ball moves"] = Case(lambda: lens("a ball"), shift("ball.to_world"), spp=512)


def circled(**nodes: Any) -> dict[str, Any]:
    """What a fisheye sees whose film reaches past its image circle; outlines cross the edge of the circle."""
    return {**nodes, "sensor": sensor(type="fisheye", image_circle=16.0, principal_point_offset_x=0.1)}


SHINING = ball(center=[0.35, 0.2, 0], radius=0.7, emitter={"type": "area", "radiance": SPOTS})
CASES |= {
    f"an image circle, {name}: a globe": Case(
        lambda: circled(globe=SHINING), move, step=0.01, spp=512, spp_difference=16384, settings={"sppi": 0}
    )
    for name, move in (("turn", turn_head), ("what is seen", shift("globe.to_world")))
}
BARREL = sensor(fov=60, k1=-0.9)
CASES["a picture that folds, turn: the light of a point"] = Case(
    lambda: {**lens("a ball"), "sensor": BARREL}, turn_head, spp=2048
)


def pair() -> dict[str, Any]:
    """Two cameras side by side, of different kinds."""
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    left = sensor((1, 0, 6), 40, film={"type": "hdrfilm", "width": SIZE // 2, "height": SIZE})
    right = sensor((-2, 0, 5), 50, type="thinlens", aperture_radius=0.3, focus_distance=5.0)
    return {"type": "batch", "left": left, "right": right, "film": film}


def both(params: Any, theta: Float) -> None:
    """Turn one camera and zoom with the other one."""
    own = djpt.Transform4f().rotate([0.6, 0.8, 0], 20 * theta)
    params["sensor.left.to_world"] = djpt.Transform4f(params["sensor.left.to_world"]) @ own
    params["sensor.right.x_fov"] = Float(params["sensor.right.x_fov"]) + 20 * theta


CASES |= {
    f"two cameras: {name}": Case(lambda: {**lens("a ball"), "sensor": pair()}, move, spp=512)
    for name, move in (("they move", both), ("a ball moves", shift("ball.to_world")))
}

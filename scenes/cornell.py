"""The Cornell box, after C. Goral et al., "Modeling the Interaction of Light Between Diffuse Surfaces", 1984."""

from __future__ import annotations

from typing import Any

from djpt.core.transforms import ScalarTransform4f as T

__all__ = ["cornell_box", "cornell_box_boxfilter", "cornell_box_spheres", "furnace"]


def cornell_box() -> dict[str, Any]:
    """Mitsuba's Cornell box, entry by entry: two white boxes, a red and a green wall, a lamp in the ceiling.

    The room is [-1, 1]^3, open towards the camera at z = 3.9; 256x256 pixels, gaussian filter,
    `path` with 8 bounces, 64 samples per pixel.
    """
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 8},
        "sensor": {
            "type": "perspective",
            "fov_axis": "smaller",
            "near_clip": 0.001,
            "far_clip": 100.0,
            "focus_distance": 1000,
            "fov": 39.3077,
            "to_world": T().look_at(origin=[0, 0, 3.9], target=[0, 0, 0], up=[0, 1, 0]),
            "sampler": {"type": "independent", "sample_count": 64},
            "film": {
                "type": "hdrfilm",
                "width": 256,
                "height": 256,
                "rfilter": {"type": "gaussian"},
                "pixel_format": "rgb",
                "component_format": "float32",
            },
        },
        "white": diffuse(0.885809, 0.698859, 0.666422),
        "green": diffuse(0.105421, 0.37798, 0.076425),
        "red": diffuse(0.570068, 0.0430135, 0.0443706),
        "light": {
            "type": "rectangle",
            "to_world": T().translate([0, 0.99, 0.01]).rotate([1, 0, 0], 90).scale([0.23, 0.19, 0.19]),
            "bsdf": {"type": "ref", "id": "white"},
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [18.387, 13.9873, 6.75357]}},
        },
        "floor": shape("rectangle", T().translate([0, -1, 0]).rotate([1, 0, 0], -90), "white"),
        "ceiling": shape("rectangle", T().translate([0, 1, 0]).rotate([1, 0, 0], 90), "white"),
        "back": shape("rectangle", T().translate([0, 0, -1]), "white"),
        "green-wall": shape("rectangle", T().translate([1, 0, 0]).rotate([0, 1, 0], -90), "green"),
        "red-wall": shape("rectangle", T().translate([-1, 0, 0]).rotate([0, 1, 0], 90), "red"),
        "small-box": shape("cube", T().translate([0.335, -0.7, 0.38]).rotate([0, 1, 0], -17).scale(0.3), "white"),
        "large-box": shape(
            "cube", T().translate([-0.33, -0.4, -0.28]).rotate([0, 1, 0], 18.25).scale([0.3, 0.61, 0.3]), "white"
        ),
    }


def cornell_box_boxfilter() -> dict[str, Any]:
    """The Cornell box with the box filter: each sample contributes to its own pixel only."""
    scene = cornell_box()
    scene["sensor"]["film"]["rfilter"] = {"type": "box"}
    return scene


def cornell_box_spheres() -> dict[str, Any]:
    """The Cornell box with two white diffuse spheres in place of the boxes."""
    scene = cornell_box()
    del scene["small-box"], scene["large-box"]
    scene["small-sphere"] = shape("sphere", T().translate([0.4, -0.7, 0.35]).scale(0.3), "white")
    scene["large-sphere"] = shape("sphere", T().translate([-0.4, -0.6, -0.3]).scale(0.4), "white")
    return scene


def diffuse(r: float, g: float, b: float) -> dict[str, Any]:
    """A Lambertian material."""
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": [r, g, b]}}


def shape(kind: str, to_world: T, bsdf: str) -> dict[str, Any]:
    """A shape with a shared material."""
    return {"type": kind, "to_world": to_world, "bsdf": {"type": "ref", "id": bsdf}}


# ---- a closed form ---------------------------------------------------------------------------


def furnace(reflectance: float = 0.5, radiance: float = 1.0) -> dict[str, Any]:
    """The closed Cornell box whose surfaces all reflect and emit equally: its radiance is known.

    From any point the same radiance arrives from all directions, so with `max_depth` n each pixel is::

        radiance (1 + reflectance + ... + reflectance^(n - 1)) = radiance (1 - reflectance^n) / (1 - reflectance)

    or radiance / (1 - reflectance) without a limit (-1). The camera stands inside; 64x64 pixels, box
    filter, `path` with 8 bounces.

    Args:
        reflectance: albedo of all surfaces, in [0, 1).
        radiance: emitted by all surfaces (W m^-2 sr^-1).
    """
    scene = cornell_box()
    sensor = scene["sensor"]
    sensor.update(to_world=T().look_at(origin=[0, 0, 0.98], target=[0, 0, 0], up=[0, 1, 0]), fov=80.0)
    sensor["film"].update(width=64, height=64, rfilter={"type": "box"})
    scene["front"] = {"type": "rectangle", "to_world": T().translate([0, 0, 1]).rotate([0, 1, 0], 180)}
    for key in ("light", "white", "green", "red"):
        del scene[key]
    scene = {"type": "scene", "grey": {"type": "diffuse", "reflectance": reflectance}, **scene}
    for node in scene.values():
        if isinstance(node, dict) and node["type"] in ("rectangle", "cube"):
            node["bsdf"] = {"type": "ref", "id": "grey"}
            node["emitter"] = {"type": "area", "radiance": radiance}
    return scene

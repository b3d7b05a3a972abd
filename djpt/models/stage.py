"""The stage of a model: a scene with a camera that frames it, a sky, and a soft ground."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f
from djpt.errors import SceneError
from djpt.models.atlas import resolve_coordinates
from djpt.models.model import Camera, Matrix, Model, Part

__all__ = ["around", "staged"]

AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "-x": (-1, 0, 0), "-y": (0, -1, 0), "-z": (0, 0, -1)}

WIDTH, HEIGHT = 768, 576
FOV = 35.0
"""The vertical angle of view of the camera that frames a model, in degrees."""
VIEW = (0.55, 0.4, 1.0)
"""From the model to that camera, on the stage: right, up, to the front."""
MARGIN = 1.08
"""How much larger than the model the picture is."""
GROUND = 40.0
"""The radius of the ground over the model's."""
MOST_COPIED = 200_000
"""Parts that stand in several places are copied up to so many triangles in all, else instanced."""


def staged(
    model: Model, *, up: str | None = None, camera: int | None = 0, stage: bool | None = None, cull: bool = False
) -> dict[str, Any]:
    """A scene that shows a model.

    Args:
        model: the model.
        up: the axis that points up, ``x``, ``y``, ``z``, or one of these with a minus; default: the file's.
        camera: the number of the file's camera that is used if it has any; None for one that frames the model.
        stage: whether there is a sky and a ground; default: where the file has no lights, or only distant ones, by
            which metal would be black.
        cull: whether triangles of one-sided materials that face away from the camera are left out, as programs for
            games do: then a room is seen into through its walls, and light falls in.

    Raises:
        SceneError: there is nothing to see; no such camera or axis.
    """
    turn = upright(axis_of(model.up if up is None else up, model.name))
    resolve_coordinates(model)
    low, high = model.bounds()
    center, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)) or 1.0
    has_media = any(part.interior is not None for part in model.parts)
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "volpath" if has_media else "path", "max_depth": 24 if has_media else 12},
    }
    if camera is not None and (isinstance(camera, bool) or not isinstance(camera, int) or camera < 0):
        raise SceneError(f"{model.name}: 'camera' must be the number of a camera, from 0, or None, found {camera!r}")
    if camera is not None and model.cameras:
        if camera >= len(model.cameras):
            raise SceneError(f"{model.name}: there is no camera {camera}; the file has {len(model.cameras)}")
        scene["sensor"] = of_camera(model.cameras[camera], center, radius)
    elif camera:
        raise SceneError(f"{model.name}: there is no camera {camera}; the file has none")
    else:
        scene["sensor"] = framing(low, high, turn)
    scene |= model.nodes
    parts = facing(model.parts, scene["sensor"]) if cull else model.parts
    for number, part in enumerate(parts):
        add_part(scene, part, number)
    scene |= exposed(model, center, radius)
    near = any(light["type"] != "directional" for light in model.lights.values())
    if stage if stage is not None else not near:
        scene |= surroundings(low, high, turn)
    return scene


def around(shape: Mapping[str, Any], *, up: str = "y", stage: bool = True) -> dict[str, Any]:
    """A scene that shows a shape by its description; arguments as of `staged`.

    Raises:
        SceneError: it isn't the description of a shape, or infinite; no such axis.
    """
    from djpt.description.loader import load_dict

    turn = upright(axis_of(up, "scene_of"))
    box = load_dict({"type": "scene", "shape": dict(shape)}).bbox()
    low, high = (np.array(corner, np.float64).ravel() for corner in (box.min, box.max))
    if not np.isfinite([low, high]).all() or (low > high).any():
        raise SceneError(f"scene_of: '{shape.get('type')}' has no box that a camera could frame")
    scene = {"type": "scene", "integrator": {"type": "path", "max_depth": 12}, "sensor": framing(low, high, turn)}
    return scene | {"shape": dict(shape)} | (surroundings(low, high, turn) if stage else {})


# ---- lights ----------------------------------------------------------------------------------

EXPOSED = 3.0
"""The irradiance of a well exposed picture: grey surfaces are half white."""
LATITUDE = 30.0
"""How far from it the irradiance by a file's lights may be, as a factor."""


def exposed(model: Model, center: Matrix, radius: float) -> dict[str, dict[str, Any]]:
    """The lights of the file; scaled alike, with a warning, if pictures by them would be black or white.

    Files give strengths in units of their own, or for a camera with an exposure.
    """
    total = sum(irradiance(light, center, radius) for light in model.lights.values())
    if not 0 < total < math.inf or 1 / LATITUDE <= total / EXPOSED <= LATITUDE:
        return model.lights
    factor = EXPOSED / total
    model.say(f"lights are scaled by {factor:.3g}: pictures by those of the file would be black or white")
    return {name: dimmed(light, factor) for name, light in model.lights.items()}


def irradiance(light: dict[str, Any], center: Matrix, radius: float) -> float:
    """Roughly the irradiance by a light at the centre of the model, facing it, without shadows."""

    def mean(node: Any) -> float:
        return float(np.mean(node["value"]))

    kind = light["type"]
    if kind == "directional":
        return mean(light["irradiance"])
    if kind == "envmap":
        return math.pi * float(light.get("scale", 1.0))
    if kind == "constant":
        return math.pi * mean(light["radiance"])
    place = light["position"] if kind == "point" else np.asarray(light["to_world"].matrix)[:3, 3]
    squared = max(float(np.sum((np.asarray(place) - center) ** 2)), (0.25 * radius) ** 2, 1e-30)
    if "emitter" in light:
        sides = np.linalg.norm(np.asarray(light["to_world"].matrix)[:3, :3], axis=0)
        area = (4.0 if kind == "rectangle" else math.pi) * float(sides[0] * sides[1])
        return mean(light["emitter"]["radiance"]) * area / squared
    return mean(light["intensity"]) / squared


def dimmed(light: dict[str, Any], factor: float) -> dict[str, Any]:
    """A light `factor` times as strong."""
    if "emitter" in light:
        return {**light, "emitter": dimmed(light["emitter"], factor)}
    if light["type"] == "envmap":
        return {**light, "scale": factor * float(light.get("scale", 1.0))}
    key = next(key for key in ("irradiance", "intensity", "radiance") if key in light)
    return {**light, key: {**light[key], "value": [factor * x for x in light[key]["value"]]}}


def axis_of(up: Any, name: str) -> Matrix:
    """The axis that points up by its name, (3,)."""
    if up not in AXES:
        raise SceneError(f"{name}: 'up' must be one of {', '.join(AXES)}, found {up!r}")
    return np.array(AXES[up], np.float64)


def upright(up: Matrix) -> Matrix:
    """The rotation from the stage, where +y is up and +z to the front, to a space with another axis up, (3, 3)."""
    if up[1]:
        return np.diag([1.0, up[1], up[1]])
    if up[2]:  # as in CAD: the front looks along -y
        return np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]) * np.array([[1.0], [up[2]], [up[2]]])
    return np.array([[0, up[0], 0], [-up[0], 0, 0], [0, 0, 1.0]])


def facing(parts: list[Part], sensor: dict[str, Any]) -> list[Part]:
    """The parts without the triangles of one-sided materials that face away from a camera."""
    camera = np.asarray(sensor["to_world"].matrix)
    kept = []
    for part in parts:
        if not part.one_sided:
            kept.append(part)
            continue
        for place in part.places:
            corners = (part.mesh.positions.astype(np.float64) @ place[:3, :3].T + place[:3, 3])[part.mesh.indices]
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            away = -camera[:3, 2] if sensor["type"] == "orthographic" else camera[:3, 3] - corners[:, 0]
            # A mirrored mesh has its corners the other way round.
            front = (normal * away).sum(axis=1) * np.linalg.det(place[:3, :3]) > 0
            if front.any():
                mesh = replace(part.mesh, indices=np.ascontiguousarray(part.mesh.indices[front]))
                mesh.attributes = {
                    name: values[front] if name.startswith("face_") else values
                    for name, values in part.mesh.attributes.items()
                }
                kept.append(replace(part, mesh=mesh, places=[place]))
    return kept


def add_part(scene: dict[str, Any], part: Part, number: int) -> None:
    """Add the shapes of a part: one for each place, or instances of a group."""
    node: dict[str, Any] = {"type": "ply", "data": part.mesh, "bsdf": {"type": "ref", "id": part.bsdf}}
    if part.mesh.normals is None:
        node["face_normals"] = True
    if part.interior is not None:
        node["interior"] = {"type": "ref", "id": part.interior}
    if part.emission is not None:
        node["emitter"] = {"type": "area", "radiance": part.emission}
    key = f"part_{number}"
    copied = len(part.places) * len(part.mesh.indices) <= MOST_COPIED or part.emission is not None
    if len(part.places) == 1 or copied:
        for i, place in enumerate(part.places):
            scene[key if not i else f"{key}_{i}"] = {**node, "to_world": ScalarTransform4f(place)}
        return
    scene[f"group_{number}"] = {"type": "shapegroup", "shape": node}
    for i, place in enumerate(part.places):
        group = {"type": "ref", "id": f"group_{number}"}
        scene[f"{key}_{i}"] = {"type": "instance", "group": group, "to_world": ScalarTransform4f(place)}


# ---- cameras ---------------------------------------------------------------------------------


def film() -> dict[str, Any]:
    """The film of all cameras."""
    return {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "pixel_format": "rgb"}


def of_camera(camera: Camera, center: Matrix, radius: float) -> dict[str, Any]:
    """A camera of the file."""
    matrix = np.array(camera.to_model, np.float64)
    axes = matrix[:3, :3] / np.maximum(np.linalg.norm(matrix[:3, :3], axis=0), 1e-30)
    if not np.isfinite(matrix).all() or abs(np.linalg.det(axes)) < 1e-6:
        raise SceneError(f"the camera '{camera.name}' has no place: {matrix.tolist()}")
    matrix[:3, :3] = axes * (-1.0, 1.0, -1.0)  # it looks along +z here
    distance = float(np.linalg.norm(matrix[:3, 3] - center))
    sensor = {
        "near_clip": 1e-4 * radius,
        "far_clip": 10 * (distance + GROUND * radius),
        "film": film(),
        "sampler": {"type": "independent", "sample_count": 64},
    }
    if camera.fov is not None:
        angles = {"fov": min(max(camera.fov, 0.1), 175.0), "fov_axis": "y"}
        return {"type": "perspective", "to_world": ScalarTransform4f(matrix), **angles, **sensor}
    # Mitsuba's orthographic camera sees from -1 to 1 across.
    half = 0.5 * camera.height * WIDTH / HEIGHT
    matrix[:3, :3] = matrix[:3, :3] @ np.diag([half, half, 1.0])
    return {"type": "orthographic", "to_world": ScalarTransform4f(matrix), **sensor}


def framing(low: Matrix, high: Matrix, turn: Matrix) -> dict[str, Any]:
    """A camera from the front, the right and above, as near as the whole box fits in."""
    away = turn @ (np.array(VIEW) / np.linalg.norm(VIEW))
    up = turn[:, 1]
    right = np.cross(up, away)
    right /= np.linalg.norm(right)
    above = np.cross(away, right)
    center = 0.5 * (low + high)
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    corners -= center
    slope = math.tan(math.radians(0.5 * FOV)) / MARGIN
    radius = 0.5 * float(np.linalg.norm(high - low)) or 1.0
    # A corner is in the picture if it is as far before the camera as it is aside, over the slope.
    needed = [
        np.abs(corners @ right) / (slope * WIDTH / HEIGHT) + corners @ away,
        np.abs(corners @ above) / slope + corners @ away,
    ]
    distance = max(float(np.max(needed)), 1.05 * radius)
    origin = center + distance * away
    return {
        "type": "perspective",
        "to_world": ScalarTransform4f().look_at(origin.tolist(), center.tolist(), up.tolist()),
        "fov": FOV,
        "fov_axis": "y",
        "near_clip": 1e-3 * radius,
        "far_clip": 1e2 * (distance + radius),
        "film": film(),
        "sampler": {"type": "independent", "sample_count": 64},
    }


# ---- surroundings ----------------------------------------------------------------------------


def surroundings(low: Matrix, high: Matrix, turn: Matrix) -> dict[str, Any]:
    """A sky with soft lights in it, and a ground below the box."""
    center, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)) or 1.0
    up = turn[:, 1]
    lowest = float(np.minimum(low * up, high * up).sum())
    foot = center + (lowest - 1e-3 * radius - center @ up) * up
    matrix, sky = np.eye(4), np.eye(4)
    matrix[:3, :3] = GROUND * radius * np.stack([turn[:, 0], -turn[:, 2], up], axis=1)
    matrix[:3, 3] = foot
    sky[:3, :3] = turn
    grey = {"type": "rgb", "value": [0.45, 0.45, 0.45]}
    return {
        "sky": {"type": "envmap", "bitmap": studio(), "to_world": ScalarTransform4f(sky)},
        "ground": {
            "type": "disk",
            "to_world": ScalarTransform4f(matrix),
            "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": grey}},
        },
    }


def studio() -> NDArray[np.float32]:
    """The radiance of the sky by direction, (32, 64, 3): brighter upwards, with a large soft light and a small one."""
    rows, columns = 32, 64
    theta = (np.arange(rows) + 0.5) / rows * np.pi
    phi = (np.arange(columns) + 0.5) / columns * 2 * np.pi
    # Mitsuba's directions of a latitude-longitude map, with +y up.
    x = np.sin(phi)[None, :] * np.sin(theta)[:, None]
    y = np.cos(theta)[:, None] + 0 * phi[None, :]
    z = -np.cos(phi)[None, :] * np.sin(theta)[:, None]
    value = 0.42 + 0.3 * np.clip(y, -0.2, 1)
    for direction, sharpness, strength in (((-0.6, 0.7, 0.5), 14, 3.5), ((0.9, 0.35, 0.2), 24, 1.5)):
        unit = np.array(direction) / np.linalg.norm(direction)
        value = value + strength * np.exp(sharpness * (x * unit[0] + y * unit[1] + z * unit[2] - 1))
    tint = np.array([0.98, 1.0, 1.03])
    return np.asarray(value[..., None] * tint, np.float32)

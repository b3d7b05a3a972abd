"""Cameras whose place or lens has gradients: views of them whose rays are attached."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from typing import Any

import drjit as dr

from djpt.core.transforms.host import ScalarTransform4f
from djpt.core.transforms.lanes import Transform4f
from djpt.jit.types import Float, Matrix4f, Point2f, Point3f, Vector3f
from djpt.shapes.silhouettes.base import with_gradient
from djpt.shapes.silhouettes.moving import AttachedTransform, exchanged_value

__all__ = [
    "attached_transform",
    "attached_values",
    "attached_view",
    "central_rays",
    "dual",
    "has_motion",
    "lens_rays",
    "parallel_rays",
    "pinhole",
    "shifting",
    "still",
    "turning",
]

MATRIX, FOCUS, ORIGIN = "attached_matrix", "_focus_distance", "origin"


def attached_transform(value: Any) -> AttachedTransform:
    """A transform with gradients as a camera keeps it."""
    return AttachedTransform(Transform4f(value))


def attached_values(camera: Any) -> dict[str, Any]:
    """The values that place a camera and have gradients: of its `motions`, those in their place if there are any."""
    values = {}
    with dr.resume_grad():
        for name in camera.motions:
            value = exchanged_value(camera.stands_for or camera, name)
            value = getattr(camera, name) if value is None else value
            if value is not None and dr.grad_enabled(value):
                values[name] = value
    return values


def attached_view(camera: Any) -> Any:
    """A view of a camera whose rays are attached to what places it; the camera itself if nothing has gradients."""
    values = attached_values(camera)
    if not values:
        return camera
    view = copy.copy(camera)
    view.is_attached = True
    with dr.resume_grad():
        for name, value in camera.moved_rays(values).items():
            if name not in camera.fixed:
                setattr(view, name, with_gradient(getattr(camera, name), value))
    return view


def still(camera: Any) -> Any:
    """A copy of a camera, or of a group of cameras, that stays where it is; itself if nothing has gradients."""
    if not camera.attached_names():
        return camera
    view = copy.copy(camera)
    if camera.delegates():
        view.sensors = [still(other) for other in camera.delegates()]
        view.forget()
        return view
    for name in camera.attached_names():
        if name == MATRIX:
            view.to_world = ScalarTransform4f(camera.to_world.matrix)
        else:
            setattr(view, name, dr.detach(getattr(camera, name)))
    return view


def turning(camera: Any) -> Any:
    """A view of a pinhole camera, or of a batch of them, whose centre stays: only the directions of rays move."""
    return holding(camera, lambda values: values & {ORIGIN})


def shifting(camera: Any) -> Any:
    """A view of a pinhole camera, or of a batch of them, of which only the centre moves, and no ray turns."""
    return holding(camera, lambda values: values - {ORIGIN})


def holding(camera: Any, fixed: Callable[[frozenset[str]], frozenset[str]]) -> Any:
    """A view of a camera, or of those of a batch, with some of their `values` held where they are."""
    view = copy.copy(camera)
    if camera.delegates():
        view.sensors = [holding(other, fixed) for other in camera.delegates()]
        view.forget()
    else:
        view.fixed, view.stands_for = fixed(frozenset(camera.values)), camera
    return view


def has_motion(camera: Any, forward: bool) -> bool:
    """Whether rays of a pinhole camera, or of those of a batch, have gradients; in forward mode, any that aren't 0."""
    with dr.resume_grad():
        views = camera.attached().members()
        found = [value for view in views for value in (getattr(view, name) for name in view.values)]
        found = [value for value in found if dr.grad_enabled(value)]
        if not (forward and found):
            return bool(found)
        dr.forward_to(found, flags=dr.ADFlag.ClearInterior)
        return any(dr.any(dr.grad(value) != 0, axis=None) for value in found)


def columns(camera: Any, values: Mapping[str, Any]) -> tuple[Vector3f, Vector3f, Vector3f, Point3f]:
    """The axes of a camera and its position, attached."""
    matrix = values.get(MATRIX)
    if matrix is None:
        matrix = Matrix4f(camera.to_world.matrix.tolist())
    x, y, z, origin = (Vector3f(matrix[0, k], matrix[1, k], matrix[2, k]) for k in range(4))
    return x, y, z, origin


def dual(a: Vector3f, b: Vector3f, c: Vector3f) -> tuple[Vector3f, Vector3f, Vector3f]:
    """The vectors whose products with a, b and c are 1 and otherwise 0: the rows of the inverse of their matrix."""
    bc = dr.cross(b, c)
    inverse = dr.rcp(dr.dot(a, bc))
    return bc * inverse, dr.cross(c, a) * inverse, dr.cross(a, b) * inverse


def central_rays(camera: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    """What `djpt.sensors.projective.Central` computes its rays from, attached.

    The corner of the film is at cx x + cy y + z, its sides are sx x and sy y, with the width growing like the tangent
    of half of the field of view, and all of it shifted with the principal point.
    """
    x, y, z, origin = columns(camera, values)
    tangent = math.tan(math.radians(float(dr.detach(camera.x_fov)[0])) / 2)
    corner, step = camera.crop_window(1.0, camera.image_shift())
    half = dr.tan(values["x_fov"] * (math.pi / 360)) if "x_fov" in values else Float(tangent)
    width, height = camera.film().size()
    shift = (values.get(name) for name in ("principal_point_offset_x", "principal_point_offset_y"))
    # The derivative by a shift is that of the corner: -2 times the reach of the film along the axis.
    moved = [
        0 if s is None else (s - dr.detach(s)) * (-2 * reach)
        for s, reach in zip(shift, (1.0, height / width), strict=True)
    ]
    cx, cy, sx, sy = (float(v) * half for v in (*corner, *step))
    cx, cy = cx + moved[0] * half, cy + moved[1] * half
    to_x, to_y, to_z = dual(x, y, z)
    corner, across, down = cx * x + cy * y + z, sx * x, sy * y
    return {
        "origin": origin,
        "corner": corner,
        "across": across,
        "down": down,
        "axis": to_z,
        "to_column": to_x / sx,
        "to_row": to_y / sy,
        "inv_area": dr.rcp(dr.abs(dr.dot(dr.cross(across, down), corner))),
    }


def lens_rays(camera: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    """What `djpt.sensors.thinlens.ThinLens` computes its rays from, attached."""
    x, y, _, _ = columns(camera, values)
    radius, focus = (values.get(name, dr.detach(getattr(camera, name))) for name in ("aperture_radius", FOCUS))
    return {**central_rays(camera, values), "lens_x": x * radius, "lens_y": y * radius, "inv_focus": dr.rcp(focus)}


def pinhole(camera: Any, aperture_sample: Point2f) -> Any:
    """A camera with a lens as seen through one point of it: the rays through that point, with the same film."""
    view = copy.copy(camera)
    with dr.resume_grad():
        lens = camera.lens_point(dr.detach(aperture_sample))
        view.origin, view.corner = camera.origin + lens, camera.bent(camera.corner, lens)
    view.lens_x, view.lens_y, view.uses_aperture = Vector3f(0), Vector3f(0), False
    return view


def parallel_rays(camera: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    """What `djpt.sensors.orthographic.Orthographic` computes its rays from, attached."""
    x, y, z, origin = columns(camera, values)
    corner, step = (tuple(float(v) for v in pair) for pair in camera.crop_window(1.0))
    across, down, direction = x * step[0], y * step[1], dr.normalize(z)
    to_column, to_row, _ = dual(across, down, direction)
    return {
        "corner": origin + x * corner[0] + y * corner[1] + z * camera.near_clip(),
        "across": across,
        "down": down,
        "direction": direction,
        "to_column": to_column,
        "to_row": to_row,
        "inv_area": dr.rcp(dr.abs(dr.dot(dr.cross(across, down), direction))),
    }

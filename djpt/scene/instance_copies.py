"""Scenes whose instances are replaced by copies of what they place, as derivatives need them."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from djpt.core.transforms import ScalarTransform4f
from djpt.errors import RenderError
from djpt.jit.frozen import recording
from djpt.jit.types import Array4f, Matrix4f, Point3f
from djpt.shapes.instance import Instance
from djpt.shapes.shapegroup import ShapeGroup
from djpt.shapes.silhouettes.moving import AttachedTransform

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["with_copies"]


def with_copies(scene: Scene) -> Scene:
    """The scene with a copy of each shape of a group in the place of each of its instances; itself if it has none.

    Each copy has silhouettes of its own, and moves as its instance does.

    Raises:
        RenderError: a frozen function is being recorded, within which no scene can be made.
    """
    if not any(isinstance(shape, Instance) for shape in scene.shapes()):
        return scene
    if recording():
        raise RenderError("within dr.freeze, scenes with instances have no derivatives by motion: use meshes")
    view = copy.copy(scene)
    view._shapes = [part for shape in scene.shapes() for part in parts(shape)]
    view._compile()
    return view


def parts(shape: Any) -> Iterator[Any]:
    """What stands in the place of a shape of the scene."""
    if isinstance(shape, Instance):
        for nested in shape.group.shapes:
            copied = {"vertex_positions": copied_mesh, "control_points": copied_curves}
            yield copied.get(nested.points_parameter, copied_solid)(shape, nested)
    elif not isinstance(shape, ShapeGroup):
        yield shape


def copied_mesh(instance: Instance, mesh: Any) -> Any:
    """A copy of a mesh where an instance puts it, attached to its transform if that has gradients."""
    data = mesh.data()
    own = Point3f(data.positions.T)
    data.transform(instance.to_world)
    copied = of_instance(instance, mesh)
    copied.leave(data.positions)
    copied.normals = data.normals
    copied._forget()
    matrix = instance.attached_matrix
    if matrix is not None:
        with dr.resume_grad():
            copied.vertex_positions = dr.ravel(mapped(matrix, own))
    return copied


def copied_curves(instance: Instance, curves: Any) -> Any:
    """The same of curves, whose radii grow like the root of the volume."""
    copied = copied_solid(instance, curves)
    copied.points, copied.to_world = copied.placed_points().astype(np.float32), ScalarTransform4f()
    copied.tabulate()
    matrix = instance.attached_matrix
    if matrix is not None:
        own = Array4f(curves.points.T)
        with dr.resume_grad():
            p, stretch = mapped(matrix, Point3f(own.x, own.y, own.z)), dr.cbrt(dr.abs(dr.det(matrix)))
            copied.control_points = dr.ravel(Array4f(p.x, p.y, p.z, own.w * stretch))
    return copied


def mapped(matrix: Matrix4f, p: Point3f) -> Point3f:
    """Points under an affine map."""
    x, y, z, origin = (Point3f(matrix[0, k], matrix[1, k], matrix[2, k]) for k in range(4))
    return x * p.x + y * p.y + z * p.z + origin


def copied_solid(instance: Instance, solid: Any) -> Any:
    """The same of another shape."""
    copied = of_instance(instance, solid)
    copied.leave()
    copied.to_world = solid.check_parameter("to_world", instance.to_world @ solid.to_world)
    lanes = getattr(instance.to_world, "lanes", None)
    if lanes is not None:
        with dr.resume_grad():
            copied.to_world = AttachedTransform(lanes @ type(lanes)(solid.to_world.matrix))
    return copied


def of_instance(instance: Instance, shape: Any) -> Any:
    """A copy of a shape that doesn't belong to a group, named after its instance."""
    copied = copy.copy(shape)
    copied.in_group = False
    copied.set_id(f"{instance.id()}.{shape.id()}")
    return copied

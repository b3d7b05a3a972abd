"""Where outlines are on the film, and how they move there."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.records import Interaction3f
from djpt.description.registry import name_of
from djpt.errors import RenderError
from djpt.jit.types import Float, Point2f, Point3f, Vector3f
from djpt.sensors.mapped import MappedCamera
from djpt.sensors.orthographic import Orthographic
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["FAR", "film_vectors", "place_on_film", "swept_area", "viewpoint_of", "way_ahead"]

FAR = 1e4
"""The distance from which outlines are seen by parallel rays, in radii of the scene."""


def viewpoint_of(scene: Any, sensor: Any) -> Point3f:
    """The point that a sensor sees outlines from, or one close by; of one with parallel rays a point far away.

    It is attached to the sensor.

    Raises:
        RenderError: the sensor is no camera with a place, nor one with parallel rays.
    """
    if sensor.is_central or isinstance(sensor, MappedCamera):
        return Point3f(sensor.origin)
    if not isinstance(sensor, Orthographic):
        raise RenderError(
            "silhouettes are supported for cameras whose rays meet in one point or are parallel only, found "
            f"'{sensor.id()}' ({name_of(type(sensor))})"
        )
    center, radius = scene.bounding_sphere()
    return Point3f(*(float(c) for c in center)) - sensor.direction * (FAR * float(radius))


def way_ahead(sensor: Any, d: Vector3f) -> Vector3f:
    """The way from the centre of a camera to points in directions `d` that it sees, detached.

    They are half-way between the near and the far plane on a logarithmic scale: closer points would be rounded.
    """
    depth = dr.sqrt(sensor.near * (sensor.near + sensor.depth))
    return Vector3f(dr.detach(d * (depth / dr.dot(d, sensor.axis))))


def place_on_film(sensor: Any, p: Point3f) -> Point2f:
    """Where a sensor sees points, on a film that is a unit square."""
    it = dr.zeros(Interaction3f)
    it.p = p
    return Point2f(sensor.sample_direction(it, Point2f(0))[0].uv / Point2f(sensor.film().crop_size()))


def film_vectors(sensor: Any, ss: SilhouetteSample3f) -> tuple[Point2f, Point2f]:
    """How far points move on the film, a unit square, along `silhouette_d` and along `n`."""
    with dr.resume_grad():
        steps = [Float(0), Float(0)]
        dr.enable_grad(steps)
        places = []
        for step, direction in zip(steps, (ss.silhouette_d, ss.n), strict=True):
            places.append(place_on_film(sensor, dr.fma(dr.detach(direction), step, dr.detach(ss.p))))
            dr.set_grad(step, 1)
            dr.enqueue(dr.ADMode.Forward, step)
        dr.traverse(dr.ADMode.Forward)
        return dr.grad(places[0]), dr.grad(places[1])


def swept_area(sensor: Any, ss: SilhouetteSample3f, change: Point2f) -> Float:
    """The area that a unit of length of outlines sweeps on the film, a unit square, as they move by `change` there."""
    tangent, outward = film_vectors(sensor, ss)
    side = dr.mulsign(Float(1), tangent.x * outward.y - tangent.y * outward.x)
    return Float((tangent.x * change.y - tangent.y * change.x) * side)

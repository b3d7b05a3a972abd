"""Shapes: a file and a line of registration for each."""

from djpt.description.registry import register_shape
from djpt.shapes.base import Face, Hit, Shape
from djpt.shapes.cone import Cone
from djpt.shapes.cube import Cube
from djpt.shapes.cuboid import Cuboid
from djpt.shapes.cylinder import Cylinder
from djpt.shapes.disk import Disk
from djpt.shapes.implicit import Implicit, Metaballs, Torus
from djpt.shapes.instance import Instance
from djpt.shapes.mesh import Mesh
from djpt.shapes.obj import Obj
from djpt.shapes.plane import Plane
from djpt.shapes.ply import Ply
from djpt.shapes.rectangle import Rectangle
from djpt.shapes.sdfgrid import SDFGrid
from djpt.shapes.serialized import Serialized
from djpt.shapes.shapegroup import ShapeGroup
from djpt.shapes.sphere import Sphere

__all__ = [
    "Cone",
    "Cube",
    "Cuboid",
    "Cylinder",
    "Disk",
    "Face",
    "Hit",
    "Implicit",
    "Instance",
    "Mesh",
    "Metaballs",
    "Obj",
    "Plane",
    "Ply",
    "Rectangle",
    "SDFGrid",
    "Serialized",
    "Shape",
    "ShapeGroup",
    "Sphere",
    "Torus",
]

register_shape("rectangle", Rectangle)
register_shape("cube", Cube)
register_shape("sphere", Sphere)
register_shape("disk", Disk)
register_shape("cylinder", Cylinder)
register_shape("cone", Cone)
register_shape("plane", Plane)
register_shape("cuboid", Cuboid)
register_shape("implicit", Implicit)
register_shape("torus", Torus)
register_shape("metaballs", Metaballs)
register_shape("sdfgrid", SDFGrid)
register_shape("obj", Obj)
register_shape("ply", Ply)
register_shape("serialized", Serialized)
register_shape("shapegroup", ShapeGroup)
register_shape("instance", Instance)

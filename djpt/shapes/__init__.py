"""Shapes, one per file. The file registers its shape; one line here says where it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if TYPE_CHECKING:
    from djpt.shapes.base import Face as Face
    from djpt.shapes.base import Hit as Hit
    from djpt.shapes.base import Shape as Shape
    from djpt.shapes.bsplinecurve import BSplineCurve as BSplineCurve
    from djpt.shapes.cone import Cone as Cone
    from djpt.shapes.cube import Cube as Cube
    from djpt.shapes.cuboid import Cuboid as Cuboid
    from djpt.shapes.curve import Curves as Curves
    from djpt.shapes.cylinder import Cylinder as Cylinder
    from djpt.shapes.deforming import Deforming as Deforming
    from djpt.shapes.disk import Disk as Disk
    from djpt.shapes.ellipsoids import Ellipsoids as Ellipsoids
    from djpt.shapes.ellipsoidsmesh import EllipsoidsMesh as EllipsoidsMesh
    from djpt.shapes.implicit import Implicit as Implicit
    from djpt.shapes.implicit import Metaballs as Metaballs
    from djpt.shapes.instance import Instance as Instance
    from djpt.shapes.linearcurve import LinearCurve as LinearCurve
    from djpt.shapes.merge import Merge as Merge
    from djpt.shapes.mesh import Mesh as Mesh
    from djpt.shapes.obj import Obj as Obj
    from djpt.shapes.paraboloid import Paraboloid as Paraboloid
    from djpt.shapes.plane import Plane as Plane
    from djpt.shapes.ply import Ply as Ply
    from djpt.shapes.rectangle import Rectangle as Rectangle
    from djpt.shapes.sdfgrid import SDFGrid as SDFGrid
    from djpt.shapes.serialized import Serialized as Serialized
    from djpt.shapes.shapegroup import ShapeGroup as ShapeGroup
    from djpt.shapes.sphere import Sphere as Sphere
    from djpt.shapes.torus import Torus as Torus
else:
    __getattr__, __dir__, __all__ = lazily(__name__)

"""The kinds of shapes."""

from __future__ import annotations

import enum

__all__ = ["ShapeType"]


class ShapeType(enum.IntFlag):
    """The kinds of shapes; the values are Mitsuba's. djpt's own shapes are `Other`."""

    Invalid = 0
    Mesh = 1
    Rectangle = 3
    BSplineCurve = 4
    LinearCurve = 8
    Cylinder = 16
    Disk = 32
    SDFGrid = 64
    Sphere = 128
    Ellipsoids = 256
    EllipsoidsMesh = 513
    Other = 1024

"""Areas and vertex normals of triangles as functions in LLVM's language.

NumPy does the same in `djpt.shapes.meshes.normals`, with the same roundings. Positions have single precision, all else
has double, unless noted. Functions work on the triangles from `first` up to `end`.
"""

from __future__ import annotations

from collections.abc import Sequence

from djpt.jit.llvm.arithmetic import sqrt
from djpt.jit.llvm.ir import F32, F64, I32, I64, PTR, Function, Module, Value

__all__ = ["PARAMETERS", "add_normal_functions"]

PARAMETERS = {"areas": 5, "corner_cosines": 6, "add_normals": 6, "unit_normals": 3}
"""The functions, and how many parameters each has."""

Vector = Sequence[Value]


def add_normal_functions(module: Module) -> None:
    """Add the functions to a module."""
    add_areas(module)
    add_corner_cosines(module)
    add_add_normals(module)
    add_unit_normals(module)


def add_areas(module: Module) -> None:
    """Compute the areas of triangles."""
    names = [("positions", PTR), ("indices", PTR), ("areas", PTR), ("first", I64), ("end", I64)]
    with module.function("areas", names, I64) as f:
        positions, indices, areas, first, end = f.parameters
        with f.each(first, end) as face:
            p0, p1, p2 = corners(f, positions, indices, face)
            f.store(length(cross(minus(p1, p0), minus(p2, p0))) * 0.5, areas.at(face * 8))
        f.give(1)


def add_corner_cosines(module: Module) -> None:
    """Compute the unit normals of triangles, (N, 3), and the cosines of their angles, a row for each corner: (3, N)."""
    names = [*((name, PTR) for name in ("positions", "indices", "normals", "cosines")), ("first", I64), ("end", I64)]
    with module.function("corner_cosines", names, I64) as f:
        positions, indices, normals, cosines, first, end = f.parameters
        with f.each(first, end) as face:
            p = corners(f, positions, indices, face)
            number = face - first
            write(f, normals.at(number * 24), unit(f, cross(minus(p[1], p[0]), minus(p[2], p[0]))))
            edges = [unit(f, minus(p[(k + 1) % 3], p[k])) for k in range(3)]
            for k in range(3):
                cos = -dot(edges[k], edges[(k + 2) % 3])
                f.store(cos, cosines.at(((end - first) * k + number) * 8))
        f.give(1)


def add_add_normals(module: Module) -> None:
    """Add the normals of triangles, times their angles, to the `totals` of their vertices: first corners first."""
    names = [*((name, PTR) for name in ("indices", "normals", "angles", "totals")), ("first", I64), ("end", I64)]
    with module.function("add_normals", names, I64) as f:
        indices, normals, angles, totals, first, end = f.parameters
        count = end - first
        with f.each(0, 3) as corner, f.each(0, count) as face:
            vertex = f.load(I32, indices.at((first + face) * 12 + corner * 4)).to(I64)
            angle, total = f.load(F64, angles.at((count * corner + face) * 8)), totals.at(vertex * 24)
            sums = [f.load(F64, total.at(8 * k)) + f.load(F64, normals.at(face * 24 + 8 * k)) * angle for k in range(3)]
            write(f, total, sums)
        f.give(1)


def add_unit_normals(module: Module) -> None:
    """Scale vectors to length 1, in single precision; zero stays."""
    with module.function("unit_normals", [("totals", PTR), ("normals", PTR), ("count", I64)], I64) as f:
        totals, normals, count = f.parameters
        with f.each(0, count) as vertex:
            v = unit(f, [f.load(F64, totals.at(vertex * 24 + 8 * k)) for k in range(3)])
            for k, component in enumerate(v):
                f.store(component.to(F32), normals.at(vertex * 12 + 4 * k))
        f.give(1)


# ---- vectors -------------------------------------------------------------------------------------------------


def corners(f: Function, positions: Value, indices: Value, face: Value) -> list[Vector]:
    """The corners of a triangle."""
    vertices = [f.load(I32, indices.at(face * 12 + 4 * k)).to(I64) for k in range(3)]
    return [[f.load(F32, positions.at(vertex * 12 + 4 * k)).to(F64) for k in range(3)] for vertex in vertices]


def minus(a: Vector, b: Vector) -> Vector:
    """The difference."""
    return [x - y for x, y in zip(a, b, strict=True)]


def cross(a: Vector, b: Vector) -> Vector:
    """The cross product."""
    return [a[i] * b[j] - a[j] * b[i] for i, j in ((1, 2), (2, 0), (0, 1))]


def dot(a: Vector, b: Vector) -> Value:
    """The scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def length(v: Vector) -> Value:
    """The length."""
    return sqrt(dot(v, v))


def unit(f: Function, v: Vector) -> Vector:
    """The vector with length 1; zero stays."""
    size, result = length(v), [f.variable(F64, 0.0) for _ in range(3)]
    with f.when(size > 0.0):
        for variable, component in zip(result, v, strict=True):
            variable.value = component / size
    return [variable.value for variable in result]


def write(f: Function, target: Value, vector: Vector) -> None:
    """Write a vector."""
    for k, component in enumerate(vector):
        f.store(component, target.at(8 * k))

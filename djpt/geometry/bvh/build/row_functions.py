"""The corners and the records of triangles, as functions in LLVM's language.

Triangles are worked through in the order of their faces, `CHILDREN` at a time, mesh by mesh: the functions get a
table of parts, each some faces of one mesh (see `PART_BYTES`). A record goes to its triangle's place among the
leaves. The formulas are those of `djpt.geometry.bvh.leaves`, with the same roundings.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from djpt.geometry.bvh.build.build_functions import BOX, CORNERS_SIZE
from djpt.geometry.bvh.calls.layout import CHILDREN, ROW_BYTES
from djpt.jit.llvm.arithmetic import copysign, gather, minimum, select, sqrt
from djpt.jit.llvm.ir import F32, F64, I1, I32, I64, PTR, Function, Module, Type, Value, vector

__all__ = ["PART_BYTES", "add_row_functions"]

Vector = Sequence[Value]

WORDS, LONGS, PAIRS, MASK = vector(I32, CHILDREN), vector(I64, CHILDREN), vector(F64, CHILDREN), vector(I1, CHILDREN)

PART_BYTES = 56
"""Bytes of a part, seven words of 64 bits.

====  ====================================================================
word  contents
====  ====================================================================
0, 1  the first face, and the end; counted through all meshes
2     address of the first face's three indices
3     address of the mesh's positions
4     address of its texture coordinates, 0 if it has none
5     1 or, to turn normals around, -1: the bits of a float
6     the label of its triangles
====  ====================================================================
"""

FIRST, END, INDICES, POSITIONS, TEXCOORDS, SIDE, LABEL = range(0, PART_BYTES, 8)


def add_row_functions(module: Module) -> None:
    """Add `take_corners`, `invert` and `write_rows` to a module."""
    add_take_corners(module)
    add_invert(module)
    add_write_rows(module)


@contextmanager
def each_part(f: Function, parts: Value, first: Value, end: Value) -> Iterator[tuple[Value, Value, Value]]:
    """Run what is built inside for some parts: the address in the table, the first face and the end."""
    with f.each(first, end) as i:
        part = parts.at(i * PART_BYTES)
        yield part, f.load(I64, part.at(FIRST)), f.load(I64, part.at(END))


# ---- corners --------------------------------------------------------------------------------------------


def add_take_corners(module: Module) -> None:
    """Write the corners of all triangles of some parts."""
    with module.function("take_corners", [("parts", PTR), ("first", I64), ("end", I64), ("corners", PTR)]) as f:
        parts, first, end, corners = f.parameters
        with each_part(f, parts, first, end) as (part, first_face, end_face):
            indices, positions = f.load(PTR, part.at(INDICES)), f.load(PTR, part.at(POSITIONS))
            target = corners.at(first_face * CORNERS_SIZE)
            with f.each(0, (end_face - first_face) * 3) as k:
                source = positions.at(f.load(I32, indices.at(k * 4)).to(I64) * 12)
                # Two moves; the type doesn't matter.
                f.store(f.load(I64, source, 4), target.at(k * 12), 4)
                f.store(f.load(I32, source.at(8)), target.at(k * 12 + 8))


# ---- records --------------------------------------------------------------------------------------------


def add_invert(module: Module) -> None:
    """For some numbers in a permutation, write where they stand."""
    with module.function("invert", [("order", PTR), ("first", I64), ("end", I64), ("place", PTR)]) as f:
        order, first, end, place = f.parameters
        with f.each(first, end) as i:
            f.store(i.to(I32), place.at(f.load(I32, order.at(i * 4)).to(I64) * 4))


def add_write_rows(module: Module) -> None:
    """Write the records of all triangles of some parts; `first_face` is added to the numbers of faces."""
    parameters = [
        ("parts", PTR),
        ("first", I64),
        ("end", I64),
        ("corners", PTR),
        ("place", PTR),
        ("rows", PTR),
        ("first_face", I64),
    ]
    with module.function("write_rows", parameters) as f:
        parts, first, end, corners, place, rows, offset = f.parameters
        with each_part(f, parts, first, end) as (part, first_face, end_face):
            label, side = f.load(I32, part.at(LABEL)).spread(CHILDREN), f.load(F32, part.at(SIDE))
            with f.each(0, (end_face - first_face + (CHILDREN - 1)) // CHILDREN) as group:
                start = first_face + group * CHILDREN
                # A last group that isn't full is filled up with copies of the last triangle.
                faces = [minimum(start + lane, end_face - 1) for lane in range(CHILDREN)]
                edge1, edge2 = edges(f, corners, faces)
                normal = [x * side for x in unit(cross(edge1, edge2))]
                direction = direction_of(f, part, first_face, faces, normal, (edge1, edge2))
                numbers = assembled(f, WORDS, [(face + offset).to(I32) for face in faces])
                unused = f.constant(BOX, 0.0)
                columns = [unused, *normal, label.bits_as(BOX), numbers.bits_as(BOX), *direction]
                for face, row in zip(faces, transposed(columns), strict=True):
                    to = f.load(I32, place.at(face * 4)).to(I64)
                    f.store(row, rows.at(to * ROW_BYTES))


def edges(f: Function, corners: Value, faces: Vector) -> tuple[Vector, Vector]:
    """The edges from the first corner to the others."""
    sources = [corners.at(face * CORNERS_SIZE) for face in faces]
    words = transposed([f.load(BOX, source) for source in sources])
    words.append(assembled(f, BOX, [f.load(F32, source.at(CORNERS_SIZE - 4)) for source in sources]))
    p0, p1, p2 = words[:3], words[3:6], words[6:]
    return [b - a for a, b in zip(p0, p1, strict=True)], [b - a for a, b in zip(p0, p2, strict=True)]


def direction_of(
    f: Function, part: Value, first_face: Value, faces: Vector, normal: Vector, edges: tuple[Vector, Vector]
) -> Vector:
    """The direction of dp/du: cosines with the two tangents; (1, 0) where it has none."""
    s, t = tangents(normal)
    dp_du = [f.variable(BOX, x) for x in edges[0]]
    texcoords = f.load(PTR, part.at(TEXCOORDS))
    with f.when(f.load(I64, part.at(TEXCOORDS)) != 0):
        indices = f.load(PTR, part.at(INDICES))
        sources = assembled(f, LONGS, [(face - first_face) * 12 for face in faces])
        (u0, v0), (u1, v1), (u2, v2) = (corner_texcoords(f, indices.at(sources + 4 * k), texcoords) for k in range(3))
        du1, dv1, du2, dv2 = u1 - u0, v1 - v0, u2 - u0, v2 - v0
        determinant = du1 * dv2 - dv1 * du2
        # NaN stays what it is.
        sign = select(determinant == determinant, copysign(1.0, determinant), determinant)
        for variable, along1, along2, otherwise in zip(dp_du, *edges, s, strict=True):
            variable.value = select(determinant != 0.0, (dv2 * along1 - dv1 * along2) * sign, otherwise)
    x, y = (dot([variable.value for variable in dp_du], tangent) for tangent in (s, t))
    length = sqrt(x * x + y * y)
    usable = length > 0.0
    divisor = select(usable, length, 1.0)
    return [select(usable, x / divisor, 1.0), select(usable, y / divisor, 0.0)]


def corner_texcoords(f: Function, indices: Value, texcoords: Value) -> tuple[Value, Value]:
    """The texture coordinates of one corner, from the addresses of its indices."""
    everywhere = f.constant(MASK, 1)
    vertices = gather(indices, everywhere, f.constant(WORDS, 0)).to(LONGS)
    pairs = gather(texcoords.at(vertices * 8), everywhere, f.constant(PAIRS, 0.0)).bits_as(vector(F32, 2 * CHILDREN))
    return pairs.shuffled(range(0, 2 * CHILDREN, 2)), pairs.shuffled(range(1, 2 * CHILDREN, 2))


# ---- vectors, one per lane ------------------------------------------------------------------------------


def cross(a: Vector, b: Vector) -> Vector:
    """The cross product."""
    return [a[i] * b[j] - a[j] * b[i] for i, j in ((1, 2), (2, 0), (0, 1))]


def dot(a: Vector, b: Vector) -> Value:
    """The dot product."""
    x, y, z = (p * q for p, q in zip(a, b, strict=True))
    # No sum of zeros is -0.
    return (x + y) + (z + 0.0)


def unit(v: Vector) -> Vector:
    """The vectors with unit length; +z for zeros."""
    # In double precision the squares of small numbers aren't lost.
    x, y, z = (component.to(F64) for component in v)
    length = sqrt(x * x + y * y + z * z)
    usable = length > 0.0
    divisor = select(usable, length, 1.0)
    return [select(usable, a / divisor, b).to(F32) for a, b in ((x, 0.0), (y, 0.0), (z, 1.0))]


def tangents(n: Vector) -> tuple[Vector, Vector]:
    """`djpt.core.frame.coordinate_system`; as in kernels, -0 is no negative number."""
    x, y, z = n
    sign = copysign(1.0, z + 0.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return [sign * x * x * a + 1.0, sign * b, -sign * x], [b, y * y * a + sign, -y]


# ---- lanes ----------------------------------------------------------------------------------------------


def assembled(f: Function, type: Type, values: Vector) -> Value:
    """A vector of single values."""
    result = Value(f, type, "undef")
    for lane, value in enumerate(values):
        result = f.emit(f"insertelement {result}, {value}, i32 {lane}", type)
    return result


def transposed(rows: Vector) -> list[Value]:
    """The transpose of a square matrix whose rows are vectors, one element per lane."""
    result, size = list(rows), len(rows)
    step = size // 2
    while step:
        for i in range(size):
            if not i & step:
                a, b = result[i], result[i + step]
                result[i] = a.shuffled([k + size - step if k & step else k for k in range(size)], b)
                result[i + step] = a.shuffled([k + size if k & step else k + step for k in range(size)], b)
        step //= 2
    return result

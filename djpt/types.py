"""The Dr.Jit types that djpt computes with, under Mitsuba's names.

The backend (`llvm` or `cuda`) is fixed when this module is first imported: see
`djpt.variants`. Everything else imports its types from here.

Points, vectors, normals and colours are one type, Dr.Jit's `Array3f` (Dr.Jit's array
classes can't be subclassed): the names say what is meant, not what is checked.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import drjit.llvm.ad as backend
else:
    from djpt.variants import load_backend

    backend = load_backend()

__all__ = [
    "PCG32",
    "Array3f",
    "Array4f",
    "Array4i64",
    "ArrayXf",
    "ArrayXu",
    "Bool",
    "Color3f",
    "Event",
    "Float",
    "Float64",
    "Int",
    "Int32",
    "Int64",
    "Mask",
    "Matrix4f",
    "Normal3f",
    "Point2f",
    "Point3f",
    "Spectrum",
    "TensorXf",
    "UInt",
    "UInt32",
    "UInt64",
    "Vector2f",
    "Vector3f",
    "backend",
]

Float = backend.Float
Float64 = backend.Float64
Int = backend.Int
Int32 = backend.Int
UInt = backend.UInt32
UInt32 = backend.UInt32
UInt64 = backend.UInt64
Int64 = backend.Int64
Bool = backend.Bool
Mask = backend.Bool

Array3f = backend.Array3f
Array4f = backend.Array4f
Array4i64 = backend.Array4i64
ArrayXf = backend.ArrayXf
ArrayXu = backend.ArrayXu
Point2f = backend.Array2f
Vector2f = backend.Array2f
Point3f = backend.Array3f
Vector3f = backend.Array3f
Normal3f = backend.Array3f
Color3f = backend.Array3f
Spectrum = backend.Array3f
Matrix4f = backend.Matrix4f

TensorXf = backend.TensorXf
Event = backend.Event
PCG32 = backend.PCG32

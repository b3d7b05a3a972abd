"""The Dr.Jit types that djpt computes with, under Mitsuba's names.

The backend (`llvm` or `cuda`) is fixed when this module is first imported: see
`djpt.jit.backends`. Everything else imports its types from here.

Points, vectors, normals and colours are one type, Dr.Jit's `Array3f` (Dr.Jit's array
classes can't be subclassed): the names say what is meant, not what is checked.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

from djpt.errors import ArgumentError

if TYPE_CHECKING:
    import drjit.llvm.ad as backend
else:
    from djpt.jit.backends import load_backend

    backend = load_backend()

from drjit.scalar import Array2i as ScalarArray2i
from drjit.scalar import Array2u as ScalarArray2u

__all__ = [
    "PCG32",
    "Array3f",
    "Array3f64",
    "Array4f",
    "Array4f64",
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
    "ScalarArray2i",
    "ScalarArray2u",
    "Spectrum",
    "TensorXf",
    "UInt",
    "UInt32",
    "UInt64",
    "Vector2f",
    "Vector3f",
    "argument_types",
    "backend",
    "converted",
    "converting",
]

Function = TypeVar("Function", bound=Callable[..., Any])

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
Array3f64 = backend.Array3f64
Array4f = backend.Array4f
Array4f64 = backend.Array4f64
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


def converting(function: Function) -> Function:
    """Let a function take whatever its arguments' types can be made from: numbers, lists, tuples, NumPy arrays.

    Arguments are converted if their annotation is the name of a Dr.Jit type of this module. What has that type already
    stays the object that it is, so kernels are the same with and without.

    Raises:
        ArgumentError: by the function, if an argument can't be converted.
    """
    types = argument_types(function)
    code = function.__code__
    by_position = [(name, types.get(name)) for name in code.co_varnames[: code.co_argcount]]

    @functools.wraps(function)
    def call(*arguments: Any, **keywords: Any) -> Any:
        pairs = zip(by_position, arguments, strict=False)
        front = [converted(function, name, value, kind) for (name, kind), value in pairs]
        return function(
            *front,
            *arguments[len(by_position) :],
            **{name: converted(function, name, value, types.get(name)) for name, value in keywords.items()},
        )

    return call  # type: ignore[return-value]


def argument_types(function: Callable[..., Any]) -> dict[str, Any]:
    """The types of this module that a function's arguments are annotated with, by name."""
    return {name: globals()[kind] for name, kind in function.__annotations__.items() if kind in __all__}


def converted(function: Callable[..., Any], name: str, value: Any, kind: Any) -> Any:
    """The argument `name` of a function as the type `kind`; itself if it has that type, or if `kind` is None.

    Raises:
        ArgumentError: It can't be converted.
    """
    if kind is None or type(value) is kind:
        return value
    try:
        return kind(value)
    except TypeError as error:
        raise ArgumentError(
            f"{function.__name__}(): '{name}' must be something that {kind.__name__} can be made from: {error}"
        ) from None

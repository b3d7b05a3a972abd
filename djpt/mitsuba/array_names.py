"""Mitsuba's names of array types, by the rules that Mitsuba made them by."""

from __future__ import annotations

from collections.abc import Iterator

__all__ = ["ARRAYS", "SCALAR"]

SCALAR = "Scalar"
"""The prefix of types that hold one value each, as Python sees it, in place of one per lane."""

FLOATS = {"f": "f", "d": "f64", "f16": "f16", "f32": "f", "f64": "f64"}
ENTRIES = FLOATS | {
    **dict.fromkeys(("i", "i32"), "i"),
    **dict.fromkeys(("u", "u32"), "u"),
    **{name: name for name in ("b", "i8", "i64", "u8", "u64")},
}
"""Mitsuba's suffixes for the types of entries, and those of Dr.Jit."""


def _families() -> Iterator[tuple[str, str]]:
    """Names without the prefix, each with the name of the type in Dr.Jit."""
    for stem, sizes, entries in (
        ("Array", "01234X", ENTRIES),
        ("Tensor", "X", ENTRIES),
        ("Matrix", "234", FLOATS),
        ("Quaternion", "4", FLOATS),
        ("Complex", "2", {name: entry for name, entry in FLOATS.items() if name != "f16"}),
        ("Texture", "123", FLOATS | {"f8u": "f8u"}),
    ):
        yield from ((f"{stem}{n}{name}", f"{stem}{n}{entry}") for n in sizes for name, entry in entries.items())
    # Dr.Jit has one kind of vector: what these names say about the meaning is for the reader.
    for stem, sizes, letters in (
        ("Vector", "01234", "iufd"),
        ("Point", "01234", "iufd"),
        ("Normal", "3", "fd"),
        ("Color", "013", "fd"),
    ):
        yield from ((f"{stem}{n}{name}", f"Array{n}{ENTRIES[name]}") for n in sizes for name in letters)
    for name in ("Float16", "Float32", "Float64", "Int8", "Int32", "Int64", "UInt8", "UInt32", "UInt64"):
        yield name, name
    yield from (("Float", "Float"), ("Int", "Int32"), ("UInt", "UInt32"), ("Bool", "Bool"), ("Mask", "Bool"))
    yield from (("PCG32", "PCG32"), ("Philox4x32", "Philox4x32"))


LANES = dict(_families())
ARRAYS = {
    **LANES,
    "Event": "Event",
    "Spectrum": "Array3f",
    "UnpolarizedSpectrum": "Array3f",
    **{SCALAR + name: entry for name, entry in LANES.items()},
}
"""The names, each with the name of the type in a module of Dr.Jit's: `drjit.scalar` for those with the prefix."""

"""Descriptions of records and their conversion, beside Mitsuba's."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from djpt.errors import SceneError
from djpt.images.structs import ByteOrder, Field, Flags, Struct, StructConverter, Type


@pytest.fixture
def mi() -> Any:
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    return mitsuba


FIELDS = [
    [],
    [("a", "Float32", 0, 0.0)],
    [("a", "UInt8", Flags.Normalized, 0.0), ("b", "Float32", Flags.Default, 2.5), ("c", "Float16", Flags.Alpha, 0.0)],
    [("a", "Float16", 0, 0.0), ("b", "Float64", 0, 0.0), ("c", "Int8", 0, 0.0)],
    [("a", "UInt16", Flags.Normalized | Flags.Gamma, 0.0), ("b", "Int64", Flags.Check, 3.0)],
]


def made(module: Any, fields: list[Any], **options: Any) -> Any:
    """The record, of djpt's or Mitsuba's making."""
    result = module.Struct(**options)
    for name, kind, flags, value in fields:
        result.append(name, getattr(module.Struct.Type, kind), int(flags), value)
    return result


class Ours:
    """The names that `made` looks for."""

    Struct = Struct


@pytest.mark.parametrize("pack", [False, True])
@pytest.mark.parametrize("fields", FIELDS, ids=len)
def test_records_are_laid_out_as_mitsubas(mi: Any, fields: list[Any], pack: bool) -> None:
    ours, theirs = made(Ours, fields, pack=pack), made(mi, fields, pack=pack)
    assert (ours.nbytes(), ours.align(), len(ours)) == (theirs.nbytes(), theirs.align(), len(theirs))
    assert [(f.name, f.offset, f.type.value, int(f.flags), f.value) for f in ours] == [
        (f.name, f.offset, f.type.value, int(f.flags), f.value) for f in theirs
    ]
    if fields:
        assert ours.dtype() == theirs.dtype()
    assert repr(ours).split() == repr(theirs).replace(" byte ", " bytes ").split()
    assert "a" in ours or not fields
    assert Struct(ours) == ours


def test_enumerations_have_mitsubas_values(mi: Any) -> None:
    for ours, theirs in ((Type, mi.Struct.Type), (ByteOrder, mi.Struct.ByteOrder)):
        assert {member.name: member.value for member in ours} == {member.name: member.value for member in theirs}
    for flag in Flags:
        if flag:
            assert int(flag) == int(getattr(mi.Struct.Flags, str(flag.name)))


CASES = [
    ([("v", "UInt8", Flags.Normalized, 0)], [("v", "Float32", 0, 0)], struct.pack("@3B", 255, 7, 0)),
    ([("v", "UInt8", Flags.Normalized | Flags.Gamma, 0)], [("v", "Float32", 0, 0)], struct.pack("@3B", 255, 77, 0)),
    ([("v", "Float32", 0, 0)], [("v", "Int16", 0, 0)], struct.pack("@3f", 1.2, -5.6, 1e9)),
    ([("v", "Float32", 0, 0)], [("v", "UInt8", Flags.Normalized, 0)], struct.pack("@3f", 1.2, -5.6, 0.4)),
    (
        [("a", "Int32", 0, 0), ("b", "Int32", 0, 0)],
        [("b", "Int32", 0, 0), ("c", "Int32", Flags.Default, 7)],
        struct.pack("@4i", 1, 2, 3, -4),
    ),
    (
        [("v", "Float32", 0, 0), ("w", "Float32", Flags.Weight, 0)],
        [("v", "Float64", 0, 0)],
        struct.pack("@4f", 6, 3, 5, 0),
    ),
    (
        [("v", "Float32", Flags.PremultipliedAlpha, 0), ("a", "UInt8", Flags.Alpha | Flags.Normalized, 0)],
        [("v", "Float32", 0, 0), ("a", "Float32", Flags.Alpha, 0)],
        struct.pack("@fB3xfB3x", 0.25, 51, 2, 0),
    ),
]


@pytest.mark.parametrize(("source", "target", "data"), CASES, ids=range(len(CASES)))
@pytest.mark.parametrize("order", ["Native", "BigEndian"])
def test_records_are_converted_as_by_mitsuba(mi: Any, source: Any, target: Any, data: bytes, order: str) -> None:
    results = []
    for module in (Ours, mi):
        to = made(module, target, byte_order=getattr(module.Struct.ByteOrder, order))
        converter = (StructConverter if module is Ours else mi.StructConverter)(made(module, source), to)
        assert converter.source() == made(module, source)
        results.append(np.frombuffer(converter.convert(data), made(Ours, target, byte_order=ByteOrder[order]).dtype()))
    for name in results[0].dtype.names:
        np.testing.assert_allclose(results[0][name], results[1][name], rtol=1e-6, atol=1e-6)


def test_sums_and_checks(mi: Any) -> None:
    source = made(Ours, [("r", "Float32", 0, 0), ("g", "Float32", 0, 0)])
    target = Struct().append(Field("y", Type.Float32, blend=[(0.25, "r"), (0.75, "g")]))
    assert np.frombuffer(StructConverter(source, target).convert(struct.pack("@2f", 4, 8)), "f4").tolist() == [7]
    checked = made(Ours, [("v", "UInt8", Flags.Check, 3)])
    assert StructConverter(checked, made(Ours, [("v", "UInt8", 0, 0)])).convert(b"\3\3") == b"\3\3"
    with pytest.raises(SceneError, match="field 'v' isn't 3 everywhere"):
        StructConverter(checked, made(Ours, [("v", "UInt8", 0, 0)])).convert(b"\3\4")


@pytest.mark.parametrize(
    ("source", "target", "message"),
    [
        ([("v", "UInt8", 0, 0)], [("w", "UInt8", 0, 0)], "there is no field 'w', and it has no default; there are: v"),
        ([("v", "Float32", Flags.Normalized, 0)], [], "only whole numbers are normalized"),
        ([("v", "UInt8", 0, 0), ("v", "UInt8", 0, 0)], [], "two fields have the name 'v'"),
        (
            [("v", "UInt8", Flags.Weight, 0), ("w", "UInt8", Flags.Weight, 0)],
            [("v", "UInt8", 0, 0)],
            "more than one field has the flag 'Weight': 'v' and 'w'",
        ),
    ],
)
def test_errors_name_the_field(source: Any, target: Any, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        StructConverter(made(Ours, source), made(Ours, target)).convert(bytes(made(Ours, source).nbytes()))
    with pytest.raises(SceneError, match="3 bytes are not a number of records of 2 bytes"):
        StructConverter(made(Ours, [("v", "UInt16", 0, 0)]), Struct()).convert(b"abc")
    with pytest.raises(KeyError, match="no field 'colour'; did you mean 'color'"):
        made(Ours, [("color", "UInt8", 0, 0)])["colour"]

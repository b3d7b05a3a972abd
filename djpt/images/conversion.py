"""Conversion of records: types, ranges, the curve of sRGB, weights, alpha, and sums of fields."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.errors import SceneError
from djpt.images.srgb import decoded, encoded, from_srgb, shares, to_srgb8
from djpt.images.structs import Field, Flags, Struct, Type

__all__ = ["StructConverter", "convert_fields"]

Numbers = npt.NDArray[Any]


class StructConverter:
    """Converts records of one kind to those of another; see `convert_fields`.

    Args:
        source: What is given.
        target: What is wanted.
        dither: Must be False, unlike Mitsuba's: whole numbers are rounded to nearest.

    Raises:
        SceneError: names occur twice, flags don't fit the types, or `dither`.
    """

    def __init__(self, source: Struct, target: Struct, dither: bool = False) -> None:
        if dither:
            raise SceneError("records are converted without dithering, so that equal images give equal bytes")
        self._source, self._target = Struct(source), Struct(target)
        self._source.validate()
        self._target.validate()

    def source(self) -> Struct:
        """What is given."""
        return self._source

    def target(self) -> Struct:
        """What is wanted."""
        return self._target

    def convert(self, data: Any) -> bytes:
        """The bytes of converted records.

        Raises:
            SceneError: `data` isn't made of whole records, or a field can't be had; see `convert_fields`.
        """
        size = self._source.nbytes()
        if size == 0 or len(data) % size:
            raise SceneError(f"{len(data)} bytes are not a number of records of {size} bytes")
        records = np.frombuffer(data, self._source.dtype())
        columns = {field.name: records[field.name] for field in self._source}
        result = np.zeros(len(records), self._target.dtype())
        for name, column in convert_fields(self._source, self._target, columns).items():
            result[name] = column
        return result.tobytes()


def convert_fields(source: Struct, target: Struct, columns: Mapping[str, Numbers]) -> dict[str, Numbers]:
    """The fields of records of one kind as those of another, in arrays of the types of `target`.

    A field that differs in type or meaning becomes a linear number in single precision, in which all happens:
    division by the weight (unless it is 0) if only the source has one; multiplication by alpha, or division (0 if it
    is 0), if both have alpha. Then the number is encoded, rounded and clipped to the type. A field that differs in
    nothing is copied bit for bit.

    Args:
        source: What is given.
        target: What is wanted: fields with the same names or another `source`, sums (`blend`), or defaults.
        columns: The numbers of the source's fields by name, arrays of equal shapes.

    Raises:
        SceneError: a field can't be had, two weights or alphas leave open which one is meant, or a number isn't the
            one that `Flags.Check` asks for.
    """
    source.validate()
    target.validate()
    shape = next(iter(columns.values())).shape if columns else (0,)
    for field in source:
        if field.flags & Flags.Check and not np.all(columns[field.name] == stored_value(field)):
            raise SceneError(f"field '{field.name}' isn't {field.value:g} everywhere")
    weight = 1 / nonzero(source, Flags.Weight, columns) if divides(source, target) else None
    result = {}
    for field in target:
        if field.blend:
            missing = [name for _, name in field.blend if name not in source]
            if missing:
                raise SceneError(f"field '{field.name}' is a sum of '{missing[0]}', which doesn't exist")
            total = sum(np.float32(factor) * linear(source[name], columns[name]) for factor, name in field.blend)
            value = np.asarray(total if weight is None else total * weight, np.float32)
            result[field.name] = stored(field, value)
        elif (field.source or field.name) in source:
            result[field.name] = converted(source, target, field, columns, weight)
        elif field.flags & Flags.Default:
            result[field.name] = np.full(shape, stored_value(field))
        else:
            have = ", ".join(entry.name for entry in source)
            raise SceneError(f"there is no field '{field.name}', and it has no default; there are: {have}")
    return result


def converted(
    source: Struct, target: Struct, field: Field, columns: Mapping[str, Numbers], weight: Numbers | None
) -> Numbers:
    """A field that both have."""
    given = source[field.source or field.name]
    column = columns[given.name]
    changed = given.flags ^ field.flags
    with_alpha = (
        not field.flags & (Flags.Weight | Flags.Alpha) and has(source, Flags.Alpha) and has(target, Flags.Alpha)
    )
    alpha_changes = with_alpha and bool(changed & Flags.PremultipliedAlpha)
    if not (alpha_changes or weight is not None or changed & Flags.Gamma):
        if given.type is field.type and not changed & Flags.Normalized:
            return column
        if field.type.dtype.kind == "f" and given.type.dtype.kind == "f":
            with np.errstate(over="ignore"):
                return column.astype(np.float32, copy=False).astype(field.type.dtype)
        # The curve of sRGB would be undone and applied again.
        return stored(field, number(given, column), encode=False)
    value = linear(given, column)
    if weight is not None:
        value = value * weight
    if alpha_changes and field.flags & Flags.PremultipliedAlpha:
        value = value * only(source, Flags.Alpha, columns)
    elif alpha_changes:
        alpha = only(source, Flags.Alpha, columns)
        value = np.divide(value, alpha, out=np.zeros_like(value), where=alpha != 0)
    return stored(field, value)


def number(field: Field, column: Numbers) -> npt.NDArray[np.float32]:
    """The numbers of a field in single precision, in [0, 1] if they are normalized."""
    if field.flags & Flags.Normalized and column.dtype in (np.uint8, np.uint16):
        return shares(column)
    value = column.astype(np.float32)
    if field.flags & Flags.Normalized:
        value *= np.float32(1 / np.iinfo(field.type.dtype).max)
    return value


def linear(field: Field, column: Numbers) -> npt.NDArray[np.float32]:
    """The numbers of a field in single precision, without the curve of sRGB."""
    if field.flags & Flags.Gamma and field.flags & Flags.Normalized and column.dtype in (np.uint8, np.uint16):
        return from_srgb(column.reshape(1, -1, 1)).reshape(column.shape)
    value = number(field, column)
    return decoded(value).astype(np.float32) if field.flags & Flags.Gamma else value


def stored(field: Field, value: npt.NDArray[np.float32], encode: bool = True) -> Numbers:
    """Linear numbers in the form of a field: NaN becomes 0 in whole numbers, which are rounded to nearest."""
    if encode and field.flags & Flags.Gamma and field.flags & Flags.Normalized and field.type is Type.UInt8:
        return to_srgb8(value.reshape(1, -1, 1)).reshape(value.shape)
    if encode and field.flags & Flags.Gamma:
        value = encoded(value).astype(np.float32)
    dtype = field.type.dtype
    if dtype.kind == "f":
        with np.errstate(over="ignore"):
            return value.astype(dtype)
    limits = np.iinfo(dtype)
    wide = np.nan_to_num(value.astype(np.float64), nan=0.0, posinf=np.inf, neginf=-np.inf)
    if field.flags & Flags.Normalized:
        wide = wide * limits.max
    # The largest double below 2^64 is not the largest whole number.
    largest = float(limits.max) if float(limits.max) <= limits.max else np.nextafter(float(limits.max), 0)
    return np.clip(np.rint(wide), float(limits.min), largest).astype(dtype)


def stored_value(field: Field) -> Any:
    """The `value` of a field in its form."""
    return stored(field, np.array(field.value, np.float32))[()]


def has(struct: Struct, flag: Flags) -> bool:
    """Whether a field has the flag."""
    return any(field.flags & flag for field in struct)


def divides(source: Struct, target: Struct) -> bool:
    """Whether a conversion divides by a weight."""
    return has(source, Flags.Weight) and not has(target, Flags.Weight)


def only(source: Struct, flag: Flags, columns: Mapping[str, Numbers]) -> npt.NDArray[np.float32]:
    """The linear numbers of the one field with the flag."""
    fields = [field for field in source if field.flags & flag]
    if len(fields) > 1:
        names = " and ".join(f"'{field.name}'" for field in fields)
        raise SceneError(f"more than one field has the flag '{flag.name}': {names}; which one is meant?")
    return linear(fields[0], columns[fields[0].name])


def nonzero(source: Struct, flag: Flags, columns: Mapping[str, Numbers]) -> npt.NDArray[np.float32]:
    """The linear numbers of the one field with the flag, 1 in place of 0."""
    value = only(source, flag, columns)
    return np.where(value == 0, np.float32(1), value)

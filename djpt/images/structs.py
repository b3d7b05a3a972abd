"""Records in memory, as Mitsuba's `Struct`: named fields of numbers, and their conversion.

Types, ranges, the curve of sRGB, weights, alpha, and sums of fields are converted.
"""

from __future__ import annotations

import dataclasses
import enum
import sys
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.core.forms import accessors
from djpt.errors import SceneError, near_miss
from djpt.images.srgb import decoded, encoded, from_srgb, shares, to_srgb8

__all__ = ["ByteOrder", "Field", "Flags", "Struct", "StructConverter", "Type", "convert_fields"]

Numbers = npt.NDArray[Any]


class Type(enum.Enum):
    """The type of a number."""

    Invalid = 0
    UInt8 = 1
    Int8 = 2
    UInt16 = 3
    Int16 = 4
    UInt32 = 5
    Int32 = 6
    UInt64 = 7
    Int64 = 8
    Float16 = 9
    Float32 = 10
    Float64 = 11

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type in NumPy. Raises `SceneError` for `Invalid`."""
        if self is Type.Invalid:
            raise SceneError("'Type.Invalid' is not the type of a number")
        return np.dtype(self.name.lower())

    @classmethod
    def of(cls, dtype: Any) -> Type:
        """The type of NumPy's numbers, `Invalid` for those without one."""
        return next((kind for kind in cls if kind.name.lower() == np.dtype(dtype).newbyteorder("=").name), cls.Invalid)


class Flags(enum.IntFlag):
    """What the numbers of a field mean."""

    Empty = 0
    Normalized = 1
    """Whole numbers are shares of the type's largest."""
    Gamma = 2
    """Encoded by the curve of sRGB."""
    Check = 4
    """Records whose value differs can't be converted."""
    Default = 8
    """The value stands for one that the source lacks."""
    Weight = 16
    """What the other fields are to be divided by."""
    Alpha = 32
    PremultipliedAlpha = 64
    """Multiplied by alpha."""


class ByteOrder(enum.Enum):
    """The order of the bytes of numbers; `Native` is this machine's."""

    Native = 0
    LittleEndian = 1
    BigEndian = 2


WORDS = {
    Flags.Normalized: "normalized",
    Flags.Gamma: "gamma",
    Flags.Weight: "weight",
    Flags.Alpha: "alpha",
    Flags.PremultipliedAlpha: "premultiplied alpha",
    Flags.Check: "check",
    Flags.Default: "default",
}


@dataclasses.dataclass
class Field:
    """A number of a record.

    `offset`: in bytes; `value`: what `Flags.Default` and `Flags.Check` refer to; `blend`: factors and names of
    source fields whose sum is this one; `source`: the name of the source field, if it has another.
    """

    name: str
    type: Type
    offset: int = 0
    flags: Flags = Flags.Empty
    value: float = 0.0
    blend: list[tuple[float, str]] = dataclasses.field(default_factory=list)
    source: str = ""

    def __str__(self) -> str:
        words = [word for flag, word in WORDS.items() if self.flags & flag]
        if self.flags & (Flags.Default | Flags.Check):
            words.append(f"value={self.value:g}")
        if self.blend:
            words.append("blend = " + " + ".join(f"{factor:g} * {name}" for factor, name in self.blend))
        return f"{self.type.name.lower()} {self.name}; // {', '.join([f'@{self.offset}', *words])}"

    __repr__ = __str__


Kind = Type  # inside of `Struct`, these names are its attributes
Order = ByteOrder


class Struct:
    """A record: fields one after the other, each at a multiple of its size unless the record is packed.

    Args:
        pack: Whether no bytes are left out between fields; or another `Struct`, or a structured NumPy dtype, to copy.
        byte_order: Of all fields.
        dtype: Another name of `pack` for a dtype.
    """

    Type = Type
    Flags = Flags
    ByteOrder = ByteOrder
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, pack: Any = False, byte_order: Order = Order.Native, dtype: Any = None) -> None:
        pack = pack if dtype is None else dtype
        native = Order.LittleEndian if sys.byteorder == "little" else Order.BigEndian
        self._order = native if byte_order is Order.Native else byte_order
        self._fields: list[Field] = []
        self._pack = False
        if isinstance(pack, Struct):
            self._pack, self._order = pack._pack, pack._order
            self._fields = [dataclasses.replace(entry, blend=list(entry.blend)) for entry in pack]
        elif isinstance(pack, bool):
            self._pack = pack
        else:
            self._read(np.dtype(pack))

    def _read(self, dtype: np.dtype[Any]) -> None:
        """Take the fields of a structured type of NumPy's."""
        for name, (kind, offset, *_) in (dtype.fields or {}).items():
            self._fields.append(Field(name, Type.of(kind), offset))

    def append(
        self,
        name: str | Field = "",
        type: Kind = Kind.Invalid,
        flags: int = 0,
        value: float = 0.0,
        field: Field | None = None,
    ) -> Struct:
        """Add a field at the next free place; one given whole, also as `name`, keeps its own. Returns the record."""
        whole = name if isinstance(name, Field) else field
        if whole is not None:
            self._fields.append(dataclasses.replace(whole, blend=list(whole.blend)))
            return self
        assert isinstance(name, str)
        size = type.dtype.itemsize
        place = max((entry.offset + entry.type.dtype.itemsize for entry in self), default=0)
        if not self._pack:
            place = -(-place // size) * size
        self._fields.append(Field(name, type, place, Flags(int(flags)), value))
        return self

    def nbytes(self) -> int:
        """The size of a record."""
        end = max((entry.offset + entry.type.dtype.itemsize for entry in self), default=0)
        return end if self._pack else -(-end // self.align()) * self.align()

    def align(self) -> int:
        """The number of which the addresses of records are multiples: the size of the largest field, or 1."""
        return 1 if self._pack else max((entry.type.dtype.itemsize for entry in self), default=1)

    byte_order, set_byte_order = accessors("_order", "The order of the bytes of numbers.", ByteOrder)
    pack, set_pack = accessors("_pack", "Whether no bytes are left out between fields that are added from now on.")

    def dtype(self) -> np.dtype[Any]:
        """The structured type of NumPy's that describes the same record."""
        description: Any = {
            "names": [entry.name for entry in self],
            "formats": [
                entry.type.dtype.newbyteorder(">" if self._order is Order.BigEndian else "<") for entry in self
            ],
            "offsets": [entry.offset for entry in self],
            "itemsize": self.nbytes(),
        }
        return np.dtype(description)

    def validate(self) -> None:
        """Raise `SceneError` unless names differ and flags fit the types."""
        names = [entry.name for entry in self]
        for entry in self:
            if names.count(entry.name) > 1:
                raise SceneError(f"two fields have the name '{entry.name}'")
            if entry.flags & Flags.Normalized and entry.type.dtype.kind == "f":
                raise SceneError(f"field '{entry.name}': only whole numbers are normalized, found {entry.type}")
            if entry.flags & Flags.Check and entry.flags & Flags.Default:
                raise SceneError(f"field '{entry.name}': 'Check' and 'Default' exclude each other")

    def __getitem__(self, key: int | str) -> Field:
        if isinstance(key, str):
            for entry in self:
                if entry.name == key:
                    return entry
            raise KeyError(f"no field '{key}'{near_miss(key, (entry.name for entry in self))}")
        return self._fields[key]

    def __contains__(self, name: object) -> bool:
        return any(entry.name == name for entry in self)

    def __iter__(self) -> Iterator[Field]:
        return iter(self._fields)

    def __len__(self) -> int:
        return len(self._fields)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Struct):
            return NotImplemented
        return self._fields == other._fields and (self._pack, self._order) == (other._pack, other._order)

    def __repr__(self) -> str:
        lines, end = [], 0
        for entry in self:
            lines += [f"  // {entry.offset - end} bytes of padding"] if entry.offset > end else []
            lines.append(f"  {entry}")
            end = entry.offset + entry.type.dtype.itemsize
        lines += [f"  // {self.nbytes() - end} bytes of padding"] if self.nbytes() > end else []
        return "\n".join(["Struct[", *lines, "]"])


# ---- conversion ----------------------------------------------------------------------------


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
    divides = has(source, Flags.Weight) and not has(target, Flags.Weight)
    weight = 1 / nonzero(source, Flags.Weight, columns) if divides else None
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

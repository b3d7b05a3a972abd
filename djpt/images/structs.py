"""Descriptions of records in memory: named fields of numbers, as Mitsuba's `Struct`."""

from __future__ import annotations

import enum
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from djpt.errors import SceneError, near_miss

__all__ = ["ByteOrder", "Field", "Flags", "Struct", "Type"]


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


@dataclass
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
    blend: list[tuple[float, str]] = field(default_factory=list)
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
            self._fields = [replace(entry, blend=list(entry.blend)) for entry in pack]
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
            self._fields.append(replace(whole, blend=list(whole.blend)))
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

    def byte_order(self) -> Order:
        """The order of the bytes of numbers."""
        return self._order

    def set_byte_order(self, order: Order) -> None:
        """Change the order of the bytes of numbers."""
        self._order = order

    def pack(self) -> bool:
        """Whether no bytes are left out between fields."""
        return self._pack

    def set_pack(self, pack: bool) -> None:
        """Leave bytes out between fields that are added from now on, or not."""
        self._pack = pack

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

"""Files of accumulations.

    djpt accumulation 1         the kind and the version of the format
    1f0c2a9b                    the CRC-32 of all that follows, in hexadecimal digits
    {"djpt": .., ..}            a line of JSON: everything but the arrays
    ...                         the arrays one after the other, little-endian

Nothing in it is code, and all sizes follow from the line of JSON.
"""

from __future__ import annotations

import json
import math
import os
import zlib
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from djpt.errors import FileError
from djpt.files import as_path, read_bytes, shortened, writing
from djpt.version import __version__

if TYPE_CHECKING:
    from djpt.long_renders.accumulation import Accumulation

__all__ = ["load", "save"]

KIND, VERSION = b"djpt accumulation ", 1


def save(accumulation: Accumulation, path: str | os.PathLike[str]) -> None:
    """Write an accumulation: see `Accumulation.save`."""
    header = {
        "djpt": __version__,
        "drjit": version("drjit"),
        "fingerprint": dict(accumulation.fingerprint),
        "channels": accumulation.channels,
        "constant": accumulation.constant.shape[2],
        "size": accumulation.size,
        "round_spp": accumulation.round_spp,
        "seeds": accumulation.seeds,
        **accumulation.facts(),
    }
    parts: list[Any] = [json.dumps(header).encode() + b"\n"]
    for name, kind in accumulation.stored.items():
        parts.append(np.ascontiguousarray(getattr(accumulation, name), kind).reshape(-1).view(np.uint8))
    check = 0
    for part in parts:
        check = zlib.crc32(part, check)
    target = as_path(path)
    with writing(target) as temporary, temporary.open("wb") as file:
        file.writelines([KIND, b"%d\n%08x\n" % (VERSION, check), *parts])


def load(path: str | os.PathLike[str]) -> Accumulation:
    """Read an accumulation: see `Accumulation.load`."""
    from djpt.long_renders.adaptive import AdaptiveAccumulation
    from djpt.long_renders.even import EvenAccumulation

    source = as_path(path)
    kind, _, rest = read_bytes(source).partition(b"\n")
    if not kind.startswith(KIND):
        raise unreadable(source, "it isn't an accumulation of djpt")
    if kind[len(KIND) :] != b"%d" % VERSION:
        found = kind[len(KIND) :][:8].decode("ascii", "replace")
        raise unreadable(source, f"its format is version {found}; this djpt reads version {VERSION}")
    check, _, data = rest.partition(b"\n")
    if check != b"%08x" % zlib.crc32(data):
        raise unreadable(source, "it is cut off or damaged")
    line, _, memory = data.partition(b"\n")
    try:
        header = checked(json.loads(line))
        made: type[Accumulation] = AdaptiveAccumulation if "tiles" in header else EvenAccumulation
        types, shapes = made.stored, made.shapes(header)
        needed = sum(int(np.dtype(types[name]).itemsize) * math.prod(shape) for name, shape in shapes.items())
        if needed != len(memory):
            raise ValueError(f"its arrays have {len(memory)} bytes, its header asks for {needed}")
        entries, place = made.further(header), 0
        for name, shape in shapes.items():
            array = np.frombuffer(memory, types[name], math.prod(shape), place).reshape(shape)
            place += array.nbytes
            entries[name] = array.astype(array.dtype.newbyteorder("="))
    except (ValueError, TypeError, KeyError, RecursionError, MemoryError) as error:
        raise unreadable(source, f"its header is wrong: {str(error) or type(error).__name__}") from None
    return made(
        fingerprint=header["fingerprint"],
        channels=tuple(header["channels"]),
        round_spp=header["round_spp"],
        seeds=tuple(header["seeds"]),
        **entries,
    )


def checked(header: Any) -> Mapping[str, Any]:
    """The header, if its entries have the types and ranges that are expected; raises `ValueError` or `KeyError`."""
    if not isinstance(header, dict):
        raise ValueError("it isn't a dict")
    if not isinstance(header["fingerprint"], dict):
        raise ValueError("'fingerprint' must be a dict")
    width, height = header["size"]
    numbers = {"width": width, "height": height, "constant": header["constant"], "round_spp": header["round_spp"]}
    for name, number in {**numbers, **{f"seed {i}": seed for i, seed in enumerate(header["seeds"])}}.items():
        if type(number) is not int or not 0 <= number < 2**32:
            raise ValueError(f"'{name}' is no whole number of 32 bits")
    texts = [*header["channels"], *header["fingerprint"], *header["fingerprint"].values()]
    if not all(isinstance(text, str) for text in texts):
        raise ValueError("'channels' and 'fingerprint' must be texts")
    if min(width, height, header["round_spp"]) < 1 or header["constant"] > len(header["channels"]):
        raise ValueError("a size is out of range")
    if len(set(header["seeds"])) != len(header["seeds"]):
        raise ValueError("two rounds have the same seed")
    return header


def unreadable(source: Path, problem: str) -> FileError:
    """The error to raise for a file."""
    return FileError(f"can't read '{shortened(source)}': {problem}")

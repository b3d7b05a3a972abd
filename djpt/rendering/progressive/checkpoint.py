"""Files of accumulations.

    djpt accumulation 2         the kind and the version of the format
    1f0c2a9b                    the CRC-32 of all that follows, in hexadecimal digits
    {"software": .., ..}        a line of JSON: everything but the arrays
    ...                         the arrays one after the other, little-endian

If a last round is smaller, the arrays of all rounds are followed by those without it, from which a render continues.
Nothing in it is code, and all sizes follow from the line of JSON.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

import drjit as dr
import numpy as np

from djpt.core.files import as_path, read_bytes, shortened, writing
from djpt.core.transforms import ScalarTransform4f
from djpt.description.plugin import ParamFlags, Plugin, TraversalCallback, is_plain
from djpt.errors import FileError
from djpt.films import Film
from djpt.integrators.base import Integrator
from djpt.integrators.termination import Terminating
from djpt.samplers import Sampler
from djpt.scene.scene import Scene
from djpt.sensors import Sensor
from djpt.version import __version__

__all__ = ["Fingerprint", "difference", "fingerprint", "load", "save", "versions"]

Fingerprint = Mapping[str, str]
"""A hash (64 bits, in hexadecimal digits) for each node of a scene by its name, the sensor and the like."""

SHOWN = 4
"""The maximum number of nodes that a message lists."""


def fingerprint(scene: Scene, sensor: Sensor, integrator: Integrator) -> dict[str, str]:
    """The fingerprint of an image: of all nodes of the scene but other sensors and integrators.

    Hashes cover the classes of plugins, their parameters (what `traverse` reports: numbers, vertices, texels), and what
    their kernels depend on besides; and the order of lights, which decides what random numbers choose. The number of
    samples and the seed of `render` aren't part of it.
    """
    named = [(name, node) for name, node in scene.named if not isinstance(node, (Sensor, Integrator))]
    parts = [*named, ("the sensor", sensor), ("the film", sensor.film()), ("the sampler", sensor.sampler())]
    lights = "\n".join(emitter.id() for emitter in scene.emitters())
    order = hashlib.blake2b(lights.encode("utf-8", "replace"), digest_size=8)
    nodes = {name: hash_of(node) for name, node in [*parts, ("the integrator", integrator)]}
    return {**nodes, "the order of lights": order.hexdigest()}


def versions() -> str:
    """The versions that the bits of a round depend on."""
    # Not importlib.metadata, which takes two megabytes.
    return f"djpt {__version__}, drjit {dr.__version__}"  # type: ignore[attr-defined]


def difference(a: Fingerprint, b: Fingerprint) -> str:
    """The nodes in which two fingerprints differ, for messages; an empty string if they are equal."""
    names = [name for name in {**a, **b} if a.get(name) != b.get(name)]
    quoted = [name if name.startswith("the ") else f"'{name}'" for name in names]
    return ", ".join(quoted[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")


def hash_of(plugin: Plugin) -> str:
    """The hash of a plugin with all that is nested in it."""
    digest = hashlib.blake2b(digest_size=8)
    for piece in pieces(plugin, {}):
        digest.update(len(piece).to_bytes(8, "little"))
        digest.update(piece)
    return digest.hexdigest()


class Parts(TraversalCallback):
    """A traversal callback that collects parameters and nested plugins by name."""

    def __init__(self) -> None:
        self.parts: dict[str, Any] = {}

    def put(
        self,
        name: str,
        value: Any,
        flags: ParamFlags | None = None,
        attribute: str | None = None,
    ) -> None:
        """Record a parameter or a plugin."""
        self.parts[name] = value


def pieces(plugin: Plugin, seen: dict[int, int]) -> Iterator[bytes]:
    """The data of a plugin and of those nested in it. One that was met before is named by its number: `seen`."""
    if id(plugin) in seen:
        yield f"see {seen[id(plugin)]}".encode()
        return
    seen[id(plugin)] = len(seen)
    yield f"{type(plugin).__module__}.{type(plugin).__qualname__}".encode()
    for name, value in sorted(described(plugin).items()):
        yield name.encode()
        yield from pieces_of_value(value, seen)


def described(plugin: Plugin) -> dict[str, Any]:
    """The description of a plugin, by name: its parameters, and whatever else kernels and schedules depend on."""
    parts = Parts()
    plugin.traverse(parts)
    found = parts.parts
    for name in (*plugin.values, *plugin.tables, *plugin.children):
        found.setdefault(name, getattr(plugin, name))
    if not plugin.infers:
        found.update((f"static {name}", getattr(plugin, name)) for name in plugin.statics)
    if isinstance(plugin, (Integrator, Sensor, Film, Sampler)):
        # They are Python in large part, whose settings are attributes.
        for name, value in vars(plugin).items():
            if is_setting(name, value) or (isinstance(plugin, Integrator) and holds_plugins(value)):
                found.setdefault(f"attribute {name}", value)
    if isinstance(plugin, Terminating):
        found.update((name, getattr(plugin, f"_{name}", None)) for name in ("max_depth", "rr_depth"))
    if isinstance(plugin, Sensor):
        return {name: value for name, value in found.items() if not isinstance(value, (Film, Sampler))}
    if isinstance(plugin, Film):
        return {**found, "border": plugin.border, "channels": plugin.channel_names(), "rfilter": plugin.rfilter()}
    return found


def is_setting(name: str, value: Any) -> bool:
    """True if an attribute is a plain value that isn't the state of a render."""
    return not name.startswith("_") and is_plain(tuple(value) if isinstance(value, list) else value)


def holds_plugins(value: Any) -> bool:
    """True if a value is a plugin, or a list of plugins or of pairs with them."""
    if isinstance(value, (list, tuple)):
        return any(map(holds_plugins, value))
    return isinstance(value, Plugin)


def pieces_of_value(value: Any, seen: dict[int, int]) -> Iterator[bytes]:
    """The data of one value."""
    if isinstance(value, Plugin):
        yield from pieces(value, seen)
    elif isinstance(value, ScalarTransform4f):
        yield np.asarray(value.matrix, np.float64).tobytes()
    elif dr.is_array_v(value):
        if dr.is_struct_v(value):
            return
        array = np.ascontiguousarray(dr.detach(value).numpy() if dr.is_jit_v(value) else np.array(value))
        yield f"{array.dtype} {array.shape}".encode()
        yield array.tobytes()
    elif isinstance(value, np.ndarray):
        array = np.ascontiguousarray(value)
        yield f"{array.dtype} {array.shape}".encode()
        yield array.tobytes()
    elif isinstance(value, (list, tuple)):
        yield f"{len(value)} values".encode()
        for item in value:
            yield from pieces_of_value(item, seen)
    elif is_plain(value):
        yield repr(value).encode()
    else:
        yield type(value).__qualname__.encode()


KIND, VERSION = b"djpt accumulation ", 2


class Stored(Protocol):
    """The protocol of stored objects: accumulations, see `djpt.rendering.progressive.accumulation.Accumulation`."""

    stored: ClassVar[Mapping[str, str]]

    def facts(self) -> dict[str, Any]:
        """The facts that files hold besides the arrays and the header."""

    def check(self) -> None:
        """Raise `ValueError` if the arrays contradict each other."""

    @classmethod
    def shapes(cls, header: Mapping[str, Any]) -> dict[str, tuple[int, ...]]:
        """The shapes of the arrays of a file."""

    @classmethod
    def stored_in(cls, header: Mapping[str, Any], rounds: int, beginning: Any, arrays: Mapping[str, Any]) -> Any:
        """The accumulation of a file."""


Kind = TypeVar("Kind", bound=Stored)


def save(path: str | os.PathLike[str], header: Mapping[str, Any], sets: Sequence[Stored]) -> None:
    """Write an accumulation, followed by the one that it continues from, if that is another one."""
    header = {**header, "sets": [one.facts() for one in sets]}
    parts: list[Any] = [json.dumps(header).encode() + b"\n"]
    for one in sets:
        for name, kind in one.stored.items():
            parts.append(np.ascontiguousarray(getattr(one, name), kind).reshape(-1).view(np.uint8))
    check = 0
    for part in parts:
        check = zlib.crc32(part, check)
    target = as_path(path)
    with writing(target) as temporary, temporary.open("wb") as file:
        file.writelines([KIND, b"%d\n%08x\n" % (VERSION, check), *parts])


def load(path: str | os.PathLike[str], kind_of: Callable[[Mapping[str, Any]], type[Kind]]) -> Kind:
    """Read an accumulation, whose class `kind_of` knows from a header.

    Raises:
        FileError: It can't be read, is of another kind or version, or is damaged.
    """
    source = as_path(path)
    kind, _, rest = read_bytes(source).partition(b"\n")
    if not kind.startswith(KIND):
        raise unreadable(source, "it isn't an accumulation of djpt")
    if kind[len(KIND) :] != b"%d" % VERSION:
        found = kind[len(KIND) :][:8].decode("ascii", "replace")
        raise unreadable(source, f"its format is version {found}; this djpt reads version {VERSION}")
    check, _, data = rest.partition(b"\n")
    if check != b"%08x" % zlib.crc32(data):
        raise unreadable(source, "it is truncated or damaged")
    line, _, memory = data.partition(b"\n")
    try:
        header = checked(json.loads(line))
        return read(kind_of(header), header, memory)
    except (ValueError, TypeError, KeyError, RecursionError, MemoryError) as error:
        raise unreadable(source, f"its header is wrong: {str(error) or type(error).__name__}") from None


def read(made: type[Kind], header: Mapping[str, Any], memory: bytes) -> Kind:
    """The accumulation of a checked header and the memory of its arrays; raises `ValueError` if they disagree."""
    headers = [{**header, **facts} for facts in header["sets"]]
    layouts = [made.shapes(one) for one in headers]
    needed = sum(
        int(np.dtype(made.stored[name]).itemsize) * math.prod(shape)
        for shapes in layouts
        for name, shape in shapes.items()
    )
    if needed != len(memory):
        raise ValueError(f"its arrays have {len(memory)} bytes, but its header requires {needed}")
    found: list[Kind] = []
    end = len(memory)
    # The beginning stands last, and what follows refers to it.
    for without, (one, shapes) in reversed(list(enumerate(zip(headers, layouts, strict=True)))):
        arrays = {}
        for name, shape in reversed(shapes.items()):
            kind = np.dtype(made.stored[name])
            end -= kind.itemsize * math.prod(shape)
            array = np.frombuffer(memory, kind, math.prod(shape), end).reshape(shape)
            arrays[name] = array.astype(kind.newbyteorder("="))
        rounds = len(header["seeds"]) - without
        accumulation: Kind = made.stored_in(one, rounds, found[-1] if found else None, arrays)
        accumulation.check()
        found.append(accumulation)
    return found[-1]


def checked(header: Any) -> Mapping[str, Any]:
    """The header, if its entries have the types and ranges that are expected; raises `ValueError` or `KeyError`."""
    if not isinstance(header, dict):
        raise ValueError("it isn't a dict")
    if not isinstance(header["fingerprint"], dict):
        raise ValueError("'fingerprint' must be a dict")
    width, height = header["size"]
    seeds, counts = header["seeds"], header["counts"]
    numbers = {"width": width, "height": height, "constant": header["constant"], "round_spp": header["round_spp"]}
    numbers |= {f"seed {i}": seed for i, seed in enumerate(seeds)}
    numbers |= {f"count {i}": count for i, count in enumerate(counts)}
    for name, number in numbers.items():
        if type(number) is not int or not 0 <= number < 2**32:
            raise ValueError(f"'{name}' isn't a 32-bit integer")
    texts = [header["software"], header["schedule"], *header["channels"]]
    texts += [*header["fingerprint"], *header["fingerprint"].values()]
    if not all(isinstance(text, str) for text in texts):
        raise ValueError("'software', 'schedule', 'channels' and 'fingerprint' must hold strings")
    if min(width, height, header["round_spp"]) < 1 or header["constant"] > len(header["channels"]):
        raise ValueError("a size is out of range")
    if len(set(seeds)) != len(seeds):
        raise ValueError("two rounds have the same seed")
    if len(counts) != len(seeds) or not all(1 <= count <= header["round_spp"] for count in counts):
        raise ValueError(f"'counts' must be {len(seeds)} numbers of 1 to {header['round_spp']} samples")
    sets = header["sets"]
    if not isinstance(sets, list) or not 1 <= len(sets) <= 2 or not all(isinstance(one, dict) for one in sets):
        raise ValueError("'sets' must be one or two dicts")
    whole = [count == header["round_spp"] for count in counts]
    if len(sets) == 2 and not (all(whole[:-1]) and whole[-1:] == [False]):
        raise ValueError("'sets' and 'counts' disagree on whether the last round alone is smaller")
    return header


def unreadable(source: Path, problem: str) -> FileError:
    """The error to raise for a file."""
    return FileError(f"can't read '{shortened(source)}': {problem}")

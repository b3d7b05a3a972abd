"""The fingerprint of what is rendered: equal for equal scenes, in any process."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.transforms import ScalarTransform4f
from djpt.description.plugin import ParamFlags, Plugin, TraversalCallback, is_plain
from djpt.films import Film
from djpt.integrators.base import Integrator
from djpt.integrators.termination import Terminating
from djpt.samplers import Sampler
from djpt.scene.scene import Scene
from djpt.sensors import Sensor
from djpt.version import __version__

__all__ = ["Fingerprint", "difference", "fingerprint", "versions"]

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
    return f"djpt {__version__}, drjit {version('drjit')}"


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
        flags: ParamFlags = ParamFlags.NonDifferentiable,
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

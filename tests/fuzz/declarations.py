"""The parameters that plugins declare, learnt by watching what their constructors ask for."""

from __future__ import annotations

import contextlib
import functools
import inspect
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import djpt
from djpt.description.properties import REQUIRED, Properties
from djpt.description.registry import names
from tests.fuzz.seeds import seed_files

__all__ = ["KINDS", "Declaration", "declared"]

KINDS = (
    "bsdf", "emitter", "film", "integrator", "medium", "phase", "rfilter", "sampler", "sensor", "shape", "texture",
    "volume",
)  # fmt: skip
"""All kinds of plugins that a scene consists of."""

GETTERS = (
    "float", "integer", "boolean", "string", "vector", "transform", "texture", "texture_1", "volume", "plugin",
    "child", "children", "raw",
)  # fmt: skip
"""The methods of `Properties` that hand out entries."""


@dataclass(frozen=True)
class Declaration:
    """One parameter of a plugin."""

    key: str
    """Its name; for nested plugins under any name, their kind."""
    sort: str
    """The getter that it is asked for with."""
    required: bool = False
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    kind: str = ""
    """The kind of a nested plugin."""


def declared(plugin: str) -> tuple[Declaration, ...]:
    """The parameters of a plugin, by its name, in alphabetical order."""
    return catalogue()[plugin]


@functools.cache
def catalogue() -> dict[str, tuple[Declaration, ...]]:
    """The parameters of all plugins, by name."""
    with tempfile.TemporaryDirectory(prefix="djpt-") as folder:
        for name, content in seed_files().items():
            (Path(folder) / name).write_bytes(content)
        with djpt.FileResolver([folder]).active():
            return {name: learn(name) for kind in KINDS for name in names(kind)}


def learn(plugin: str) -> tuple[Declaration, ...]:
    """Construct a plugin again and again, each time with what it missed before, until nothing new is asked for."""
    found: dict[str, Declaration] = {}
    before = -1
    while len(found) > before:
        before = len(found)
        entries = {d.key: example(d) for d in found.values() if d.required} | NEEDED.get(plugin, {})
        with watching(plugin, found), contextlib.suppress(djpt.DjptError), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            djpt.load_dict({"type": plugin, **entries})
    return tuple(found[key] for key in sorted(found))


@contextlib.contextmanager
def watching(plugin: str, found: dict[str, Declaration]) -> Iterator[None]:
    """Collect what a plugin asks for within a ``with`` block."""
    with contextlib.ExitStack() as stack:
        for sort in ("__contains__", *GETTERS):
            stack.enter_context(mock.patch.object(Properties, sort, watched(sort, plugin, found)))
        yield


def watched(sort: str, plugin: str, found: dict[str, Declaration]) -> Any:
    """A getter that notes its arguments."""
    getter = getattr(Properties, sort)
    names_of_arguments = list(inspect.signature(getter).parameters)[2:]

    def get(self: Properties, key: str = "to_world", *arguments: Any, **options: Any) -> Any:
        if self.plugin_name() == plugin:
            given = dict(zip(names_of_arguments, arguments, strict=False)) | options
            found[key] = declaration(key, sort, given, found.get(key))
        return getter(self, key, *arguments, **options)

    return get


def declaration(key: str, sort: str, given: dict[str, Any], known: Declaration | None) -> Declaration:
    """The parameter that a getter was asked for; `known` is what another one has told about it."""
    if sort == "__contains__":
        return known or Declaration(key, "raw")
    required = given.get("default", REQUIRED) is REQUIRED and sort not in ("transform", "child", "children")
    kind = given.get("kind", "") if sort == "plugin" else key if sort in ("child", "children") else ""
    return Declaration(
        key, sort, required, given.get("low"), given.get("high"), tuple(given.get("choices") or ()), kind
    )


def example(declaration: Declaration) -> Any:
    """A value that a parameter may have."""
    if declaration.sort in ("plugin", "child", "children"):
        return {"type": SIMPLEST.get(declaration.kind, "diffuse")}
    low = 0.0 if declaration.low is None else declaration.low
    high = low + 1 if declaration.high is None else declaration.high
    return {
        "float": 0.5 * (low + high),
        "integer": max(1, int(low)),
        "boolean": True,
        "string": declaration.choices[0] if declaration.choices else "a.obj",
        "vector": [1.0, 2.0, 3.0],
        "transform": djpt.ScalarTransform4f(),
        "raw": 1.0,
    }.get(declaration.sort, 0.5)


NEEDED: dict[str, dict[str, Any]] = {
    "bitmap": {"filename": "a.png"},
    "envmap": {"filename": "a.exr"},
    "gridvolume": {"filename": "a.vol"},
    "sdfgrid": {"filename": "a.vol"},
    "measured": {"filename": "a.bsdf"},
    "obj": {"filename": "a.obj"},
    "ply": {"filename": "a.ply"},
    "serialized": {"filename": "a.serialized"},
    "linearcurve": {"filename": "a.txt"},
    "bsplinecurve": {"filename": "a.txt"},
    "ellipsoids": {"filename": "cloud.ply"},
    "ellipsoidsmesh": {"filename": "cloud.ply"},
    "metaballs": {"balls": [[0.0, 0, 0, 1]]},
    "projector": {"irradiance": {"type": "checkerboard"}},
    "srgb": {"color": [0.2, 0.5, 0.8]},
    "rgb": {"value": [0.2, 0.5, 0.8]},
    "uniform": {"value": 0.5},
    "spectrum": {"value": [(400, 0.5), (700, 1.0)]},
    "regular": {"values": "0.5, 0.7, 0.9", "wavelength_min": 400.0, "wavelength_max": 700.0},
    "irregular": {"values": "0.5, 0.7, 0.9", "wavelengths": "400, 500, 700"},
    "tabphase": {"values": "0.5, 0.7, 0.9"},
    "implicit": {"function": lambda p: p.x},
}
"""What plugins can't do without and don't declare as required."""

SIMPLEST = {
    "bsdf": "diffuse", "emitter": "area", "film": "hdrfilm", "integrator": "path", "medium": "homogeneous",
    "phase": "isotropic", "rfilter": "box", "sampler": "independent", "sensor": "perspective", "shape": "sphere",
    "texture": "checkerboard", "volume": "constvolume",
}  # fmt: skip
"""A plugin of each kind that needs nothing."""

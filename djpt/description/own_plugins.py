"""djpt's own plugins by name: their kinds and files, read from the sources so that nothing is imported to know a name.

The lines that are read are those that register plugins, one or several in the file of each::

    register_bsdf("diffuse", Diffuse)
"""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

__all__ = ["PACKAGES", "PluginModule", "plugin_module", "plugin_modules"]

PACKAGES = (
    "djpt.textures",
    "djpt.materials",
    "djpt.shapes",
    "djpt.emitters",
    "djpt.media",
    "djpt.phase",
    "djpt.volumes",
    "djpt.rfilters",
    "djpt.films",
    "djpt.samplers",
    "djpt.sensors",
    "djpt.integrators",
    "djpt.rendering",
)
"""The packages that djpt's own plugins stand in. Usually a plugin's file bears its name."""

LINE = re.compile(r'^register_(\w+)\("(\w+)"', re.MULTILINE)


@dataclass(frozen=True)
class PluginModule:
    """The `kind` of a plugin, and the `module` that registers it when it is imported."""

    kind: str
    module: str


@functools.cache
def plugin_module(name: str) -> PluginModule | None:
    """The module of djpt's plugin of that name, or None. The file of that name is read first, and usually no other."""
    if name.isidentifier():
        for package, folder in folders().items():
            file = folder / f"{name}.py"
            if file.is_file() and name in (found := modules_in(package, file)):
                return found[name]
    return plugin_modules().get(name)


@functools.cache
def plugin_modules() -> dict[str, PluginModule]:
    """The modules of all of djpt's plugins, by name."""
    found: dict[str, PluginModule] = {}
    for package, folder in folders().items():
        for file in sorted(folder.glob("*.py")):
            found |= modules_in(package, file)
    return found


@functools.cache
def folders() -> dict[str, Path]:
    """The folders of the packages; a package of plugins is on disk, as djpt is."""
    spec = find_spec("djpt")
    assert spec is not None and spec.submodule_search_locations
    djpt = Path(spec.submodule_search_locations[0])
    return {package: djpt.joinpath(*package.split(".")[1:]) for package in PACKAGES}


def modules_in(package: str, file: Path) -> dict[str, PluginModule]:
    """The modules of the plugins that a file of a package registers."""
    lines = LINE.findall(file.read_text(encoding="utf-8"))
    return {name: PluginModule(kind, f"{package}.{file.stem}") for kind, name in lines}

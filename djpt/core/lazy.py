"""Packages whose names are imported when they are first used.

A package that holds many plugins lists them under ``if TYPE_CHECKING``, where editors and type checkers find them::

    if TYPE_CHECKING:
        from djpt.shapes.cube import Cube as Cube
    else:
        __getattr__, __dir__, __all__ = lazily(__name__)

`lazily` reads the same lines from the package's source: nothing has to be listed twice, and a scene
imports the plugins that it has. A name may be that of a module.
"""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

__all__ = ["lazily"]

LINE = re.compile(r"^    from (djpt\S*) import (?:\(\n +)?(\w+) as (\w+)(?:,\n    \))?$", re.MULTILINE)


def lazily(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """The `__getattr__`, `__dir__` and `__all__` of a package that imports names at their first use.

    Modules of the package are attributes, too, as if they had been imported.
    """
    sources = {alias: (module, name) for module, name, alias in LINE.findall(source_of(package))}
    modules = {module.rpartition(".")[2]: module for module, _ in sources.values()}

    def attribute(name: str) -> Any:
        if name in sources:
            module, own_name = sources[name]
            # The package itself is asked for modules only.
            found = None if module == package else getattr(importlib.import_module(module), own_name, None)
            return importlib.import_module(f"{module}.{own_name}") if found is None else found
        if name in modules:
            return importlib.import_module(modules[name])
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    names = sorted(sources)
    return attribute, lambda: names, names


def source_of(package: str) -> str:
    """The source of a package; empty if there is none."""
    spec = sys.modules[package].__spec__
    read = getattr(spec.loader, "get_source", None) if spec is not None else None
    if read is not None:
        return read(package) or ""
    # Not all loaders can tell, such as that of pytest, which rewrites the modules of installed plugins.
    return Path(spec.origin).read_text(encoding="utf-8") if spec is not None and spec.origin is not None else ""

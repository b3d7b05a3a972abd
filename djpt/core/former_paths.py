"""The former import paths of public modules, which keep working: `djpt.types` is `djpt.jit.types`.

Plugins and scripts import from them, also by Mitsuba's paths (``djpt.ad.integrators.common``). Both paths give one
module, so classes are the same. The tree itself imports from where a module is.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType

__all__ = ["FORMER", "FormerPaths", "present_path"]

FORMER = {
    # what plugins and scripts import
    "djpt.arithmetic": "djpt.jit.kernels",
    "djpt.backends": "djpt.jit.backends",
    "djpt.kernels": "djpt.jit.kernels",
    "djpt.lookup": "djpt.jit.kernels",
    "djpt.types": "djpt.jit.types",
    "djpt.frame": "djpt.core.frame",
    "djpt.records": "djpt.core.records",
    "djpt.transforms": "djpt.core.transforms",
    "djpt.warp": "djpt.core.warp",
    "djpt.parameters": "djpt.description.parameters",
    "djpt.optimization": "djpt.apps.optimization",
    "djpt.optimization.bounds": "djpt.apps.optimization.variables",
    # Mitsuba's modules
    "djpt.ad": "djpt.mitsuba.ad",
    "djpt.ad.guiding": "djpt.integrators.projective.guiding",
    "djpt.ad.projective": "djpt.integrators.projective.detail",
    "djpt.ad.integrators.direct_projective": "djpt.integrators.direct_projective",
    "djpt.ad.integrators.prb_projective": "djpt.integrators.prb_projective",
    "djpt.ad.integrators.volprim_rf_basic": "djpt.integrators.volprim_rf_basic",
    "djpt.chi2": "djpt.mitsuba.chi2",
    "djpt.filesystem": "djpt.mitsuba.filesystem",
    "djpt.math": "djpt.mitsuba.math",
    "djpt.math_py": "djpt.mitsuba.math",
    "djpt.misc": "djpt.mitsuba.misc",
    "djpt.quad": "djpt.mitsuba.quad",
    "djpt.spline": "djpt.mitsuba.spline",
    "djpt.tensor_io": "djpt.mitsuba.tensor_io",
    "djpt.util": "djpt.mitsuba.util",
    "djpt.xml": "djpt.mitsuba.xml",
}
"""Modules and packages by their former paths; what stands in a package has moved along, but where it is listed."""


def present_path(name: str) -> str | None:
    """The present path of the module at a former path; None if `name` isn't one."""
    package, inside = name, ""
    while package:
        if package in FORMER:
            return FORMER[package] + inside
        package, _, last = package.rpartition(".")
        inside = f".{last}{inside}"
    return None


class FormerPaths:
    """Finds modules by their former paths: a finder, and the loader of what it finds.

    Without the base classes of `importlib.abc`, whose import takes longer than all else of ``import djpt``.
    """

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        return None if present_path(fullname) is None else ModuleSpec(fullname, self)  # type: ignore[arg-type]

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        present = present_path(spec.name)
        assert present is not None
        try:
            module = importlib.import_module(present)
        except ModuleNotFoundError as error:
            if error.name != present:
                raise
            raise ModuleNotFoundError(f"No module named {spec.name!r}", name=spec.name) from None
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        # The import system has given the module the spec of its former path.
        module.__spec__ = self._spec

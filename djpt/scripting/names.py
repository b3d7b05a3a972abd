"""Where the names for scripts are defined: the table that `djpt` looks them up in."""

from __future__ import annotations

__all__ = ["EXPORTS", "SUBMODULES", "VARIANT_MODULES"]

EXPORTS: dict[str, str] = {
    "djpt.scripting.variants": "is_monochromatic is_polarized is_rgb is_spectral scoped_set_variant variant_context",
}
"""The modules of names that are attributes of `djpt`, each with its names, separated by spaces."""

SUBMODULES: dict[str, str] = {}
"""Attributes of `djpt` that are modules, with the modules that they stand for."""

VARIANT_MODULES = ("llvm_ad_rgb", "cuda_ad_rgb", "scalar_rgb")
"""Mitsuba's modules that hold its names in one variant; here they are `djpt` itself."""

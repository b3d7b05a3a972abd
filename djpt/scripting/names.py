"""Where the names for scripts are defined: the table that `djpt` looks them up in."""

from __future__ import annotations

__all__ = ["EXPORTS", "SUBMODULES", "VARIANT_MODULES"]

EXPORTS: dict[str, str] = {
    "djpt.description.files": "FileResolver file_resolver set_file_resolver",
    "djpt.scripting.arguments": "ArgParser",
    "djpt.scripting.constants": (
        "DEBUG MI_AUTHORS MI_CIE_D65_NORMALIZATION MI_CIE_MAX MI_CIE_MIN MI_CIE_Y_NORMALIZATION MI_ENABLE_CUDA "
        "MI_ENABLE_EMBREE MI_ENABLE_METAL MI_FILTER_RESOLUTION MI_VERSION MI_VERSION_MAJOR MI_VERSION_MINOR "
        "MI_VERSION_PATCH MI_YEAR"
    ),
    "djpt.scripting.log": (
        "Appender DefaultFormatter Formatter Log LogLevel Logger StreamAppender log_level logger set_log_level "
        "set_logger"
    ),
    "djpt.scripting.objects": "Object ObjectType PluginManager TraversalCallback register_medium register_phase",
    "djpt.scripting.run": "Timer Version while_loop",
    "djpt.scripting.thread": "Thread",
    "djpt.scripting.variants": "is_monochromatic is_polarized is_rgb is_spectral scoped_set_variant variant_context",
}
"""The modules of names that are attributes of `djpt`, each with its names, separated by spaces."""

SUBMODULES: dict[str, str] = {
    "misc": "djpt.scripting.misc",
}
"""Attributes of `djpt` that are modules, with the modules that they stand for."""

VARIANT_MODULES = ("llvm_ad_rgb", "cuda_ad_rgb", "scalar_rgb")
"""Mitsuba's modules that hold its names in one variant; here they are `djpt` itself."""

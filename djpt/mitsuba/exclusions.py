"""The names of Mitsuba that djpt leaves out on purpose, each family with its reason."""

from __future__ import annotations

from fnmatch import fnmatchcase

__all__ = ["REASONS", "reason"]

POLARISATION = "Polarisation: djpt computes with unpolarised light."
SPECTRAL = "Spectral rendering: djpt computes with red, green and blue."
LOADER = "The stages of the C++ scene loader: `djpt.xml.read_file` gives a description as a dict that can be edited."
MACHINERY = "Machinery between C++ and Python that has nothing to connect here."
BLOCKS = "Blocks of a picture: `djpt.render_to_file` renders pictures band by band, `djpt.render_passes` in rounds."
COMMAND_LINES = "Command lines: Python has `argparse`."
COMPRESSION = "Streams that compress: Python's `gzip` works through any stream of djpt, and `zlib` packs bytes."
DEBUGGER = "A stop in a C++ debugger: Python has `breakpoint`."
PLANAR = "Transforms of the line don't exist in Python: Mitsuba raises a TypeError, too."

REASONS: dict[str, str] = {
    "mueller": POLARISATION,
    "mueller.*": POLARISATION,
    "srgb_model_*": SPECTRAL,
    "Conditional*1DSpectrum*": SPECTRAL,
    "Texture.spectral_resolution": SPECTRAL,
    "Texture.wavelength_range": SPECTRAL,
    "TexturePtr.*spectrum": SPECTRAL,
    "parser": LOADER,
    "parser.*": LOADER,
    "Properties.Reference*": LOADER,
    "Properties.ResolvedReference*": LOADER,
    "detail": MACHINERY,
    "detail.*": MACHINERY,
    "StructConverter*": MACHINERY,
    "Object.ptr": MACHINERY,
    "get_property": MACHINERY,
    "set_property": MACHINERY,
    "*Transform3?.extract": PLANAR,
    "misc.trap_debugger": DEBUGGER,
    "Spiral": BLOCKS,
    "Spiral.*": BLOCKS,
    "ArgParser": COMMAND_LINES,
    "ArgParser.*": COMMAND_LINES,
    "ZStream": COMPRESSION,
    "ZStream.*": COMPRESSION,
}
"""Reasons by pattern. ``*`` stands for any characters, as in file names."""


def reason(path: str) -> str:
    """Why a name is left out; empty if there is no reason."""
    return next((why for pattern, why in REASONS.items() if fnmatchcase(path, pattern)), "")

"""Stored references: images with their noise and where they come from, in one small EXR file.

A file has the mean image, the variance of a batch's pixels in the layer ``variance``, and in its metadata the number
of batches, their samples and seeds, their averages over cells and what was rendered. That is what the tests of
`djpt.validation.statistics` need, so an image of today is tested against one of last year as if both had been
rendered now.
"""

from __future__ import annotations

import base64
import importlib.metadata
import json
import os
import platform
import sys
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any

import numpy as np

from djpt.errors import FileError
from djpt.images.exr import usual_names
from djpt.images.image import read_metadata, read_pixels, write
from djpt.jit.backends import variant
from djpt.validation.statistics import CELL, Batches
from djpt.version import __version__

__all__ = ["Reference", "is_reference", "machine", "read_reference", "readable", "versions", "write_reference"]

FORM = "djpt.reference"
"""The name of the metadata that make an EXR a reference, with the number of its form."""

VERSION = "1"


@dataclass(frozen=True)
class Reference:
    """An image with its noise.

    * `batches`: the mean and the variance; see `djpt.validation.statistics`.
    * `batch_spp`: samples per pixel of one batch.
    * `seeds`: the seed of each batch.
    * `independent_pixels`: whether it is known that pixels share no samples.
    * `facts`: what was rendered, when, by which versions, on which machine.
    """

    batches: Batches
    batch_spp: int
    seeds: tuple[int, ...]
    independent_pixels: bool = False
    facts: Mapping[str, Any] = field(default_factory=dict)


def write_reference(path: str | os.PathLike[str], reference: Reference) -> None:
    """Write a reference as an EXR, with the versions, the machine and the date. Raises `FileError`."""
    if not os.fspath(path).lower().endswith(".exr"):
        raise FileError(f"can't write '{path}': a reference is an exr")
    batches = reference.batches
    moments = batches.pixels()
    names = usual_names(moments.mean.shape[2])
    cells = np.asarray(batches.cells, "<f4")
    facts = {
        **reference.facts,
        "versions": versions(),
        "machine": machine(),
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
    }
    write(
        path,
        np.concatenate([moments.mean, moments.variance], axis=2).astype(np.float32),
        [*names, *(f"variance.{name}" for name in names)],
        {
            FORM: VERSION,
            f"{FORM}.batch_spp": reference.batch_spp,
            f"{FORM}.seeds": json.dumps(list(reference.seeds)),
            f"{FORM}.independent": json.dumps(reference.independent_pixels),
            f"{FORM}.shape": json.dumps(cells.shape),
            f"{FORM}.cells": base64.b64encode(zlib.compress(cells.tobytes(), 9)).decode("ascii"),
            f"{FORM}.facts": json.dumps(facts),
        },
    )


def is_reference(path: str | os.PathLike[str]) -> bool:
    """True if a file is one that `write_reference` wrote. Raises `FileError` for files that can't be read."""
    return os.fspath(path).lower().endswith(".exr") and FORM in read_metadata(path)


def read_reference(path: str | os.PathLike[str]) -> Reference:
    """Read what `write_reference` wrote. Raises `FileError` for other files and damaged ones."""
    found = read_metadata(path)
    if found.get(FORM) != VERSION:
        stated = f"of form {found[FORM]}" if FORM in found else "an image without its noise"
        raise FileError(
            f"'{path}' is {stated}, not a reference of form {VERSION}: write a new one with write_reference"
        )
    try:
        shape = tuple(json.loads(found[f"{FORM}.shape"]))
        data = zlib.decompress(base64.b64decode(found[f"{FORM}.cells"]))
        cells = np.frombuffer(data, "<f4").reshape(shape)
        pixels = read_pixels(path)
        channels = pixels.shape[2] // 2
        expected = (-(-pixels.shape[0] // CELL), -(-pixels.shape[1] // CELL), channels)
        if cells.shape[1:] != expected or pixels.shape[2] != 2 * channels:
            raise ValueError(f"cells of shape {cells.shape[1:]}, {expected} expected")
        return Reference(
            Batches.restored(pixels[..., :channels], pixels[..., channels:], cells),
            int(found[f"{FORM}.batch_spp"]),
            tuple(json.loads(found[f"{FORM}.seeds"])),
            json.loads(found[f"{FORM}.independent"]),
            json.loads(found[f"{FORM}.facts"]),
        )
    except (KeyError, ValueError, TypeError, zlib.error) as error:
        raise FileError(f"'{path}' is a damaged reference: {error}") from error


# ---- the origin of images: versions, the machine, descriptions as text -----------------------


LONGEST = 64
"""The numbers of an array that are written out; larger arrays are named by their shape."""

PACKAGES = ("drjit", "mitsuba", "numpy", "scipy", "flip-evaluator")


def versions() -> dict[str, str]:
    """The versions of djpt, Python and the packages that matter, where they are installed, and djpt's variant."""
    found = {"djpt": __version__, "Python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {**found, "variant": variant()}


def machine() -> dict[str, str]:
    """The system, the processor and its number of threads."""
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "processor": processor(),
        "threads": str(os.cpu_count() or 1),
    }


def processor() -> str:
    """The name of the processor, as far as the system tells."""
    if sys.platform == "linux":
        try:
            with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
                names = (line.partition(":")[2].strip() for line in file if line.startswith("model name"))
                return next(names, "unknown")
        except OSError:
            pass
    return platform.processor() or "unknown"


def readable(value: Any) -> Any:
    """A description as JSON can hold it: arrays as lists if they are small, everything else by its type's name."""
    if isinstance(value, Mapping):
        return {str(key): readable(inner) for key, inner in value.items()}
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, float):
        return value if np.isfinite(value) else str(value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "matrix"):
        return readable(value.matrix)
    if isinstance(value, (list, tuple)) and len(value) <= LONGEST:
        return [readable(inner) for inner in value]
    try:
        array = np.array(value)
    except (TypeError, ValueError, RuntimeError):
        return type(value).__name__
    if array.dtype.kind not in "fiub":
        return type(value).__name__
    if array.size > LONGEST:
        return f"array {array.shape} of {array.dtype}"
    return [readable(inner) for inner in array.tolist()] if array.ndim else readable(array.item())

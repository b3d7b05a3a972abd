"""Shared parts of commands that write pictures: tone mapping, channels, and the metadata of files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import djpt
from djpt.apps.cli.console import number_or_word
from djpt.errors import RenderError
from djpt.images.formats import DISPLAY_FORMATS, METADATA

__all__ = ["Tone", "carried", "channels_for", "layers"]


class Tone:
    """The options of tone mapping, checked before anything is rendered.

    Args:
        target: the picture's file.
        operator: see `djpt.tonemap`.
        exposure: stops, or ``auto``.
        white_balance: kelvin, or three numbers with commas.

    Raises:
        RenderError: the file isn't a picture for displays, or an option is wrong.
    """

    def __init__(self, target: Path, operator: str, exposure: str, white_balance: str | None) -> None:
        if target.suffix.lower() not in DISPLAY_FORMATS:
            raise RenderError(f"tone-mapped pictures are written as png or jpg, found '{target}'")
        self.operator = operator
        self.exposure: float | str = number_or_word(exposure)
        self.white_balance: Any = None
        if white_balance is not None:
            parts = [number_or_word(part) for part in white_balance.split(",")]
            self.white_balance = parts[0] if len(parts) == 1 else parts
        self.apply(np.zeros((1, 1, 3), np.float32))
        self.facts = {"tonemap": operator, "exposure": exposure}
        if white_balance is not None:
            self.facts["whiteBalance"] = white_balance

    def apply(self, image: Any) -> Any:
        """The image for displays."""
        return djpt.tonemap(image, self.operator, self.exposure, self.white_balance)


def carried(target: Path, facts: dict[str, Any]) -> dict[str, Any]:
    """The metadata, if a file of this format can carry them; else none."""
    return facts if target.suffix.lower() in METADATA else {}


# ---- the part of an image that goes into a file ----------------------------------------------


def channels_for(target: Path, names: Sequence[str], colours: int) -> int:
    """The number of an image's channels, from the first, that are written to a file: all, or those of the colour.

    Args:
        target: the file, whose extension is one of the known formats.
        names: of all channels.
        colours: how many of them are the colour's, perhaps with alpha, which is left out where a format has none.

    Raises:
        RenderError: the format doesn't hold this colour.
    """
    from djpt.images.formats import FORMATS

    suffix = target.suffix.lower()
    possible = FORMATS[suffix].channels
    if not possible or len(names) in possible:
        return len(names)
    for count in (colours, colours - 1) if names[colours - 1] == "A" else (colours,):
        if count in possible:
            return count
    raise RenderError(
        f"can't write '{target}': {suffix[1:]} holds {' or '.join(map(str, possible))} channels, this film makes "
        f"{' '.join(names[:colours])}; exr and npy hold any"
    )


def layers(names: Sequence[str]) -> list[str]:
    """The layers that channels belong to, such as ``albedo`` for ``albedo.R``, in order and once each."""
    return list(dict.fromkeys(name.rpartition(".")[0] or name for name in names))

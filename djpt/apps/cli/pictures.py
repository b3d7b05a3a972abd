"""The part of an image that goes into a file: pictures hold colours, layers need other formats."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from djpt.errors import RenderError

__all__ = ["channels_for", "layers"]


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

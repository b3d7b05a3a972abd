"""Shared parts of the commands that write strips of pictures."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import djpt
from djpt.apps.cli.console import say
from djpt.errors import RenderError
from djpt.images.formats import DISPLAY_FORMATS
from djpt.images.image import check_writable
from djpt.images.sheets import captioned_rows, captioned_sheet

if TYPE_CHECKING:
    from djpt.images.sheets import Tile

__all__ = ["checked", "write", "write_rows"]


def checked(target: Path) -> Path:
    """Check that a strip can be written to a file, and return its path.

    Raises:
        RenderError: it isn't the name of a picture for displays.
        FileError: the file can't be written.
    """
    check_writable(target)
    if target.suffix.lower() not in DISPLAY_FORMATS:
        raise RenderError(f"a strip has labels, so it is written as png or jpg, found '{target}'")
    return target


def write(target: Path, tiles: list[Tile], columns: int | None, start: float, quiet: bool) -> None:
    """Write the strip, and print its size and the time since `start`, of `time.perf_counter`."""
    djpt.write(target, captioned_sheet(tiles, columns))
    report(target, tiles, start, quiet)


def write_rows(target: Path, rows: list[list[Tile]], start: float, quiet: bool) -> None:
    """Write a picture of rows of tiles of different lengths, which are centred."""
    djpt.write(target, captioned_rows(rows))
    report(target, [tile for row in rows for tile in row], start, quiet)


def report(target: Path, tiles: list[Tile], start: float, quiet: bool) -> None:
    """Print the size of a strip and the time since `start`, unless all is to be `quiet`."""
    if not quiet:
        height, width, _ = tiles[0].picture.shape
        say(f"{target}: {len(tiles)} pictures of {width} x {height}, {time.perf_counter() - start:.2f} s")

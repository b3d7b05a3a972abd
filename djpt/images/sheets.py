"""Captioned sheets: pictures side by side in rows, each with a title and a subtitle below it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from djpt.images.image import Image

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont, ImageFont

__all__ = ["DARK", "LIGHT", "Tile", "captioned_rows", "captioned_sheet", "enlarged", "fitting_font", "shown"]

Bytes = npt.NDArray[np.uint8]
Color = tuple[int, int, int]


class Palette(NamedTuple):
    """The colours of a sheet, in sRGB."""

    paper: Color
    title: Color
    subtitle: Color


LIGHT = Palette((250, 250, 248), (28, 28, 30), (110, 110, 114))
"""Dark text on white paper."""

DARK = Palette((24, 24, 24), (230, 230, 230), (160, 160, 160))
"""Light text on black paper, for pictures with a white background."""


@dataclass(frozen=True)
class Tile:
    """A picture of a sheet, (H, W, 3) bytes of sRGB, with a title and a subtitle.

    In both, ``K^2`` is written with a raised 2.
    """

    title: str
    subtitle: str
    picture: Bytes


def shown(image: Any) -> Bytes:
    """Convert an image of any number of channels to a picture, (H, W, 3) bytes of sRGB; see `djpt.Image`."""
    pixels = Image(image).srgb()
    return pixels[..., :3] if pixels.shape[2] >= 3 else pixels[..., :1].repeat(3, axis=2)


def enlarged(picture: Bytes, width: int = 256) -> Bytes:
    """Show pixels as squares if a picture is narrower than `width`: larger by the least whole factor that reaches it.

    The captions of very small pictures would not be legible.
    """
    factor = -(-width // picture.shape[1])
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


def captioned_sheet(tiles: Sequence[Tile], columns: int | None = None, palette: Palette = LIGHT) -> Bytes:
    """Put tiles side by side, with their captions below them: (H, W, 3) bytes of sRGB.

    Args:
        tiles: The tiles, row by row; their pictures have the same size.
        columns: Tiles in a row (default: all).
        palette: The colours of paper and captions.
    """
    columns = min(columns or len(tiles), len(tiles))
    return captioned_rows([tiles[i : i + columns] for i in range(0, len(tiles), columns)], palette, centred=False)


def captioned_rows(rows: Sequence[Sequence[Tile]], palette: Palette = LIGHT, *, centred: bool = True) -> Bytes:
    """Put rows of tiles below each other, with their captions: (H, W, 3) bytes of sRGB.

    Args:
        rows: The rows; all pictures have the same size.
        palette: The colours of paper and captions.
        centred: Whether shorter rows stand in the middle; else they begin on the left.
    """
    from PIL import Image as Picture
    from PIL import ImageDraw

    columns = max(len(row) for row in rows)
    height, width, _ = rows[0][0].picture.shape
    gap, text = max(2, width // 20), max(9, width // 14)
    caption = round(2.9 * text)
    size = (columns * (width + gap) + gap, len(rows) * (height + caption + gap) + gap)
    page = Picture.new("RGB", size, palette.paper)
    draw = ImageDraw.Draw(page)
    for j, row in enumerate(rows):
        left = gap + centred * (columns - len(row)) * (width + gap) // 2
        for i, tile in enumerate(row):
            x, y = left + i * (width + gap), gap + j * (height + caption + gap)
            page.paste(Picture.fromarray(tile.picture), (x, y))
            write_line(draw, tile.title, (x, y + height + 0.25 * text), width, text + 1, palette.title)
            write_line(draw, tile.subtitle, (x, y + height + 1.5 * text), width, text, palette.subtitle)
    return np.array(page)


def write_line(draw: ImageDraw, line: str, corner: tuple[float, float], width: int, height: int, color: Color) -> None:
    """Write a line in the middle of a tile; ``^`` raises the digits that follow it."""
    pieces = [piece for piece in re.split(r"(\^\d+)", line) if piece]
    font = fitting_font(line.replace("^", ""), height, width)
    raised = fitting_font("0", max(6, round(0.7 * height)), width)
    fonts = [raised if piece.startswith("^") else font for piece in pieces]
    words = [piece.removeprefix("^") for piece in pieces]
    x = corner[0] + (width - sum(f.getlength(word) for f, word in zip(fonts, words, strict=True))) / 2
    for word, f in zip(words, fonts, strict=True):
        top = corner[1] - (0.15 * height if f is raised else 0)
        draw.text((x, top), word, color, f, anchor="la")
        x += f.getlength(word)


def fitting_font(line: str, height: int, width: int) -> ImageFont | FreeTypeFont:
    """Pillow's own font, `height` pixels high if the line fits into `width`, otherwise smaller, at least 6 pixels."""
    from PIL import ImageFont as fonts

    for points in range(max(height, 6), 5, -1):
        font = fonts.load_default(points)
        if font.getlength(line) <= width:
            break
    return font

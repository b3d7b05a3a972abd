"""The pictures of results: panels side by side, and differences in red and blue."""

from __future__ import annotations

import html
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from djpt.core.files import as_path, check_target, writing
from djpt.errors import FileError
from djpt.images.formats import DISPLAY_FORMATS
from djpt.images.image import Image, png_address, write

__all__ = ["Bytes", "Pictured", "aligned", "check_page", "difference_picture", "document", "read_beside", "write_page"]

Bytes = npt.NDArray[np.uint8]


class Pictured:
    """A result that is also a picture, for files and for notebooks."""

    title: ClassVar[str]
    """The kind of result, for messages."""

    def picture(self) -> Bytes:
        """The picture, sRGB (H, W, 3)."""
        raise NotImplementedError

    @classmethod
    def check_picture(cls, path: str | os.PathLike[str]) -> None:
        """Raise `FileError` unless the picture can have this name; ask before rendering."""
        if Path(path).suffix.lower() not in DISPLAY_FORMATS:
            raise FileError(f"can't write '{path}': the picture of {cls.title} is a png or a jpg")

    def write_picture(self, path: str | os.PathLike[str]) -> None:
        """Write `picture` as png or jpg. Raises `FileError`."""
        self.check_picture(path)
        write(path, self.picture())

    def _repr_png_(self) -> bytes:
        """The picture as a PNG, for notebooks."""
        return Image(self.picture())._repr_png_()

    def _repr_html_(self) -> str:
        """The picture and the table, for notebooks."""
        return f'<img src="{png_address(self._repr_png_())}"><pre>{html.escape(str(self))}</pre>'


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """The rows of a table as lines of text, with their cells below each other."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [f"  {'  '.join(map(str.ljust, row, widths))}".rstrip() for row in rows]


def difference_picture(image: Any, reference: Any, scale: float) -> Bytes:
    """Draw the signed difference, (H, W, 3): white for 0, red for +scale and more, blue for -scale and less."""
    signed = np.mean(np.asarray(image, np.float64) - np.asarray(reference, np.float64), axis=2) / scale
    away = np.clip(np.abs(signed), 0, 1)[..., None]
    hue = np.where(signed[..., None] > 0, np.array([178.0, 24, 43]), np.array([33.0, 102, 172]))
    return np.asarray(np.rint(255 + (hue - 255) * away), np.uint8)


def read_beside(module: str, name: str) -> str:
    """Read a text file in the folder of a module, given by its ``__file__``."""
    return Path(module).with_name(name).read_text(encoding="utf-8")


def check_page(path: str | os.PathLike[str], what: str) -> Path:
    """The path of a page; raises `FileError` unless it can have this name and be written. Ask before rendering."""
    target = as_path(path)
    if target.suffix.lower() not in (".html", ".htm"):
        raise FileError(f"can't write '{target}': {what} is a page, .html")
    check_target(target)
    return target


def write_page(target: Path, text: str) -> None:
    """Write a page. Names of files in it may hold bytes that aren't UTF-8."""
    with writing(target) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="replace")


def document(title: str, style: str, parts: Iterable[str], end: str) -> str:
    """A page of HTML: its title, its style, the parts of its body that aren't empty, and what follows them."""
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<link rel="icon" href="data:,">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<title>{title}</title>\n'
        f"<style>\n{style}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(part for part in parts if part)
        + f"\n</main>\n{end}\n</body>\n</html>\n"
    )

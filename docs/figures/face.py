"""What the code of the README and of the gallery writes."""

from __future__ import annotations

import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

import djpt
from djpt.images.sheets import Tile, captioned_sheet
from places import IMAGES, ROOT

__all__ = ["gallery", "script"]

PICTURES = {"image.png": "the image", "derivative.png": "its derivative by the paint of the left wall"}

PAGE = ROOT / "docs" / "gallery.md"

CODE = re.compile(r"^```python\n(.*?)^```\n", re.MULTILINE | re.DOTALL)
ENTRY = re.compile(r"^```python\n(.*?)^```\n\n\*.*?\*", re.MULTILINE | re.DOTALL)
"""An entry of the gallery: its code, and the words about its time."""


def run(code: str, folder: Path) -> float:
    """Run a script in a folder, by a process of its own; return the seconds of CPU time that it took."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "HOME": str(folder)}  # a home without compiled kernels
    subprocess.run([sys.executable, "-c", code], cwd=folder, env=environment, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def script() -> None:
    """The two pictures of the README's code, side by side."""
    (code,) = CODE.findall((ROOT / "README.md").read_text())
    with tempfile.TemporaryDirectory() as folder:
        run(code, Path(folder))
        tiles = [
            Tile(name, words, np.array(Image.open(Path(folder, name)).convert("RGB")))
            for name, words in PICTURES.items()
        ]
    djpt.write(IMAGES / "script.png", captioned_sheet(tiles))


def gallery() -> None:
    """The pictures of the gallery, and the times that its page gives."""
    (IMAGES / "gallery").mkdir(exist_ok=True)
    for code in CODE.findall(PAGE.read_text()):
        with tempfile.TemporaryDirectory() as folder:
            seconds = run(code, Path(folder))
            (picture,) = Path(folder).glob("*.png")
            shutil.copy(picture, IMAGES / "gallery")
        PAGE.write_text(PAGE.read_text().replace(*with_time(code, seconds)))


def with_time(code: str, seconds: float) -> tuple[str, str]:
    """An entry of the gallery's page, and the same with another time."""
    old = next(entry[0] for entry in ENTRY.finditer(PAGE.read_text()) if entry[1] == code)
    return old, f"```python\n{code}```\n\n*{seconds:.0f} s*"

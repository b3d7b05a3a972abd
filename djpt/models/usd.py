"""Models in USD (.usd, .usda, .usdc, .usdz), read by the package usd-core in a process of its own.

The library never ends on some damaged files, or ends the process: there it can be stopped.
"""

from __future__ import annotations

import importlib.util
import os
import pickle
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

from djpt.errors import DjptError, FileError, SceneError
from djpt.models.folder import Folder
from djpt.models.model import Model

__all__ = ["read_usd"]

MOST_SECONDS = 60
"""The processor time that reading may take, plus `SECONDS_PER_MEGABYTE`."""
SECONDS_PER_MEGABYTE = 4
MOST_MEMORY = 2**33
"""The bytes that reading may take."""

CHILD = "from djpt.models.usd import child; child()"


def read_usd(data: bytes, folder: Folder, name: str, *, time: float | None = None, texture_size: int = 2048) -> Model:
    """Read a USD file.

    Args:
        data: the file's contents, which the library reads once more.
        folder: where the file and the layers and textures that it names are.
        name: the file's name.
        time: the time in seconds; default: the first one of each value.
        texture_size: textures with more rows or columns are made smaller.

    Raises:
        FileError: usd-core isn't installed, or a layer is outside of the folder.
        SceneError: the file is damaged, or takes too long to read.
    """
    if importlib.util.find_spec("pxr") is None:
        raise FileError(f"{name}: needs the package usd-core: pip install usd-core")
    seconds = MOST_SECONDS + SECONDS_PER_MEGABYTE * len(data) // 2**20
    request = (folder.path, folder.root, name, time, texture_size, seconds)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    try:
        answer = subprocess.run(
            [sys.executable, "-c", CHILD],
            input=pickle.dumps(request),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=20 * seconds,  # of a process that sleeps
            env=environment,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise SceneError(f"{name}: can't be read: it takes too long") from None
    if answer.returncode or not answer.stdout:
        raise SceneError(f"{name}: can't be read: the library ended with the code {answer.returncode}")
    found, said, files = pickle.loads(answer.stdout)
    folder.files += files
    if isinstance(found, DjptError):
        raise found
    model: Model = found
    for text in said:
        model.say(text)
    return model


def child() -> None:
    """Read the file that the parent asks for, within limits, and send it the model or the error."""
    path, root, name, time, texture_size, seconds = pickle.loads(sys.stdin.buffer.read())
    limit(seconds)
    answer = os.dup(1)
    os.dup2(2, 1)  # whatever the library prints
    from djpt.models.usd_stage import read_stage

    folder = Folder(path, root)
    said: list[str] = []
    found: Any
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = read_stage(folder, name, time, texture_size)
            said, found.said = sorted(found.said), set()
        except DjptError as error:
            found = error
        except MemoryError:
            found = SceneError(f"{name}: doesn't fit into memory")
    files: list[Path] = folder.files
    with os.fdopen(answer, "wb") as stream:
        pickle.dump((found, said, files), stream, protocol=5)
    os._exit(0)  # the library's clean-up takes long


def limit(seconds: int) -> None:
    """Limit the processor time and the memory of this process, by less where it has limits already."""
    import resource

    for kind, wanted in ((resource.RLIMIT_CPU, seconds), (resource.RLIMIT_AS, MOST_MEMORY)):
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (wanted if hard == resource.RLIM_INFINITY else min(wanted, hard), hard))

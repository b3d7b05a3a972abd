"""Scenes measured one after the other, each in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from fnmatch import fnmatch
from pathlib import Path
from xml.etree import ElementTree

from djpt.apps.benchmarks.one_scene import Options
from djpt.apps.benchmarks.table import SceneRow
from djpt.errors import SceneError
from djpt.scenes.overrides import described

__all__ = ["measured", "scenes_named"]

FRAGMENTS = {"include", "includes", "fragments"}
"""Folders of files that are included by others."""


def scenes_named(names: Sequence[str], only: str = "") -> list[tuple[str, str]]:
    """The scenes that files, folders and built-in names stand for, each with a short name.

    Of a folder, all files of scenes in it and below that have a sensor, except for those in folders of fragments.
    `only`: a part of their relative paths, or a pattern with ``*``.

    Raises:
        SceneError: There is no such scene, or a folder has none.
        FileError: There is no such file.
    """
    found = []
    for name in names:
        folder = Path(name)
        if folder.is_dir():
            files = list(scene_files(folder, only))
            if not files:
                raise SceneError(f"'{name}' has no scene file (XML with a sensor) whose path contains '{only}'")
            found += [(file.relative_to(folder).as_posix(), str(file)) for file in files]
            continue
        if not folder.suffix:
            described(name)  # raises if it isn't built in
        elif not folder.is_file():
            described(folder)
        found.append((folder.name, str(folder)))
    return found


def scene_files(folder: Path, only: str) -> Iterator[Path]:
    """Find the files of whole scenes below `folder` whose relative paths match `only` or contain it."""
    for file in sorted(folder.rglob("*.xml")):
        place = file.relative_to(folder)
        chosen = only in place.as_posix() or fnmatch(place.as_posix(), only)
        if chosen and not FRAGMENTS & set(place.parts) and has_sensor(file):
            yield file


def has_sensor(file: Path) -> bool:
    """Whether a file, or one that it includes, is a scene with a sensor; an unreadable one might be."""
    try:
        root = ElementTree.parse(file).getroot()
    except (OSError, ElementTree.ParseError):
        return True
    if root.tag != "scene":
        return False
    included = [file.parent / node.get("filename", "") for node in root.iter("include")]
    return root.find(".//sensor") is not None or any(other.is_file() and has_sensor(other) for other in included)


def measured(name: str, scene: str, options: Options, limit: float) -> SceneRow:
    """Measure a scene in a process of its own with an empty kernel cache, for at most `limit` seconds."""
    with tempfile.TemporaryDirectory() as folder:
        into = Path(folder) / "results.json"
        words = [scene, str(into), json.dumps(asdict(options))]
        command = [sys.executable, "-m", "djpt.apps.benchmarks.one_scene", *words]
        environment = {**os.environ, "DRJIT_CACHE_DIR": folder}
        end = None
        try:
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True, errors="replace", timeout=limit
            )
            if done.returncode:
                lines = done.stderr.strip().splitlines()
                end = f"ended with code {done.returncode}: {lines[-1] if lines else ''}"
        except subprocess.TimeoutExpired:
            end = f"took longer than {limit:g} s"
        found = json.loads(into.read_text()) if into.exists() else {"failures": {}}
        if end:
            who, what = found.get("stage") or ("both", "start")
            found["failures"][who] = f"{what}: {end}"
        # Messages name files by their whole paths.
        for who, why in found["failures"].items():
            found["failures"][who] = why.replace(f"{Path(scene).resolve().parent}/", "")
        return SceneRow.of(name, found)

"""All scene files of a folder in both renderers: times of loading and rendering, and equality of the images.

    python benchmarks/scenes.py FOLDER [--only PATTERN] [--width N] [--spp N] [--pairs N] [--lanes 8]
                                       [--define NAME=VALUE] [--json FILE] [--markdown]

Finds the scene files (XML) in FOLDER and below that have a sensor, except in folders of fragments. Integrator, sampler
and all else are the file's; the film is at most `--width` pixels wide, and the samples at most `--spp`. Each scene
gets a process of its own with an empty kernel cache, so that one that fails, or takes too long, doesn't end the run.
Exit code 1: no scene was shown by both renderers.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path
from xml.etree import ElementTree

import mitsuba as mi
from pairs import heading, machine
from scene_table import HEADING, SceneRow, line, markdown, numbers, summary

from djpt.jit.backends import load_backend
from djpt.jit.llvm.lanes import force_lanes

FRAGMENTS = {"include", "includes", "fragments"}
"""Folders of files that are included by others."""


def scene_files(folder: Path, pattern: str) -> Iterator[Path]:
    """Find the files of whole scenes below `folder` whose relative paths match `pattern` or contain it."""
    for file in sorted(folder.rglob("*.xml")):
        place = file.relative_to(folder)
        chosen = pattern in str(place) or fnmatch(str(place), pattern)
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


def measured(file: Path, name: str, arguments: argparse.Namespace) -> SceneRow:
    """Measure one scene in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        into = Path(folder) / "results.json"
        options = {key: getattr(arguments, key) for key in ("width", "spp", "pairs", "lanes")}
        options["define"] = dict(pair.split("=", 1) for pair in arguments.define)
        script = str(Path(__file__).with_name("one_scene.py"))
        command = [sys.executable, script, str(file), str(into), json.dumps(options)]
        environment = {**os.environ, "DRJIT_CACHE_DIR": folder}
        end = None
        try:
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True, errors="replace", timeout=arguments.limit
            )
            if done.returncode:
                words = done.stderr.strip().splitlines()
                end = f"ended with code {done.returncode}: {words[-1] if words else ''}"
        except subprocess.TimeoutExpired:
            end = f"took longer than {arguments.limit:g} s"
        found = json.loads(into.read_text()) if into.exists() else {"failures": {}}
        if end:
            who, what = found.get("stage") or ("both", "start")
            found["failures"][who] = f"{what}: {end}"
        # Messages name files by their whole paths.
        for who, why in found["failures"].items():
            found["failures"][who] = why.replace(f"{arguments.folder.resolve()}/", "")
        return SceneRow.of(name, found)


def main() -> int:
    """Measure all scenes and print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path, help="where the scene files are, at any depth")
    parser.add_argument("--only", default="", metavar="PATTERN", help="a part of relative paths, or a pattern with *")
    parser.add_argument("--width", type=int, default=320, help="films are at most this wide (default 320)")
    parser.add_argument("--spp", type=int, default=16, help="samples per pixel at most (default 16)")
    parser.add_argument("--pairs", type=int, default=5, help="pairs of images of each scene (default 5)")
    parser.add_argument("--define", action="append", default=[], metavar="NAME=VALUE", help="for files that use $NAME")
    parser.add_argument("--limit", type=float, default=120, help="seconds that a scene may take (default 120)")
    parser.add_argument("--lanes", type=int, choices=(8, 16), help="compile for AVX2 or AVX-512")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers to FILE as well")
    parser.add_argument("--markdown", action="store_true", help="print the table in Markdown, too")
    arguments = parser.parse_args()
    if min(arguments.width, arguments.spp, arguments.pairs) < 1:
        parser.error("--width, --spp and --pairs must be at least 1")
    if not all("=" in pair for pair in arguments.define):
        parser.error("--define needs NAME=VALUE")
    if not arguments.folder.is_dir():
        parser.error(f"{arguments.folder} is no folder")

    mi.set_variant("llvm_ad_rgb")
    djpt.set_variant("llvm_ad_rgb")
    load_backend()
    if arguments.lanes:
        force_lanes(arguments.lanes)
    facts = machine()
    what = f"{arguments.width} pixels wide at most, {arguments.spp} spp at most, {arguments.pairs} pairs"
    print(heading(facts, what))
    print(HEADING)
    rows: list[SceneRow] = []
    for file in scene_files(arguments.folder, arguments.only):
        rows.append(measured(file, str(file.relative_to(arguments.folder)), arguments))
        print(line(rows[-1]), flush=True)
        if arguments.json:
            table = {"machine": facts, "what": what, "rows": [numbers(row) for row in rows]}
            arguments.json.write_text(json.dumps(table, indent=1) + "\n")
    print("\n".join(summary(rows)))
    if arguments.markdown:
        print("\n" + markdown(rows))
    return 0 if any(row.image for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())

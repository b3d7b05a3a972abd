"""Make a release: ``make release``, or ``python packaging/release.py [--dirty] [--sign]``.

In `dist/`, for the version of `djpt/version.py`, which must be a section of the changelog with its date:

* the source archive and the wheel;
* ``djpt-VERSION.cdx.json``: a bill of materials (CycloneDX) of all that the wheel brings into an empty environment;
* ``SHA256SUMS``, with ``--sign`` also its signature by gpg, ``SHA256SUMS.asc``;
* ``NOTES.md``: the section of the changelog, how the wheel was tried, and the hashes.

The wheel is tried as a stranger would: in a new environment, with an empty home, one command fetches LLVM if the system
has none and renders a picture. Needs the package index. Nothing is published, and no tag is made: the last lines
printed say how to.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import platform
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"

FIRST_PICTURE = 60.0
"""Seconds of CPU time in which a stranger has the first picture, from the installed wheel on."""

SBOM_TOOL = "cyclonedx-bom>=7,<8"


def version() -> str:
    """The version of the source tree."""
    return re.findall(r'^__version__ = "(.+)"$', (ROOT / "djpt" / "version.py").read_text(), re.MULTILINE)[0]


def changes(text: str, version: str) -> str:
    """The section of a version in the changelog `text`; ends the program if it has none with a date."""
    match = re.search(rf"^## \[{re.escape(version)}\] - \d{{4}}-\d\d-\d\d\n(.*?)(?=^## \[|\Z)", text, re.M | re.S)
    if not match or not match[1].strip():
        sys.exit(f"CHANGELOG.md has no section '## [{version}] - YYYY-MM-DD' that says something")
    return match[1].strip()


def run(command: Sequence[str | Path], **options: object) -> str:
    """Run a command and return what it prints; end the program with that if it fails."""
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False, **options)  # type: ignore[call-overload]
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}: status {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def build() -> list[Path]:
    """The source archive and the wheel, with the time of the last commit, so that they can be built again alike."""
    shutil.rmtree(DIST, ignore_errors=True)
    moment = run(["git", "log", "-1", "--format=%ct"], cwd=ROOT).strip()
    run(
        [sys.executable, "-m", "hatchling", "build", "-d", DIST],
        cwd=ROOT,
        env={**os.environ, "SOURCE_DATE_EPOCH": moment},
    )
    return sorted(DIST.iterdir())


def cpu_time() -> float:
    """Seconds of CPU time of all processes that have ended: what else runs doesn't count."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def environment(folder: Path, *packages: str | Path) -> Path:
    """The interpreter of a new virtual environment with some packages."""
    venv.create(folder, with_pip=True)
    python = folder / "bin" / "python"
    run([python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *packages])
    return python


def tried(wheel: Path, bill: Path, folder: Path) -> str:
    """Try the wheel in an empty environment with an empty home, and write its bill of materials; say how it went."""
    began = time.monotonic()
    python = environment(folder / "venv", wheel)
    installed, before = time.monotonic(), cpu_time()
    home = folder / "home"
    home.mkdir()
    bare = {"HOME": str(home), "PATH": f"{python.parent}:/usr/bin:/bin"}
    run([python.parent / "djpt", "render", "cornell_box", "-o", "first.png"], cwd=home, env=bare)
    rendered, used = time.monotonic(), cpu_time() - before
    if used > FIRST_PICTURE:
        sys.exit(f"the first picture took {used:.0f} s of CPU time, more than {FIRST_PICTURE:.0f}")
    doctor = run([python.parent / "djpt", "doctor"], cwd=home, env=bare)
    tool = environment(folder / "tools", SBOM_TOOL)
    run([tool.parent / "cyclonedx-py", "environment", "--output-reproducible", "-o", bill, python])
    return (
        f"CPython {platform.python_version()} on {platform.platform()}: the wheel was installed in "
        f"{installed - began:.0f} s; LLVM and the first picture took {rendered - installed:.0f} s, "
        f"{used:.0f} s of them on the processor.\n\n"
        f"```text\n{doctor.replace(str(folder), '..').strip()}\n```"
    )


def hashes(files: Sequence[Path]) -> str:
    """Lines that ``sha256sum --check`` reads."""
    return "".join(f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n" for file in files)


def main() -> None:
    """Build, try, and write what belongs to the release."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dirty", action="store_true", help="build although files are changed: a rehearsal")
    parser.add_argument("--sign", action="store_true", help="sign the hashes with gpg")
    options = parser.parse_args()

    name = version()
    notes = changes((ROOT / "CHANGELOG.md").read_text(), name)
    changed = run(["git", "status", "--porcelain"], cwd=ROOT)
    if changed and not options.dirty:
        sys.exit(f"there are changes that no commit has:\n{changed}commit them, or rehearse with --dirty")
    files = build()
    wheel = next(file for file in files if file.suffix == ".whl")
    bill = DIST / f"djpt-{name}.cdx.json"
    with tempfile.TemporaryDirectory() as folder:
        trial = tried(wheel, bill, Path(folder))
    sums = hashes([*files, bill])
    (DIST / "SHA256SUMS").write_text(sums)
    if options.sign:
        run(["gpg", "--armor", "--detach-sign", DIST / "SHA256SUMS"])
    (DIST / "NOTES.md").write_text(
        f"# djpt {name}\n\n{notes}\n\n## Tried\n\n{trial}\n\n## Hashes (SHA-256)\n\n```text\n{sums}```\n"
    )
    print(f"dist/: {', '.join(file.name for file in sorted(DIST.iterdir()))}")
    print(f"then: git tag -s v{name} -m 'djpt {name}' && git push origin v{name}")


if __name__ == "__main__":
    main()

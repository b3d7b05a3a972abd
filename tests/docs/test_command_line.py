"""Every command of the page of the command line is understood, and runs."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import click
import pytest

from djpt.apps.cli.main import app
from tests.kit.documents import snippets
from tests.kit.processes import ROOT, run_python

PAGE = "docs/command-line.md"

pytestmark = pytest.mark.skipif(not (ROOT / PAGE).exists(), reason="not a working copy of the repository")


def commands() -> list[str]:
    """The lines of the page that start with `djpt`."""
    if not (ROOT / PAGE).exists():
        return []
    lines = [line for block in snippets(PAGE, "sh") for line in block.code.splitlines()]
    return [line for line in lines if line.startswith("djpt ")]


SMALLER = {
    "benchmarks": ["--width", "16", "--spp", "2", "--pairs", "1"],
    "compare": ["--spp", "16", "--rmse", "0.2"],
    "gallery": ["--size", "32", "--spp", "4"],
    "gradcheck": ["--width", "16", "--spp", "16", "--seeds", "4", "--most-seeds", "4"],
    "ladder": ["--spp", "2", "--size", "16"],
    "turntable": ["--width", "16", "--spp", "1", "--frames", "2"],
}
"""Options that spare what takes minutes: the pictures of 30 materials are for people to look at."""

MANY_KERNELS = ("gallery", "ladder")
"""Commands that compile for tens of seconds, one kernel after the other for each material or integrator."""


@pytest.mark.parametrize("command", commands())
def test_the_commands_are_understood(command: str) -> None:
    name, *arguments = shlex.split(command, comments=True)[1:]
    # Commands remember the names of the help option that they are first asked for.
    context = click.Context(app, **app.context_settings)
    known = app.get_command(context, name)
    assert known is not None, name
    with known.make_context(name, arguments, parent=context) as parsed:
        assert parsed.args == []


@pytest.mark.sparse(20)
@pytest.mark.parametrize(
    "command",
    [
        pytest.param(
            line, marks=[pytest.mark.slow] if line.split()[1] in MANY_KERNELS else [], id=line.split("#")[0].strip()
        )
        for line in commands()
    ],
)
def test_the_commands_run(command: str, tmp_path: Path) -> None:
    arguments = shlex.split(command, comments=True)[1:]
    arguments += SMALLER.get(arguments[0], [])
    if arguments[0] in ("benchmarks", "compare"):
        pytest.importorskip("mitsuba")
    if "--denoise" in arguments:
        pytest.importorskip("mitsuba_oidn", exc_type=ImportError)
    shutil.copy(ROOT / "scenes" / "cornell_box.xml", tmp_path / "scene.xml")
    done = run_python("-m", "djpt", *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    if "-o" in arguments:
        assert (tmp_path / arguments[arguments.index("-o") + 1]).exists()

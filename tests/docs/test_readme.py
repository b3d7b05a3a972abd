"""Every code block of the README runs, and says the truth."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

import djpt
from djpt.apps.cli.main import app
from tests.kit.documents import snippets
from tests.kit.processes import ROOT, run_python

pytestmark = pytest.mark.skipif(not (ROOT / "README.md").exists(), reason="not a working copy of the repository")


def test_the_script_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    script, comparison = snippets("README.md")
    names: dict[str, Any] = {"__name__": "readme"}
    script.run(names)
    assert "red.reflectance.value" in capsys.readouterr().out
    assert np.array(djpt.read("cornell_box.exr")).shape == (256, 256, 3)
    red, blue = (np.array(djpt.read(name))[:, :24].mean((0, 1)) for name in ("cornell_box.png", "blue_wall.png"))
    assert red[0] > red[2] and blue[2] > blue[0]

    pytest.importorskip("mitsuba")
    comparison.run(names)
    assert Path("comparison.png").exists()


def commands() -> list[str]:
    """The lines of the README that start with `djpt`."""
    if not (ROOT / "README.md").exists():
        return []
    lines = [line for block in snippets("README.md", "sh") for line in block.code.splitlines()]
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


@pytest.mark.sparse(2)
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


def test_the_make_targets_exist() -> None:
    makefile = (ROOT / "Makefile").read_text()
    for block in snippets("README.md", "sh"):
        for target in re.findall(r"^make (\w+)", block.code, re.MULTILINE):
            assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


def test_links_lead_somewhere() -> None:
    targets = re.findall(r"\]\(([^)#]+)\)", (ROOT / "README.md").read_text())
    for target in targets:
        assert target.startswith("https://") or (ROOT / target).exists(), target
    assert len(targets) > 5


KINDS = {
    "Shapes": ["shape"],
    "Materials": ["bsdf"],
    "Lights": ["emitter"],
    "Cameras": ["sensor"],
    "Samplers": ["sampler"],
    "Films, filters": ["film", "rfilter"],
    "Integrators": ["integrator"],
    "Phase functions, volumes": ["phase", "volume"],
}


@pytest.mark.parametrize("row", [*KINDS, "Textures", "Media"])
def test_the_table_of_plugins_is_true(row: str) -> None:
    from djpt.description.registry import is_own, registered

    line = next(x for x in (ROOT / "README.md").read_text().splitlines() if re.match(rf"\| \[?{row}\b", x))
    both, only_here, missing = (set(re.findall(r"`(\w+)`", cell)) for cell in line.strip("|").split("|")[1:])
    assert both | only_here <= set(registered())
    assert not missing & set(registered())
    if row in KINDS:
        own = [name for kind in KINDS[row] for name, factory in registered(kind).items() if is_own(factory)]
        assert both | only_here == set(own)
    mitsuba = pytest.importorskip("mitsuba")
    theirs = {path.stem for path in (Path(mitsuba.__file__).parent / "plugins").iterdir()}
    # Some of its integrators are in Python.
    in_python = {"prb", "prb_basic", "prbvolpath", "direct_projective", "prb_projective", "volprim_rf_basic"}
    assert both - in_python <= theirs
    assert missing <= theirs and not only_here & theirs


def test_the_changelog_and_the_citation_name_this_version() -> None:
    assert f"\n## [{djpt.__version__}] - " in (ROOT / "CHANGELOG.md").read_text()
    assert f"\nversion: {djpt.__version__}\n" in (ROOT / "CITATION.cff").read_text()

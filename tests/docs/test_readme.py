"""The README is short, its code runs, and it says the truth."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from tests.kit.documents import snippets
from tests.kit.processes import ROOT

pytestmark = pytest.mark.skipif(not (ROOT / "README.md").exists(), reason="not a working copy of the repository")


def test_the_script_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (script,) = snippets("README.md")
    names: dict[str, Any] = {"__name__": "readme"}
    script.run(names)
    image, derivative = (np.array(djpt.read(name)) for name in ("image.png", "derivative.png"))
    assert image.shape == derivative.shape == (256, 256, 3)
    left, right = np.s_[100:150, 8:40], np.s_[100:150, 216:248]
    assert image[left][..., 0].mean() > 3 * image[left][..., 1].mean(), "the left wall is red"
    assert derivative[left].mean() > 2 * derivative[right].mean(), "its own paint matters to it most"


def test_the_tables_begin_on_the_second_screen() -> None:
    text = (ROOT / "README.md").read_text()
    assert len(text.split("## Speed")[0].split()) < 300
    assert len(text.split()) < 600


def test_the_headline_numbers_are_those_of_the_page_of_results() -> None:
    headline = (ROOT / "README.md").read_text().split("<!-- headline -->")[1].split("<!-- end -->")[0]
    numbers = re.findall(r"\*\*([\d.]+)\*\*", headline)
    results = (ROOT / "docs" / "speed.md").read_text()
    assert len(numbers) == 3
    assert [number for number in numbers if not re.search(rf"\b{re.escape(number)}\b", results)] == []


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


def test_the_changelog_and_the_citation_name_this_version() -> None:
    assert f"\n## [{djpt.__version__}] - " in (ROOT / "CHANGELOG.md").read_text()
    assert f"\nversion: {djpt.__version__}\n" in (ROOT / "CITATION.cff").read_text()

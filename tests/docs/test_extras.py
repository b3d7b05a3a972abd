"""What messages and pages say about missing packages can be done from a clone."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.docs.test_links import MARKDOWN
from tests.kit.processes import ROOT

HINT = re.compile(r"pip install (?:--\S+ )*'?([^\s'`\",;]+)")
PYPROJECT = ROOT / "pyproject.toml"

pytestmark = pytest.mark.skipif(not PYPROJECT.exists(), reason="not a working copy of the repository")


def extras() -> dict[str, list[str]]:
    """The optional dependencies: name -> packages."""
    table = PYPROJECT.read_text().split("[project.optional-dependencies]")[1].split("\n[project.")[0]
    return {
        name: re.findall(r'"([^"]+)"', packages) for name, packages in re.findall(r"^(\w+) = \[(.*)\]$", table, re.M)
    }


def sources() -> list[Path]:
    """The modules of djpt."""
    folders = ("djpt", "integrators", "materials", "scenes", "validation")
    return [path for folder in folders for path in (ROOT / folder).rglob("*.py")]


def test_messages_name_packages_that_an_extra_brings() -> None:
    """djpt itself needn't be on an index, nor the folder of its clone known."""
    wanted = {re.split(r"[<>=]", package)[0] for packages in extras().values() for package in packages}
    hints = [(path.name, hint) for path in sources() for hint in HINT.findall(path.read_text())]
    named = {(name, re.split(r"[<>=]", hint)[0]) for name, hint in hints}
    assert len(named) > 5
    assert [pair for pair in sorted(named) if pair[1] not in wanted] == []


@pytest.mark.parametrize("page", [page for page in MARKDOWN if "pip install" in (ROOT / page).read_text()])
def test_pages_install_extras_from_the_clone(page: str) -> None:
    hints = [hint for hint in HINT.findall((ROOT / page).read_text()) if "djpt" in hint or "[" in hint]
    known = {f".[{name}]" for name in extras()}
    assert [hint for hint in hints if hint not in known] == []

"""Every Python block of the documentation runs, and links lead somewhere."""

from __future__ import annotations

import pkgutil
import re
from pathlib import Path
from typing import Any

import pytest

from tests.kit.markdown import snippets
from tests.kit.processes import ROOT, run_python

DOCS = ROOT / "docs"
PAGES = sorted(str(path.relative_to(ROOT)) for path in DOCS.rglob("*.md") if "_build" not in path.parts)

FEW = {"SIZE": 8, "SPP": 4, "ITERATIONS": 4, "TARGET_SPP": 16, "TEXELS": 8, "ROWS": 4}
SMALLER = {"docs/guides/albedo-experiments.md": FEW}
"""Constants of pages whose code takes minutes as it stands. `python docs/figures` runs it so, for their pictures."""

pytestmark = pytest.mark.skipif(not PAGES, reason="not a working copy of the repository")


@pytest.mark.parametrize("page", [page for page in PAGES if snippets(page)])
def test_the_code_of_a_page_runs(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = snippets(page)
    if any("mitsuba" in block.code or "validation" in block.code for block in code):
        pytest.importorskip("mitsuba")
    if any("from distributed" in block.code for block in code):
        pytest.importorskip("distributed")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": Path(page).stem}
    for block in code:
        block.smaller(SMALLER.get(page, {})).run(names)


@pytest.mark.parametrize("page", ["README.md", *PAGES])
def test_djpt_is_imported_before_drjit(page: str) -> None:
    """Dr.Jit, imported before djpt, opens an LLVM of its own, which may be too old."""
    code = "\n".join(block.code for block in snippets(page))
    names = [name for name in re.findall(r"^(?:import|from) (\w+)", code, re.MULTILINE) if name in ("djpt", "drjit")]
    assert names[:1] != ["drjit"]


@pytest.mark.slow
def test_the_documentation_builds_without_warnings(tmp_path: Path) -> None:
    for module in ("sphinx", "myst_parser", "furo", "sphinx-mathjax-offline"):
        pytest.importorskip(module)
    done = run_python("-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", str(DOCS), str(tmp_path / "html"))
    assert done.returncode == 0, done.stderr
    pages = [path.read_text() for path in (tmp_path / "html").rglob("*.html")]
    fetched = [
        found
        for page in pages
        for found in re.findall(r"<(?:script|img|link)[^>]*(?:src|href)=\"(https?:[^\"]*)", page)
    ]
    assert pages and not fetched, "the pages need a network"
    assert (tmp_path / "html" / "_static" / "tex-svg.js").exists(), "formulas stay TeX without MathJax"


PACKAGES = [
    "integrators",
    "materials",
    "shapes",
    "emitters",
    "rfilters",
    "samplers",
    "sensors",
    "films",
    "phase",
    "volumes",
]


@pytest.mark.parametrize("package", PACKAGES)
def test_every_plugin_is_in_the_reference(package: str) -> None:
    reference = (DOCS / "api.md").read_text()
    modules = {path.stem for path in (ROOT / "djpt" / package).glob("*.py")} - {"__init__"}
    assert modules <= set(re.findall(rf"djpt\.{package}\.(\w+)", reference))


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page: str) -> None:
    folder = (ROOT / page).parent
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", (ROOT / page).read_text()):
        assert target.startswith("https://") or (folder / target).exists(), target


@pytest.mark.parametrize("page", [page for page in PAGES if "](#djpt" in (ROOT / page).read_text()])
def test_references_name_what_there_is(page: str) -> None:
    for name in re.findall(r"\]\(#(djpt[\w.]+)\)", (ROOT / page).read_text()):
        pkgutil.resolve_name(name)

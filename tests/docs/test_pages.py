"""Every Python block of the documentation runs, and links lead somewhere."""

from __future__ import annotations

import inspect
import json
import pkgutil
import re
from pathlib import Path
from typing import Any

import pytest

from djpt.description.registry import plugin_modules
from tests.kit.documents import snippets
from tests.kit.processes import ROOT, run_python

DOCS = ROOT / "docs"
PAGES = sorted(str(path.relative_to(ROOT)) for path in DOCS.rglob("*.md") if "_build" not in path.parts)

PORTING = DOCS / "guides" / "comparing.md"

LARGEST_PAGE = 2_000_000
"""Bytes: phones and search engines give up at more."""

FEW = {"SIZE": 8, "SPP": 4, "ITERATIONS": 4, "TARGET_SPP": 16, "TEXELS": 8, "ROWS": 4, "STEPS": 2}
SMALLER = {"docs/guides/albedo-experiments.md": FEW, "docs/gallery.md": FEW}
"""Constants of pages whose code takes minutes as it stands. `python docs/figures` runs it so, for their pictures."""

pytestmark = pytest.mark.skipif(not PAGES, reason="not a working copy of the repository")


@pytest.mark.sparse(11)
@pytest.mark.parametrize(
    "page", [pytest.param(p, marks=pytest.mark.slow if p in SMALLER else ()) for p in PAGES if snippets(p)]
)
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
    arguments = ("-q", "-W", "--keep-going", "-b", "html", str(DOCS), str(tmp_path / "html"))
    done = run_python("-m", "sphinx", *arguments, timeout=600)
    assert done.returncode == 0, done.stderr
    pages = [path.read_text() for path in (tmp_path / "html").rglob("*.html")]
    fetched = [
        found
        for page in pages
        for found in re.findall(r"<(?:script|img|link)[^>]*(?:src|href)=\"(https?:[^\"]*)", page)
    ]
    assert pages and not fetched, "the pages need a network"
    assert (tmp_path / "html" / "_static" / "tex-svg.js").exists(), "formulas stay TeX without MathJax"
    assert max(map(len, pages)) < LARGEST_PAGE

    # The search ranks main entries of the index above all else.
    index = (tmp_path / "html" / "searchindex.js").read_text()
    found = json.loads(index.removeprefix("Search.setIndex(").removesuffix(")"))
    for plugin in set(plugin_modules()) - {"scene"}:  # the code of pages, run by a test above, registers others
        mains = {found["docnames"][page] for page, _, main in found["indexentries"].get(plugin, []) if main}
        assert mains and all(page.startswith("guides/") for page in mains), plugin


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
    reference = "".join(path.read_text() for path in (DOCS / "api").glob("*.md"))
    modules = {path.stem for path in (ROOT / "djpt" / package).glob("*.py")} - {"__init__"}
    assert modules <= set(re.findall(rf"djpt\.{package}\.(\w+)", reference))


@pytest.mark.parametrize("page", [page for page in PAGES if "](#djpt" in (ROOT / page).read_text()])
def test_references_name_what_the_reference_has(page: str) -> None:
    """Methods are documented where they are defined, not in the classes that inherit them."""
    for name in re.findall(r"\]\(#(djpt[\w.]+)\)", (ROOT / page).read_text()):
        pkgutil.resolve_name(name)
        owner, _, last = name.rpartition(".")
        holder = pkgutil.resolve_name(owner)
        assert not inspect.isclass(holder) or last in vars(holder), f"{name} is inherited"


def test_the_names_of_the_guide_to_porting_exist() -> None:
    """All but those that it says are left out."""
    prose = re.sub(r"^```.*?^```", "", PORTING.read_text(), flags=re.DOTALL | re.MULTILINE)
    names = set(re.findall(r"`mi\.([\w.]+)`", prose))
    listed = (DOCS / "names.md").read_text().split("## Left out")[1].split("## Different")[0]
    left_out = set(re.findall(r"`([\w.]+)`", listed))
    missing = {name for name in names if not resolves(f"djpt.{name}")}
    assert len(names) > 5
    assert missing <= left_out


def resolves(name: str) -> bool:
    """Whether there is an object of that full name."""
    try:
        pkgutil.resolve_name(name)
    except AttributeError:
        return False
    return True

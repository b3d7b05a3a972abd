"""Sphinx configuration; `make docs` builds the documentation with warnings as errors."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import shutil
from functools import cache
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, GoogleDocstring
from sphinx.transforms import SphinxTransform

import djpt
from djpt.description.registry import registered

project = "djpt"
author = "djpt contributors"
copyright = "djpt contributors, BSD-3-Clause"
version = release = djpt.__version__

extensions = [
    "myst_parser",
    "sphinx_copybutton",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
]
exclude_patterns = ["_build"]
toc_object_entries = False  # every page carries the table of contents: thousands of methods would make it megabytes
html_theme = "furo"
html_title = f"djpt {version}"

# The pages need no network. Of MathJax one file is enough: it draws formulas as SVG, which needs no fonts,
# which browsers don't load for pages that are opened from a disk.
MATHJAX = distribution("sphinx-mathjax-offline").locate_file("sphinx-mathjax-offline/static/mathjax/tex-svg.js")
html_static_path = ["_static", str(MATHJAX)]
html_css_files = ["pages.css"]
mathjax_path = "tex-svg.js"

myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence", "attrs_block"]
myst_heading_anchors = 3

# Docstrings put code between single backquotes.
default_role = "code"
autosummary_generate = False
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
autodoc_default_options = {"members": True, "show-inheritance": True}
python_use_unqualified_type_names = True

SECTIONS = Config(napoleon_numpy_docstring=False)
"""Docstrings have Google's sections: Args, Returns, Raises."""

CHAPTERS = Path(__file__).parent / "api"
"""The chapters of the API reference, with tables of modules. Each module gets a page in the folder `modules`, which is
written anew by every build."""

MODULE_PAGE = """
:orphan:

{module}
{underline}

A module of the chapter :doc:`../{chapter}`.

.. automodule:: {module}
"""


def _write_module_pages(app: Sphinx) -> None:
    """Write a page for each module of a table.

    They are in no table of contents: every page carries that, and four hundred modules would double its size.
    """
    folder = CHAPTERS / "modules"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for chapter in CHAPTERS.glob("*.md"):
        for table in re.findall(r"^\.\. autosummary::\n\n((?:   \S+\n)+)", chapter.read_text(), re.MULTILINE):
            for module in table.split():
                page = MODULE_PAGE.format(module=module, underline="=" * len(module), chapter=chapter.stem)
                (folder / f"{module}.rst").write_text(page.lstrip())


def _google_sections(app, what, name, obj, options, lines) -> None:
    """What the extension Napoleon does, except for attributes: it takes words before a colon for their type."""
    if what not in ("attribute", "data", "property"):
        lines[:] = GoogleDocstring(lines, SECTIONS, app, what, name, obj, options).lines()


def _skip_drjit(app, what, name, obj, skip, options) -> bool | None:
    """Classes of Dr.Jit that modules offer under a name of theirs: Dr.Jit documents them."""
    return True if inspect.isclass(obj) and obj.__module__.startswith("drjit") else None


def _absolute_values(app, what, name, obj, options, lines) -> None:
    """Docstrings may write an absolute value as |z|, which reST would take for a substitution."""
    lines[:] = [re.sub(r"\|(\w+)\|", r"abs(\1)", line) for line in lines]


@cache
def _imported(module: str) -> dict[str, str]:
    """What a module imports by name, also what only type checkers import: name -> full name."""
    tree = ast.parse(inspect.getsource(importlib.import_module(module)))
    statements = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    return {alias.asname or alias.name: f"{node.module}.{alias.name}" for node in statements for alias in node.names}


def _qualify_annotations(app: Sphinx, doctree: nodes.document) -> None:
    """Annotations that Python can't evaluate name a class as their module does, and others may do so, too."""
    for reference in doctree.findall(addnodes.pending_xref):
        if reference.get("refdomain") == "py" and reference.get("py:module"):
            imported = _imported(reference["py:module"])
            reference["reftarget"] = imported.get(reference["reftarget"], reference["reftarget"])


GUIDES = {
    "guides/rendering": ("film", "rfilter"),
    "guides/shapes": ("shape",),
    "guides/meshes": ("shape",),
    "guides/materials": ("bsdf",),
    "guides/textures": ("texture",),
    "guides/volumes": ("volume", "phase"),
    "guides/lights": ("emitter",),
    "guides/media": ("medium",),
    "guides/cameras": ("sensor",),
    "guides/integrators": ("integrator",),
    "guides/samplers": ("sampler",),
}
"""The kinds of plugins that a guide explains."""


class PluginIndex(SphinxTransform):
    """Index entries for the plugins that a guide explains, at their rows in tables or where the text names them first.

    The search ranks index entries above modules, so that a plugin's name leads to the guide first.
    """

    default_priority = 700  # before Sphinx collects the entries of a page

    def apply(self, **kwargs: Any) -> None:
        """Called by Sphinx for each page."""
        names = {name for kind in GUIDES.get(self.env.docname, ()) for name in registered(kind)}
        literals = [node for node in self.document.findall(nodes.literal) if node.astext() in names]
        seen: set[str] = set()
        for literal in sorted(literals, key=lambda node: not _begins_a_row(node)):  # stable: in the order of the page
            name, section = literal.astext(), _section(literal)
            if name not in seen and section is not None:
                seen.add(name)
                section.insert(1, addnodes.index(entries=[("single", name, section["ids"][0], "main", None)]))


def _begins_a_row(literal: nodes.literal) -> bool:
    """Whether the literal stands in the first column of a table."""
    entry = literal.parent.parent
    return isinstance(entry, nodes.entry) and entry.parent.index(entry) == 0


def _section(node: nodes.Node) -> nodes.section | None:
    """The innermost section that holds the node."""
    while node is not None and not isinstance(node, nodes.section):
        node = node.parent
    return node


def setup(app) -> None:
    """Called by Sphinx."""
    app.add_transform(PluginIndex)
    app.connect("doctree-read", _qualify_annotations)
    app.connect("builder-inited", _write_module_pages)
    app.connect("autodoc-skip-member", _skip_drjit)
    app.connect("autodoc-process-docstring", _google_sections, priority=400)
    app.connect("autodoc-process-docstring", _absolute_values)

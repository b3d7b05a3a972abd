"""Sphinx configuration; `make docs` builds the documentation with warnings as errors."""

from __future__ import annotations

import inspect
import re
import shutil
from importlib.metadata import distribution
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, GoogleDocstring

import djpt

project = "djpt"
author = "djpt contributors"
copyright = "djpt contributors, BSD-3-Clause"
version = release = djpt.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
]
templates_path = ["_templates"]
exclude_patterns = ["_build", "_templates"]
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
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
autodoc_default_options = {"members": True, "show-inheritance": True}
python_use_unqualified_type_names = True

SECTIONS = Config(napoleon_numpy_docstring=False)
"""Docstrings have Google's sections: Args, Returns, Raises."""

# The chapters of the API reference list modules; each gets a page, which is written here at every build.
MODULE_PAGES = Path(__file__).parent / "api" / "modules"


def _forget_module_pages(app: Sphinx) -> None:
    """Modules come and go: the page of one that is gone would be in no table of contents."""
    shutil.rmtree(MODULE_PAGES, ignore_errors=True)


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


def setup(app) -> None:
    """Called by Sphinx."""
    app.connect("builder-inited", _forget_module_pages, priority=100)  # before autosummary writes them
    app.connect("autodoc-skip-member", _skip_drjit)
    app.connect("autodoc-process-docstring", _google_sections, priority=400)
    app.connect("autodoc-process-docstring", _absolute_values)

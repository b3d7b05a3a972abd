"""Sphinx configuration; `make docs` builds the documentation with warnings as errors."""

from __future__ import annotations

import re
from importlib.metadata import distribution

import djpt

project = "djpt"
author = "djpt contributors"
copyright = "djpt contributors, BSD-3-Clause"
version = release = djpt.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax", "sphinx.ext.viewcode"]
exclude_patterns = ["_build"]
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
napoleon_google_docstring = True
napoleon_numpy_docstring = False


def _absolute_values(app, what, name, obj, options, lines) -> None:
    """Docstrings may write an absolute value as |z|, which reST would take for a substitution."""
    lines[:] = [re.sub(r"\|(\w+)\|", r"abs(\1)", line) for line in lines]


def setup(app) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", _absolute_values)

"""The scripts of docs/figures as modules, without their pictures being made."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType

import pytest

from tests.kit.processes import ROOT

__all__ = ["figures"]

FOLDER = ROOT / "docs" / "figures"


def figures(name: str) -> ModuleType:
    """A module of docs/figures, which import each other by their short names."""
    if not FOLDER.is_dir():
        pytest.skip("not a working copy of the repository")
    if str(FOLDER) not in sys.path:
        sys.path.append(str(FOLDER))
    return importlib.import_module(name)

"""Names that packages import when they are first used."""

from __future__ import annotations

import importlib
import pkgutil
import subprocess
import sys

import pytest

LAZY = ("emitters", "integrators", "materials", "rfilters", "samplers", "scenes", "sensors", "shapes", "textures")


@pytest.mark.parametrize("name", LAZY)
def test_names_are_no_modules(name):
    """A module would take the place of a name when it is imported."""
    package = importlib.import_module(f"djpt.{name}")
    modules = {module.name for module in pkgutil.iter_modules(package.__path__)}
    assert not modules.intersection(package.__all__)


def test_names_stay_what_they_are():
    code = "import djpt.scenes as s; first = s.stage; s.sky(4); assert s.stage is first and callable(first)"
    subprocess.run([sys.executable, "-c", code], check=True)

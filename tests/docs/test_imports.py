"""Imports that readers see: none of our own modules by a string, none upwards in hiding, former paths that work."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import djpt
from djpt.core.former_paths import FORMER
from djpt.mitsuba.names import SUBMODULES

ROOT = Path(djpt.__file__).resolve().parents[1]
FOLDERS = ("djpt", "integrators", "materials", "scenes", "validation")
LAZY = {
    "djpt/__init__.py",  # public names
    "djpt/core/former_paths.py",
    "djpt/core/lazy.py",
    "djpt/description/registry.py",  # plugins
    "djpt/mitsuba/ad/__init__.py",  # names of scripts
}
"""The tables that are imported from when a name is first used."""
IMPORTERS = {"import_module", "__import__"}


def sources() -> list[Path]:
    links = {ROOT / "djpt" / name for name in FOLDERS}
    return [
        path
        for folder in FOLDERS
        for path in sorted((ROOT / folder).rglob("*.py"))
        if not links.intersection(path.parents)
    ]


def string_imports(path: Path) -> list[str]:
    """Calls that import by a string, unless it is the name of somebody else's package."""
    found: list[str] = []
    text = path.read_text()
    if not any(word in text for word in IMPORTERS):
        return found
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in IMPORTERS:
            name = node.args[0]
            literal = isinstance(name, ast.Constant) and isinstance(name.value, str)
            if not literal or name.value.split(".")[0] == "djpt":
                found.append(f"{path.relative_to(ROOT)}:{node.lineno}: {ast.unparse(node)}")
    return found


def test_no_module_of_ours_is_imported_by_a_string() -> None:
    """Such an arrow no reader sees. `djpt.jit.backends` names modules of Dr.Jit by the variant."""
    found = [call for path in sources() if str(path.relative_to(ROOT)) not in LAZY for call in string_imports(path)]
    assert [call for call in found if "drjit.{backend}" not in call] == []


def test_a_string_import_is_found(tmp_path: Path) -> None:
    path = ROOT / "djpt" / "core" / "lazy.py"
    assert string_imports(path)


@pytest.mark.parametrize("former", FORMER)
def test_former_paths_give_the_same_module(former: str) -> None:
    assert importlib.import_module(former) is importlib.import_module(FORMER[former])


@pytest.mark.parametrize("name", SUBMODULES)
def test_modules_for_scripts_are_imported_by_path(name: str) -> None:
    assert importlib.import_module(f"djpt.{name}") is getattr(djpt, name)


def test_former_paths_in_a_new_process() -> None:
    code = """
from djpt.types import Float
from djpt.warp import square_to_cosine_hemisphere
from djpt.records import BSDFSample3f
import djpt.ad.integrators.common as common, djpt, importlib.util
from djpt.ad.integrators.prb import PRBIntegrator
assert Float is djpt.Float and BSDFSample3f is djpt.BSDFSample3f and common.ADIntegrator is djpt.CppADIntegrator
assert djpt.types.__spec__.name == "djpt.jit.types" and importlib.util.find_spec("djpt.jit.types")
try:
    import djpt.types.nothing
except ModuleNotFoundError as error:
    assert error.name == "djpt.types.nothing", error.name
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_the_first_scene_imports_no_slow_modules() -> None:
    """Modules of the standard library that take longer than a file of ours, and that no scene of shapes needs."""
    slow = ["asyncio", "difflib", "hashlib", "importlib.resources", "logging", "random", "tempfile"]
    if sys.version_info >= (3, 11):  # before, `platform` imports it
        slow.append("subprocess")
    code = f"""
import djpt, sys
djpt.load_dict(djpt.cornell_box())
print(*(name for name in {slow} if name in sys.modules))
"""
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert shown.stdout.split() == []

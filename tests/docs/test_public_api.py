"""The public names: all there, from one place each, and cheap until used."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

import pytest

import djpt
from tests.kit.processes import run_python

DESIGN = """
    set_variant variant load_dict render traverse cornell_box write read Image util types validation
    Float UInt32 Point3f Vector3f Color3f TensorXf Transform4f ScalarTransform4f Ray3f
    register_bsdf register_shape register_emitter register_texture register_sensor register_film register_rfilter
    register_sampler register_integrator DjptError SceneError ParameterError RenderError FileError BackendError
    __version__
"""


def type_checking_imports() -> dict[str, str]:
    """What ``if TYPE_CHECKING:`` in djpt/__init__.py imports: name -> module, submodules -> djpt."""
    tree = ast.parse(Path(djpt.__file__).read_text())
    block = next(n for n in tree.body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING")
    names = {}
    for statement in block.body:
        assert isinstance(statement, ast.ImportFrom) and statement.module
        for alias in statement.names:
            assert alias.asname == alias.name, f"{alias.name}: only 'as {alias.name}' exports it to type checkers"
            names[alias.name] = statement.module
    return names


MODULES = {
    "ad",
    "errors",
    "integrators",
    "materials",
    "optimization",
    "scenes",
    "types",
    "util",
    "validation",
    "warp",
    "xml",
}
MODULE_OF = {name: module for name, module in type_checking_imports().items() if name not in MODULES} | djpt._MODULE_OF
"""The module of each public name, modules left out."""


def test_names_for_scripts_are_no_others() -> None:
    assert not set(type_checking_imports()) & (set(djpt._MODULE_OF) | set(djpt._SUBMODULES))
    assert {*type_checking_imports(), *djpt._MODULE_OF, *djpt._SUBMODULES, "__version__"} == set(djpt.__all__)


def test_every_public_name_resolves() -> None:
    assert [name for name in djpt.__all__ if getattr(djpt, name, None) is not getattr(djpt, name, djpt)] == []


def test_every_public_name_is_public_where_it_lives() -> None:
    assert [name for name in MODULE_OF if name not in importlib.import_module(MODULE_OF[name]).__all__] == []


def test_the_names_of_the_design_exist() -> None:
    assert set(DESIGN.split()) <= set(djpt.__all__)
    assert dir(djpt) == djpt.__all__ == sorted(set(djpt.__all__))


def test_no_submodule_has_the_name_of_a_public_object() -> None:
    """Importing such a submodule would replace the object in the package."""
    folder = Path(djpt.__file__).parent
    submodules = {p.stem for p in folder.iterdir() if p.suffix == ".py" or p.is_dir()}
    assert not submodules & set(MODULE_OF)


def test_an_unknown_name() -> None:
    with pytest.raises(AttributeError, match=r"module 'djpt' has no attribute 'rendr'; did you mean 'render'\?"):
        djpt.rendr  # noqa: B018
    with pytest.raises(AttributeError, match="no attribute 'mueller', which is left out: Polarisation: djpt computes"):
        djpt.mueller  # noqa: B018
    assert not hasattr(djpt, "nothing_like_it")


def test_import_is_light() -> None:
    """`import djpt` and the errors need no Dr.Jit and no NumPy; rendering needs no Mitsuba."""
    code = """
import sys, djpt
djpt.DjptError, djpt.variant()
heavy = {"drjit", "mitsuba", "numpy", "scipy", "click", "rich", "OpenEXR", "PIL"}
print(sorted(heavy & set(sys.modules)))
"""
    assert run_python("-c", code).stdout == "[]\n"


def test_a_scene_imports_what_it_has() -> None:
    """The Cornell box has no meshes, textures, trees of lights or derivatives; all else comes at its first use."""
    code = """
import sys, djpt
from importlib.util import find_spec
djpt.render(djpt.load_dict(djpt.cornell_box()), spp=1)
needless = ("geometry.two_level_bvh", "geometry.bvh", "shapes.mesh", "shapes.sphere", "rendering.gradients.modes",
            "materials.principled", "textures.bitmap", "emitters.envmap", "emitters.light_samplers.tree",
            "images.formats", "integrators.direct", "rendering.schedules.machine", "scenes.gallery", "apps.cli")
print(sorted(name for name in needless if f"djpt.{name}" in sys.modules))
print([name for name in needless if find_spec(f"djpt.{name}") is None])
from djpt import shapes
print(djpt.materials.Principled.__name__, shapes.mesh.Mesh is djpt.Mesh, "Sphere" in dir(shapes))
"""
    done = run_python("-c", code)
    assert done.stdout == "[]\n[]\nPrincipled True True\n", done.stderr


def test_a_missing_scene_file_is_found_without_drjit() -> None:
    code = """
import sys
from djpt.scenes.overrides import described
from djpt.errors import FileError
try:
    described("nothing.xml")
except FileError as error:
    print(error)
print(sorted({"drjit", "numpy"} & set(sys.modules)))
"""
    assert run_python("-c", code).stdout == "can't read 'nothing.xml': there is no such file\n[]\n"


def test_a_misspelt_plugin_of_a_scene_file_is_found_without_drjit(tmp_path: Path) -> None:
    file = tmp_path / "scene.xml"
    file.write_text('<scene version="3.0.0"><shape type="obj"/><integrator type="pathh"/></scene>')
    code = f"""
import sys
from djpt.scenes.overrides import described
from djpt.errors import SceneError
try:
    described({str(file)!r})
except SceneError as error:
    print(error)
print(sorted({{"drjit", "numpy"}} & set(sys.modules)))
"""
    message, imported = run_python("-c", code).stdout.splitlines()
    assert "scene.xml:1: <integrator>: unknown integrator 'pathh'; did you mean 'path'? (possible: path, " in message
    assert "diffuse" not in message
    assert imported == "[]"


def test_rendering_does_not_import_mitsuba() -> None:
    code = """
import sys, djpt
scene = djpt.load_dict(djpt.cornell_box())
params = djpt.traverse(scene)
djpt.render(scene, spp=1)
print(sorted({"mitsuba", "scipy", "matplotlib"} & set(sys.modules)))
"""
    done = run_python("-c", code)
    assert done.stdout == "[]\n", done.stderr

"""Plugins in packages: one file registers each, one line imports it."""

from __future__ import annotations

import importlib
import math
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.description import registry
from djpt.description.registry import LACKING, MITSUBA
from tests.kit.processes import run_python

DISTANCE = 2.0

PACKAGE = {
    "__init__": """
from chalk_and_cheese.chalk import Chalk as Chalk
from chalk_and_cheese.halves import Halves as Halves
from chalk_and_cheese.pigment import PigmentView as PigmentView
""",
    "chalk": '''
import math

import drjit as dr

from djpt import BSDF, BSDFFlags, BSDFSample3f, register_bsdf
from djpt.core.warp import square_to_cosine_hemisphere


class Chalk(BSDF):
    """Lambert's law."""

    children = ("pigment",)

    def __init__(self, props):
        super().__init__(props)
        self.pigment = props.texture("pigment", 0.5, low=0.0, high=1.0)

    def flags(self):
        return int(BSDFFlags.DiffuseReflection | BSDFFlags.FrontSide)

    def eval_pdf(self, ctx, si, wo, active=True):
        pdf = dr.select((si.wi.z > 0) & (wo.z > 0), wo.z / math.pi, 0)
        return self.pigment.eval(si, active) * pdf, pdf

    def sample(self, ctx, si, sample1, sample2, active=True):
        wo = square_to_cosine_hemisphere(sample2)
        value, pdf = self.eval_pdf(ctx, si, wo, active)
        return BSDFSample3f.of(wo, pdf, BSDFFlags.DiffuseReflection), dr.select(pdf > 0, value / pdf, 0)


register_bsdf("chalk", Chalk)
''',
    "halves": '''
import drjit as dr
import numpy as np

from djpt import Color3f, Float, ParamFlags, register_texture
from djpt.textures import Texture


class Halves(Texture):
    """One number where u < 1/2, another one beyond."""

    values = {"low": ParamFlags.Differentiable, "high": ParamFlags.Differentiable}

    def __init__(self, props):
        super().__init__(props)
        self.low, self.high = Float(props.float("low")), Float(props.float("high"))

    def eval_1(self, si, active=True):
        return dr.select(si.uv.x < 0.5, self.low, self.high)

    def eval(self, si, active=True):
        return Color3f(self.eval_1(si, active))

    def mean(self):
        return 0.5 * (self.low + self.high)

    def restrict(self, allowed, where):
        allowed.require(np.array([self.low[0], self.high[0]]), where)


register_texture("halves", Halves)
''',
    "pigment": '''
import drjit as dr

from djpt import Integrator, register_integrator


class PigmentView(Integrator):
    """The albedo of the first surface."""

    def sample(self, scene, sampler, ray, medium=None, active=True):
        si = scene.ray_intersect(ray, active)
        hit = si.is_valid() & active
        return dr.select(hit, si.bsdf().eval_diffuse_reflectance(si, hit), 0), hit, []


register_integrator("pigment_view", PigmentView)
''',
}
"""A package of three plugins: its files by name."""


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("packages")
    (folder / "chalk_and_cheese").mkdir()
    for name, text in PACKAGE.items():
        (folder / "chalk_and_cheese" / f"{name}.py").write_text(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        yield importlib.import_module("chalk_and_cheese")


def wall(integrator: str) -> djpt.Scene:
    """A wall of chalk, seen and lit from the same point at `DISTANCE` in front of its middle."""
    return djpt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": integrator},
            "sensor": {
                "type": "perspective",
                "fov": 0.1,
                "to_world": T().look_at([0, 0, DISTANCE], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 2, "height": 2, "rfilter": {"type": "box"}},
            },
            "wall": {
                "type": "rectangle",
                "bsdf": {"type": "chalk", "pigment": {"type": "halves", "low": 0.2, "high": 0.6}},
            },
            "lamp": {"type": "point", "position": [0, 0, DISTANCE], "intensity": 1.0},
        }
    )


def columns(image: Any) -> list[float]:
    """The mean of each column of pixels, in increasing order."""
    return sorted(np.array(image).mean(axis=(0, 2)).tolist())


def test_each_file_has_one_line_that_registers_and_one_that_imports() -> None:
    lines = PACKAGE["__init__"].split("\n")[1:-1]
    assert len(lines) == len(PACKAGE) - 1
    for name, text in PACKAGE.items():
        assert name == "__init__" or text.count("\nregister_") == 1


def test_plugins_of_a_package_render_together(package: Any) -> None:
    np.testing.assert_allclose(columns(djpt.render(wall("pigment_view"), spp=4)), [0.2, 0.6], rtol=1e-5)
    # L = albedo / pi cos I / d^2.
    expected = np.array([0.2, 0.6]) / math.pi / DISTANCE**2
    np.testing.assert_allclose(columns(djpt.render(wall("path"), spp=4)), expected, rtol=1e-4)


def test_plugins_of_a_package_are_traversed_and_edited(package: Any) -> None:
    scene = wall("path")
    params = djpt.traverse(scene)
    assert {"wall.bsdf.pigment.low", "wall.bsdf.pigment.high"} <= set(params.keys())
    params["wall.bsdf.pigment.high"] = 0.9
    params.update()
    expected = np.array([0.2, 0.9]) / math.pi / DISTANCE**2
    np.testing.assert_allclose(columns(djpt.render(scene, spp=4)), expected, rtol=1e-4)


def test_classes_of_a_package_are_what_scenes_are_made_of(package: Any) -> None:
    scene = wall("pigment_view")
    assert type(scene.integrator()) is package.PigmentView
    assert type(scene.shapes()[0].bsdf()) is package.Chalk
    assert type(scene.shapes()[0].bsdf().pigment) is package.Halves


@pytest.mark.slow
def test_names_and_kinds_of_plugins_are_known_without_imports() -> None:
    code = """
import sys
from djpt.description.registry import _plugins, kind_of, names, registered
known = {name: kind_of(name) for name in names()}
assert kind_of("nothing") is None
assert not {"drjit", "numpy"} & set(sys.modules), "imported"
registered()
assert known == {name: kind for name, (kind, _) in _plugins.items()}
assert all(set(names(kind)) == set(registered(kind)) for kind in known.values())
print(len(known))
"""
    assert int(run_python("-c", code).stdout) > 100


def test_plugins_of_mitsuba_that_are_missing_have_a_reason() -> None:
    theirs = {name for names in MITSUBA.values() for name in names.split()}
    assert theirs - set(registry.names()) == set(LACKING)


@pytest.mark.slow
def test_no_plugin_of_djpt_is_forgotten_by_its_package() -> None:
    """A file that registers plugins has its line in the `__init__`."""
    code = """
import sys
from djpt.description.registry import registered
registered()
print(*sys.modules)
"""
    imported = set(run_python("-c", code).stdout.split())
    for name in registry.PACKAGES:
        package = importlib.import_module(name)
        files = [path for folder in getattr(package, "__path__", ()) for path in Path(folder).glob("*.py")]
        registering = {f"{name}.{path.stem}" for path in files if "\nregister_" in path.read_text()}
        assert registering <= imported
        assert registering
    assert "djpt.scene.scene" in imported


@pytest.mark.parametrize("name", registry.PACKAGES)
def test_each_registered_class_is_public_in_its_package(name: str) -> None:
    package = importlib.import_module(name)
    own = {factory for factory in registry.registered().values() if factory.__module__.startswith(f"{name}.")}
    assert own
    public = [getattr(package, name) for name in package.__all__]
    # The package of differentiable integrators has modules in it, as Mitsuba's has.
    inside = [getattr(module, name) for module in public if isinstance(module, ModuleType) for name in module.__all__]
    assert own <= {*public, *inside}

"""Plugins of installed packages are found by entry points: no import in the script, and none before they are needed."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import djpt
from djpt.description import registry
from djpt.errors import SceneError

TEXTURE = """
from djpt import register_texture
from djpt.textures.rgb import ConstantTexture


class Own(ConstantTexture):
    pass


register_texture("{name}", Own)
"""

Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Install a distribution with a module and its entry points, as a package manager would."""

    def install(distribution: str, module: str, code: str, *points: str) -> None:
        site = tmp_path / distribution
        info = site / f"{distribution}-1.0.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text("\n".join(["[djpt.plugins]", *points, ""]))
        (site / f"{module}.py").write_text(code)
        monkeypatch.syspath_prepend(site)

    return install


def test_a_scene_uses_a_plugin_that_nobody_imported(install: Install) -> None:
    install("ink", "ink_module", TEXTURE.format(name="ink"), "texture.ink = ink_module")
    assert "ink" in registry.names("texture") and "ink" not in registry.names("bsdf")
    assert registry.kind_of("ink") == "texture"
    assert "ink_module" not in sys.modules  # neither by names and kinds, nor by what is in djpt itself
    djpt.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.3}})
    assert "ink_module" not in sys.modules
    bsdf = djpt.load_dict({"type": "diffuse", "reflectance": {"type": "ink", "value": 0.3}})
    assert type(bsdf.reflectance) is sys.modules["ink_module"].Own


def test_all_plugins_include_those_of_packages(install: Install) -> None:
    install("blot", "blot_module", TEXTURE.format(name="blot"), "texture.blot = blot_module")
    assert registry.registered("texture")["blot"].__module__ == "blot_module"


def test_near_misses_name_them(install: Install) -> None:
    install("sepia", "sepia_module", TEXTURE.format(name="sepia"), "texture.sepia = sepia_module")
    with pytest.raises(SceneError, match=r"unknown texture 'sepja'.*did you mean 'sepia'"):
        registry.lookup("texture", "sepja")


def test_names_of_djpt_are_its_own(install: Install) -> None:
    install("rival", "rival_module", "raise RuntimeError", "texture.rgb = rival_module")
    assert registry.lookup("texture", "rgb").__module__ == "djpt.textures.rgb"


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (
            "import no_such_module",
            r"the entry point 'texture.{name} = {name}_module' of the package '{name}' can't be imported: "
            "ModuleNotFoundError: No module named 'no_such_module'",
        ),
        ("1 / 0", "can't be imported: ZeroDivisionError"),
        ("", "of the package '{name}' was imported, but registers no texture '{name}'"),
    ],
)
def test_a_package_that_fails_is_named(code: str, message: str, install: Install) -> None:
    name = f"broken_{len(code)}"
    install(name, f"{name}_module", code, f"texture.{name} = {name}_module")
    with pytest.raises(SceneError, match=message.format(name=name)):
        djpt.load_dict({"type": name})


def test_an_entry_has_a_kind_and_a_name(install: Install) -> None:
    install("kindless", "kindless_module", "", "kindless = kindless_module")
    with pytest.raises(SceneError, match=r"package 'kindless' has an entry point 'kindless' .*such as 'bsdf.chalk'"):
        registry.names()


def test_two_packages_with_one_name_are_refused(install: Install) -> None:
    for name in ("first", "second"):
        install(name, f"{name}_module", "", f"texture.twice = {name}_module")
    with pytest.raises(SceneError, match=r"two packages have a plugin 'twice': .*package 'second', and .*'first'"):
        djpt.load_dict({"type": "twice"})

"""The gallery: every material has a picture in it, and the sheet is put together from them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.apps.cli.console import ExitCode
from djpt.description.registry import registered
from djpt.errors import SceneError
from djpt.images.image import read_pixels
from djpt.images.sheets import fitting_font
from djpt.scenes import SCENES
from djpt.scenes.gallery import GLASS, PANELS, Panel, panels, shader_ball, sheet
from tests.kit.commands import run

SIZE = 16


def types_in(node: Any) -> set[str]:
    """All plugins of a description."""
    if not isinstance(node, dict):
        return set()
    return {node["type"]}.union(*map(types_in, node.values()))


# ---------------------------------------------------------------- panels


def test_every_material_has_a_panel() -> None:
    shown = set().union(*(types_in(panel.bsdf()) for panel in PANELS.values()))
    own = {name for name, factory in registered("bsdf").items() if factory.__module__.startswith("djpt.")}
    assert len(own) >= 20 and own <= shown | {"measured"}  # which needs a file


@pytest.mark.parametrize("name", PANELS)
@pytest.mark.sparse(4)
def test_a_panel_loads(name: str) -> None:
    panel = PANELS[name]
    description = panel.scene(SIZE)
    assert panel.title in types_in(description["ball"]["bsdf"])
    scene = djpt.load_dict(description)
    assert tuple(scene.sensors()[0].film().size()) == (SIZE, SIZE)


def test_the_ball_rests_on_the_rim_of_its_stand() -> None:
    scene = shader_ball()
    center, stand = np.array(scene["ball"]["center"]), scene["stand"]
    assert np.hypot(stand["radius"], center[2] - stand["p1"][2]) == pytest.approx(1)
    assert center[2] > 1  # the floor doesn't touch it
    assert SCENES["shader_ball"] is shader_ball


def test_nothing_and_glass_without_a_bend_look_the_same() -> None:
    """Refraction at equal indices is no refraction: the same paths, so the same picture."""
    nothing, refraction, both = (
        djpt.render(djpt.load_dict(PANELS[name].scene(SIZE)), spp=16).numpy()
        for name in ("null", "glass-refraction-1", "glass-1")
    )
    np.testing.assert_allclose(refraction, nothing, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(both, nothing, rtol=1e-3, atol=1e-3)


def test_the_two_halves_of_glass_are_darker_than_the_whole() -> None:
    """No pixel of finite light is brighter by one lobe alone than by both, but for noise."""
    reflection, refraction, both = (
        djpt.render(djpt.load_dict(GLASS[name].scene(SIZE)), spp=64).numpy().mean()
        for name in ("glass-reflection", "glass-refraction", "glass")
    )
    assert reflection < refraction < both


# ---------------------------------------------------------------- the sheet


def test_the_sheet_holds_the_pictures_in_order() -> None:
    seen: list[tuple[int, int]] = []
    names = ["diffuse", "mirror"]
    page = sheet(panels(names), size=SIZE, spp=4, columns=1, progress=lambda done, total: seen.append((done, total)))
    assert page.dtype == np.uint8 and page.shape[2] == 3
    gap = (page.shape[1] - SIZE) // 2
    for name, top in zip(names, (gap, gap + page.shape[0] // 2), strict=True):
        picture = djpt.Image(djpt.render(djpt.load_dict(PANELS[name].scene(SIZE)), spp=4)).srgb()
        rows = [y for y in range(top - 4, top + 5) if y >= 0]
        assert any(np.array_equal(page[y : y + SIZE, gap : gap + SIZE], picture) for y in rows), name
    total = 2 * SIZE * SIZE * 4
    assert seen[-1] == (total, total) and seen == sorted(seen)


def test_labels_are_drawn_below_the_pictures() -> None:
    page = sheet([Panel("diffuse", "any", matte)], size=48, spp=1)
    assert (page[48 + 6 :] < 100).any(), "no ink"
    assert (page[:, :1] > 240).all() and (page[:, -1:] > 240).all()


@pytest.mark.parametrize("size", [96, 200])
def test_labels_fit_under_their_pictures(size: int) -> None:
    for panel in PANELS.values():
        for line in (panel.title, panel.subtitle):
            font = fitting_font(line, size // 14, size)
            assert font.getlength(line) <= size, line


def matte() -> dict[str, Any]:
    """Any material."""
    return {"type": "diffuse"}


# ---------------------------------------------------------------- the command line


def test_the_command_writes_a_sheet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = run("gallery", "diffuse", "glass", "--size", "16", "--spp", "2")
    assert code == ExitCode.DONE, err
    assert out.startswith("gallery.png: 2 panels of 16 x 16, 2 spp, ")
    height, width, _ = read_pixels("gallery.png").shape
    assert width > 32 and height > 16


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["diffusse"], "the gallery has no panel 'diffusse'; did you mean 'diffuse'?"),
        (["diffuse", "-o", "a.exr"], "a gallery has labels, so it is written as png or jpg, found 'a.exr'"),
        (["diffuse", "--size", "0"], "--size must be at least 1, found 0"),
        (["diffuse", "--spp", "0"], "--spp must be at least 1, found 0"),
    ],
)
def test_wrong_arguments(arguments: list[str], message: str) -> None:
    code, out, err = run("gallery", *arguments)
    assert (code, out) == (ExitCode.BAD_INPUT, "")
    assert message in err


def test_unknown_panels_are_answered_with_those_there_are() -> None:
    with pytest.raises(SceneError, match=r"no panel 'x'; possible: anisotropic, .* and [0-9]+ more"):
        panels(["x"])
    assert panels() == list(PANELS.values())

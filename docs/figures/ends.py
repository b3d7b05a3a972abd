"""Paths from both ends: what each strategy finds."""

from __future__ import annotations

from typing import Any

import djpt
from djpt.images.sheets import Tile, captioned_rows, captioned_sheet, shown
from djpt.validation.integrator_comparison.strips import pyramid
from places import IMAGES

__all__ = ["fog_caustic", "fog_methods", "pool", "strategies"]


def strategies() -> None:
    """The pyramids of strategies, weighted and alone, of paths of 2 to 5 edges in the box with the glass ball."""
    rows = pyramid("glass_ball", 5, 256, width=112)
    half = len(rows) // 2
    for name, part in (("strategies", rows[:half]), ("strategies_alone", rows[half:])):
        djpt.write(IMAGES / f"{name}.png", captioned_rows(part))


def fog_caustic() -> None:
    """The box with the glass ball, in fog: what `volpath` and `bdpt` find in about the same time."""
    scene = djpt.load_dict(foggy_ball())
    tiles = []
    for kind, spp in (("volpath", 1400), ("bdpt", 256)):
        integrator = djpt.load_dict({"type": kind, "max_depth": 8})
        tiles.append(Tile(kind, f"{spp} samples", shown(djpt.render(scene, integrator=integrator, spp=spp))))
    djpt.write(IMAGES / "fog_caustic.png", captioned_sheet(tiles))


IN_FOG = {
    "glass_ball": {"volpath": 1400, "bdpt": 320, "sppm": 64, "vcm": 208, "upbp": 160},
    "lamp_in_glass": {"volpath": 1400, "bdpt": 400, "sppm": 64, "vcm": 256, "upbp": 200},
}
"""Scenes in fog, and the samples of each method for about the same time, by `benchmarks/methods.py`."""


def fog_methods() -> None:
    """The two scenes in fog of `benchmarks/methods.py`, by all methods in about the same time."""
    rows = []
    for name, methods in IN_FOG.items():
        scene = djpt.load_dict(in_thin_fog(djpt.scenes.SCENES[name]()))
        row = []
        for kind, spp in methods.items():
            integrator = djpt.load_dict({"type": kind, "max_depth": 8})
            row.append(Tile(kind, f"{spp} samples", shown(3 * djpt.render(scene, integrator=integrator, spp=spp))))
        rows.append(row)
    djpt.write(IMAGES / "fog_methods.png", captioned_rows(rows))


def in_thin_fog(scene: dict[str, Any]) -> dict[str, Any]:
    """A scene with a glass ball, in fog that fills all space but the ball."""
    scene["sensor"]["film"].update(width=128, height=128)
    scene["sensor"]["medium"] = scene["ball"]["exterior"] = {"type": "ref", "id": "fog"}
    return {"fog": {"type": "homogeneous", "sigma_t": 0.3, "albedo": 0.9, "id": "fog"}, **scene}


def pool() -> None:
    """The pool, seen through its waves: four methods, with samples for about the same time."""
    description = djpt.scenes.pool()
    description["sensor"]["film"].update(width=220, height=220)
    scene = djpt.load_dict(description)
    tiles = []
    for kind, spp in (("path", 1500), ("bdpt", 600), ("sppm", 256), ("vcm", 224)):
        integrator = djpt.load_dict({"type": kind, "max_depth": 8})
        tiles.append(Tile(kind, f"{spp} samples", shown(djpt.render(scene, integrator=integrator, spp=spp))))
    djpt.write(IMAGES / "pool.png", captioned_sheet(tiles))


def foggy_ball() -> dict[str, Any]:
    """The box with a small lamp and a glass ball, full of fog that scatters forward; the ball itself is clear."""
    scene = djpt.scenes.glass_ball()
    scene["sensor"]["film"].update(width=220, height=220)
    fog = {"type": "homogeneous", "sigma_t": 0.4, "albedo": 0.95, "phase": {"type": "hg", "g": 0.5}, "id": "fog"}
    scene["sensor"]["medium"] = scene["ball"]["exterior"] = {"type": "ref", "id": "fog"}
    return {"fog": fog, **scene}

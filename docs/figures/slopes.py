"""Derivatives, and what they are good for."""

from __future__ import annotations

import runpy
import sys
from unittest.mock import patch

import drjit as dr
import numpy as np

import djpt
from djpt.images.sheets import Tile, captioned_sheet, shown
from djpt.validation.report import difference_picture
from places import IMAGES, LADDER, ROOT

__all__ = ["albedo", "caustic", "derivatives", "lamp", "lens", "pose", "smoke"]


def albedo() -> None:
    """What the albedo example writes."""
    with patch.object(sys, "argv", ["albedo.py", "--out", str(IMAGES / "albedo.png")]):
        runpy.run_path(str(ROOT / "examples" / "albedo.py"), run_name="__main__")


def smoke() -> None:
    """What the smoke example writes."""
    with patch.object(sys, "argv", ["smoke.py", "--out", str(IMAGES / "recovered_smoke.png")]):
        runpy.run_path(str(ROOT / "examples" / "smoke.py"), run_name="__main__")


def pose() -> None:
    """What the example of a camera's pose writes."""
    with patch.object(sys, "argv", ["pose.py", "--out", str(IMAGES / "pose.png")]):
        runpy.run_path(str(ROOT / "examples" / "pose.py"), run_name="__main__")


def lamp() -> None:
    """What the example of a lamp's shadow writes."""
    with patch.object(sys, "argv", ["lamp.py", "--out", str(IMAGES / "lamp.png")]):
        runpy.run_path(str(ROOT / "examples" / "lamp.py"), run_name="__main__")


def caustic() -> None:
    """What the example of a glass ball writes."""
    with patch.object(sys, "argv", ["caustic.py", "--steps", "60", "--out", str(IMAGES / "caustic.png")]):
        runpy.run_path(str(ROOT / "examples" / "caustic.py"), run_name="__main__")


def lens() -> None:
    """What the example of a pane of glass writes."""
    options = ["--size", "96", "--points", "97", "--out", str(IMAGES / "lens.png")]
    with patch.object(sys, "argv", ["lens.py", *options]):
        runpy.run_path(str(ROOT / "examples" / "lens.py"), run_name="__main__")


def derivatives() -> None:
    """The room, and how each pixel depends on one number: red where more of it means more light, blue where less."""
    description = LADDER["room"](216)
    description["copper"]["bsdf"]["alpha"] = 0.2
    scene = djpt.load_dict(description)
    image = np.array(djpt.render(scene, spp=2048), np.float32)
    tiles = [Tile("the image", "path, 8 edges", shown(image))]
    for key, title, subtitle in (
        ("red.reflectance.value", "derivative", "by the red paint"),
        ("large-sphere.bsdf.reflectance.value", "derivative", "by the mirror's reflectance"),
        ("copper.bsdf.alpha.value", "derivative", "by the copper's roughness"),
    ):
        params = djpt.traverse(scene)
        change = djpt.Float(0)
        dr.enable_grad(change)
        params[key] = params[key] + change
        params.update()
        rendered = djpt.render(scene, params, spp=2048)
        dr.forward(change)
        derivative = np.array(dr.grad(rendered), np.float32)
        scale = float(np.quantile(np.abs(derivative.mean(axis=2)), 0.99))
        tiles.append(Tile(title, subtitle, difference_picture(derivative, np.zeros_like(derivative), scale)))
        params[key] = dr.detach(params[key])
        params.update()
    djpt.write(IMAGES / "derivatives.png", captioned_sheet(tiles))

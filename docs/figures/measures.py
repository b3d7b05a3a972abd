"""The chapter of radiometry: solid angles, the terms of the series, and the lamp that is black."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

import djpt
from djpt.images.sheets import Tile, captioned_sheet, shown
from places import IMAGES, ROOT
from svg import BLUE, GREY, RED, Drawing

sys.path.append(str(ROOT))  # for the code blocks of the tests

from tests.kit.documents import sections

__all__ = ["black_lamp", "series", "solid_angle"]

PAGE = "docs/theory/radiometry.md"

Points = NDArray[np.float64]

SCALE = 105.0
"""Pixels per unit."""

PALE, ORANGE = "#dbe6f6", "#f9b572"


def seen(p: Points, left: float) -> Points:
    """Where points (n, 3), z upwards, are in the drawing: a parallel projection from the right, in front, above."""
    turn, tilt = np.radians(28), np.radians(18)
    x = p[:, 0] * np.cos(turn) + p[:, 1] * np.sin(turn)
    y = p[:, 2] * np.cos(tilt) + (p[:, 0] * np.sin(turn) - p[:, 1] * np.cos(turn)) * -np.sin(tilt)
    return np.stack([left + SCALE * x, 190 - SCALE * y], axis=1)


def on_sphere(polar: Any, azimuth: Any) -> Points:
    """Points of the unit sphere, (n, 3)."""
    polar, azimuth = np.broadcast_arrays(np.asarray(polar, np.float64), np.asarray(azimuth, np.float64))
    return np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1)


def hemisphere(drawing: Drawing, left: float) -> None:
    """Draw the unit hemisphere over the plane z = 0: its equator, and meridians."""
    turns = np.linspace(0, 2 * np.pi, 73)
    drawing.polygon(seen(on_sphere(np.pi / 2, turns), left), PALE, GREY)
    for azimuth in np.radians([-150, -105, -60, -15, 30, 75, 120, 165]):
        drawing.line(seen(on_sphere(np.linspace(0, np.pi / 2, 25), azimuth), left), "#c3cbd6", 0.8)
    for polar in np.radians([30, 60]):
        drawing.line(seen(on_sphere(polar, turns), left), "#c3cbd6", 0.8)


def tilted_surface(drawing: Drawing, left: float) -> None:
    """A small surface far away, its projection on the unit sphere, and the cone between."""
    hemisphere(drawing, left)
    direction = on_sphere(np.radians(48), np.radians(-20))
    across = np.cross(direction, [0, 0, 1])
    across /= np.linalg.norm(across)
    up = np.cross(across, direction)
    tilted = np.cos(np.radians(50)) * up + np.sin(np.radians(50)) * direction
    center, half = 2.0 * direction, 0.3
    corners = np.array([center + half * (a * across + b * tilted) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    shadow = corners / np.linalg.norm(corners, axis=1, keepdims=True)
    for corner in corners:
        drawing.line(seen(np.array([np.zeros(3), corner]), left), GREY, 0.8, dashed=True)
    drawing.polygon(seen(shadow, left), ORANGE, RED)
    drawing.polygon(seen(corners, left), "#8fb1e3", BLUE)
    normal = np.cross(across, tilted)
    normal *= -np.sign(normal @ direction)
    middle, towards, end = seen(np.array([center, center - 0.6 * direction, center + 0.6 * normal]), left)
    drawing.arrow(tuple(middle), tuple(end), BLUE)
    drawing.arrow(tuple(middle), tuple(towards), RED)
    drawing.text((end[0] - 44, end[1] + 2), "normal", 12, color=BLUE)
    angle = seen(np.array([center + 0.42 * (normal - direction) / np.linalg.norm(normal - direction)]), left)[0]
    drawing.text(tuple(angle), "\u03b8", 14, middle=True)
    place = seen(corners, left).max(axis=0)
    drawing.text((place[0] + 6, place[1] - 30), "dA", 14, color=BLUE)
    place = seen(shadow.mean(axis=0, keepdims=True), left)[0]
    drawing.text((place[0] - 14, place[1] - 16), "d\u03c9", 14, color=RED)
    drawing.text((left - 90, 272), "d\u03c9 = cos \u03b8 dA / r\u00b2", 15)


def piece_of_sphere(drawing: Drawing, left: float) -> None:
    """A piece of the sphere between two polar angles and two azimuths."""
    hemisphere(drawing, left)
    low, high, first, last = np.radians([40, 58, -40, -8])
    around, down = np.linspace(first, last, 12), np.linspace(low, high, 8)
    border = np.concatenate(
        [
            *(on_sphere(low, around), on_sphere(down, last)),
            *(on_sphere(high, around[::-1]), on_sphere(down[::-1], first)),
        ]
    )
    origin = np.zeros(3)
    top, bottom = on_sphere(low, last), on_sphere(high, last)
    for end in (top, bottom):
        drawing.line(seen(np.array([origin, end]), left), GREY, 0.9)
    drawing.line(seen(np.array([origin, [0, 0, 1]]), left), GREY, 0.9, dashed=True)
    axis = np.array([[0, 0, np.cos(low)], on_sphere(low, first), on_sphere(low, last)])
    drawing.line(seen(axis[[1, 0, 2]], left), GREY, 0.9, dashed=True)
    drawing.polygon(seen(border, left), ORANGE, RED)
    arc = seen(0.35 * on_sphere(np.linspace(0, low, 12), last), left)
    drawing.line(arc, BLUE, 1.4)
    drawing.text((arc[6][0] + 2, arc[6][1] - 5), "\u03d1", 14, color=BLUE)
    side = seen(on_sphere(np.array([(low + high) / 2]), last), left)[0]
    drawing.text((side[0] + 7, side[1] + 5), "d\u03d1", 14, color=RED)
    edge = seen(on_sphere(np.array([high]), (first + last) / 2), left)[0]
    drawing.text((edge[0] - 34, edge[1] + 18), "sin \u03d1 d\u03c6", 14, color=RED)
    drawing.text((left - 90, 272), "d\u03c9 = sin \u03d1 d\u03d1 d\u03c6", 15)


def solid_angle() -> None:
    """What a solid angle is: a projected surface, and a piece of the sphere."""
    drawing = Drawing(700, 292, "A small surface projected onto the unit sphere; a piece of the sphere in polar angles")
    tilted_surface(drawing, 150)
    piece_of_sphere(drawing, 520)
    (IMAGES / "solid_angle.svg").write_text(drawing.finished())


def series() -> None:
    """The sums of the first terms of the Neumann series in the Cornell box."""
    size, terms = 220, 16
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=size, height=size)
    description["integrator"] = {"type": "path", "max_depth": terms, "rr_depth": 100, "bounces": True}
    layers = np.array(djpt.render(djpt.load_dict(description), spp=1024))[..., 3:].reshape(size, size, terms, 3)
    sums = np.cumsum(layers, axis=2)
    captions = ((1, "E", "what lamps emit"), (2, "E + KE", "what a rasteriser shades"))
    captions += ((3, "E + KE + K^2E", "one more reflection"), (terms, "all", f"{terms} terms"))
    tiles = [Tile(title, subtitle, shown(1.5 * sums[:, :, count - 1])) for count, title, subtitle in captions]
    djpt.write(IMAGES / "series.png", captioned_sheet(tiles))


def black_lamp() -> None:
    """The strict algorithm, with emission nowhere, at the camera's vertices, and after reflections by mirrors, too."""
    names: dict[str, Any] = {"__name__": "black_lamp", "djpt": djpt, "np": np}
    import drjit

    names |= {"dr": drjit, "close": lambda *numbers: None}
    blocks = sections(PAGE)["Why is the lamp black?"]
    blocks[0].run(names)
    room = djpt.scenes.cornell_box_spheres()
    room["large-sphere"]["bsdf"], room["small-sphere"]["bsdf"] = {"type": "mirror"}, {"type": "dielectric"}
    room["sensor"]["film"].update(width=240, height=240)
    scene = djpt.load_dict(room)
    tiles = []
    for emission, subtitle in (
        ("never", "by the letter"),
        ("camera", "added at the first surface"),
        ("specular", "and after mirrors and glass"),
    ):
        image = djpt.render(scene, spp=512, integrator=djpt.load_dict({"type": "strict", "emission": emission}))
        tiles.append(Tile(f"emission: {emission}", subtitle, shown(1.5 * np.array(image))))
    djpt.write(IMAGES / "black_lamp.png", captioned_sheet(tiles))

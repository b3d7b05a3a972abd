"""Rays of a packet that are searched side by side: the rings in which they stand, and the pipeline at the nodes."""

from __future__ import annotations

from places import IMAGES
from svg import BLUE, GREY, RED, Box, Drawing

__all__ = ["rings"]

RINGS = (
    ("nodes", "test eight boxes", ("a", "d", "f", "g", "h", "i")),
    ("leaves", "test eight triangles", ("b", "e")),
    ("placed", "test a solid; enter an instance", ("c",)),
)
"""The rings: name, work, and the rays that wait in the picture."""

STAGES = ("test its boxes", "find the nearest child", "write its stack")
"""The stages at a node."""

CELL, LEFT, TOP, PITCH = 34, 30, 62, 96
STEPS = 5


def rings() -> None:
    """On the left the rings with the rays that wait, on the right what the pipeline does with them step by step."""
    drawing = Drawing(990, 330, "Rays of a packet wait in rings for the work that they need next")
    drawing.text((LEFT, 30), "Rings", 15, bold=True)
    for row, (name, work, rays) in enumerate(RINGS):
        y = TOP + PITCH * row
        drawing.text((LEFT, y), name, 13, code=True, bold=True)
        drawing.text((LEFT + 70, y), work, 12, color=GREY)
        for place in range(8):
            box = Box(LEFT + CELL * place, y + 10, CELL, CELL)
            drawing.box(box, "#eef3fb" if place < len(rays) else "#ffffff")
            if place < len(rays):
                drawing.text(box.at(0.5, 0.65), rays[place], 13, code=True, middle=True)
    right = LEFT + 8 * CELL
    drawing.text((right + 22, 30), "a step takes the first ray ...", 12, color=BLUE)
    for row in range(len(RINGS)):
        y = TOP + PITCH * row + 10 + CELL / 2
        drawing.arrow((right + 70, 150), (right + 4, y), RED, bend=(right + 50, y))
    drawing.text((right + 22, 168), "... and puts it behind", 12, color=RED)
    drawing.text((right + 22, 184), "the last of one of them", 12, color=RED)
    x0, y0, wide = 620, 62, 70
    drawing.text((x0 - 140, 30), "The pipeline at the nodes", 15, bold=True)
    waiting = RINGS[0][2]
    for step in range(STEPS):
        drawing.text((x0 + wide * (step + 0.5), y0), f"step {step + 1}", 12, middle=True, color=GREY)
    for stage, work in enumerate(STAGES):
        y = y0 - 10 + 72 * stage
        drawing.text((x0 - 140, y + 44), work, 12)
        for step in range(STEPS):
            box = Box(x0 + wide * step, y + 22, wide, CELL)
            ray = step - stage
            drawing.box(box, "#eef3fb" if ray >= 0 else "#ffffff")
            if ray >= 0:
                drawing.text(box.at(0.5, 0.65), waiting[ray], 13, code=True, middle=True)
            if ray >= 0 and stage + 1 < len(STAGES) and step + 1 < STEPS:
                drawing.arrow(box.at(0.6, 1), (box.x + 1.4 * wide, y + 94), BLUE)
    drawing.text((x0 - 140, 300), "In a step no stage needs what another one computes.", 12, color=GREY)
    (IMAGES / "rings.svg").write_text(drawing.finished(), encoding="utf-8")

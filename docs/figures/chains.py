"""Two chains of calls: from a ray to a surface point, and from a loss to the gradient of a parameter."""

from __future__ import annotations

from dataclasses import dataclass

from places import IMAGES
from svg import BLUE, GREY, Box, Drawing

__all__ = ["gradient", "ray_query"]


@dataclass(frozen=True)
class Step:
    """A box: what is called, or None for a result, and what happens there."""

    call: str | None
    """A module and a name in it, ``djpt.scene.queries:SceneQueries.closest_hit``."""
    words: str
    title: str = ""
    """What is written in the place of the call's name."""


Rows = tuple[tuple[Step | None, ...], ...]
"""Steps from top to bottom; those of a row are beside each other, None where there is room."""

CLOSEST = "the unrolled shapes, then the tree up to the nearest of them"

RAY_QUERY: Rows = (
    (Step("djpt.scene.mitsuba_api:MitsubaScene.ray_intersect", "a ray per lane; origins far away are moved near"),),
    (Step("djpt.scene.queries:SceneQueries.closest_hit", "what integrators need to go on"),),
    (Step("djpt.geometry.aggregate:Geometry.closest", CLOSEST),),
    (
        Step("djpt.geometry.unrolled:Unrolled.closest", "straight-line code, no loop; bounds the search"),
        Step("djpt.geometry.query:RayTree.search", "the contract of all trees"),
    ),
    (
        Step("djpt.geometry.bvh.steps.trees:StepTree.search", "a loop in the kernel"),
        Step("djpt.geometry.bvh.calls.trees:CompiledTree.search", "one call per packet of lanes"),
    ),
    (
        None,
        Step("djpt.jit.llvm.calls:call", "a node of the trace, as Embree's would be"),
    ),
    (
        Step("djpt.core.records:PreliminaryIntersection3f", "distance, face, shape"),
        Step("djpt.geometry.bvh.calls.searches:functions", "machine code: all rays of a packet side by side"),
    ),
    (Step("djpt.scene.queries:SceneQueries.surface_interaction", "position, normal, frame, uv of the nearest"),),
)

GRADIENT: Rows = (
    (Step("djpt.rendering.render:render", "finds parameters with gradients enabled"),),
    (Step("djpt.rendering.gradients.choice:differentiable", "one operation of Dr.Jit: image and derivative"),),
    (
        Step("djpt.rendering.schedules.base:Schedule.image", "the image, nothing tracked"),
        Step("djpt.rendering.gradients.derivatives:ImageOp.backward", "called by dr.backward(loss)"),
    ),
    (
        None,
        Step("djpt.rendering.gradients.derivatives:ReplayDerivative.backward", "derivatives of the loss, by sample"),
    ),
    (Step("djpt.rendering.schedules.base:Schedule.replay", "samples of their own seed, each walked twice"),),
    (
        Step(None, "adds up the sample's light L", "first walk"),
        Step(None, "subtracts from L what it passes", "second walk"),
    ),
    (
        Step("djpt.rendering.gradients.leaves:Leaves", "fresh leaves for what a vertex reads"),
        Step("djpt.rendering.gradients.modes:Reverse.differentiate", "dr.backward of one expression"),
    ),
    (
        None,
        Step("djpt.rendering.gradients.leaves:Accumulator.add", "sums per parameter, in registers"),
    ),
    (Step("djpt.rendering.gradients.leaves:Accumulator.gradients", "dr.grad(parameter)"),),
)

Arrow = tuple[tuple[int, int], tuple[int, int]]
"""From one box to another, each a row and a place in it."""

CHAINS: dict[str, tuple[str, Rows, tuple[Arrow, ...]]] = {
    "ray_query": (
        "From a ray to a surface point",
        RAY_QUERY,
        (
            *(((0, 0), (1, 0)), ((1, 0), (2, 0)), ((2, 0), (3, 0)), ((2, 0), (3, 1)), ((3, 1), (4, 0))),
            *(((3, 1), (4, 1)), ((4, 1), (5, 1)), ((5, 1), (6, 1)), ((4, 0), (6, 0)), ((6, 1), (6, 0))),
            ((6, 0), (7, 0)),
        ),
    ),
    "gradient": (
        "From a loss to the gradient of a parameter",
        GRADIENT,
        (
            *(((0, 0), (1, 0)), ((1, 0), (2, 0)), ((1, 0), (2, 1)), ((2, 1), (3, 1)), ((3, 1), (4, 0))),
            *(((4, 0), (5, 0)), ((5, 0), (5, 1)), ((5, 1), (6, 1)), ((6, 0), (6, 1)), ((6, 1), (7, 1))),
            ((7, 1), (8, 0)),
        ),
    ),
}
"""The title of each chain, its boxes and its arrows."""

WIDE, HIGH, GAP, PITCH = 400, 58, 40, 88


def drawn(name: str) -> str:
    """The picture of a chain."""
    title, rows, arrows = CHAINS[name]
    drawing = Drawing(2 * WIDE + GAP + 40, PITCH * len(rows) + 4, title)
    boxes = {
        (row, place): Box(20 + (WIDE + GAP) * (place if len(steps) == 2 else 0.5), 16 + PITCH * row, WIDE, HIGH)
        for row, steps in enumerate(rows)
        for place, step in enumerate(steps)
        if step is not None
    }
    for (row, place), box in boxes.items():
        step = rows[row][place]
        assert step is not None
        module, _, qualified = (step.call or "").partition(":")
        drawing.box(box, "#ffffff" if step.call else "#eef3fb", BLUE)
        drawing.text(box.at(0.5, 0.33), qualified or step.title, 14, code=bool(qualified), bold=True, middle=True)
        drawing.text(box.at(0.5, 0.62), step.words, 12, middle=True)
        drawing.text(box.at(0.5, 0.88), module, 10, code=True, middle=True, color=GREY)
    for a, b in arrows:
        if a[0] == b[0]:
            left = a[1] > b[1]
            drawing.arrow(boxes[a].at(0 if left else 1, 0.5), boxes[b].at(1 if left else 0, 0.5), BLUE)
        else:
            lean = 0.2 if boxes[b].x > boxes[a].x else -0.2 if boxes[b].x < boxes[a].x else 0
            drawing.arrow(boxes[a].at(0.5 + lean, 1), boxes[b].at(0.5 - lean, 0), BLUE)
    return drawing.finished()


def ray_query() -> None:
    """The calls of a ray query, one below the other."""
    (IMAGES / "ray_query.svg").write_text(drawn("ray_query"), encoding="utf-8")


def gradient() -> None:
    """The calls of a gradient, one below the other."""
    (IMAGES / "gradient.svg").write_text(drawn("gradient"), encoding="utf-8")

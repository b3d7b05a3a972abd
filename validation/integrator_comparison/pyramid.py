"""The pyramid of strategies of bidirectional path tracing, as Veach drew it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from djpt.description.loader import load_dict
from djpt.images.sheets import Tile, shown
from djpt.images.tone_mapping import stops
from djpt.integrators.bidirectional.strategies import strategies
from djpt.rendering.image import channel_names
from djpt.rendering.progress import Progress
from djpt.rendering.render import render
from djpt.scenes.overrides import described, override
from djpt.validation.integrator_comparison.steps import STEPS

__all__ = ["pyramid"]

KINDS = {"": "weighted", ".alone": "alone"}
"""The ends of channels' names, and the captions of pictures."""


def pyramid(
    scene: Mapping[str, Any] | str,
    max_depth: int = 5,
    spp: int = 64,
    *,
    exposure: float | str = "auto",
    width: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[list[Tile]]:
    """Render the light of each strategy (s, t): s vertices from a light and t from the camera.

    A row has the strategies of paths of one length, which all estimate the same light: first row by row with their
    weights, so that a row's sum is its light, then each as if there were no other. The film has a box filter.

    Args:
        scene: A dict of Mitsuba's schema, a built-in name, or a scene file.
        max_depth: Edges of the longest path, 2 to 8; the first row has those of two edges.
        spp: Samples per pixel.
        exposure: In stops; ``"auto"`` is computed for each row from its light, since longer paths carry less.
        width: Pixels of a panel, instead of the scene's; the image keeps its shape.
        seed: Seed of the image.
        progress: Called with (samples done, samples in all).
    """
    loaded = load_dict(override(described(scene)[1], width=width, rfilter="box"))
    bdpt = next(step for step in STEPS if step.title == "bdpt").description(loaded)
    integrator = load_dict({**bdpt, "max_depth": max_depth, "strategies": True})
    image = np.array(render(loaded, integrator=integrator, spp=spp, seed=seed, progress=progress), np.float64)
    names = channel_names(loaded, integrator=integrator)

    def light(s: int, t: int, kind: str) -> np.ndarray:
        first = names.index(f"s{s}t{t}{kind}.R")
        return image[..., first : first + 3]

    pairs, rows = list(strategies(max_depth)), []
    for kind, caption in KINDS.items():
        for edges in range(2, max_depth + 1):
            row = [(s, t) for s, t in pairs if s + t - 1 == edges]
            gain = 2.0 ** stops(exposure, np.sum([light(s, t, "") for s, t in row], axis=0))
            rows.append([Tile(f"s = {s}, t = {t}", caption, shown(gain * light(s, t, kind))) for s, t in row])
    return rows

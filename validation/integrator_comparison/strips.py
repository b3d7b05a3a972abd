"""Series of pictures: light by its number of bounces, and noise by the number of samples."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.description.loader import load_dict
from djpt.errors import RenderError
from djpt.images.sheets import Tile, shown
from djpt.images.tone_mapping import stops
from djpt.integrators.bidirectional.strategies import strategies
from djpt.rendering.image import channel_names
from djpt.rendering.progress import Progress
from djpt.rendering.render import render
from djpt.scenes.overrides import described, override
from djpt.validation.integrator_comparison.measure import BATCHES, colors, seeds
from djpt.validation.integrator_comparison.steps import STEPS
from djpt.validation.statistics import Batches

__all__ = ["bounces", "pyramid", "samples"]

FIRST = ("emitted", "scattered once", "scattered twice")
"""The names of the first terms of the Neumann series."""


def bounces(
    scene: Mapping[str, Any] | str,
    max_depth: int = 6,
    spp: int = 256,
    *,
    exposure: float | str = 0.0,
    width: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[Tile]:
    """Render the terms of L = E + K E + K^2 E + .. one by one, and their sum: light by how often it was scattered.

    Args:
        scene: A dict of Mitsuba's schema, a built-in name, or a scene file.
        max_depth: Edges of the longest path, which is the number of terms: 1 to 32.
        spp: Samples per pixel.
        exposure: In stops, of all panels; ``"auto"`` is computed from the sum.
        width: Pixels of a panel, instead of the scene's; the image keeps its shape.
        seed: Seed of the image.
        progress: Called with (samples done, samples in all).
    """
    loaded = load_dict(override(described(scene)[1], width=width))
    path = next(step for step in STEPS if step.title == "path").description(loaded)
    integrator = load_dict({**path, "max_depth": max_depth, "bounces": True})
    image = np.array(render(loaded, integrator=integrator, spp=spp, seed=seed, progress=progress), np.float64)
    first = channel_names(loaded, integrator=integrator).index("bounce0.R")
    terms = [image[..., first + 3 * k : first + 3 * k + 3] for k in range(max_depth)]
    total = np.sum(terms, axis=0)
    gain = 2.0 ** stops(exposure, total)
    tiles = [
        Tile(("E", "KE")[k] if k < 2 else f"K^{k}E", FIRST[k] if k < 3 else f"{k} times", shown(gain * term))
        for k, term in enumerate(terms)
    ]
    return [*tiles, Tile("sum", f"up to {max_depth} edges", shown(gain * total))]


def samples(
    scene: Mapping[str, Any] | str,
    most: int = 4096,
    *,
    integrator: str | None = None,
    reference_spp: int | None = None,
    repeats: int = 4,
    width: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[Tile]:
    """Render an image with 1, 16, 64, 256, .. samples per pixel, and measure the RMSE of each.

    The RMSE is the root mean square over `repeats` images with different seeds, against a reference with other seeds.
    The reference's own noise is known from its parts and taken out: see
    `djpt.validation.integrator_comparison.measure`.

    Args:
        scene: A dict of Mitsuba's schema, a built-in name, or a scene file.
        most: Samples per pixel of the last panel.
        integrator: Name of an integrator, instead of the scene's.
        reference_spp: Samples per pixel of the reference, in 16 equal parts (default: 4 times `most`).
        repeats: Images that an RMSE is averaged over.
        width: Pixels of a panel, instead of the scene's; the image keeps its shape.
        seed: Changes all seeds.
        progress: Called with (samples per pixel done, samples per pixel in all).
    """
    if most < 1 or repeats < 1:
        raise RenderError(f"the strip of samples needs positive numbers, found most={most}, repeats={repeats}")
    counts = [count for count in (1, *(4**k for k in range(2, 16))) if count < most] + [most]
    loaded = load_dict(override(described(scene)[1], width=width, integrator=integrator))
    part = math.ceil((reference_spp or 4 * most) / BATCHES)
    total, done = part * BATCHES + repeats * sum(counts), 0

    def image(spp: int, seed: int) -> npt.NDArray[np.float64]:
        nonlocal done
        result = colors(np.array(render(loaded, spp=spp, seed=seed), np.float64))
        done += spp
        if progress is not None:
            progress(done, total)
        return result

    random = seeds(seed, 0)
    reference = Batches()
    for _ in range(BATCHES):
        reference.add(image(part, next(random)))
    variance = float(reference.variance_of_mean().mean())
    tiles = []
    for number, count in enumerate(counts):
        random = seeds(seed, number + 1)
        images = [image(count, next(random)) for _ in range(repeats)]
        squares = float(np.mean([np.square(one - reference.mean).mean() for one in images]))
        error = math.sqrt(max(squares - variance, 0.0))
        tiles.append(Tile(f"{count} spp", f"RMSE {error:.2g}", shown(images[0])))
    return tiles


# ---- the pyramid of strategies of bidirectional path tracing ---------------------------------


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

"""The work done by workers: loading a scene once, rendering rounds of it, differentiating images of it."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

import djpt
from djpt.apps.cluster.bundle import Bundle
from djpt.jit.llvm.lanes import lane_count
from djpt.rendering.progressive.rounds import Rounds
from djpt.rendering.settings import RenderSettings
from djpt.scene.scene import Scene
from djpt.version import __version__

__all__ = ["Answer", "differentiated", "rendered", "software"]

KEPT = 4
"""The number of scenes that a worker keeps, the most recently used ones."""

one_at_a_time = threading.Lock()
"""Held while something is rendered: Dr.Jit's threads work on one task at a time, whatever threads the worker has."""

# A task is a function and its arguments: what a worker keeps from one to the next can only be kept by its process.

loaded: OrderedDict[str, Scene] = OrderedDict()
"""Those scenes, by the keys of their bundles."""

begun: dict[tuple[str, int, int, str], Rounds] = {}
"""The render whose rounds were computed last."""


@dataclass(frozen=True)
class Answer:
    """The result of a task, and the software that computed it."""

    value: Any
    software: str


def software() -> str:
    """Everything that the bits of a result depend on: versions, and the vector width."""
    return f"djpt {__version__}, drjit {version('drjit')}, {lane_count()} lanes"


def scene_of(bundle: Bundle) -> Scene:
    """The scene of a bundle, loaded on first use."""
    if bundle.key not in loaded:
        loaded[bundle.key] = bundle.loaded()
    loaded.move_to_end(bundle.key)
    while len(loaded) > KEPT:
        loaded.popitem(last=False)
    return loaded[bundle.key]


def rendered(bundle: Bundle, sensor: int, spp: int, schedule: str, seed: int) -> Answer:
    """A round of a render: see `djpt.rendering.progressive.rounds`."""
    with one_at_a_time:
        scene = scene_of(bundle)
        key = bundle.key, sensor, spp, schedule
        if key not in begun:
            begun.clear()
            begun[key] = Rounds(scene, RenderSettings.of(scene, sensor, spp=spp, schedule=schedule))
        return Answer(begun[key].begin(seed)(), software())


def differentiated(
    bundle: Bundle,
    values: Mapping[str, npt.NDArray[np.floating]],
    loss: Callable[[Any, int], Any],
    view: int,
    spp: int,
    seed: int,
) -> Answer:
    """The loss of one view, and its derivatives with respect to the parameters: (float, arrays by name)."""
    with one_at_a_time:
        scene = scene_of(bundle)
        params = djpt.traverse(scene)
        before = {key: type(params[key])(params[key]) for key in values}
        try:
            for key, value in values.items():
                params[key] = type(params[key])(value)
                dr.enable_grad(params[key])
            params.update()
            result = loss(djpt.render(scene, params, sensor=view, spp=spp, seed=seed), view)
            dr.backward(result)
            derivatives = {key: np.array(dr.grad(params[key])) for key in values}
            return Answer((float(np.array(dr.detach(result)).ravel()[0]), derivatives), software())
        finally:
            # The next task finds the scene as it was loaded.
            params.update({key: dr.detach(value) for key, value in before.items()})

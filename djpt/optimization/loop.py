"""`optimize`: parameters of a scene from pictures of it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import drjit.opt
import numpy as np
import numpy.typing as npt

from djpt.display.progress import Progress, watched
from djpt.errors import ParameterError, RenderError, near_miss
from djpt.long_renders.rounds import round_seed
from djpt.optimization.losses import Loss, loss_of
from djpt.optimization.priors import Prior, prior_of
from djpt.optimization.state import load_state, save_state
from djpt.optimization.variables import Variable
from djpt.parameters import SceneParameters, traverse
from djpt.rendering import check_count, check_seed, find_sensor, render
from djpt.scene import Scene

__all__ = ["Optimization", "Progressed", "optimize"]

SAVED = 10
"""Iterations from one writing of the checkpoint to the next."""

OPTIMIZERS = {"adam": drjit.opt.Adam, "sgd": drjit.opt.SGD, "rmsprop": drjit.opt.RMSProp}


@dataclass(frozen=True)
class Progressed:
    """What a callback is told after each iteration."""

    iteration: int
    loss: float
    """Of the views of this iteration, priors included."""
    values: Mapping[str, Any]
    """The parameters."""
    seconds: float
    """Since the start."""


@dataclass
class Optimization:
    """The result of `optimize`.

    * `values`: the parameters, which the scene has as well; `average`: their means over the last quarter of the
      iterations, which have less noise.
    * `losses`: of each iteration.
    * `seconds`: in all.
    """

    values: dict[str, Any]
    average: dict[str, npt.NDArray[np.float64]]
    losses: list[float]
    seconds: float

    @property
    def iterations(self) -> int:
        """The number of steps, those of an earlier run included."""
        return len(self.losses)


def optimize(
    scene: Scene,
    keys: str | Sequence[str],
    targets: Sequence[Any],
    *,
    views: Sequence[int] | None = None,
    batch: int = 0,
    iterations: int = 100,
    spp: int = 16,
    loss: str | Loss = "l2",
    optimizer: str = "adam",
    rate: float | Callable[[int], float] = 0.02,
    bounds: Mapping[str, tuple[float, float]] | tuple[float, float] = (0.0, 1.0),
    keeping: str = "projection",
    priors: Mapping[str, tuple[str | Prior, float]] | None = None,
    coarse: Mapping[str, int] | None = None,
    demodulate: bool = False,
    seed: int = 0,
    callback: Callable[[Progressed], bool | None] | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Progress | bool | None = None,
) -> Optimization:
    """Find parameters with which a scene looks like pictures of it, by stochastic gradient descent.

    Args:
        scene: What `load_dict` returned; the search starts at its values, and it has the result in the end.
        keys: The parameters, by their names in `djpt.traverse`.
        targets: The pictures, (H, W, C) each, of linear values.
        views: The numbers of the sensors that they were taken with; by default 0, 1, ..
        batch: How many views each iteration looks at, in an order drawn anew for each round of all; 0: all.
        iterations: How many steps.
        spp: Samples per pixel of each image, and of each gradient, which has samples of its own: derivatives of L2
            losses are unbiased therefore.
        loss: ``l1``, ``l2``, ``relative``, ``log``, or a function of image and target.
        optimizer: ``adam``, ``sgd``, ``rmsprop``: those of `drjit.opt`.
        rate: The step, or a function of the iteration, such as ``lambda i: 0.05 * 0.99**i``.
        bounds: Of all parameters, or by name.
        keeping: How parameters stay in them: ``projection``, ``sigmoid``, or ``free``.
        priors: For textures by name: (``smooth``, ``tv`` or a function, weight).
        coarse: For textures by name: how often width and height are halved at first. They are doubled again at equal
            parts of the iterations.
        demodulate: Divide image and target by the target's brightness before the loss, so that light and dark parts
            of a picture count alike: what is left is the ratio of albedos.
        seed: Of all renders; iteration i has seeds of its own.
        callback: Called after each iteration; returning True ends the search.
        checkpoint: A file that keeps the state after each tenth iteration; if it exists, the search goes on from it,
            with the same steps as one that was never ended.
        progress: Called with (iterations done, all); True shows a bar.

    Raises:
        ParameterError: A parameter is unknown, has no derivatives, or its bounds make no sense.
        RenderError: Targets don't fit the views, or arguments are out of range.
        FileError: The checkpoint is another search's, or can't be written.
    """
    names = [keys] if isinstance(keys, str) else list(keys)
    numbers = list(range(len(targets)) if views is None else views)
    iterations, seed = check_count("iterations", iterations), check_seed("seed", seed)
    if optimizer not in OPTIMIZERS:
        raise RenderError(f"unknown optimizer '{optimizer}'{near_miss(optimizer, OPTIMIZERS)}")
    params, rate_at = traverse(scene), rate if callable(rate) else lambda i: rate
    variables = {name: variable(params, name, bounds, keeping, (coarse or {}).get(name, 0)) for name in names}
    search = Search(
        scene=scene,
        params=params,
        variables=variables,
        optimizer=OPTIMIZERS[optimizer](lr=rate_at(0), params={name: v.start for name, v in variables.items()}),
        pictures=pictures_of(scene, numbers, targets),
        count=check_count("batch", batch) or len(numbers),
        loss=loss_of(loss),
        priors=[(name, prior_of(prior), weight) for name, (prior, weight) in (priors or {}).items()],
        demodulate=demodulate,
        spp=check_count("spp", spp),
        seed=seed,
    )
    first, losses, sums = 0, list[float](), dict.fromkeys(names, np.zeros(()))
    if checkpoint is not None and os.path.exists(checkpoint):
        first, losses, sums = load_state(checkpoint, search.optimizer, variables)
    start, last = time.perf_counter(), max(1, iterations // 4)
    with watched(progress, "optimising", "iterations") as shown:
        for i in range(first, iterations):
            if refines(i, iterations, coarse):
                search.refine()
            losses.append(search.descend(i, rate_at(i)))
            values = search.values()
            if i >= iterations - last:
                sums = {name: sums[name] + np.array(value, np.float64) for name, value in values.items()}
            if shown:
                shown(i + 1, iterations)
            if checkpoint is not None and (i % SAVED == SAVED - 1 or i + 1 == iterations):
                save_state(checkpoint, i + 1, losses, sums, search.optimizer, variables)
            done = Progressed(i, losses[-1], values, time.perf_counter() - start)
            if callback is not None and callback(done):
                break
    params.update(search.values())
    values = {name: params[name] for name in names}
    counted = len(losses) - (iterations - last)
    means = {name: sums[name] / counted if counted > 0 else np.array(values[name], np.float64) for name in names}
    return Optimization(values, means, losses, time.perf_counter() - start)


@dataclass
class Search:
    """An optimisation under way."""

    scene: Scene
    params: SceneParameters
    variables: Mapping[str, Variable]
    optimizer: Any
    pictures: Mapping[int, npt.NDArray[np.float32]]
    """The targets by view."""
    count: int
    """Views of an iteration."""
    loss: Loss
    priors: Sequence[tuple[str, Prior, float]]
    demodulate: bool
    spp: int
    seed: int

    def descend(self, iteration: int, rate: float) -> float:
        """Take a step; returns the loss before it."""
        self.optimizer.set_learning_rate(rate)
        total = 0.0
        for view in order(list(self.pictures), iteration, self.count, self.seed):
            # Anew for each view: a derivative frees what led to it.
            self.params.update({name: self._parameter(name) for name in self.variables})
            number = round_seed(self.seed, 4096 * (iteration + 1) + view)
            image = render(self.scene, self.params, sensor=view, spp=self.spp, seed=number)
            total += differentiated(self.loss(*compared(image, self.pictures[view], self.demodulate)) / self.count)
        for name, prior, weight in self.priors:
            total += differentiated(weight * prior(self._parameter(name)))
        self.optimizer.step()
        for name, v in self.variables.items():
            self.optimizer[name] = v.projected(self.optimizer[name])
        return total

    def refine(self) -> None:
        """Give coarse textures more texels."""
        for name, v in self.variables.items():
            if v.is_coarse(self.optimizer[name]):
                self.optimizer[name] = v.refined(self.optimizer[name])

    def values(self) -> dict[str, Any]:
        """The parameters as they are now."""
        return {name: dr.detach(self._parameter(name)) for name in self.variables}

    def _parameter(self, name: str) -> Any:
        return self.variables[name].parameter(self.optimizer[name])


def differentiated(value: Any) -> float:
    """A number on Dr.Jit's side, whose derivatives are added to those of the variables."""
    dr.backward(value)
    return float(np.array(dr.detach(value)).ravel()[0])


def variable(
    params: SceneParameters,
    name: str,
    bounds: Mapping[str, tuple[float, float]] | tuple[float, float],
    keeping: str,
    shrunk: int,
) -> Variable:
    """The variable of a parameter."""
    value = params[name]
    if not params.flags(name).differentiable:
        raise ParameterError(f"{name}: has no derivatives")
    limits = bounds.get(name, (0.0, 1.0)) if isinstance(bounds, Mapping) else bounds
    return Variable(name, dr.detach(value), (float(limits[0]), float(limits[1])), keeping, shrunk)


def pictures_of(scene: Scene, views: Sequence[int], targets: Sequence[Any]) -> dict[int, npt.NDArray[np.float32]]:
    """The targets by view."""
    if not views or len(views) != len(targets):
        raise RenderError(f"each view needs a target: found {len(views)} views and {len(targets)} targets")
    pictures = {}
    for view, target in zip(views, targets, strict=True):
        width, height = find_sensor(scene, view).film().crop_size()
        picture = np.array(target, np.float32)
        if picture.shape[:2] != (height, width) or picture.ndim != 3:
            film = int(height), int(width)
            raise RenderError(f"the target of view {view} has shape {picture.shape}, its film {film}")
        pictures[view] = picture
    return pictures


def order(views: Sequence[int], iteration: int, count: int, seed: int) -> list[int]:
    """The views of an iteration: each comes once before any comes again."""
    chosen = []
    for place in range(iteration * count, (iteration + 1) * count):
        turn, within = divmod(place, len(views))
        chosen.append(views[int(np.random.default_rng([seed, turn]).permutation(len(views))[within])])
    return chosen


def refines(iteration: int, iterations: int, coarse: Mapping[str, int] | None) -> bool:
    """Whether coarse textures get more texels before an iteration."""
    levels = max((coarse or {}).values(), default=0)
    return (
        levels > 0
        and iteration > 0
        and any(iteration == round(iterations * level / (levels + 1)) for level in range(1, levels + 1))
    )


def compared(image: Any, target: npt.NDArray[np.float32], demodulate: bool) -> tuple[Any, Any]:
    """Image and target as the loss gets them."""
    wanted = type(image)(target)
    if not demodulate:
        return image, wanted
    brightness = np.maximum(target.mean(axis=2, keepdims=True), 1e-2) * np.ones_like(target)
    inverse = type(image)((1 / brightness).astype(np.float32))
    return image * inverse, wanted * inverse

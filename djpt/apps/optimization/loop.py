"""`optimize`: parameters of a scene from pictures of it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import drjit.opt
import numpy as np
import numpy.typing as npt

from djpt.apps.optimization.bounds import usual_bounds
from djpt.apps.optimization.gauss_newton import RATE, GaussNewton
from djpt.apps.optimization.live import shown_live
from djpt.apps.optimization.losses import Loss, loss_of, residual_of
from djpt.apps.optimization.priors import Prior, curvature_of, prior_of
from djpt.apps.optimization.search import Search
from djpt.apps.optimization.state import load_state, save_state
from djpt.apps.optimization.variables import Variable
from djpt.description.parameters import SceneParameters, traverse
from djpt.errors import ParameterError, RenderError, near_miss
from djpt.rendering.progress import Progress, watched
from djpt.rendering.settings import check_count, check_seed
from djpt.scene.scene import Scene, find_sensor

__all__ = ["Optimization", "Progressed", "optimize"]

Rate = float | Callable[[int], float]
"""A step, or one for each iteration."""

SAVED = 10
"""The number of iterations between two checkpoints."""

OPTIMIZERS: dict[str, tuple[Callable[..., Any], float]] = {
    "adam": (drjit.opt.Adam, 0.02),
    "sgd": (drjit.opt.SGD, 0.02),
    "rmsprop": (drjit.opt.RMSProp, 0.02),
    "gauss_newton": (GaussNewton, RATE),
}
"""The optimisers by name, each with its default rate."""


@dataclass(frozen=True)
class Progressed:
    """The state that a callback gets after each iteration."""

    iteration: int
    loss: float
    """The loss over the views of this iteration, priors included."""
    values: Mapping[str, Any]
    """The parameters."""
    seconds: float
    """The time since the start."""
    images: Mapping[int, Any] = field(default_factory=dict)
    """The images of this iteration, (H, W, C) each, by their sensors."""
    targets: Mapping[int, npt.NDArray[np.float32]] = field(default_factory=dict)
    """The pictures that they should match."""


@dataclass
class Optimization:
    """The result of `optimize`.

    * `values`: the parameters, which the scene has as well; `average`: their means over the last quarter of the
      iterations, which have less noise.
    * `losses`: of each iteration.
    * `seconds`: the total time.
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
    spp: int | Callable[[int], int] = 16,
    loss: str | Loss = "l2",
    optimizer: str = "adam",
    rate: Rate | Mapping[str, Rate] | None = None,
    bounds: Mapping[str, tuple[float, float]] | tuple[float, float] | None = None,
    keeping: str = "projection",
    priors: Mapping[str, tuple[str | Prior, float]] | None = None,
    coarse: Mapping[str, int] | None = None,
    demodulate: bool = False,
    seed: int = 0,
    callback: Callable[[Progressed], bool | None] | None = None,
    live: bool = False,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Progress | bool | None = None,
) -> Optimization:
    """Find parameters with which a scene matches pictures of it, by stochastic gradient descent.

    Args:
        scene: What `load_dict` returned; the search starts at its values, and at the end it holds the result.
        keys: The parameters, by their names in `djpt.traverse`.
        targets: The pictures, (H, W, C) each, of linear values.
        views: The numbers of the sensors that they were taken with; by default 0, 1, ..
        batch: The number of views per iteration, in an order redrawn for each pass over all; 0: all.
        iterations: The number of steps.
        spp: Samples per pixel of each image, and of each gradient, which has samples of its own: therefore
            derivatives of L2 losses are unbiased. A number, or a function of the iteration.
        loss: ``l1``, ``l2``, ``relative``, ``log``, or a function of image and target.
        optimizer: ``adam``, ``sgd``, ``rmsprop``: those of `drjit.opt`; or ``gauss_newton``, which measures how much
            the pictures change with the parameters, and therefore needs few steps (see `GaussNewton`). It takes losses
            of squares only, and no functions as priors.
        rate: The step, or a function of the iteration, such as ``lambda i: 0.05 * 0.99**i``; of all parameters, or by
            name. By default 0.02, and 1.6 for ``gauss_newton``, whose steps are in units of the curvature: take
            smaller ones if it overshoots.
        bounds: Of all parameters, or by name; by default those that a parameter's meaning sets, see
            `djpt.optimization.bounds.usual_bounds`: 0 and 1 for albedos and roughness, 0 and infinity for light.
        keeping: How parameters are kept within the bounds: ``projection``, ``sigmoid``, or ``free``.
        priors: For textures by name: (``smooth``, ``tv`` or a function, weight).
        coarse: For textures by name: the number of times that width and height are halved at first. They
            are doubled again at equal parts of the iterations.
        demodulate: Divide image and target by the target's brightness before the loss, so that light and dark parts
            of a picture count equally: what remains is the ratio of albedos.
        seed: Of all renders; iteration i has seeds of its own.
        callback: Called after each iteration; returning True ends the search.
        live: Show the loss, the parameters and the images beside their targets while the search runs: below the cell
            of a notebook; in a terminal, a line with the loss.
        checkpoint: A file that keeps the state after each tenth iteration; if it exists, the search continues
            from it, with the same steps as an uninterrupted one.
        progress: Called with (iterations done, total); True shows a bar.

    Raises:
        ParameterError: A parameter is unknown, has no derivatives, starts outside its bounds, or these make no sense.
        RenderError: Targets don't fit the views, the loss doesn't fit the optimiser, or arguments are out of range.
        FileError: The checkpoint belongs to another search, or can't be written.
    """
    names = [keys] if isinstance(keys, str) else list(keys)
    for option, by_name in (("rate", rate), ("bounds", bounds), ("priors", priors), ("coarse", coarse)):
        check_names(option, by_name, names)
    numbers = list(range(len(targets)) if views is None else views)
    iterations, seed = check_count("iterations", iterations), check_seed("seed", seed)
    if optimizer not in OPTIMIZERS:
        raise RenderError(f"unknown optimizer '{optimizer}'{near_miss(optimizer, OPTIMIZERS)}")
    params, (kind, usual) = traverse(scene), OPTIMIZERS[optimizer]
    rates_at = {name: at_each(given(rate, name, usual)) for name in names}
    spp_at = at_each(spp)
    newton = kind is GaussNewton
    wanted = [(name, prior, weight) for name, (prior, weight) in (priors or {}).items()]
    variables = {name: variable(params, name, bounds, keeping, (coarse or {}).get(name, 0)) for name in names}
    search = Search(
        scene=scene,
        params=params,
        variables=variables,
        optimizer=kind(lr=usual, params={name: v.start for name, v in variables.items()}),
        pictures=pictures_of(scene, numbers, targets),
        count=check_count("batch", batch) or len(numbers),
        loss=loss_of(loss),
        priors=[(name, prior_of(prior), weight) for name, prior, weight in wanted],
        demodulate=demodulate,
        seed=seed,
        residual=residual_of(loss) if newton else None,
        bends=[curvature_of(prior) for _, prior, _ in wanted] if newton else [],
    )
    first, losses, sums = 0, list[float](), dict.fromkeys(names, np.zeros(()))
    if checkpoint is not None and os.path.exists(checkpoint):
        first, losses, sums = load_state(checkpoint, search.optimizer, variables, search.curvatures)
    start, last = time.perf_counter(), max(1, iterations // 4)
    with watched(progress, "optimising", "iterations") as shown, shown_live(live, losses) as shows:
        for i in range(first, iterations):
            if refines(i, iterations, coarse):
                search.refine()
            losses.append(
                search.descend(i, {name: float(at(i)) for name, at in rates_at.items()}, check_count("spp", spp_at(i)))
            )
            values = search.values()
            if i >= iterations - last:
                sums = {name: sums[name] + as_numpy(value) for name, value in values.items()}
            if shown:
                shown(i + 1, iterations)
            if checkpoint is not None and (i % SAVED == SAVED - 1 or i + 1 == iterations):
                save_state(checkpoint, i + 1, losses, sums, search.optimizer, variables, search.curvatures)
            done = Progressed(i, losses[-1], values, time.perf_counter() - start, search.images, search.pictures)
            if shows is not None:
                shows(done)
            if callback is not None and callback(done):
                break
    params.update(search.values())
    values = {name: params[name] for name in names}
    counted = len(losses) - (iterations - last)
    means = {name: sums[name] / counted if counted > 0 else as_numpy(values[name]) for name in names}
    return Optimization(values, means, losses, time.perf_counter() - start)


def check_names(option: str, by_name: Any, names: Sequence[str]) -> None:
    """Raise `ParameterError` if an option is given for a parameter that isn't optimised."""
    for name in by_name if isinstance(by_name, Mapping) else ():
        if name not in names:
            raise ParameterError(
                f"optimize: '{option}' is given for '{name}', not one of the keys{near_miss(name, names)}"
            )


def as_numpy(value: Any) -> npt.NDArray[np.float64]:
    """A parameter's value in the shape in which `SceneParameters.update` takes it: (3,) for a colour."""
    array = np.array(value, np.float64)
    return array[:, 0] if dr.depth_v(value) == 2 and array.shape[1:] == (1,) else array


def given(rate: Any, name: str, usual: float) -> Any:
    """The rate of a parameter."""
    found = rate.get(name) if isinstance(rate, Mapping) else rate
    return usual if found is None else found


def at_each(value: Any) -> Callable[[int], Any]:
    """A function of the iteration, which may be given as one number for all."""
    return value if callable(value) else lambda i: value


def variable(
    params: SceneParameters,
    name: str,
    bounds: Mapping[str, tuple[float, float]] | tuple[float, float] | None,
    keeping: str,
    shrunk: int,
) -> Variable:
    """The variable that stands for a parameter."""
    value = params[name]
    if not params.flags(name).differentiable:
        raise ParameterError(f"{name}: has no derivatives")
    limits = bounds.get(name) if isinstance(bounds, Mapping) else bounds
    if limits is None:
        limits = usual_bounds(params, name)
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


def refines(iteration: int, iterations: int, coarse: Mapping[str, int] | None) -> bool:
    """True if coarse textures get more texels before an iteration."""
    levels = max((coarse or {}).values(), default=0)
    return (
        levels > 0
        and iteration > 0
        and any(iteration == round(iterations * level / (levels + 1)) for level in range(1, levels + 1))
    )

"""`optimize`: parameters of a scene from pictures of it."""

from __future__ import annotations

import itertools
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import drjit.opt
import numpy as np
import numpy.typing as npt

from djpt.apps.optimization.gauss_newton import RATE, Curvatures, GaussNewton, majorant
from djpt.apps.optimization.live import LiveSearch, Progressed
from djpt.apps.optimization.losses import Loss, Prior, curvature_of, loss_of, prior_of, residual_of
from djpt.apps.optimization.variables import Variable, usual_bounds
from djpt.core.files import as_path, open_regular, writing
from djpt.description.parameters import SceneParameters, traverse
from djpt.errors import FileError, ParameterError, RenderError, near_miss
from djpt.rendering.progress import Progress, watched
from djpt.rendering.progressive.rounds import round_seed
from djpt.rendering.render import render
from djpt.rendering.settings import check_count, check_seed
from djpt.scene.scene import Scene, find_sensor

__all__ = ["Optimization", "optimize", "order"]

Doubles = npt.NDArray[np.float64]

RISEN = 2.0
"""The ratio of a loss to the lowest one of its views above which the last step is taken back: less may be noise."""

GROWN = 1.5
"""The ratio of the gradient's change to what the curvature allows above which the curvature is remeasured."""

MEASURING = 2**31
"""The first seed number of measurements, beyond those of all iterations."""


@dataclass
class Search:
    """A running optimisation."""

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
    seed: int
    residual: Loss | None = None
    """The residuals whose squares the loss averages; for Gauss-Newton only."""
    bends: Sequence[Callable[[Doubles], Doubles]] = ()
    """The curvatures of the priors; for Gauss-Newton only."""
    images: dict[int, Any] = field(default_factory=dict)
    """The images of the last iteration, by view."""
    lowest: dict[int, float] = field(default_factory=dict)
    """The lowest loss of the iterations that used a view; for Gauss-Newton only."""

    def __post_init__(self) -> None:
        self.spp = 0
        """Samples per pixel of the last iteration."""
        self.curvatures: Curvatures | None = None
        if isinstance(self.optimizer, GaussNewton):
            self.curvatures = Curvatures(list(self.pictures), self._measured)

    def descend(self, iteration: int, rates: Mapping[str, float], spp: int) -> float:
        """Take a step; returns the loss before it."""
        self.optimizer.set_learning_rate(rates)
        if spp != self.spp:
            self.lowest = {}  # losses with another noise can't be compared
        self.spp, views, total = spp, order(list(self.pictures), iteration, self.count, self.seed), 0.0
        self.images = {}
        measured = self._precondition(views)
        for view in views:
            # Anew for each view: a derivative frees what led to it.
            self.params.update({name: self._parameter(name) for name in self.variables})
            number = round_seed(self.seed, 4096 * (iteration + 1) + view)
            image = render(self.scene, self.params, sensor=view, spp=spp, seed=number)
            self.images[view] = dr.detach(image)
            total += differentiated(self.loss(*compared(image, self.pictures[view], self.demodulate)) / self.count)
        for name, prior, weight in self.priors:
            total += differentiated(weight * prior(self._parameter(name)))
        self._step(views, total, measured)
        for name, v in self.variables.items():
            self.optimizer[name] = v.projected(self.optimizer[name])
        return total

    def refine(self) -> None:
        """Give coarse textures more texels."""
        for name, v in self.variables.items():
            if v.is_coarse(self.optimizer[name]):
                self.optimizer[name] = v.refined(self.optimizer[name])
        self._forget()

    def values(self) -> dict[str, Any]:
        """The parameters as they are now."""
        return {name: dr.detach(self._parameter(name)) for name in self.variables}

    def _parameter(self, name: str) -> Any:
        return self.variables[name].parameter(self.optimizer[name])

    def _step(self, views: Sequence[int], loss: float, measured: bool) -> None:
        """Take a step. Gauss-Newton may take the last one back, and remeasures a curvature that has grown."""
        newton = self.optimizer if isinstance(self.optimizer, GaussNewton) else None
        grown = False
        if newton is not None:
            lowest = [self.lowest.get(view, np.inf) for view in views]
            if loss <= RISEN * float(np.mean(lowest)):
                self.lowest |= {view: min(loss, best) for view, best in zip(views, lowest, strict=True)}
                # Gradients of different views can't be compared.
                grown = self.count == len(self.pictures) and not measured and newton.growth() > GROWN
            else:
                newton.take_back()
        if grown:
            self._forget()
            self._precondition(views)
        self.optimizer.step()
        if grown:
            # The step leads back from where the curvature was so large.
            self._forget()

    # ---- curvature -----------------------------------------------------------------------

    def _precondition(self, views: Sequence[int]) -> bool:
        """Give Gauss-Newton the curvature of the loss of some views; True if any was measured for it."""
        if self.curvatures is None:
            return False
        found, measured = self.curvatures.of(views)
        for (name, _, weight), bend in zip(self.priors, self.bends, strict=True):
            found[name] = found[name] + weight * self._pulled_back(name, bend)
        self.optimizer.precondition(found)
        return measured

    def _forget(self) -> None:
        """Remeasure all curvatures before they are next used."""
        if self.curvatures is not None:
            self.curvatures.forget()

    def _measured(self, view: int, number: int) -> dict[str, Doubles]:
        """A bound on the curvature of the loss of a view: the measurement of this number."""
        variables, calls = dict(self.optimizer.items()), itertools.count()

        def residual(x: Mapping[str, Any]) -> Any:
            self.params.update({name: v.parameter(x[name]) for name, v in self.variables.items()})
            seed = round_seed(self.seed, MEASURING + 1024 * number + next(calls))
            image = render(self.scene, self.params, sensor=view, spp=self.spp, seed=seed)
            return self.residual(*compared(image, self.pictures[view], self.demodulate))  # type: ignore[misc]

        return majorant(variables, residual, {name: v.scale for name, v in self.variables.items()})

    def _pulled_back(self, name: str, bend: Callable[[Doubles], Doubles]) -> Doubles:
        """The curvature of a prior of a parameter p, as a function of its variable: J^T diag(c) J 1."""
        v, x = self.variables[name], dr.detach(self.optimizer[name])
        ahead, back = type(x)(x), type(x)(x)
        dr.enable_grad(ahead, back)
        dr.set_grad(ahead, type(x)(np.ones(np.shape(np.array(x)), np.float32)))
        slopes = dr.detach(dr.forward_to(v.parameter(ahead)))
        p = v.parameter(back)
        curvature = type(p)(bend(np.array(dr.detach(p), np.float64)).astype(np.float32))
        dr.backward(dr.sum(p * slopes * curvature, axis=None))
        return np.array(dr.grad(back), np.float64)


def order(views: Sequence[int], iteration: int, count: int, seed: int) -> list[int]:
    """The views of an iteration: all are used once before any is used again."""
    chosen = []
    for place in range(iteration * count, (iteration + 1) * count):
        turn, within = divmod(place, len(views))
        chosen.append(views[int(np.random.default_rng([seed, turn]).permutation(len(views))[within])])
    return chosen


def compared(image: Any, target: npt.NDArray[np.float32], demodulate: bool) -> tuple[Any, Any]:
    """Image and target as passed to the loss."""
    wanted = type(image)(target)
    if not demodulate:
        return image, wanted
    brightness = np.maximum(target.mean(axis=2, keepdims=True), 1e-2) * np.ones_like(target)
    inverse = type(image)((1 / brightness).astype(np.float32))
    return image * inverse, wanted * inverse


def differentiated(value: Any) -> float:
    """A number on Dr.Jit's side, whose derivatives are added to those of the variables."""
    dr.backward(value)
    return float(np.array(dr.detach(value)).ravel()[0])


# ---- the state in a file ---------------------------------------------------------------------


KIND = "djpt search 2"


def save_state(path: str | os.PathLike[str], search: Search, losses: list[float], sums: Mapping[str, Any]) -> None:
    """Write a search: its variables, its optimiser's moments, its losses, the curvatures that it has measured."""
    arrays: dict[str, Any] = {}
    for name in search.variables:
        arrays[f"x:{name}"] = np.array(search.optimizer[name])
        arrays[f"sum:{name}"] = np.array(sums[name], np.float64)
        for i, moment in enumerate(moments(search.optimizer.state[name][3])):
            if moment is not None:
                arrays[f"moment{i}:{name}"] = np.array(moment)
    header = {
        "kind": KIND,
        "iteration": len(losses),
        "losses": losses,
        "optimizer": type(search.optimizer).__name__,
        "lowest": list(search.lowest.items()),
        "spp": search.spp,
    }
    if search.curvatures is not None:
        arrays |= {f"curvature:{key}": array for key, array in search.curvatures.arrays().items()}
        header["damping"], header["least_damping"] = search.optimizer.damping, search.optimizer.least
    with writing(as_path(path)) as temporary, temporary.open("wb") as file:
        np.savez(file, header=np.frombuffer(json.dumps(header).encode(), np.uint8), **arrays)


def load_state(path: str | os.PathLike[str], search: Search) -> tuple[int, list[float], dict[str, Any]]:
    """Continue a search from a file: returns the next iteration, the losses, the sums of parameters.

    Raises:
        FileError: The file belongs to another search, or is damaged.
    """
    optimizer, variables = search.optimizer, search.variables
    try:
        with open_regular(path) as file, np.load(file, allow_pickle=False) as stored:
            header = json.loads(bytes(stored["header"]).decode())
            arrays = {name: stored[name] for name in stored.files if name != "header"}
        names = {name[2:] for name in arrays if name.startswith("x:")}
        if header["kind"] != KIND or names != set(variables) or header["optimizer"] != type(optimizer).__name__:
            raise FileError(
                f"'{path}' holds another optimisation: of {', '.join(sorted(names))} by {header['optimizer']}"
            )
        for name, v in variables.items():
            optimizer[name] = v.type(arrays[f"x:{name}"])
            value, promoted, rate, extra = optimizer.state[name]
            # In the types of what they replace.
            new = [
                None if now is None else typed(arrays[f"moment{i}:{name}"], now) for i, now in enumerate(moments(extra))
            ]
            optimizer.state[name] = value, promoted, rate, tuple(new) if isinstance(extra, tuple) else new[0]
        search.spp = int(header["spp"])
        search.lowest.update((int(view), float(loss)) for view, loss in header["lowest"])
        if search.curvatures is not None:
            known = {key.partition(":")[2]: arrays[key] for key in arrays if key.startswith("curvature:")}
            search.curvatures.restore(known)
            optimizer.damping, optimizer.least = float(header["damping"]), float(header.get("least_damping", 1))
        return int(header["iteration"]), list(header["losses"]), {name: arrays[f"sum:{name}"] for name in variables}
    except FileError:
        raise
    except Exception as error:  # whatever a damaged archive raises
        raise FileError(f"can't continue from '{path}': {error}") from None


def moments(extra: Any) -> list[Any]:
    """What an optimiser of `drjit.opt` keeps of a variable, as a list of numbers and arrays; None where it has none."""
    return list(extra) if isinstance(extra, tuple) else [extra]


def typed(value: Any, like: Any) -> Any:
    """Numbers from a file, in the type of the array or number that they replace."""
    return type(like)(value) if dr.is_array_v(like) else type(like)(value.item())


# ---- the whole search ------------------------------------------------------------------------


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
            `djpt.optimization.variables.usual_bounds`: 0 and 1 for albedos and roughness, 0 and infinity for light.
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
        first, losses, sums = load_state(checkpoint, search)
    start, last, refining = time.perf_counter(), max(1, iterations // 4), refined_at(iterations, coarse)
    with watched(progress, "optimising", "iterations") as shown, LiveSearch(losses) if live else nullcontext() as shows:
        for i in range(first, iterations):
            if i in refining:
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
                save_state(checkpoint, search, losses, sums)
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


def refined_at(iterations: int, coarse: Mapping[str, int] | None) -> set[int]:
    """The iterations before which coarse textures get more texels."""
    levels = max((coarse or {}).values(), default=0)
    return {round(iterations * level / (levels + 1)) for level in range(1, levels + 1)} - {0}

"""A running search: the views of an iteration, their derivatives, and a step of the optimiser."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.apps.optimization.gauss_newton import Curvatures, GaussNewton, majorant
from djpt.apps.optimization.losses import Loss, Prior
from djpt.apps.optimization.variables import Variable
from djpt.core.files import as_path, open_regular, writing
from djpt.description.parameters import SceneParameters
from djpt.errors import FileError
from djpt.rendering.progressive.rounds import round_seed
from djpt.rendering.render import render
from djpt.scene.scene import Scene

__all__ = ["Search", "load_state", "order", "save_state"]

Doubles = npt.NDArray[np.float64]

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

    def __post_init__(self) -> None:
        self._spp = 0
        self.curvatures: Curvatures | None = None
        if isinstance(self.optimizer, GaussNewton):
            self.curvatures = Curvatures(list(self.pictures), self._measured)

    def descend(self, iteration: int, rates: Mapping[str, float], spp: int) -> float:
        """Take a step; returns the loss before it."""
        self.optimizer.set_learning_rate(rates)
        self._spp, views, total = spp, order(list(self.pictures), iteration, self.count, self.seed), 0.0
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
        # Gradients of different views can't be compared.
        whole = self.count == len(self.pictures)
        grown = self.curvatures is not None and whole and not measured and self.optimizer.growth() > GROWN
        if grown:
            self._forget()
            self._precondition(views)
        self.optimizer.step()
        if grown:
            # The step leads back from where the curvature was so large.
            self._forget()
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
            image = render(self.scene, self.params, sensor=view, spp=self._spp, seed=seed)
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


KIND = "djpt search 1"


def save_state(
    path: str | os.PathLike[str],
    iteration: int,
    losses: list[float],
    sums: Mapping[str, Any],
    optimizer: Any,
    variables: Mapping[str, Variable],
    curvatures: Curvatures | None = None,
) -> None:
    """Write a search: its variables, its optimiser's moments, its losses, the curvatures that it has measured."""
    arrays: dict[str, Any] = {}
    for name in variables:
        arrays[f"x:{name}"] = np.array(optimizer[name])
        arrays[f"sum:{name}"] = np.array(sums[name], np.float64)
        for i, moment in enumerate(moments(optimizer, name)):
            if moment is not None:
                arrays[f"moment{i}:{name}"] = np.array(moment)
    for key, array in (curvatures.arrays() if curvatures is not None else {}).items():
        arrays[f"curvature:{key}"] = array
    header = {"kind": KIND, "iteration": iteration, "losses": losses, "optimizer": type(optimizer).__name__}
    with writing(as_path(path)) as temporary, temporary.open("wb") as file:
        np.savez(file, header=np.frombuffer(json.dumps(header).encode(), np.uint8), **arrays)


def load_state(
    path: str | os.PathLike[str],
    optimizer: Any,
    variables: Mapping[str, Variable],
    curvatures: Curvatures | None = None,
) -> tuple[int, list[float], dict[str, Any]]:
    """Load a search into an optimiser: returns the next iteration, the losses, the sums of parameters.

    Raises:
        FileError: The file belongs to another search, or is damaged.
    """
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
            kept = sorted(key for key in arrays if key.startswith("moment") and key.partition(":")[2] == name)
            restore(optimizer, name, [arrays[key] for key in kept])
        if curvatures is not None:
            known = {key.partition(":")[2]: arrays[key] for key in arrays if key.startswith("curvature:")}
            curvatures.restore(known)
        return int(header["iteration"]), list(header["losses"]), {name: arrays[f"sum:{name}"] for name in variables}
    except FileError:
        raise
    except Exception as error:  # whatever a damaged archive raises
        raise FileError(f"can't continue from '{path}': {error}") from None


def moments(optimizer: Any, name: str) -> list[Any]:
    """The state of a variable in an optimiser of `drjit.opt`, as numbers and arrays; None where there is none."""
    extra = optimizer.state[name][3]
    return list(extra) if isinstance(extra, tuple) else [extra]


def restore(optimizer: Any, name: str, values: list[Any]) -> None:
    """Restore the state of an optimiser, in the types of its current values."""
    value, promoted, rate, extra = optimizer.state[name]
    now = list(extra) if isinstance(extra, tuple) else [extra]
    found = iter(values)
    new = [None if entry is None else typed(next(found), entry) for entry in now]
    optimizer.state[name] = value, promoted, rate, tuple(new) if isinstance(extra, tuple) else new[0]


def typed(value: Any, like: Any) -> Any:
    """Numbers from a file, in the type of the array or number that they replace."""
    return type(like)(value) if dr.is_array_v(like) else type(like)(value.item())

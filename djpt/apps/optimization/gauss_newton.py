"""`GaussNewton`: steps divided by the curvature of squared losses, so that no rate has to be tuned."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import drjit as dr
import drjit.opt
import numpy as np
import numpy.typing as npt

from djpt.errors import RenderError

__all__ = ["RATE", "Curvatures", "GaussNewton", "majorant"]

Doubles = npt.NDArray[np.float64]
Residual = Callable[[Mapping[str, Any]], Any]
"""A function of variables by name that returns an array attached to them; the loss is its mean square."""

RATE = 1.6
"""The default step. Losses that are quadratic converge with rates below 2 (1 + momentum)."""

MOMENTUM = 0.3
"""The default fraction of a step that the next one repeats."""

DAMPING = 1e-2
"""The share of a parameter's largest curvature that is added to all: entries of little effect take small steps."""


class GaussNewton(drjit.opt.Optimizer[tuple[Any, Any, Any]]):
    """Descent x' = x - rate g / D + momentum (x - x_before), with a diagonal D that bounds the curvature.

    For a loss mean(r^2) of n residuals with derivatives J, D = 2 |J|^T |J| 1 / n: the sums of the absolute values of
    the rows of the Gauss-Newton matrix, or more where its terms cancel. D - 2 J^T J / n has no negative eigenvalue
    therefore, and steps of rate 1 never raise a quadratic loss: D is that of a separable surrogate (De Pierro, "A
    Modified Expectation Maximization Algorithm for Penalized Likelihood Estimation in Emission Tomography", IEEE
    Transactions on Medical Imaging 14, 1995). Momentum makes up for what a diagonal can't represent (Polyak 1964).

    It has the methods of the optimisers of `drjit.opt`, and one more, `measure`::

        optimizer = GaussNewton(params={key: params[key]})

        def residual(variables):
            params.update(variables)
            return djpt.render(scene, params, spp=8) - target

        optimizer.measure(residual)
        for i in range(8):
            params.update(optimizer)
            image = djpt.render(scene, params, spp=8, seed=i + 1)
            dr.backward(dr.mean(dr.square(image - target), axis=None))
            optimizer.step()
            optimizer[key] = dr.clip(optimizer[key], 0, 1)

    Args:
        lr: the rate.
        params: the variables by name.
        momentum: of the last step.
    """

    def __init__(
        self, lr: float = RATE, params: Mapping[str, Any] | None = None, *, momentum: float = MOMENTUM
    ) -> None:
        if not 0 <= momentum < 1:
            raise RenderError(f"'momentum' must be in [0, 1), found {momentum}")
        self.momentum = momentum
        super().__init__(lr, params)

    def measure(self, *residuals: Residual, scales: Mapping[str, float] | None = None) -> None:
        """Measure the curvature of a loss, the sum of the mean squares of residuals, at the variables' current values.

        Args:
            residuals: Called with the variables, twice or more often.
            scales: The relative sizes of changes of each variable; by default 1.
        """
        variables = dict(self.items())
        found = [majorant(variables, residual, scales or {}) for residual in residuals]
        self.precondition({name: np.sum([one[name] for one in found], axis=0) for name in variables})

    def precondition(self, curvatures: Mapping[str, Doubles]) -> None:
        """Divide by these curvatures, slightly increased, from now on."""
        for name, curvature in curvatures.items():
            value, promoted, rate, (before, gradient, old) = self.state[name]
            damped = curvature + DAMPING * np.max(curvature)
            new = type(old)(np.ascontiguousarray(damped.reshape(np.shape(np.array(old))), np.float32))
            dr.make_opaque(new)
            self.state[name] = value, promoted, rate, (before, gradient, new)

    def growth(self) -> float:
        """The change of the gradient over the last step, as a share of the change that the curvature allows.

        It is at most 1 for quadratic losses: more means that the curvature has grown and must be remeasured; 0 as
        long as no step was taken.
        """
        change = allowed = 0.0
        for value, _, _, (before, gradient, curvature) in self.state.values():
            moved = doubles(dr.detach(value).array) - doubles(before)
            change += float(np.sum(moved * (doubles(value.grad.array) - doubles(gradient))))
            allowed += float(np.sum(np.square(moved) * doubles(curvature)))
        return change / allowed if allowed > 0 else 0.0

    def step(self, **options: Any) -> None:
        """Take a step; arguments as those of `drjit.opt.Optimizer.step`.

        Raises:
            RenderError: No curvature was measured, or it is zero because nothing depends on the variables.
        """
        if not any(np.any(np.array(extra[2])) for _, _, _, extra in self.state.values()):
            raise RenderError(
                "'GaussNewton' has no curvature: call 'measure' first, and check that the residuals depend on a "
                "variable"
            )
        super().step(**options)

    def _step(self, cache: Any, value: Any, grad: Any, lr: Any, extra: tuple[Any, Any, Any], /) -> Any:
        before, _, curvature = extra
        newton = dr.select(curvature > 0, grad / curvature, 0)
        scale = cache.product(dr.leaf_t(grad), lr, -1.0)
        return dr.fma(newton, scale, value) + self.momentum * (value - before), (value, grad, curvature)

    def _reset(self, key: str, value: Any, promoted: bool, /) -> None:
        flat = dr.detach(value).array
        nothing = [dr.opaque(type(flat), 0, flat.shape) for _ in range(2)]
        self.state[key] = value, promoted, None, (type(flat)(flat), nothing[0], nothing[1])

    def _select(self, mask: Any, extra: Any, new_extra: Any, /) -> Any:
        return tuple(dr.select(mask, old, new) for old, new in zip(extra, new_extra, strict=True))


def majorant(variables: Mapping[str, Any], residual: Residual, scales: Mapping[str, float]) -> dict[str, Doubles]:
    """The bound 2 |J|^T |J| s / (n s) on the curvature of a mean of n squares, for changes of relative size s.

    Only the product |J| s is needed: one forward derivative for each variable, and one reverse derivative, or one
    for each variable if some derivatives are negative. It is exact if the derivatives of one residual with respect
    to the entries of one variable have the same sign, as those of pixels with respect to albedos do.

    Args:
        variables: by name.
        residual: see `Residual`; each call may take other random numbers.
        scales: by name; 1 by default.
    """
    detached = {name: type(value)(dr.detach(value)) for name, value in variables.items()}
    slopes = {}
    for name, value in detached.items():
        attached = enabled(detached, [name])
        dr.set_grad(attached[name], filled(value, scales.get(name, 1.0)))
        slopes[name] = dr.detach(dr.forward_to(residual(attached)))
        dr.eval(slopes[name])
    reach = sum(dr.abs(slope) for slope in slopes.values())
    rising = all(np.min(np.array(slope), initial=0) >= 0 for slope in slopes.values())
    found = {}
    for group in [list(detached)] if rising else [[name] for name in detached]:
        attached = enabled(detached, group)
        seen = residual(attached)
        signed = reach if rising else dr.select(slopes[group[0]] < 0, -reach, reach)
        dr.backward(dr.mean(2 * seen * signed, axis=None))
        for name in group:
            bound = np.array(dr.grad(attached[name]), np.float64) / scales.get(name, 1.0)
            found[name] = np.maximum(bound, 0)
    return found


def enabled(variables: Mapping[str, Any], names: list[str]) -> dict[str, Any]:
    """The variables, with gradients enabled for those of these names."""
    result = {}
    for name, value in variables.items():
        result[name] = type(value)(value)
        if name in names:
            dr.enable_grad(result[name])
    return result


def filled(like: Any, number: float) -> Any:
    """An array like another with one number everywhere."""
    return type(like)(np.full(np.shape(np.array(like)), number, np.float32))


def doubles(value: Any) -> Doubles:
    """An array in double precision, in which products of small differences are added up."""
    return np.array(dr.detach(value), np.float64)


# ---- the curvature of a search ---------------------------------------------------------------


USES = 8
"""The number of uses of a view's curvature before it is remeasured: derivatives change with the parameters."""


class Curvatures:
    """Bounds on the curvature of the losses of all views.

    Args:
        views: the numbers of the sensors.
        measured: returns the bounds of a view by the names of the variables; called with the view and the number of the
            measurement.
    """

    def __init__(self, views: Sequence[int], measured: Callable[[int, int], Mapping[str, Doubles]]) -> None:
        self._measured, self._measurements = measured, 0
        self._bounds: dict[int, Mapping[str, Doubles]] = {}
        self._uses = dict.fromkeys(views, 0)

    def forget(self) -> None:
        """Remeasure all views before they are next used."""
        self._bounds = {}
        self._uses = dict.fromkeys(self._uses, 0)

    def of(self, views: Sequence[int]) -> tuple[dict[str, Doubles], bool]:
        """A bound on the curvature of the mean loss of as many views as these; True if one of these was measured now.

        It is the mean of the largest bounds of single views, for each entry: entries that some views don't
        show at all then don't change too much when other views are used.
        """
        due = [view for view in dict.fromkeys(views) if self._uses[view] % USES == 0]
        for view in due:
            self._bounds[view] = self._measured(view, self._measurements)
            self._measurements += 1
        for view in views:
            self._uses[view] += 1
        names = self._bounds[views[0]]
        stacks = {name: np.sort(np.stack([b[name] for b in self._bounds.values()]), axis=0) for name in names}
        return {name: stack[-len(set(views)) :].mean(axis=0) for name, stack in stacks.items()}, bool(due)

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """The complete state, to be stored in a file."""
        found: dict[str, npt.NDArray[np.generic]] = {"measurements": np.array(self._measurements)}
        found |= {f"uses:{view}": np.array(uses) for view, uses in self._uses.items()}
        for view, bounds in self._bounds.items():
            found |= {f"bound:{view}:{name}": bound for name, bound in bounds.items()}
        return found

    def restore(self, arrays: Mapping[str, npt.NDArray[np.generic]]) -> None:
        """Restore the state that `arrays` returned."""
        self.forget()
        bounds: dict[int, dict[str, Doubles]] = {}
        for key, array in arrays.items():
            kind, _, rest = key.partition(":")
            if kind == "measurements":
                self._measurements = int(array)
            elif kind == "uses":
                self._uses[int(rest)] = int(array)
            elif kind == "bound":
                view, _, name = rest.partition(":")
                bounds.setdefault(int(view), {})[name] = np.asarray(array, np.float64)
        self._bounds = dict(bounds)

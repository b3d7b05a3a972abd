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

FEW = 16
"""The number of entries up to which a variable's derivatives are computed entry by entry if their signs differ."""

RISEN = 1.5
"""The ratio of a loss to the lowest one above which the last step is taken back."""

LESS = 4.0
"""The factor by which a step that is repeated is shorter; up to its cube if the gradient has changed as much."""

WARNED = 1.5
"""The factor of the least damping after a step that was taken back, until the curvature is measured again."""

SLOW = 0.25
"""The growth of the gradient below which steps may be longer again."""


class GaussNewton(drjit.opt.Optimizer[tuple[Any, Any, Any]]):
    """Descent x' = x - rate g / D + momentum (x - x_before), with a diagonal D that bounds the curvature.

    For a loss mean(r^2) of n residuals with derivatives J, D = 2 |J|^T |J| 1 / n: the sums of the absolute values of
    the rows of the Gauss-Newton matrix, or more where its terms cancel. D - 2 J^T J / n has no negative eigenvalue
    therefore, and steps of rate 1 never raise a quadratic loss: D is that of a separable surrogate (De Pierro, "A
    Modified Expectation Maximization Algorithm for Penalized Likelihood Estimation in Emission Tomography", IEEE
    Transactions on Medical Imaging 14, 1995). Momentum makes up for what a diagonal can't represent (Polyak 1964).

    The loss of a scene isn't quadratic, and of many variables whose derivatives differ in sign D is only an estimate.
    So steps are checked by the losses at their ends: one that has raised the loss beyond noise is taken back, and
    repeated from where it started with a larger D (Levenberg 1944, Marquardt 1963).

    It has the methods of the optimisers of `drjit.opt`, and one more, `measure`::

        optimizer = GaussNewton(params={key: params[key]})

        def residual(variables):
            params.update(variables)
            return djpt.render(scene, params, spp=8) - target

        optimizer.measure(residual)
        for i in range(8):
            params.update(optimizer)
            image = djpt.render(scene, params, spp=8, seed=i + 1)
            loss = dr.mean(dr.square(image - target), axis=None)
            dr.backward(loss)
            optimizer.step(loss)
            optimizer[key] = dr.clip(optimizer[key], 0, 1)

    Args:
        lr: the rate.
        params: the variables by name.
        momentum: of the last step.
    """

    def __init__(
        self,
        lr: float = RATE,
        params: Mapping[str, Any] | None = None,
        *,
        momentum: float = MOMENTUM,
    ) -> None:
        if not 0 <= momentum < 1:
            raise RenderError(f"'momentum' must be in [0, 1), found {momentum}")
        self.momentum = momentum
        self.damping = 1.0
        """The factor of D, at least 1: larger after steps that had to be taken back."""
        self.least = 1.0
        """The least damping: every step that had to be taken back has shown that the curvature is underestimated."""
        self.lowest = np.inf
        """The lowest loss of all steps."""
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
        self.least = 1.0
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
            allowed += float(np.sum(np.square(moved) * doubles(curvature))) * self.damping
        return change / allowed if allowed > 0 else 0.0

    def step(self, loss: Any = None, **options: Any) -> None:
        """Take a step, or take the last one back and repeat it more cautiously.

        Args:
            loss: The loss at the current values, as a number; without it the last step isn't checked. More than 1.5
                times the lowest loss so far isn't noise.
            options: As those of `drjit.opt.Optimizer.step`.

        Raises:
            RenderError: No curvature was measured, or it is zero because nothing depends on the variables.
        """
        if not any(np.any(np.array(extra[2])) for _, _, _, extra in self.state.values()):
            raise RenderError(
                "'GaussNewton' has no curvature: call 'measure' first, and check that the residuals depend on a "
                "variable"
            )
        value = np.nan if loss is None else float(np.array(dr.detach(loss)).ravel()[0])
        if loss is not None and not value <= RISEN * self.lowest:
            self.take_back()
        else:
            self.lowest = np.fmin(self.lowest, value)
            if self.growth() < SLOW:
                self.damping = max(self.least, self.damping / 2)
        super().step(**options)

    def take_back(self) -> None:
        """Return to the start of the last step, and to the gradient there, and raise the damping."""
        growth, self.least = self.growth(), WARNED * self.least
        self.damping *= np.clip(growth, LESS, LESS**3) if np.isfinite(growth) else LESS**3
        for name, (value, promoted, rate, (before, gradient, curvature)) in self.state.items():
            shape = (value.shape,) if dr.is_tensor_v(value) else ()
            start = type(value)(before, *shape)
            dr.enable_grad(start)
            dr.set_grad(start, type(value)(gradient, *shape))
            self.state[name] = start, promoted, rate, (before, gradient, curvature)

    def _step(self, cache: Any, value: Any, grad: Any, lr: Any, extra: tuple[Any, Any, Any], /) -> Any:
        before, _, curvature = extra
        newton = dr.select(curvature > 0, grad / curvature, 0)
        scale = cache.product(dr.leaf_t(grad), lr, -1.0) / dr.opaque(dr.leaf_t(grad), self.damping)
        return dr.fma(newton, scale, value) + self.momentum * (value - before), (value, grad, curvature)

    def _reset(self, key: str, value: Any, promoted: bool, /) -> None:
        flat = dr.detach(value).array
        nothing = [dr.opaque(type(flat), 0, flat.shape) for _ in range(2)]
        self.state[key] = value, promoted, None, (type(flat)(flat), nothing[0], nothing[1])

    def _select(self, mask: Any, extra: Any, new_extra: Any, /) -> Any:
        return tuple(dr.select(mask, old, new) for old, new in zip(extra, new_extra, strict=True))


def majorant(variables: Mapping[str, Any], residual: Residual, scales: Mapping[str, float]) -> dict[str, Doubles]:
    """The bound 2 |J|^T |J| s / (n s) on the curvature of a mean of n squares, for changes of relative size s.

    Where the derivatives J of the residuals with respect to the entries of a variable have the same sign, as those of
    pixels with respect to albedos do, |J| s is one forward derivative, and one reverse derivative of all variables
    gives the bound. Where signs differ, variables of up to 16 entries take one forward derivative for each. For larger
    ones the bound is estimated from two directions, in which all entries rise and in which random ones fall: the
    larger results are used, which are too small where terms cancel in both.

    Args:
        variables: by name.
        residual: see `Residual`; each call may take other random numbers.
        scales: by name; 1 by default.
    """
    detached = {name: type(value)(dr.detach(value)) for name, value in variables.items()}
    scale = {name: scales.get(name, 1.0) for name in detached}
    rises = {name: derivative(detached, residual, name, scale[name] * np.ones(size)) for name, size in sizes(detached)}
    if all(np.min(np.array(slope), initial=0) >= 0 for slope in rises.values()):
        reach = sum(rises.values())
        bounds = reverse(detached, residual, list(detached), reach)
        return {name: np.maximum(bound, 0) / scale[name] for name, bound in bounds.items()}

    columns, slopes = {}, {}
    for name, size in sizes(detached):
        if size <= FEW:
            unit = scale[name] * np.eye(size)
            columns[name] = [dr.abs(derivative(detached, residual, name, direction)) for direction in unit]
        else:
            signs = np.random.default_rng(size).choice([-1.0, 1.0], size)
            slopes[name] = [(np.ones(size), rises[name])]
            slopes[name] += [(signs, derivative(detached, residual, name, scale[name] * signs))]
    reach = sum(sum(column) for column in columns.values())
    reach += sum(dr.maximum(*(dr.abs(slope) for _, slope in pair)) for pair in slopes.values())
    found = {}
    for name, value in detached.items():
        shape = np.shape(np.array(value))
        if name in columns:
            sums = [float(np.mean(np.array(2 * column * reach, np.float64))) for column in columns[name]]
            found[name] = np.reshape(sums, shape) / scale[name] ** 2
        else:
            seen = [
                signs.reshape(shape) * reverse(detached, residual, [name], dr.select(slope < 0, -reach, reach))[name]
                for signs, slope in slopes[name]
            ]
            found[name] = np.maximum(np.maximum(*seen), 0) / scale[name]
    return found


def sizes(variables: Mapping[str, Any]) -> list[tuple[str, int]]:
    """The numbers of entries of variables."""
    return [(name, np.size(np.array(value))) for name, value in variables.items()]


def derivative(variables: Mapping[str, Any], residual: Residual, name: str, direction: Doubles) -> Any:
    """The derivative of the residuals in a direction of one variable."""
    attached = enabled(variables, [name])
    shape = np.shape(np.array(attached[name]))
    dr.set_grad(attached[name], type(attached[name])(direction.reshape(shape).astype(np.float32)))
    slope = dr.detach(dr.forward_to(residual(attached)))
    dr.eval(slope)
    return slope


def reverse(variables: Mapping[str, Any], residual: Residual, names: list[str], weights: Any) -> dict[str, Doubles]:
    """The derivatives of mean(2 r w), w the weights of the residuals r, with respect to some variables."""
    attached = enabled(variables, names)
    dr.backward(dr.mean(2 * residual(attached) * weights, axis=None))
    return {name: np.array(dr.grad(attached[name]), np.float64) for name in names}


def enabled(variables: Mapping[str, Any], names: list[str]) -> dict[str, Any]:
    """The variables, with gradients enabled for those of these names."""
    result = {}
    for name, value in variables.items():
        result[name] = type(value)(value)
        if name in names:
            dr.enable_grad(result[name])
    return result


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

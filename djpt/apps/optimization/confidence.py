"""The accuracy with which images determine parameters: standard errors, and undetermined combinations.

At the minimum of the loss mean((I - T)^2) + prior, with the derivatives J of N pixels, the curvature is

    H = 2 J^T J / N + P,    P the prior's second derivatives.

What shakes the gradient with the covariance S moves the minimum by H^-1 S H^-1 in covariance. S is the sum of

* the covariance of the gradients' noise / the number of gradients that the result is a mean of,
* 4 J^T diag(v) J / N^2 for targets whose pixels have the variance v,
* 2 v P / N, v the mean variance: a prior is what a mean of squares of such noise takes it for, the logarithm of a
  density exp(-N prior / (2 v)). The result then is Laplace's approximation of what is known after the pictures (MacKay,
  "A Practical Bayesian Framework for Backpropagation Networks", Neural Computation 4, 1992).

Up to `MOST` entries H is computed in full, from two independent estimates of J, whose product isn't raised by their
noise. Of more, samples of the gradient's noise are multiplied by H^-1 by conjugate gradients, without any matrix
(Papandreou and Yuille, "Gaussian Sampling by Local Perturbations", NIPS 2010).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.apps.optimization.losses import Prior, prior_of
from djpt.description.parameters import SceneParameters, traverse
from djpt.errors import ParameterError, RenderError
from djpt.rendering.progressive.rounds import round_seed
from djpt.rendering.render import render
from djpt.rendering.settings import check_count
from djpt.scene.scene import Scene

__all__ = ["Confidence", "confidence"]

Doubles = npt.NDArray[np.float64]

MOST = 64
"""The number of entries, of all parameters together, up to which the curvature is computed in full."""

UNSEEN = 1e-6
"""Combinations whose curvature is below this share of the largest are considered undetermined."""

PRODUCTS = 30
"""The most products of a solution by conjugate gradients."""

SOLVED = 0.02
"""The residual of conjugate gradients, relative to the first, at which a solution is good enough."""

NUDGE = 3e-4
"""The distance over which derivatives of priors are compared: `tv` bends within a thousandth."""


@dataclass(frozen=True)
class Confidence:
    """The information that images hold about parameters, near a result.

    * `names`: one for each entry, ``key[i]``.
    * `errors`: the standard error of each entry, infinite where nothing is determined.
    * `curvatures`: the eigenvalues of H, ascending, and `combinations`, the eigenvectors, one in each row: a row with
      small curvature is a change of the parameters that hardly changes the pictures. Empty for more than `MOST`
      entries.
    """

    names: tuple[str, ...]
    errors: Doubles
    curvatures: Doubles
    combinations: Doubles

    def half_widths(self, level: float = 0.9) -> Doubles:
        """The distance from each entry within which the truth lies with this probability."""
        if not 0 < level < 1:
            raise RenderError(f"'level' must be between 0 and 1, found {level}")
        return np.asarray(self.errors * NormalDist().inv_cdf((1 + level) / 2))

    @property
    def condition(self) -> float:
        """The largest curvature divided by the smallest: the ratio of the best to the worst determined combination."""
        if not self.curvatures.size:
            return math.nan
        low = float(self.curvatures[0])
        return float(self.curvatures[-1]) / low if low > 0 else math.inf

    @property
    def undetermined(self) -> list[dict[str, float]]:
        """Combinations that the pictures don't determine: the share of each entry, by name."""
        least = UNSEEN * float(self.curvatures[-1]) if self.curvatures.size else 0.0
        rows = [row for value, row in zip(self.curvatures, self.combinations, strict=True) if value <= least]
        return [dict(zip(self.names, row.tolist(), strict=True)) for row in rows]

    def __str__(self) -> str:
        if not self.curvatures.size:
            known = self.errors[np.isfinite(self.errors)]
            middle = f"median {np.median(known):.2g}, largest {known.max():.2g}" if known.size else "none"
            return f"{len(self.names)} numbers, {known.size} determined, standard errors: {middle}"
        width = max(len(name) for name in self.names)
        lines = [f"{name:<{width}}  +- {error:.2g}" for name, error in zip(self.names, self.errors, strict=True)]
        lines.append(f"condition {self.condition:.3g}")
        for combination in self.undetermined:
            parts = [f"{share:+.2f} {name}" for name, share in combination.items() if abs(share) > 0.05]
            lines.append(f"undetermined: {' '.join(parts)}")
        return "\n".join(lines)


def confidence(
    scene: Scene,
    keys: Sequence[str],
    targets: Sequence[Any],
    *,
    views: Sequence[int] | None = None,
    spp: int = 64,
    gradients: int = 16,
    averaged: int = 1,
    noise: float | str | Sequence[Any] = 0.0,
    priors: Mapping[str, tuple[str | Prior, float]] | None = None,
    seed: int = 0,
) -> Confidence:
    """Estimate how well pictures determine parameters, at the scene's current values.

    Args:
        scene: What `load_dict` returned, at the result of an optimisation.
        keys: Parameters of `djpt.traverse`. More than `MOST` entries together, such as textures, take up to
            2 `PRODUCTS` derivatives for each of the `gradients`, and have errors that are known to about
            1 / sqrt(2 `gradients`).
        targets: The pictures, (H, W, C) each.
        views: The numbers of their sensors; by default 0, 1, ..
        spp: Samples per pixel of the derivative images and of each gradient.
        gradients: The number of gradients from which their covariance is estimated.
        averaged: The number of gradients behind the result, n above: about the number of iterations near the minimum.
        noise: The standard deviation of the targets' pixels: a number, an array (H, W, C) for each view, or
            ``residual``: that of the differences which remain.
        priors: Those of `optimize`: by name ('smooth', 'tv' or a function, weight). With noise 0 they make errors
            smaller, by what they keep from moving, and add none of their own.
        seed: Of all renders.

    Raises:
        ParameterError: A parameter is unknown or has no derivatives.
        RenderError: `noise` makes no sense, or `gradients` is below 2.
    """
    params, numbers = traverse(scene), list(range(len(targets)) if views is None else views)
    pictures = {view: np.array(target, np.float64) for view, target in zip(numbers, targets, strict=True)}
    if check_count("gradients", gradients) < 2:
        raise RenderError(f"a covariance needs 2 gradients or more, found {gradients}")
    problem = Linearized(scene, params, list(keys), pictures, spp, priors or {})
    variances = problem.variances(noise, seed)
    shaken = np.stack([problem.gradient(round_seed(seed + 1, n)) for n in range(gradients)])
    shaken = (shaken - shaken.mean(axis=0)) / math.sqrt(averaged)
    names = tuple(f"{key}[{i}]" if size > 1 else key for key, size in problem.sizes.items() for i in range(size))
    if problem.count > MOST:
        errors = sampled_errors(problem, variances, shaken * math.sqrt(gradients / (gradients - 1)), seed)
        return Confidence(names, errors, np.empty(0), np.empty((0, problem.count)))
    curvature, spread = problem.in_full(variances, seed)
    spread = spread + shaken.T @ shaken / (gradients - 1)
    values, vectors = np.linalg.eigh(curvature)
    seen = values > UNSEEN * max(values[-1], 0)
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
    errors = np.sqrt(np.maximum(np.diag(inverse @ spread @ inverse), 0))
    # An entry that takes part in an undetermined combination has no error bar.
    part = np.square(vectors[:, ~seen]).sum(axis=1)
    return Confidence(names, np.where(part > 1e-3, np.inf, errors), values, vectors.T.copy())


def sampled_errors(problem: Linearized, variances: Mapping[int, Doubles], shaken: Doubles, seed: int) -> Doubles:
    """The standard errors from samples of the gradient's noise, of which `shaken` are those of its own."""
    rng = np.random.default_rng([seed, 1])
    signs = {view: rng.choice([-1.0, 1.0], (len(shaken), *picture.shape)) for view, picture in problem.pictures.items()}
    # The mean of (J^T s)^2 over random signs s is the diagonal of J^T J (Hutchinson 1990; Bekas et al. 2007).
    squares = [
        sum(np.square(problem.reverse(view, each[k], seed)) / each[k].size for view, each in signs.items())
        for k in range(len(shaken))
    ]
    diagonal = 2 * np.mean(squares, axis=0) / len(signs)
    diagonal = diagonal + np.mean(
        [np.square(problem.prior_root(rng.normal(size=problem.count))) for _ in shaken], axis=0
    )
    seen = diagonal > UNSEEN * diagonal.max(initial=0)
    scale = np.where(seen, 1 / np.sqrt(np.where(seen, diagonal, 1)), 0)
    samples = []
    for own in shaken:
        push = own + problem.noise_of_targets(variances, rng, seed)
        moved = conjugate_gradients(lambda v: scale * problem.product(scale * v, seed), scale * push)
        samples.append(np.square(scale * moved))
    return np.where(seen, np.sqrt(np.mean(samples, axis=0)), np.inf)


def conjugate_gradients(product: Callable[[Doubles], Doubles], right: Doubles) -> Doubles:
    """The solution of A x = b (Hestenes and Stiefel 1952)."""
    x, left = np.zeros_like(right), right.copy()
    way, norm = left.copy(), float(left @ left)
    first = norm
    for _ in range(PRODUCTS):
        if norm <= SOLVED**2 * first:
            break
        bent = product(way)
        size = norm / float(way @ bent)
        x, left = x + size * way, left - size * bent
        before, norm = norm, float(left @ left)
        way = left + norm / before * way
    return x


class Linearized:
    """Images near the current values of parameters, as functions of one vector of all entries."""

    def __init__(
        self,
        scene: Scene,
        params: SceneParameters,
        keys: list[str],
        pictures: Mapping[int, Doubles],
        spp: int,
        priors: Mapping[str, tuple[str | Prior, float]],
    ) -> None:
        if not keys:
            raise ParameterError("confidence needs at least one parameter")
        self._scene, self._params, self._spp, self.pictures = scene, params, spp, pictures
        self._shapes = {key: np.shape(np.array(params[key])) for key in keys}
        self.sizes = {key: int(np.prod(shape)) for key, shape in self._shapes.items()}
        self.count = sum(self.sizes.values())
        unknown = [key for key in priors if key not in self.sizes]
        if unknown:
            raise ParameterError(f"confidence: 'priors' is given for '{unknown[0]}', not one of the keys")
        self._priors = [(key, prior_of(prior), weight) for key, (prior, weight) in priors.items()]
        self.prior_variance = 0.0
        """The mean variance of the targets' pixels / half their number: the scale of the priors' density."""

    # ---- derivatives -----------------------------------------------------------------------

    @contextlib.contextmanager
    def _attached(self) -> Iterator[None]:
        """Let the parameters have gradients for a while."""
        for key in self.sizes:
            self._params[key] = type(self._params[key])(dr.detach(self._params[key]))
            dr.enable_grad(self._params[key])
        self._params.update()
        yield
        for key in self.sizes:
            self._params[key] = type(self._params[key])(dr.detach(self._params[key]))
        self._params.update()

    def _image(self, view: int, seed: int) -> Any:
        return render(self._scene, self._params, sensor=view, spp=self._spp, seed=round_seed(seed, view))

    def _parts(self, vector: Doubles) -> Iterator[tuple[str, Doubles]]:
        """The entries of a vector by parameter."""
        first = 0
        for key, size in self.sizes.items():
            yield key, vector[first : first + size].reshape(self._shapes[key])
            first += size

    def _gradients(self) -> Doubles:
        return np.concatenate([np.array(dr.grad(self._params[key]), np.float64).ravel() for key in self.sizes])

    def forward(self, view: int, direction: Doubles, seed: int) -> Doubles:
        """J v: the derivative of an image in a direction, (H, W, C)."""
        with self._attached():
            for key, part in self._parts(direction):
                dr.set_grad(self._params[key], type(self._params[key])(np.ascontiguousarray(part, np.float32)))
            image = self._image(view, seed)
            dr.enqueue(dr.ADMode.Forward, *(self._params[key] for key in self.sizes))
            dr.traverse(dr.ADMode.Forward)
            return np.array(dr.grad(image), np.float64)

    def reverse(self, view: int, weights: Doubles, seed: int) -> Doubles:
        """J^T w: the gradient of the weighted sum of an image's values."""
        with self._attached():
            image = self._image(view, seed)
            dr.backward(dr.sum(image * type(image)(weights.astype(np.float32)), axis=None))
            return self._gradients()

    def gradient(self, seed: int) -> Doubles:
        """The gradient of the loss, noise included, without that of the priors, which has none."""
        with self._attached():
            for view, target in self.pictures.items():
                image = self._image(view, seed)
                difference = image - type(image)(target.astype(np.float32))
                dr.backward(dr.mean(dr.square(difference), axis=None) / len(self.pictures))
            return self._gradients()

    # ---- the curvature ----------------------------------------------------------------------

    def product(self, v: Doubles, seed: int) -> Doubles:
        """H v."""
        found = self.prior_product(v)
        for view, picture in self.pictures.items():
            share = 2 / picture.size / len(self.pictures)
            found = found + share * self.reverse(view, self.forward(view, v, seed), seed)
        return found

    def in_full(self, variances: Mapping[int, Doubles], seed: int) -> tuple[Doubles, Doubles]:
        """H, and the covariance of its gradient by the noise of the targets and what the priors stand for."""
        units = np.eye(self.count)
        curvature = np.stack([self.prior_product(v) for v in units], axis=1)
        spread = self.prior_variance * curvature
        for view, picture in self.pictures.items():
            one, other = (
                np.stack([self.forward(view, v, round_seed(seed, k)).ravel() for v in units], axis=1) for k in (0, 1)
            )
            share = 2 / picture.size / len(self.pictures)
            curvature = curvature + share * one.T @ other
            spread = spread + share**2 * (one.T * variances[view].ravel()) @ other
        return (curvature + curvature.T) / 2, (spread + spread.T) / 2

    def prior_product(self, v: Doubles) -> Doubles:
        """P v, from the priors' gradients on both sides of the parameters."""
        found = []
        priors = {key: (prior, weight) for key, prior, weight in self._priors}
        for key, part in self._parts(v):
            longest = float(np.abs(part).max(initial=0))
            if key not in priors or longest == 0:
                found.append(np.zeros(part.size))
                continue
            prior, weight = priors[key]
            reach, slopes = NUDGE / longest, []
            for side in (1, -1):
                here = np.array(dr.detach(self._params[key]), np.float64)
                value = type(self._params[key])((here + side * reach * part).astype(np.float32))
                dr.enable_grad(value)
                dr.backward(weight * prior(value))
                slopes.append(np.array(dr.grad(value), np.float64).ravel())
            found.append((slopes[0] - slopes[1]) / (2 * reach))
        return np.concatenate(found)

    def prior_root(self, v: Doubles) -> Doubles:
        """P^(1/2) v, in the space that products with v span (Lanczos)."""
        length = float(np.linalg.norm(v))
        if not self._priors or length == 0:
            return np.zeros_like(v)
        basis, left = [v / length], v
        products = list[Doubles]()
        while len(products) < min(PRODUCTS, v.size):
            products.append(self.prior_product(basis[-1]))
            q = np.stack(basis)
            left = products[-1] - q.T @ (q @ products[-1])
            left = left - q.T @ (q @ left)
            if np.linalg.norm(left) <= 1e-4 * np.linalg.norm(products[0]):
                break
            basis.append(left / np.linalg.norm(left))
        q = np.stack(basis[: len(products)])
        small = q @ np.stack(products).T
        values, vectors = np.linalg.eigh((small + small.T) / 2)
        root = vectors @ (np.sqrt(np.maximum(values, 0)) * vectors[0])
        return np.asarray(length * root @ q)

    # ---- the noise of targets -----------------------------------------------------------------

    def variances(self, noise: float | str | Sequence[Any], seed: int) -> dict[int, Doubles]:
        """The variance of the targets' pixels, by view."""
        if isinstance(noise, str):
            if noise != "residual":
                raise RenderError(f"'noise' must be a number, arrays or 'residual', found '{noise}'")
            found = {view: self._remaining(view, picture, seed) for view, picture in self.pictures.items()}
        else:
            each = [noise] * len(self.pictures) if np.isscalar(noise) else list(noise)  # type: ignore[arg-type]
            if len(each) != len(self.pictures):
                raise RenderError(f"'noise' has {len(each)} arrays for {len(self.pictures)} views")
            pairs = zip(self.pictures.items(), each, strict=True)
            found = {view: np.square(np.broadcast_to(np.array(one, float), p.shape)) for (view, p), one in pairs}
        if not all(np.all(np.isfinite(one)) for one in found.values()):
            raise RenderError("'noise' must be finite")
        total = sum(picture.size for picture in self.pictures.values())
        self.prior_variance = 2 * float(np.mean([one.mean() for one in found.values()])) / total
        return found

    def _remaining(self, view: int, picture: Doubles, seed: int) -> Doubles:
        """The variance of what remains: the mean product of two differences, whose images' noise is independent."""
        with dr.suspend_grad():
            one, other = (np.array(self._image(view, round_seed(seed, 2 + k)), np.float64) - picture for k in (0, 1))
        return np.full(picture.shape, max(0.0, float(np.mean(one * other))))

    def noise_of_targets(self, variances: Mapping[int, Doubles], rng: np.random.Generator, seed: int) -> Doubles:
        """A sample of the gradient's change by the noise of targets, and by what the priors stand for."""
        found = math.sqrt(self.prior_variance) * self.prior_root(rng.normal(size=self.count))
        for view, variance in variances.items():
            if np.any(variance):
                weights = rng.normal(size=variance.shape) * np.sqrt(variance)
                found = found + 2 / variance.size / len(variances) * self.reverse(view, weights, seed)
        return found

"""The accuracy with which images determine parameters: standard errors, and undetermined combinations."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.description.parameters import SceneParameters, traverse
from djpt.errors import ParameterError
from djpt.rendering.progressive.rounds import round_seed
from djpt.rendering.render import render
from djpt.scene.scene import Scene

__all__ = ["Confidence", "confidence"]

Doubles = npt.NDArray[np.float64]

MOST = 64
"""The maximum number of entries, of all parameters together, for which derivative images are rendered."""

UNSEEN = 1e-6
"""Combinations whose curvature is below this share of the largest are considered undetermined."""


@dataclass(frozen=True)
class Confidence:
    """The information that images hold about parameters, near a result.

    With the derivative images J of all entries, the curvature of the loss mean((I - T)^2) is H = 2 J^T J / pixels
    (Gauss and Newton). A stochastic gradient of covariance S moves the minimum by H^-1 S H^-1 in covariance; averaged
    over n independent gradients, by 1/n of that.

    * `names`: one for each entry, ``key[i]``.
    * `errors`: the standard error of each entry from the gradients' noise, infinite where nothing is determined.
    * `curvatures`: the eigenvalues of H, ascending, and `combinations`, the eigenvectors, one in each row: a row with
      small curvature is a change of the parameters that hardly changes the pictures.
    """

    names: tuple[str, ...]
    errors: Doubles
    curvatures: Doubles
    combinations: Doubles

    @property
    def condition(self) -> float:
        """The largest curvature divided by the smallest: the ratio of the best to the worst determined combination."""
        low = float(self.curvatures[0])
        return float(self.curvatures[-1]) / low if low > 0 else math.inf

    @property
    def undetermined(self) -> list[dict[str, float]]:
        """Combinations that the pictures don't determine: the share of each entry, by name."""
        least = UNSEEN * float(self.curvatures[-1])
        rows = [row for value, row in zip(self.curvatures, self.combinations, strict=True) if value <= least]
        return [dict(zip(self.names, row.tolist(), strict=True)) for row in rows]

    def __str__(self) -> str:
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
    seed: int = 0,
) -> Confidence:
    """Estimate how well pictures determine parameters, at the scene's current values.

    Args:
        scene: What `load_dict` returned, at the result of an optimisation.
        keys: Parameters of `djpt.traverse` with `MOST` entries together at most.
        targets: The pictures, (H, W, C) each.
        views: The numbers of their sensors; by default 0, 1, ..
        spp: Samples per pixel of the derivative images and of each gradient.
        gradients: The number of gradients from which their covariance is estimated.
        averaged: The number of gradients behind the result, n above: about the number of iterations near the minimum.
        seed: Of all renders.

    Raises:
        ParameterError: A parameter is unknown, has no derivatives, or there are too many entries.
    """
    params, numbers = traverse(scene), range(len(targets)) if views is None else views
    sizes = {key: np.array(params[key]).size for key in keys}
    if not keys or sum(sizes.values()) > MOST:
        raise ParameterError(f"confidence takes 1 to {MOST} numbers, found {sum(sizes.values())}; leave out textures")
    names = [f"{key}[{i}]" if size > 1 else key for key, size in sizes.items() for i in range(size)]
    pictures = {view: np.array(target, np.float32) for view, target in zip(numbers, targets, strict=True)}
    curvature: Any = 0.0
    for view in numbers:
        images = derivative_images(scene, params, sizes, view, spp, round_seed(seed, view))
        jacobian = np.stack([image.ravel() for image in images], axis=1)
        curvature = curvature + 2 * jacobian.T @ jacobian / len(jacobian) / len(pictures)
    found = [gradient(scene, params, sizes, pictures, spp, round_seed(seed + 1, n)) for n in range(gradients)]
    noise = np.atleast_2d(np.cov(found, rowvar=False))
    values, vectors = np.linalg.eigh(curvature)
    seen = values > UNSEEN * max(values[-1], 0)
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
    spread = np.sqrt(np.maximum(np.diag(inverse @ noise @ inverse), 0) / averaged)
    # An entry that takes part in an undetermined combination has no error bar.
    part = np.square(vectors[:, ~seen]).sum(axis=1)
    return Confidence(tuple(names), np.where(part > 1e-3, np.inf, spread), values, vectors.T.copy())


@contextlib.contextmanager
def attached(params: SceneParameters, keys: Iterable[str]) -> Iterator[None]:
    """Let parameters have gradients for a while."""
    for key in keys:
        params[key] = type(params[key])(dr.detach(params[key]))
        dr.enable_grad(params[key])
    params.update()
    yield
    for key in keys:
        params[key] = type(params[key])(dr.detach(params[key]))
    params.update()


def derivative_images(
    scene: Scene, params: SceneParameters, sizes: Mapping[str, int], view: int, spp: int, seed: int
) -> list[Doubles]:
    """The derivatives of an image with respect to each entry, by forward mode."""
    found = []
    for key, size in sizes.items():
        for i in range(size):
            tangent = np.zeros(size, np.float32)
            tangent[i] = 1
            with attached(params, [key]):
                shape = np.shape(np.array(params[key]))
                dr.set_grad(params[key], type(params[key])(tangent.reshape(shape)))
                image = render(scene, params, sensor=view, spp=spp, seed=seed)
                found.append(np.array(dr.forward_to(image), np.float64))
    return found


def gradient(
    scene: Scene,
    params: SceneParameters,
    sizes: Mapping[str, int],
    pictures: Mapping[int, npt.NDArray[np.float32]],
    spp: int,
    seed: int,
) -> Doubles:
    """The gradient of the loss with respect to all entries, noise included."""
    with attached(params, sizes):
        for view, target in pictures.items():
            image = render(scene, params, sensor=view, spp=spp, seed=round_seed(seed, view))
            dr.backward(dr.mean(dr.square(image - type(image)(target)), axis=None) / len(pictures))
        return np.concatenate([np.array(dr.grad(params[key]), np.float64).ravel() for key in sizes])

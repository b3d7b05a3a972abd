"""An image and the gradient of its mean, as work to be timed: shared by the benchmarks of this folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr

__all__ = ["image_and_gradient"]


def image_and_gradient(
    module: Any, description: dict[str, Any], keys: Sequence[str], weights: Any = None
) -> Callable[[int], list[Any]]:
    """Prepare an image at 16 spp and the gradient of its mean by parameters of the scene.

    Args:
        module: djpt or mitsuba.
        description: The scene; its integrator becomes `prb`, paths of up to 8 edges.
        keys: The parameters.
        weights: Factors of the pixels in the mean, an array of the image's shape; default 1.

    Returns:
        A function of the seed whose values are the gradients, in the order of `keys`.
    """
    scene = module.load_dict({**description, "integrator": {"type": "prb", "max_depth": 8}})
    params = module.traverse(scene)
    for key in keys:
        dr.enable_grad(params[key])
    params.update()
    factors = 1 if weights is None else module.TensorXf(weights)

    def work(seed: int) -> list[Any]:
        for key in keys:
            dr.clear_grad(params[key])
        image = module.render(scene, params, spp=16, seed=seed)
        dr.backward(dr.mean(image * factors, axis=None))
        return [dr.grad(params[key]) for key in keys]

    return work

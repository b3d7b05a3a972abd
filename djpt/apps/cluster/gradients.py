"""`gradient`: the derivatives of a loss over many views, summed over the workers of a cluster."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.apps.cluster.bundle import Bundle
from djpt.apps.cluster.tasks import InOrder, require_client, warn
from djpt.apps.cluster.work import differentiated
from djpt.errors import ParameterError, RenderError
from djpt.rendering.progressive.rounds import round_seed
from djpt.rendering.settings import check_count, check_seed

__all__ = ["gradient"]


def gradient(
    client: Any,
    description: Mapping[str, Any],
    parameters: Mapping[str, Any],
    loss: Callable[[Any, int], Any],
    views: Sequence[int],
    *,
    spp: int = 0,
    seed: int = 0,
) -> tuple[float, dict[str, npt.NDArray[np.float64]]]:
    """The sum of a loss over views, and its derivatives, by reverse mode; each view is a task.

    Sums are of 64 bits, in the order of `views`: they don't depend on how many workers there are.

    Args:
        client: A `distributed.Client`.
        description: The scene's dict. It travels to a worker once; later calls with the same dict reuse it.
        parameters: The values of some parameters of `djpt.traverse`, by name, in place of the scene's: arrays.
        loss: Called on workers with an image (attached to the parameters) and the number of its view; gives a number
            on Dr.Jit's side, such as ``dr.mean(dr.square(image - targets[view]), axis=None)``. It travels with what
            it refers to, so keep target images small, or load them in it.
        views: The numbers of sensors: a minibatch.
        spp: As for `djpt.render`.
        seed: View number v is rendered with the seed of `djpt.rendering.progressive.rounds.round_seed` for v.

    Returns:
        The loss, and the derivatives by parameter, as float64 of the parameter's shape.

    Raises:
        BackendError: `distributed` is missing, or a worker has another version of djpt or Dr.Jit.
        ParameterError: `parameters` is empty, or one doesn't exist or can't have its value.
        RenderError: Arguments are out of range.
    """
    require_client(client)
    if not parameters:
        raise ParameterError("'parameters' must hold the parameters to differentiate with respect to, found none")
    if not views:
        raise RenderError("'views' must hold the number of at least one sensor, found none")
    spp, seed = check_count("spp", spp), check_seed("seed", seed)
    values = {key: np.array(value) for key, value in parameters.items()}

    def arguments(place: int) -> tuple[Any, ...]:
        view = int(views[place])
        return values, loss, view, spp, round_seed(seed, view)

    total = 0.0
    sums: dict[str, Any] = dict.fromkeys(values, 0.0)
    tasks = InOrder(client, Bundle.of(description), differentiated, arguments, warn)
    for value, derivatives in tasks.results(0, len(views)):
        total += value
        for key, derivative in derivatives.items():
            sums[key] = sums[key] + derivative.astype(np.float64)
    return total, sums

"""The derivative of an image's mean by a parameter at the ends of its range, by AD and by one-sided differences."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

import djpt
from djpt.errors import DjptError

__all__ = ["STEPS", "ZEROS", "Limits"]

ZEROS = (0.0, 1e-30, 1e-10, 1e-6)
"""The values at which derivatives must be those at 0."""

STEPS = (0.04, 0.005)
"""Steps of differences: the next one is tried where the slope changes fast."""
SEEDS = 4


class Limits:
    """A scene of which each parameter is taken to the ends of its range, all components at once."""

    def __init__(self, description: dict[str, Any], prefix: str, spp: int = 512) -> None:
        self.scene, self.spp = djpt.load_dict(description), spp
        self.params = djpt.traverse(self.scene)
        self.keys = [
            key
            for key in self.params
            if key.startswith(prefix) and not key.endswith("to_world") and self.params.flags(key).differentiable
        ]
        self.start = {key: self.params[key] for key in self.keys}

    def put(self, key: str, value: float) -> None:
        """Set all components of a parameter."""
        old = self.params[key]
        self.params[key] = (
            type(old)(dr.full(djpt.Float, value, dr.prod(old.shape)), old.shape)
            if dr.is_tensor_v(old)
            else type(old)(dr.opaque(djpt.Float, value))
        )
        self.params.update()

    def restore(self, key: str) -> None:
        self.params[key] = self.start[key]
        self.params.update()

    def accepts(self, key: str, value: float) -> bool:
        """Whether a value lies in the range of the parameter."""
        try:
            self.put(key, value)
        except DjptError:
            return False
        finally:
            self.restore(key)
        return True

    def means(self, key: str, value: float) -> np.ndarray:
        """The mean of the image, one for each seed."""
        self.put(key, value)
        found = [dr.mean(djpt.render(self.scene, spp=self.spp, seed=seed), axis=None) for seed in range(SEEDS)]
        return np.array([mean.numpy().item() for mean in found], np.float64)

    def difference(self, key: str, at: float, step: float) -> tuple[float, float]:
        """The one-sided derivative by three images, of second order in the step, and its standard error."""
        first, second, third = (self.means(key, at + k * step) for k in range(3))
        return estimate((4 * second - third - 3 * first) / (2 * step))

    def reverse(self, key: str, at: float) -> tuple[float, float]:
        """The derivative by reverse mode, and its standard error."""
        self.put(key, at)
        found = []
        for seed in range(SEEDS):
            dr.enable_grad(self.params[key])
            self.params.set_dirty(key)
            self.params.update()
            image = djpt.render(self.scene, self.params, spp=1, seed=seed, spp_grad=self.spp)
            dr.backward(dr.mean(image, axis=None))
            found.append(np.array(dr.grad(self.params[key]), np.float64).sum())
            dr.disable_grad(self.params[key])
        return estimate(np.array(found))

    def verdicts(self, key: str, scale: float = 1.0, steps: Sequence[float] = STEPS) -> list[tuple[bool, str]]:
        """For each end of the range whether the derivatives agree; those by AD are multiplied by `scale`."""
        result = []
        for ends, inward in ((ZEROS, 1), ((1.0,), -1)):
            if not self.accepts(key, ends[0]) or (inward < 0 and self.accepts(key, 1.01)):
                continue
            derivatives = [self.reverse(key, at) for at in ends]
            for step in steps if inward > 0 else STEPS:
                slope = self.difference(key, ends[0], inward * step)
                found = [
                    agree(f"{key} at {at:g}", scale * d, noise, *slope)
                    for at, (d, noise) in zip(ends, derivatives, strict=True)
                ]
                if all(good for good, _ in found):
                    break
            result += found
        self.restore(key)
        return result


def agree(what: str, found: float, noise: float, slope: float, error: float) -> tuple[bool, str]:
    """Whether a derivative by AD and one by differences agree, each with its standard error."""
    allowed = max(0.05 * abs(slope), 4 * float(np.hypot(error, noise)), 1e-7)
    text = f"{what}: {found:.5g} +- {noise:.2g} by AD, {slope:.5g} +- {error:.2g} by differences"
    return bool(np.isfinite(found) and abs(found - slope) <= allowed), text


def estimate(values: np.ndarray) -> tuple[float, float]:
    """The mean of independent values, and its standard error."""
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values)))

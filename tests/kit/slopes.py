"""The derivative of an image's mean by each of some parameters, by AD and by finite differences."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

import djpt

__all__ = ["Slopes", "numbers"]


class Slopes:
    """The derivative of an image's mean in one direction of one parameter, by AD and by differences.

    A subclass sets the values `at` which slopes are taken and the directions `along`, by key.
    """

    size = 16
    spp = 64
    step = 0.02
    seeds = (4, 28)
    """The number of images that a parameter is judged by, and the number if these aren't enough."""

    def __init__(self, description: dict[str, Any], schedule: str = "auto") -> None:
        self.schedule = schedule
        # A change of hue alone would cancel in a plain mean.
        self.weights = djpt.Float([1.5, 1.0, 0.5] * self.size**2)
        self.scene = djpt.load_dict(description)
        self.params = djpt.traverse(self.scene)
        self.keys: list[str] = []
        self.at: dict[str, np.ndarray] = {}
        self.along: dict[str, np.ndarray] = {}

    def put(self, values: dict[str, Any]) -> None:
        for key, value in values.items():
            shape, kind = np.shape(value), type(self.params[key])
            flat = np.asarray(value, np.float32)
            self.params[key] = kind(flat) if len(shape) > 1 else kind(*np.atleast_1d(flat).tolist())
        self.params.update()

    def loss(self, seed: int) -> Any:
        image = djpt.render(self.scene, self.params, spp=self.spp, seed=seed, seed_grad=seed, schedule=self.schedule)
        return dr.mean(image.array * self.weights)

    def attached(self, seed: int) -> dict[str, float]:
        """The slopes in all directions at once, by AD."""
        self.put(self.at)
        for key in self.keys:
            dr.enable_grad(self.params[key])
        self.params.update()
        dr.backward(self.loss(seed))
        slopes = {key: float((numbers(dr.grad(self.params[key])) * self.along[key]).sum()) for key in self.keys}
        for key in self.keys:
            dr.disable_grad(self.params[key])
        self.params.update()
        return slopes

    def difference(self, key: str, seed: int) -> float:
        ends = []
        for sign in (1, -1):
            self.put({key: self.at[key] + sign * self.step * self.along[key]})
            ends.append(float(self.loss(seed)[0]))
        self.put({key: self.at[key]})
        return (ends[0] - ends[1]) / (2 * self.step)

    def check(self, key: str, exact: dict[int, dict[str, float]], factor: float = 1.0) -> tuple[bool, str]:
        """Whether both agree within 1 % or 3 sigma; and a message. `factor` makes the derivative wrong."""
        errors: list[float] = []
        slopes: list[float] = []
        for count in self.seeds:
            for seed in range(1 + len(errors), 1 + count):
                if seed not in exact:
                    exact[seed] = self.attached(seed)
                slopes.append(factor * exact[seed][key])
                errors.append(slopes[-1] - self.difference(key, seed))
            error, sigma = np.mean(errors), np.std(errors, ddof=1) / np.sqrt(len(errors))
            text = f"{key}: {np.mean(slopes):.6f}, off by {error:.6f} +- {sigma:.6f}"
            if abs(error) <= max(0.01 * abs(np.mean(slopes)), 3 * sigma):
                return True, text
        return False, text


def numbers(value: Any) -> np.ndarray:
    """A parameter as NumPy numbers: (), (3,) or a tensor's shape."""
    array = np.array(dr.detach(value), np.float64)
    return array if dr.is_tensor_v(value) else array.ravel() if dr.depth_v(value) > 1 else array.reshape(())

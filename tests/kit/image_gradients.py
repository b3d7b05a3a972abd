"""A loss of an image, differentiated in reverse mode, in forward mode and by finite differences."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from tests.kit.arrays import floats, in_numpy
from tests.kit.renders import pixels

__all__ = ["ALBEDO", "RADIANCE", "SEED", "SPP", "Experiment"]

SEED, SPP = 3, 16
ALBEDO, RADIANCE = "red.reflectance.value", "light.emitter.radiance.value"


class Experiment:
    """A loss of an image as a function of some parameters: sum(weights * image)."""

    def __init__(self, description: dict[str, Any], names: list[str], spp: int = SPP, **options: Any) -> None:
        self.description, self.names = description, names
        self.scene = djpt.load_dict(description)
        self.params = djpt.traverse(self.scene)
        self.options = {"spp": spp, "seed": SEED, "seed_grad": SEED, **options}
        self.values = {name: in_numpy(self.params[name]).ravel() for name in names}
        shape = self.image().shape
        self.weights = np.random.default_rng(1).uniform(0.5, 1.5, shape).astype(np.float32)

    def image(self) -> Any:
        return djpt.render(self.scene, self.params, **self.options)

    def loss(self) -> Any:
        return dr.sum(self.image().array * floats(self.weights))

    def assign(self, name: str, value: np.ndarray) -> None:
        self.params[name] = djpt.Color3f(*value.tolist())
        self.params.update()

    def reverse(self) -> dict[str, np.ndarray]:
        """The gradients of all parameters, component by component."""
        self._attach()
        dr.backward(self.loss())
        result = {name: in_numpy(dr.grad(self.params[name])).ravel() for name in self.names}
        self._detach()
        return result

    def forward(self, name: str, component: int) -> np.ndarray:
        """The derivative of the image with respect to one component."""
        self._attach()
        tangent = np.zeros(3)
        tangent[component] = 1
        dr.set_grad(self.params[name], djpt.Color3f(*tangent.tolist()))
        result = pixels(dr.forward_to(self.image()))
        self._detach()
        return result

    def differences(self, name: str, component: int) -> np.ndarray:
        """The derivative of the image with respect to one component, by central differences of width 2 h."""
        images = []
        h = 0.02 * max(1.0, abs(self.values[name][component]))
        for sign in (1, -1):
            value = self.values[name].copy()
            value[component] += sign * h
            self.assign(name, value)
            images.append(pixels(self.image()).astype(np.float64))
        self.assign(name, self.values[name])
        return (images[0] - images[1]) / (2 * h)

    def check(self, tolerance: float = 2e-3) -> None:
        """Assert that reverse mode, forward mode and finite differences agree."""
        reverse = self.reverse()
        largest = max(np.abs(gradient).max() for gradient in reverse.values())
        assert largest > 0
        for name in self.names:
            scale = np.abs(reverse[name]).max()
            for component in range(3):
                by_difference = self.differences(name, component)
                slope = float(np.sum(by_difference * self.weights))
                assert reverse[name][component] == pytest.approx(slope, rel=tolerance, abs=tolerance * scale)
            forward = self.forward(name, 2)
            error = np.abs(forward - by_difference)
            assert np.mean(error > 0.01 * np.abs(by_difference).max() + 1e-6) < 0.002
            assert float(np.sum(forward * self.weights)) == pytest.approx(reverse[name][2], rel=1e-4, abs=1e-4 * scale)

    def _attach(self) -> None:
        for name in self.names:
            dr.enable_grad(self.params[name])
            self.params.set_dirty(name)
        self.params.update()

    def _detach(self) -> None:
        for name in self.names:
            self.assign(name, self.values[name])

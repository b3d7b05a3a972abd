"""Derivatives of a loss of an image by AD against those by differences: at one seed, on average, and at 0 and 1."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.validation.gradcheck.losses import Loss

__all__ = [
    "ALBEDO",
    "RADIANCE",
    "SEED",
    "STEPS",
    "ZEROS",
    "Experiment",
    "Limits",
    "Slopes",
    "by_both",
    "differentiable",
    "mean_and_error",
    "numbers",
]

SEED = 3
ALBEDO, RADIANCE = "red.reflectance.value", "light.emitter.radiance.value"


def differentiable(params: Any, prefix: str = "", but: Iterable[str] = ()) -> list[str]:
    """The parameters that images have derivatives by without motions, whose keys begin with `prefix`."""
    return [
        key
        for key in params
        if key.startswith(prefix)
        and key.rpartition(".")[2] not in ("to_world", "position")
        and params.flags(key).differentiable
        and key not in but
    ]


def numbers(value: Any) -> np.ndarray:
    """A parameter as NumPy numbers: (), (3,) or a tensor's shape."""
    array = np.array(dr.detach(value), np.float64)
    return array if dr.is_tensor_v(value) else array.ravel() if dr.depth_v(value) > 1 else array.reshape(())


def by_both(
    scene: djpt.Scene, key: str, step: float, along: Any = 1.0, seed: int = SEED, **options: Any
) -> tuple[float, float]:
    """The derivative of the sum of an image in a direction of a parameter: by reverse mode, and by differences."""
    loss = Loss(scene, [key], np.ones((1, 1, 1), np.float32), **options)
    direction = np.broadcast_to(np.asarray(along, np.float64), loss.values.shape)
    change = loss.difference(direction, step, seed)
    return change.size * float(loss.reverse(seed) @ direction), float(change.sum())


# ---------------------------------------------------------------- one seed, component by component


class Experiment(Loss):
    """The loss as a function of colours; all of its images follow the same paths."""

    def __init__(self, scene: dict[str, Any] | djpt.Scene, names: Sequence[str], spp: int = 16, **options: Any) -> None:
        loaded = djpt.load_dict(scene) if isinstance(scene, dict) else scene
        super().__init__(loaded, names, seed=1, spp=spp, **options)

    def gradients(self) -> dict[str, np.ndarray]:
        """In reverse mode, by name and component."""
        found = self.reverse(SEED)
        return {name: found[part] for name, part in self.parts.items()}

    def component(self, name: str, component: int) -> np.ndarray:
        """The direction of one component."""
        along = np.zeros(self.values.size)
        along[self.parts[name].start + component] = 1
        return along

    def changes(self, name: str, component: int) -> tuple[np.ndarray, np.ndarray]:
        """The derivatives of the image by one component: in forward mode, and by central differences."""
        along = self.component(name, component)
        return self.forward(along, SEED), self.by_differences(along)

    def by_differences(self, along: np.ndarray) -> np.ndarray:
        """The derivative of the image in a direction."""
        return self.difference(along, 0.02 * max(1.0, np.abs(self.values[along != 0]).max()), SEED)

    def assert_modes_agree(self) -> None:
        """Assert that forward mode gives the derivatives by all components that reverse mode gives."""
        for name, gradient in self.gradients().items():
            for component, slope in enumerate(gradient):
                forward = self.forward(self.component(name, component), SEED)
                assert self.value(forward) == pytest.approx(slope, rel=1e-4)

    def check(self, tolerance: float = 2e-3) -> None:
        """Assert that reverse mode, forward mode and finite differences agree."""
        reverse = self.gradients()
        assert max(np.abs(gradient).max() for gradient in reverse.values()) > 0
        for name in self.keys:
            found = reverse[name]
            scale = np.abs(found).max()
            for component in range(3):
                by_difference = self.by_differences(self.component(name, component))
                assert found[component] == pytest.approx(
                    self.value(by_difference), rel=tolerance, abs=tolerance * scale
                )
            forward = self.forward(self.component(name, 2), SEED)
            error = np.abs(forward - by_difference)
            assert np.mean(error > 0.01 * np.abs(by_difference).max() + 1e-6) < 0.002
            assert self.value(forward) == pytest.approx(found[2], rel=1e-4, abs=1e-4 * scale)

    def check_on_average(self, seeds: Iterable[int] = range(16)) -> None:
        """Assert that forward mode agrees with reverse mode, and its mean with that of finite differences.

        Where samples choose by what they are differentiated by, differences at one seed jump.
        """
        self.assert_modes_agree()
        exact = {seed: self.reverse(seed) for seed in seeds}
        scale = np.abs(np.mean(list(exact.values()), axis=0)).max()
        for number, along in enumerate(np.eye(self.values.size)):
            step = 0.02 * max(1.0, abs(self.values[number]))
            errors = [found[number] - self.value(self.difference(along, step, seed)) for seed, found in exact.items()]
            error, sigma = mean_and_error(errors)
            assert abs(error) <= max(4 * sigma, 2e-3 * scale) and sigma < 0.01 * scale, (number, error, sigma)


# ---------------------------------------------------------------- on average, parameter by parameter


class Slopes(Loss):
    """The loss as a function of parameters that move samples: differences have the mean of derivatives, and noise.

    Each parameter is taken in one direction, `along`.
    """

    size = 16
    spp = 64
    step = 0.02
    seeds = (4, 28)
    """The number of images that a parameter is judged by, and the number if these aren't enough."""
    slack = 0.01
    """The relative difference up to which both agree."""

    def __init__(
        self,
        scene: djpt.Scene,
        at: dict[str, np.ndarray],
        along: dict[str, np.ndarray],
        schedule: str = "auto",
    ) -> None:
        """Move the parameters of a scene to `at`."""
        # A change of hue alone would cancel in a plain mean.
        weights = np.broadcast_to(np.array([1.5, 1.0, 0.5], np.float32), (self.size, self.size, 3))
        super().__init__(scene, list(at), weights, spp=self.spp, schedule=schedule)
        self.move(np.concatenate([np.zeros(0), *(np.ravel(at[key]) for key in self.keys)]))
        self.along = {key: np.zeros(self.values.size) for key in self.keys}
        for key, part in self.parts.items():
            self.along[key][part] = np.ravel(along[key])

    def slopes(self, seed: int) -> dict[str, float]:
        """The derivatives in all directions at once, by AD."""
        gradient = self.reverse(seed)
        return {key: float(gradient @ along) for key, along in self.along.items()}

    def check(self, key: str, exact: dict[int, dict[str, float]], factor: float = 1.0) -> tuple[bool, str]:
        """Whether both agree within `slack` or 3 sigma; and a message. `factor` makes the derivative wrong.

        `exact` keeps the slopes of each seed.
        """
        errors: list[float] = []
        slopes: list[float] = []
        for count in self.seeds:
            for seed in range(1 + len(errors), 1 + count):
                if seed not in exact:
                    exact[seed] = self.slopes(seed)
                slopes.append(factor * exact[seed][key])
                errors.append(slopes[-1] - self.value(self.difference(self.along[key], self.step, seed)))
            error, sigma = mean_and_error(errors)
            text = f"{key}: {np.mean(slopes):.6f}, off by {error:.6f} +- {sigma:.6f}"
            if abs(error) <= max(self.slack * abs(np.mean(slopes)), 3 * sigma):
                return True, text
        return False, text


def mean_and_error(values: Any) -> tuple[float, float]:
    """The mean of independent values, and its standard error."""
    return float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(len(values)))


# ---------------------------------------------------------------- at the ends of ranges


ZEROS = (0.0, 1e-30, 1e-10, 1e-6)
"""The values at which derivatives must be those at 0."""

ROUNDING = 2.0**-23
"""That of sums of single precision, relative to their terms."""

STEPS = (0.04, 0.005)
"""Steps of differences: the next one is tried where the slope changes fast."""


class Limits(Loss):
    """The mean of an image as a function of one parameter, all components of which go to the ends of the range."""

    seeds = (range(4), range(4, 20))
    """The seeds that a parameter is judged by, and more if these disagree: errors of four are too small where samples
    that move far are rare."""

    def __init__(self, scene: djpt.Scene, key: str, spp: int = 512) -> None:
        # Where it is differentiated, only the derivative counts.
        super().__init__(scene, [key], np.ones((1, 1, 1), np.float32), derivatives={"spp": 1, "spp_grad": spp}, spp=spp)

    def by_ad(self, at: float, seeds: Iterable[int] = seeds[0]) -> tuple[float, float]:
        """The derivative by reverse mode, and its standard error, that of rounding included.

        Where the hue of a dark colour counts, the derivatives by its components are large and cancel.
        """
        self.move(np.full(self.values.size, at))
        gradients = np.array([self.reverse(seed) for seed in seeds])
        mean, error = mean_and_error(gradients.sum(axis=1))
        return mean, float(np.hypot(error, ROUNDING * np.abs(gradients).sum(axis=1).mean()))

    def by_differences(self, at: float, step: float, seeds: Iterable[int] = seeds[0]) -> tuple[float, float]:
        """The derivative by values ahead or, if the step is negative, behind; and its standard error."""
        self.move(np.full(self.values.size, at))
        along, side = np.ones(self.values.size), 1 if step > 0 else -1
        return mean_and_error([self.value(self.difference(along, abs(step), seed, side)) for seed in seeds])

    def verdicts(self, scale: float = 1.0, steps: Sequence[float] = STEPS) -> list[tuple[bool, str]]:
        """For each end of the range whether the derivatives agree; those by AD are multiplied by `scale`."""
        result: list[tuple[bool, str]] = []
        start, ones = self.values, np.ones(self.values.size)
        for ends, inward in ((ZEROS, 1), ((1.0,), -1)):
            if not self.allows(ends[0] * ones) or (inward < 0 and self.allows(1.01 * ones)):
                continue
            for seeds in self.seeds:
                derivatives = [self.by_ad(at, seeds) for at in ends]
                for step in steps if inward > 0 else STEPS:
                    slope = self.by_differences(ends[0], inward * step, seeds)
                    found = [
                        agree(f"{self.keys[0]} at {at:g}", scale * d, noise, *slope)
                        for at, (d, noise) in zip(ends, derivatives, strict=True)
                    ]
                    if all(good for good, _ in found):
                        break
                else:
                    continue
                break
            result += found
        self.move(start)
        return result


def agree(what: str, found: float, noise: float, slope: float, error: float) -> tuple[bool, str]:
    """Whether a derivative by AD and one by differences agree, each with its standard error."""
    allowed = max(0.05 * abs(slope), 4 * float(np.hypot(error, noise)), 1e-7)
    text = f"{what}: {found:.5g} +- {noise:.2g} by AD, {slope:.5g} +- {error:.2g} by differences"
    return bool(np.isfinite(found) and abs(found - slope) <= allowed), text

"""A loss of a scene's image in djpt and in Mitsuba, with its value and its derivatives at one seed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.core.transforms.lanes import Transform4f
from djpt.description.loader import load_dict
from djpt.description.parameters import traverse
from djpt.description.plugin import ParamFlags
from djpt.errors import ParameterError
from djpt.jit.types import Float, UInt32
from djpt.rendering.render import render
from djpt.scenes.overrides import override
from djpt.validation.bridge import mitsuba_scene
from djpt.validation.metrics import ComparisonError

__all__ = ["Loss", "MitsubaLoss", "MotionLoss", "loss_of", "weights"]

NEAR_ZERO = 1e-6
"""Entries below this are taken for zero."""

NEAR_END = 1e-3
"""Entries that are no farther from an end of their range are taken for the end."""

Floats = npt.NDArray[np.float64]


def weights(shape: tuple[int, ...], seed: int) -> npt.NDArray[np.float32]:
    """The weights of pixels in a loss: random numbers from 0.5 to 1.5, so that no errors of pixels cancel."""
    return np.random.default_rng([seed, 77]).uniform(0.5, 1.5, shape).astype(np.float32)


class Loss:
    """The loss L = mean(weights * image) as a function of a parameter, in djpt.

    Images and derivatives of one seed follow the same paths, so their noise is nearly the same.

    Raises:
        ParameterError: There is no such parameter, or it has no derivatives.
    """

    def __init__(self, scene: Mapping[str, Any], key: str, spp: int, sensor: int, seed: int) -> None:
        self.key, self.spp, self.sensor = key, spp, sensor
        self.scene = load_dict(scene, optimize=False)  # as Mitsuba's, whose names need it
        self.params = traverse(self.scene)
        value = self._start()
        if not self.params.flags(key).differentiable or not dr.is_array_v(value):
            raise ParameterError(f"{key}: has no derivatives")
        self.kind, self.shape = type(value), np.shape(np.array(value))
        self.values: Floats = np.array(value, np.float64).ravel()
        """The entries of the parameter where it is checked, (n,)."""
        first = self.image(0)
        if not first.size:
            raise ComparisonError("the integrator makes no channels to check")
        self.weights = weights(first.shape, seed)

    def _start(self) -> Any:
        """The parameter where it is checked."""
        return self.params[self.key]

    def image(self, seed: int) -> npt.NDArray[np.float32]:
        """The image, (H, W, C)."""
        return np.array(self._rendered(seed), np.float32)

    def image_at(self, entries: Floats, seed: int) -> npt.NDArray[np.float64]:
        """The image for other entries of the parameter."""
        self._assign(entries)
        try:
            return self.image(seed).astype(np.float64)
        finally:
            self._assign(self.values)

    def allows(self, entries: Floats) -> bool:
        """True if the parameter can have these entries."""
        try:
            self._assign(entries)
        except ParameterError:
            return False
        finally:
            self._assign(self.values)
        return True

    def inward(self) -> Floats:
        """The direction into the parameter's range for entries at its ends, 1 or -1, and 0 for the others, (n,)."""
        found = np.zeros_like(self.values)
        for sign, end in ((1.0, self.values.min()), (-1.0, self.values.max())):
            at_end = np.abs(self.values - end) <= NEAR_END
            if not self.allows(self.values - sign * NEAR_END * at_end):
                found[at_end] = sign
        return found

    def value(self, image: npt.NDArray[np.floating]) -> float:
        """The loss of an image."""
        return float(np.mean(np.asarray(image, np.float64) * self.weights))

    def reverse(self, seed: int) -> Floats:
        """The derivative of the loss with respect to each entry, by reverse mode, (n,)."""
        self._attach()
        try:
            image = self._rendered(seed)
            dr.backward(dr.mean(image * type(image)(self.weights), axis=None))
            return np.array(dr.grad(self.variable()), np.float64).ravel()
        finally:
            self._assign(self.values)

    def forward(self, direction: Floats, seed: int) -> npt.NDArray[np.float64]:
        """The derivative of the image in a direction, by forward mode, (H, W, C)."""
        self._attach()
        try:
            dr.set_grad(self.variable(), self._typed(direction))
            return np.array(dr.forward_to(self._rendered(seed)), np.float64)
        finally:
            self._assign(self.values)

    def variable(self) -> Any:
        """The variable with the entries, which has gradients while the loss is differentiated."""
        return self.params[self.key]

    def _rendered(self, seed: int) -> Any:
        # One seed for image and gradient: the same paths.
        return render(self.scene, self.params, sensor=self.sensor, spp=self.spp, seed=seed, seed_grad=seed)

    def _typed(self, entries: Floats) -> Any:
        return self.kind(np.ascontiguousarray(entries.reshape(self.shape), np.float32))

    def _assign(self, entries: Floats) -> None:
        self.params[self.key] = self._typed(entries)
        self.params.update()

    def _attach(self) -> None:
        self._assign(self.values)
        dr.enable_grad(self.params[self.key])
        self.params.update()


class MotionLoss(Loss):
    """The loss as a function of a rigid motion of what a transform places, which is its parameter.

    Its six entries are the way along x, y and z, in scene units, and the angles of turns about axes in these directions
    through the place, in radians.
    """

    def _start(self) -> Any:
        if not self.params.flags(self.key).differentiable:
            raise ParameterError(f"{self.key}: has no derivatives")
        self._base = Transform4f(self.params[self.key])
        self._theta = dr.zeros(Float, 6)
        return self._theta

    def variable(self) -> Any:
        return self._theta

    def _assign(self, entries: Floats) -> None:
        self._theta = self._typed(entries)
        self._place()

    def _attach(self) -> None:
        self._theta = self._typed(self.values)
        dr.enable_grad(self._theta)
        self._place()

    def _place(self) -> None:
        entries = [dr.gather(Float, self._theta, UInt32(i)) for i in range(6)]
        matrix = self._base.matrix
        center = [dr.detach(matrix[i, 3]) for i in range(3)]
        turned = Transform4f().translate(center)
        for axis, angle in zip(np.eye(3).tolist(), entries[3:], strict=True):
            turned = turned @ Transform4f().rotate(axis, angle * (180 / math.pi))
        back = turned @ Transform4f().translate([-c for c in center])
        self.params[self.key] = Transform4f().translate(entries[:3]) @ back @ self._base
        self.params.update()


def loss_of(scene: Mapping[str, Any], key: str, spp: int, sensor: int, seed: int) -> Loss:
    """The loss as a function of a parameter, or, if it is a transform, of a motion."""
    kind = MotionLoss if key.rpartition(".")[2] == "to_world" else Loss
    return kind(scene, key, spp, sensor, seed)


REPLAYING = {"path": "prb", "volpath": "prbvolpath", "volpathmis": "prbvolpath"}
"""The integrators that replace others in Mitsuba, since they need not record loops to be differentiated."""


class MitsubaLoss:
    """The loss of `Loss` in Mitsuba, with its integrators `prb` and `prbvolpath`; only reverse mode.

    Raises:
        ComparisonError: Mitsuba can't load the scene, has no such parameter, or is wrong at this value.
    """

    def __init__(self, scene: Mapping[str, Any], key: str, spp: int, sensor: int, like: Loss) -> None:
        self.key, self.spp, self.sensor, self.like = key, spp, sensor, like
        if like.params.flags(key) & ParamFlags.Discontinuous:
            raise ComparisonError("motions are compared with differences only")
        if np.any(np.abs(like.values) < NEAR_ZERO):
            raise ComparisonError("its path replay divides by the differentiated value, which is zero here")
        node = scene.get("integrator")
        kind = node.get("type") if isinstance(node, Mapping) else None
        if kind in REPLAYING:
            scene = override(scene, integrator={**node, "type": REPLAYING[kind]})  # type: ignore[dict-item]
        with mitsuba_scene(scene) as (mi, loaded):
            self.scene, self.params = loaded, mi.traverse(loaded)
            if key not in self.params:
                raise ComparisonError(f"Mitsuba has no parameter '{key}'")
            if np.array(self.params[key]).size != like.values.size:
                raise ComparisonError(f"Mitsuba's parameter '{key}' has {np.array(self.params[key]).size} entries")

    def reverse(self, seed: int) -> Floats:
        """The derivative of the loss with respect to each entry, (n,)."""
        with mitsuba_scene(None) as (mi, _):
            dr.enable_grad(self.params[self.key])
            self.params.update()
            image = mi.render(self.scene, self.params, sensor=self.sensor, spp=self.spp, seed=seed)
            dr.backward(dr.mean(image * type(image)(self.like.weights), axis=None))
            found = np.array(dr.grad(self.params[self.key]), np.float64).ravel()
            dr.disable_grad(self.params[self.key])
            return found

"""A loss of a scene's image in djpt and in Mitsuba, with its value and its derivatives at one seed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.core.transforms.lanes import Transform4f
from djpt.description.loader import load_dict
from djpt.description.parameters import traverse
from djpt.description.plugin import ParamFlags
from djpt.errors import ParameterError
from djpt.jit.kernels import own_floats
from djpt.jit.types import Float, TensorXf, UInt32
from djpt.rendering.render import render
from djpt.scene.scene import Scene
from djpt.scenes.overrides import override
from djpt.validation.bridge import mitsuba_scene
from djpt.validation.metrics import ComparisonError

__all__ = ["Loss", "MitsubaLoss", "MotionLoss", "loss_of", "quotient", "random_weights"]

NEAR_ZERO = 1e-6
"""Entries below this are taken for zero."""

NEAR_END = 1e-3
"""Entries that are no farther from an end of their range are taken for the end."""

Floats = npt.NDArray[np.float64]


def random_weights(shape: tuple[int, ...], seed: int) -> npt.NDArray[np.float32]:
    """The weights of pixels in a loss: random numbers from 0.5 to 1.5, so that no errors of pixels cancel."""
    return np.random.default_rng([seed, 77]).uniform(0.5, 1.5, shape).astype(np.float32)


def quotient(function: Callable[[float], Any], step: float, side: int = 0) -> Any:
    """The derivative of a function of a number at 0 by differences, of second order in the step.

    `side`: 0 for central differences, from two values; 1 or -1 for one side alone, from three.
    """
    if side == 0:
        return (function(step) - function(-step)) / (2 * step)
    return side * (4 * function(side * step) - 3 * function(0.0) - function(2 * side * step)) / (2 * step)


def typed(kind: Any, shape: tuple[int, ...], entries: Floats) -> Any:
    """A parameter with these entries, in memory of Dr.Jit's own: no kernel depends on its place."""
    if dr.is_tensor_v(kind):
        return kind(own_floats(entries.astype(np.float32)), shape)
    if entries.size == (dr.size_v(kind) if dr.depth_v(kind) > 1 else 1):
        return kind(*entries.tolist())
    if dr.depth_v(kind) == 1:
        return kind(own_floats(entries.astype(np.float32)))
    return kind(np.ascontiguousarray(entries.reshape(shape), np.float32))


class Loss:
    """The loss L = mean(weights * image) of a scene as a function of some of its parameters, in djpt.

    The variable is the vector of all their entries, those of one parameter after the other. Images and derivatives of
    one seed follow the same paths, so their noise is nearly the same.

    Args:
        scene: The scene, whose parameters are edited.
        keys: The parameters.
        weights: The weights of the image's entries, (H, W, C) or what can be broadcast to it. Default: random numbers,
            see `random_weights`.
        seed: The seed of the random weights.
        derivatives: Options of `render` that differ where an image is differentiated.
        options: Options of `render`, such as `spp`, `sensor`, and `schedule`.

    Raises:
        ParameterError: There is no such parameter, or it has no derivatives.
    """

    def __init__(
        self,
        scene: Scene,
        keys: Sequence[str],
        weights: npt.NDArray[np.float32] | None = None,
        seed: int = 0,
        derivatives: Mapping[str, Any] | None = None,
        **options: Any,
    ) -> None:
        self.scene, self.keys, self.options = scene, tuple(keys), options
        self.derivatives = derivatives or {}
        self.params = traverse(scene)
        start = [self._start(key) for key in self.keys]
        for key, value in zip(self.keys, start, strict=True):
            if not self.params.flags(key).differentiable or not dr.is_array_v(value):
                raise ParameterError(f"{key}: has no derivatives")
        arrays = [np.array(value, np.float64) for value in start]
        self.kinds = [(type(value), array.shape) for value, array in zip(start, arrays, strict=True)]
        self.values: Floats = np.concatenate([array.ravel() for array in arrays]) if arrays else np.zeros(0)
        """The entries of the parameters where the loss is differentiated, (n,)."""
        ends = np.cumsum([0, *(array.size for array in arrays)]).tolist()
        self.parts = {key: slice(*ends[i : i + 2]) for i, key in enumerate(self.keys)}
        """The entries of each parameter."""
        self._now: list[Floats | None] = [self.values[part] for part in self.parts.values()]
        if weights is None:
            first = self.image(0)
            if not first.size:
                raise ComparisonError("the integrator makes no channels to check")
            weights = random_weights(first.shape, seed)
        self.weights = weights
        self._weights = TensorXf(own_floats(weights.astype(np.float32)), weights.shape)

    def _start(self, key: str) -> Any:
        """The parameter where it is checked."""
        return self.params[key]

    def move(self, entries: Floats) -> None:
        """Give the parameters other entries, where the loss is differentiated then."""
        self._assign(entries)
        self.values = entries

    def image(self, seed: int) -> npt.NDArray[np.float32]:
        """The image, (H, W, C)."""
        return np.array(self._rendered(seed), np.float32)

    def difference(self, direction: Floats, step: float, seed: int, side: int = 0) -> npt.NDArray[np.float64]:
        """The derivative of the image in a direction by differences, (H, W, C); see `quotient`."""

        def at(length: float) -> npt.NDArray[np.float64]:
            self._assign(self.values + length * direction)
            return self.image(seed).astype(np.float64)

        try:
            return quotient(at, step, side)
        finally:
            self._assign(self.values)

    def allows(self, entries: Floats) -> bool:
        """True if the parameters can have these entries."""
        try:
            self._assign(entries)
        except ParameterError:
            return False
        finally:
            self._assign(self.values)
        return True

    def inward(self) -> Floats:
        """The direction into the parameters' range for entries at its ends, 1 or -1, and 0 for the others, (n,)."""
        found = np.zeros_like(self.values)
        for sign, end in ((1.0, self.values.min()), (-1.0, self.values.max())):
            at_end = np.abs(self.values - end) <= NEAR_END
            if not self.allows(self.values - sign * NEAR_END * at_end):
                found[at_end] = sign
        return found

    def value(self, image: npt.NDArray[np.floating]) -> float:
        """The loss of an image."""
        return float(np.mean(np.asarray(image, np.float64) * self.weights))

    def attached(self, seed: int) -> Any:
        """The loss with its gradients, whose derivatives the variables of `attach` get."""
        return dr.mean(self._rendered(seed, self.derivatives) * self._weights, axis=None)

    def reverse(self, seed: int) -> Floats:
        """The derivative of the loss with respect to each entry, by reverse mode, (n,)."""
        variables = self.attach()
        try:
            dr.backward(self.attached(seed))
            return np.concatenate([np.array(dr.grad(variable), np.float64).ravel() for variable in variables])
        finally:
            self._assign(self.values)

    def forward(self, direction: Floats, seed: int) -> npt.NDArray[np.float64]:
        """The derivative of the image in a direction, by forward mode, (H, W, C)."""
        variables = self.attach()
        try:
            for variable, (kind, shape), part in zip(variables, self.kinds, self.parts.values(), strict=True):
                tangent = typed(kind, shape, direction[part])
                dr.make_opaque(tangent)
                dr.set_grad(variable, tangent)
            return np.array(dr.forward_to(self._rendered(seed, self.derivatives)), np.float64)
        finally:
            self._assign(self.values)

    def attach(self) -> list[Any]:
        """Give the parameters gradients, and return the variables that have them, until entries are assigned."""
        self._assign(self.values)
        self._now = [None] * len(self.keys)
        for key in self.keys:
            dr.enable_grad(self.params[key])
            self.params.set_dirty(key)
        self.params.update()
        return [self.params[key] for key in self.keys]

    def _rendered(self, seed: int, others: Mapping[str, Any] | None = None) -> Any:
        # One seed for image and gradient: the same paths.
        options = {"seed": seed, "seed_grad": seed, **self.options, **(others or {})}
        return render(self.scene, self.params, **options)

    def _assign(self, entries: Floats) -> None:
        for i, (key, part) in enumerate(self.parts.items()):
            now = self._now[i]
            if now is None or not np.array_equal(entries[part], now):
                self._now[i] = None
                self.params[key] = typed(*self.kinds[i], entries[part])
                self._now[i] = entries[part].copy()
        self.params.update()


class MotionLoss(Loss):
    """The loss as a function of a rigid motion of what a transform places, which is its parameter.

    Its six entries are the way along x, y and z, in scene units, and the angles of turns about axes in these directions
    through the place, in radians.
    """

    def _start(self, key: str) -> Any:
        if not self.params.flags(key).differentiable:
            raise ParameterError(f"{key}: has no derivatives")
        self._base = Transform4f(self.params[key])
        self._theta = dr.zeros(Float, 6)
        return self._theta

    def _assign(self, entries: Floats) -> None:
        self._theta = Float(own_floats(entries.astype(np.float32)))
        self._place()

    def attach(self) -> list[Any]:
        self._theta = Float(own_floats(self.values.astype(np.float32)))
        dr.enable_grad(self._theta)
        self._place()
        return [self._theta]

    def _place(self) -> None:
        entries = [dr.gather(Float, self._theta, UInt32(i)) for i in range(6)]
        matrix = self._base.matrix
        center = [dr.detach(matrix[i, 3]) for i in range(3)]
        turned = Transform4f().translate(center)
        for axis, angle in zip(np.eye(3).tolist(), entries[3:], strict=True):
            turned = turned @ Transform4f().rotate(axis, angle * (180 / math.pi))
        back = turned @ Transform4f().translate([-c for c in center])
        self.params[self.keys[0]] = Transform4f().translate(entries[:3]) @ back @ self._base
        self.params.update()


def loss_of(scene: Mapping[str, Any], key: str, spp: int, sensor: int, seed: int) -> Loss:
    """The loss as a function of a parameter, or, if it is a transform, of a motion."""
    kind = MotionLoss if key.rpartition(".")[2] == "to_world" else Loss
    # Not optimised, as Mitsuba's, whose names need it.
    return kind(load_dict(scene, optimize=False), [key], seed=seed, spp=spp, sensor=sensor)


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

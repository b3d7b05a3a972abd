"""Scenes as parts of programs of PyTorch and JAX: images by parameters, with gradients in both directions.

Neither package is needed until one of these is made: then the one that is used must be installed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.description.parameters import SceneParameters, traverse
from djpt.errors import BackendError, ParameterError
from djpt.rendering.gradients.derivatives import propagated
from djpt.rendering.render import render
from djpt.scene.scene import Scene

__all__ = ["jax_function", "torch_module"]

Floats = npt.NDArray[np.float32]


class Rendered:
    """Images of a scene and their derivatives, as functions of NumPy arrays.

    Args:
        scene: What `load_dict` returned. It keeps the parameters of the last image.
        keys: The parameters, by their names in `djpt.traverse`.
        options: Further arguments of `djpt.render`, such as `sensor`, `integrator` and `spp`.

    Raises:
        ParameterError: A parameter is unknown, or has no derivatives.
    """

    def __init__(self, scene: Scene, keys: str | Sequence[str], options: Mapping[str, Any]) -> None:
        self._scene, self._options = scene, dict(options)
        self._params: SceneParameters = traverse(scene)
        self.keys = [keys] if isinstance(keys, str) else list(keys)
        for key in self.keys:
            if not self._params.flags(key).differentiable:
                raise ParameterError(f"{key}: has no derivatives")
        self._types = {key: type(dr.detach(self._params[key])) for key in self.keys}
        self.values = {key: self._value(key) for key in self.keys}
        """The parameters at the start; colours and vectors have the shape (3,), numbers ()."""
        self.shape = tuple(int(n) for n in self.image(list(self.values.values()), 0).shape)
        """The shape of the image, (H, W, C)."""

    def image(self, values: Sequence[Any], seed: int) -> Floats:
        """The image (H, W, C) at some values of the parameters."""
        self._set(values, attached=False)
        return np.array(render(self._scene, self._params, seed=seed, **self._options), np.float32)

    def backward(self, values: Sequence[Any], seed: int, grad: Any) -> list[Floats]:
        """The gradients of a loss by the parameters, from those by the pixels, `grad` (H, W, C)."""
        try:
            image = self._attached(values, seed)
            propagated(image, type(image)(np.ascontiguousarray(grad, np.float32)))
            return [self._flat(key, dr.grad(self._params[key])) for key in self.keys]
        finally:
            self._set(values, attached=False)

    def forward(self, values: Sequence[Any], seed: int, tangents: Sequence[Any]) -> Floats:
        """The derivative of the image (H, W, C) in the direction `tangents`, one for each parameter."""
        try:
            image = self._attached(values, seed)
            for key, tangent in zip(self.keys, tangents, strict=True):
                dr.set_grad(self._params[key], self._typed(key, tangent))
            dr.enqueue(dr.ADMode.Forward, *[self._params[key] for key in self.keys])
            dr.traverse(dr.ADMode.Forward)
            return np.array(dr.grad(image), np.float32)
        finally:
            self._set(values, attached=False)

    def _attached(self, values: Sequence[Any], seed: int) -> Any:
        self._set(values, attached=True)
        return render(self._scene, self._params, seed=seed, **self._options)

    def _set(self, values: Sequence[Any], attached: bool) -> None:
        for key, value in zip(self.keys, values, strict=True):
            self._params[key] = self._typed(key, value)
            if attached:
                dr.enable_grad(self._params[key])
        self._params.update()

    def _typed(self, key: str, value: Any) -> Any:
        kind, array = self._types[key], np.asarray(value, np.float32)
        if dr.is_tensor_v(kind) or dr.depth_v(kind) == 1:
            return kind(np.ascontiguousarray(array if dr.is_tensor_v(kind) else array.ravel()))
        return kind(array.tolist())

    def _value(self, key: str) -> Floats:
        return self._flat(key, dr.detach(self._params[key]))

    def _flat(self, key: str, value: Any) -> Floats:
        array = np.array(value, np.float32)
        if dr.is_tensor_v(value):
            return array
        # Without the axis of lanes where there is one lane.
        return array[..., 0] if array.shape[-1:] == (1,) else array


@contextlib.contextmanager
def needing(package: str) -> Iterator[None]:
    """Say which optional package an import needs.

    Raises:
        BackendError: The package isn't installed.
    """
    try:
        yield
    except ImportError as error:
        raise BackendError(f"'{package}' isn't installed; its own pages say which build suits the machine") from error


def torch_module(scene: Scene, keys: str | Sequence[str], **options: Any) -> Any:
    """A `torch.nn.Module` that renders a scene; its parameters are the scene's.

    ``module(seed=0)`` returns the image, (H, W, C) in single precision on the processor. The module's parameters are
    named after the keys, with ``_`` for ``.``. Reverse mode gives them gradients, so any optimiser of PyTorch finds
    them; `torch.autograd.forward_ad` gives derivatives of the image (the transforms of `torch.func` aren't supported).
    Gradients have samples of their own, as those of `djpt.render` have.

    Args:
        scene: What `load_dict` returned. It keeps the parameters of the last image.
        keys: The parameters, by their names in `djpt.traverse`.
        options: Further arguments of `djpt.render`, such as `sensor`, `integrator` and `spp`.

    Raises:
        BackendError: PyTorch isn't installed.
        ParameterError: A parameter is unknown, or has no derivatives.
    """
    with needing("torch"):
        import torch
    rendered = Rendered(scene, keys, options)

    class Image(torch.autograd.Function):  # type: ignore[misc]
        """The image as an operation of PyTorch."""

        @staticmethod
        def forward(seed: int, *values: Any) -> Any:
            return torch.from_numpy(rendered.image([v.detach().cpu().numpy() for v in values], seed))

        @staticmethod
        def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
            seed, *values = inputs
            ctx.seed, ctx.values = seed, [v.detach().cpu().numpy().copy() for v in values]

        @staticmethod
        def backward(ctx: Any, grad: Any) -> Any:
            found = rendered.backward(ctx.values, ctx.seed, grad.detach().cpu().numpy())
            return None, *(torch.from_numpy(np.ascontiguousarray(g)) for g in found)

        @staticmethod
        def jvp(ctx: Any, _: Any, *tangents: Any) -> Any:
            given = [
                np.zeros_like(value) if tangent is None else tangent.detach().cpu().numpy()
                for value, tangent in zip(ctx.values, tangents, strict=True)
            ]
            return torch.from_numpy(rendered.forward(ctx.values, ctx.seed, given))

    class Module(torch.nn.Module):  # type: ignore[misc]
        """A scene whose parameters PyTorch optimises."""

        def __init__(self) -> None:
            super().__init__()
            self._names = [key.replace(".", "_") for key in rendered.keys]
            for name, value in zip(self._names, rendered.values.values(), strict=True):
                self.register_parameter(name, torch.nn.Parameter(torch.from_numpy(np.array(value))))

        def forward(self, seed: int = 0) -> Any:
            """The image (H, W, C)."""
            return Image.apply(seed, *(getattr(self, name) for name in self._names))

    return Module()


def jax_function(
    scene: Scene, keys: str | Sequence[str], *, mode: str = "reverse", **options: Any
) -> tuple[Callable[..., Any], dict[str, Any]]:
    """A function of JAX that renders a scene, and the parameters to begin with.

    ``image(values, seed=0)`` takes a dictionary of arrays by the keys and returns the image (H, W, C) in single
    precision. It can be used within `jax.jit`, and be differentiated: a function of JAX with rules of its own has those
    of one mode, by default of reverse mode (`jax.grad`, `jax.vjp`); with ``mode="forward"`` those of `jax.jvp`.

    Args:
        scene: What `load_dict` returned. It keeps the parameters of the last image.
        keys: The parameters, by their names in `djpt.traverse`.
        mode: ``reverse`` or ``forward``.
        options: Further arguments of `djpt.render`, such as `sensor`, `integrator` and `spp`.

    Raises:
        BackendError: JAX isn't installed.
        ParameterError: A parameter is unknown, or has no derivatives; or the mode is.
    """
    if mode not in ("reverse", "forward"):
        raise ParameterError(f"'mode' must be 'reverse' or 'forward', found '{mode}'")
    with needing("jax"):
        import jax
    rendered = Rendered(scene, keys, options)
    shape = jax.ShapeDtypeStruct(rendered.shape, np.float32)
    of_parameters = tuple(jax.ShapeDtypeStruct(np.shape(v), np.float32) for v in rendered.values.values())

    def called(function: Callable[..., Any], shapes: Any, *arguments: Any) -> Any:
        return jax.pure_callback(function, shapes, *arguments)

    def primal(values: tuple[Any, ...], seed: Any) -> Any:
        return called(lambda values, seed: rendered.image(values, int(seed)), shape, values, seed)

    if mode == "reverse":
        image = jax.custom_vjp(primal)

        def backward(kept: Any, grad: Any) -> Any:
            values, seed = kept

            def gradients(values: Any, seed: Any, grad: Any) -> Any:
                return tuple(rendered.backward(values, int(seed), np.asarray(grad)))

            return called(gradients, of_parameters, values, seed, grad), None

        image.defvjp(lambda values, seed: (primal(values, seed), (values, seed)), backward)
    else:
        image = jax.custom_jvp(primal)

        def forward(primals: Any, tangents: Any) -> Any:
            (values, seed), (changes, _) = primals, tangents

            def change(values: Any, seed: Any, changes: Any) -> Any:
                return rendered.forward(values, int(seed), [np.asarray(c) for c in changes])

            return primal(values, seed), called(change, shape, values, seed, changes)

        image.defjvp(forward)

    def function(values: Mapping[str, Any], seed: Any = 0) -> Any:
        return image(tuple(jax.numpy.asarray(values[key], np.float32) for key in rendered.keys), np.uint32(seed))

    return function, {key: jax.numpy.asarray(value) for key, value in rendered.values.items()}

"""Scenes in PyTorch and JAX: their gradients, in both directions, are djpt's own."""

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.apps.optimization import jax_function, torch_module
from djpt.apps.optimization.frameworks import Rendered
from djpt.errors import BackendError, ParameterError
from tests.optimization.test_optimize import floor, texture

PAINT, BALL = "paint.reflectance.data", "ball.bsdf.reflectance.value"
TEXELS = np.random.default_rng(0).uniform(0.2, 0.8, (2, 2, 3)).astype(np.float32)
RNG = np.random.default_rng(1)


def scene() -> djpt.Scene:
    return floor(texture(TEXELS))


def own_gradients(weights: np.ndarray) -> list[np.ndarray]:
    """The gradients of the weighted sum of the pixels, by Dr.Jit."""
    loaded = scene()
    params = djpt.traverse(loaded)
    for key in (PAINT, BALL):
        dr.enable_grad(params[key])
    params.update()
    image = djpt.render(loaded, params, spp=4, seed=3)
    dr.backward(dr.sum(image * djpt.TensorXf(weights), axis=None))
    return [np.array(dr.grad(params[PAINT])), np.array(dr.grad(params[BALL])).ravel()]


def test_gradients_and_tangents_are_adjoint() -> None:
    rendered = Rendered(scene(), [PAINT, BALL], {"spp": 4})
    values = list(rendered.values.values())
    weights = RNG.uniform(0, 1, rendered.shape).astype(np.float32)
    changes = [RNG.uniform(-1, 1, np.shape(value)).astype(np.float32) for value in values]
    gradients = rendered.backward(values, 3, weights)
    for mine, own in zip(gradients, own_gradients(weights), strict=True):
        assert np.allclose(mine, own, rtol=1e-4, atol=1e-5)
    along = sum(float(np.sum(g * c)) for g, c in zip(gradients, changes, strict=True))
    assert np.isclose(np.sum(rendered.forward(values, 3, changes) * weights), along, rtol=1e-3)


def test_what_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ParameterError, match="unknown parameter"):
        Rendered(scene(), "paint.reflectence", {})
    with pytest.raises(ParameterError, match="'mode' must be 'reverse' or 'forward'"):
        jax_function(scene(), BALL, mode="backward")
    monkeypatch.setitem(__import__("sys").modules, "torch", None)
    with pytest.raises(BackendError, match="'torch' isn't installed"):
        torch_module(scene(), BALL)


def test_a_module_of_torch() -> None:
    torch = pytest.importorskip("torch")
    module = torch_module(scene(), [PAINT, BALL], spp=4)
    weights = RNG.uniform(0, 1, tuple(module().shape)).astype(np.float32)
    (module(seed=3) * torch.from_numpy(weights)).sum().backward()
    found = [parameter.grad.numpy() for parameter in module.parameters()]
    for mine, own in zip(found, own_gradients(weights), strict=True):
        assert np.allclose(mine, own, rtol=1e-4, atol=1e-5)

    changes = [torch.from_numpy(RNG.uniform(-1, 1, tuple(p.shape)).astype(np.float32)) for p in module.parameters()]
    with torch.autograd.forward_ad.dual_level():
        duals = {
            name: torch.autograd.forward_ad.make_dual(value.detach(), change)
            for (name, value), change in zip(module.named_parameters(), changes, strict=True)
        }
        image = torch.func.functional_call(module, duals, (3,))
        change = torch.autograd.forward_ad.unpack_dual(image).tangent
    along = sum((g * c.numpy()).sum() for g, c in zip(found, changes, strict=True))
    assert np.isclose((change.numpy() * weights).sum(), along, rtol=1e-3)

    optimizer = torch.optim.Adam(module.parameters(), lr=0.1)
    target = module(seed=9).detach()
    with torch.no_grad():
        getattr(module, PAINT.replace(".", "_")).fill_(0.2)
    losses = []
    for step in range(8):
        optimizer.zero_grad()
        loss = (module(seed=step) - target).square().mean()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.5 * losses[0]


def test_a_function_of_jax() -> None:
    jax = pytest.importorskip("jax")
    image, start = jax_function(scene(), [PAINT, BALL], spp=4)
    weights = RNG.uniform(0, 1, image(start).shape).astype(np.float32)
    found = jax.jit(jax.grad(lambda values: (image(values, 3) * weights).sum()))(start)
    for mine, own in zip((found[PAINT], found[BALL]), own_gradients(weights), strict=True):
        assert np.allclose(mine, own, rtol=1e-4, atol=1e-5)

    ahead, start = jax_function(scene(), [PAINT, BALL], mode="forward", spp=4)
    changes = {key: RNG.uniform(-1, 1, value.shape).astype(np.float32) for key, value in start.items()}
    _, change = jax.jvp(lambda values: ahead(values, 3), (start,), (changes,))
    along = sum(float((found[key] * changes[key]).sum()) for key in start)
    assert np.isclose(float((change * weights).sum()), along, rtol=1e-3)

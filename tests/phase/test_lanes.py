"""Phase functions per lane, their derivatives, and those of users."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.description.plugin import Plugin
from djpt.dispatch.ensemble import Attached, Detached, Ensemble
from djpt.dispatch.family import Family
from djpt.jit.types import Float, Point2f, UInt32, Vector3f
from djpt.phase.pointer import PhaseFunctionPtr
from djpt.validation.gradcheck.losses import quotient
from tests.kit.arrays import floats, in_numpy
from tests.kit.kernels import kernels
from tests.kit.phases import described, directions, interaction

CTX = djpt.PhaseFunctionContext()
NAMES = ["forward", "isotropic", "backward", "table", "skewed", "blend", "gap", "sheets", "rayleigh"]
LANES = 90


def all_of_them() -> tuple[list[Any], PhaseFunctionPtr]:
    """Some phase functions, and a pointer to one after the other."""
    phases = [djpt.load_dict(described(name)) for name in NAMES]
    family = Family(Ensemble(phases), Detached())
    return phases, PhaseFunctionPtr.into(family, dr.arange(UInt32, LANES) % len(NAMES))


def test_each_lane_asks_its_own() -> None:
    phases, pointers = all_of_them()
    mei, wo = interaction(djpt, directions(LANES, 1)), Vector3f(directions(LANES, 2))
    u = np.random.default_rng(3).random((3, LANES), dtype=np.float32)
    sample1, sample2 = floats(u[0]), Point2f(floats(u[1]), floats(u[2]))
    found = [*pointers.eval_pdf(CTX, mei, wo), *pointers.sample(CTX, mei, sample1, sample2)]
    both = pointers.eval_pdf_sample(CTX, mei, wo, sample1, sample2)
    areas, most = pointers.projected_area(mei), pointers.max_projected_area()
    for number, phase in enumerate(phases):
        mine = np.arange(LANES) % len(phases) == number
        expected = [*phase.eval_pdf(CTX, mei, wo), *phase.sample(CTX, mei, sample1, sample2)]
        for result, again, wanted in zip(found, both, expected, strict=True):
            wanted = np.broadcast_to(in_numpy(wanted + 0 * sample1), in_numpy(result).shape)
            np.testing.assert_allclose(in_numpy(result)[..., mine], wanted[..., mine], rtol=1e-5, atol=1e-6)
            np.testing.assert_allclose(in_numpy(again)[..., mine], wanted[..., mine], rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(in_numpy(areas)[mine], in_numpy(phase.projected_area(mei) + 0 * sample1)[mine])
        np.testing.assert_allclose(in_numpy(most)[mine], phase.max_projected_area()[0])
        assert set(np.array(pointers.flags())[mine]) == {phase.flags()}
        assert set(np.array(pointers.component_count())[mine]) == {phase.component_count()}


def test_instances_of_a_class_are_traced_once() -> None:
    phases = [djpt.load_dict({"type": "hg", "g": 0.1 * k}) for k in range(5)]
    assert len(Ensemble(phases).groups) == 1


def test_an_edit_compiles_nothing() -> None:
    phase = djpt.load_dict({"type": "tabphase", "values": [1, 2, 0.5, 3]})
    family = Family(Ensemble([phase, djpt.load_dict({"type": "hg"})]), Detached())
    params = djpt.traverse(phase)

    def ask(values: list[float]) -> Any:
        params["values"] = values
        params.update()
        family.lookup.forget()
        pointers = PhaseFunctionPtr.into(family, dr.arange(UInt32, 16) % 2)
        dr.eval(pointers.sample(CTX, interaction(djpt, directions(16, 1)), Float(0.3), Point2f(0.2, 0.6)))

    ask([1, 2, 3, 4])
    known = kernels(lambda: ask([1, 2, 3, 5]))
    assert known and kernels(lambda: ask([4, 3, 2, 1])) <= known


PARAMETERS: list[tuple[str, str, list[float]]] = [
    ("forward", "g", [0.4]),
    ("backward", "g", [-0.5]),
    ("blend", "weight.value.value", [0.4]),
    ("blend", "phase_0.g", [0.4]),
    ("gap", "values", [0.5, 1, 2, 3, 0.2, 0.7, 4]),
    ("skewed", "S.data", [0.5, 0.35, 0.32, 0.1, 0.14, 0.2]),
]


def assigned(params: Any, key: str, numbers: np.ndarray) -> None:
    """Set a parameter from numbers in any shape."""
    kind = type(params[key])
    flat = kind(Float(numbers.astype(np.float32)), params[key].shape) if dr.is_tensor_v(kind) else None
    params[key] = kind(Float(numbers.astype(np.float32))) if flat is None else flat
    params.update()


@pytest.mark.sparse(3)
@pytest.mark.parametrize("attached", [False, True])
@pytest.mark.parametrize(("name", "key", "numbers"), PARAMETERS)
def test_derivatives_by_parameters(name: str, key: str, numbers: list[float], attached: bool) -> None:
    """The gradient of values, summed up with weights, against central differences in all directions."""
    at = np.array(numbers)
    phase = djpt.load_dict(described(name))
    params = djpt.traverse(phase)
    mei, wo = interaction(djpt, directions(64, 1)), Vector3f(directions(64, 2))
    shares = floats(np.random.default_rng(5).random(64))

    def value() -> Any:
        if not attached:
            return dr.sum(phase.eval_pdf(CTX, mei, wo)[0].x * shares)
        family = Family(Ensemble([phase]), Attached(leaves(phase)))
        return dr.sum(PhaseFunctionPtr.into(family, UInt32(0)).eval_pdf(CTX, mei, wo)[0].x * shares)

    assigned(params, key, at)
    dr.enable_grad(params[key])
    params.update()
    dr.backward(value())
    gradient = np.array(dr.grad(params[key])).ravel()
    dr.disable_grad(params[key])

    def moved(x: float, axis: np.ndarray) -> float:
        assigned(params, key, at + x * axis)
        return dr.detach(value())[0]

    slopes = [quotient(lambda x, axis=axis: moved(x, axis), 2e-3) for axis in np.eye(len(at))]
    np.testing.assert_allclose(gradient, slopes, rtol=1e-2, atol=2e-3 * np.abs(slopes).max())


def leaves(plugin: Plugin) -> dict[tuple[int, str], Any]:
    """The values and tables of a plugin and of those within it that have gradients."""
    found = {
        (id(plugin), name): getattr(plugin, name)
        for name in (*plugin.values, *plugin.tables)
        if dr.grad_enabled(getattr(plugin, name))
    }
    for name in plugin.children:
        child = getattr(plugin, name)
        if isinstance(child, Plugin):
            found |= leaves(child)
    return found


def test_weights_of_samples_carry_the_derivative_of_the_value() -> None:
    phase = djpt.load_dict({"type": "hg", "g": 0.5})
    mei, u = interaction(djpt, [0, 0, 1]), Point2f(0.3, 0.8)
    wo = phase.sample(CTX, mei, Float(0.5), u)[0]
    expected = dr.detach(phase.eval_pdf(CTX, mei, wo)[0].x)[0]
    dr.enable_grad(phase.g)
    pointers = PhaseFunctionPtr.into(Family(Ensemble([phase]), Attached(leaves(phase))), UInt32(0))
    found, weight, pdf = pointers.sample(CTX, mei, Float(0.5), u)
    assert not dr.grad_enabled(found, pdf)
    value = phase.eval_pdf(CTX, mei, wo)[0].x
    dr.forward_from(phase.g)
    assert weight.x == 1
    assert abs(dr.grad(weight.x)[0] - dr.grad(value)[0] / expected) < 1e-4


def test_a_users_own_phase_function() -> None:
    """As in a script for Mitsuba: nothing is declared, numbers and lists are returned."""

    class Sheet(djpt.PhaseFunction):
        def __init__(self, props: Any) -> None:
            djpt.PhaseFunction.__init__(self, props)
            self.m_flags = djpt.PhaseFunctionFlags.Anisotropic
            self.share = djpt.Float(props["share"])

        def traverse(self, callback: Any) -> None:
            callback.put("share", self.share, djpt.ParamFlags.Differentiable)

        def sample(self, ctx: Any, mei: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            active &= sample1 < self.share
            wo = djpt.warp.square_to_uniform_sphere(sample2)
            return wo, dr.select(active, self.share, 0), 1 / (4 * np.pi)

        def eval_pdf(self, ctx: Any, mei: Any, wo: Any, active: Any = True) -> Any:
            return self.share / (4 * np.pi), 1 / (4 * np.pi)

    djpt.register_phase("sheet", Sheet)
    sheets = [djpt.load_dict({"type": "sheet", "share": share}) for share in (0.25, 0.75)]
    family = Family(Ensemble(sheets), Detached())
    assert len(family.ensemble.groups) == 1
    pointers = PhaseFunctionPtr.into(family, UInt32([0, 1]))
    value, pdf = pointers.eval_pdf(CTX, interaction(djpt, [0, 0, 1]), Vector3f(0, 0, 1))
    np.testing.assert_allclose(in_numpy(value.y / pdf), [0.25, 0.75], rtol=1e-6)
    _, weight, _ = pointers.sample(CTX, interaction(djpt, [0, 0, 1]), Float(0.5), Point2f(0.1, 0.2))
    np.testing.assert_allclose(in_numpy(weight.x), [0, 0.75])
    assert sheets[0].component_count() == 1 and sheets[0].flags() == djpt.PhaseFunctionFlags.Anisotropic
    assert list(djpt.traverse(sheets[0]).keys()) == ["share"]


def test_what_is_asked_together_has_the_derivatives_of_what_is_asked_alone() -> None:
    """`eval_pdf_sample`, whose dispatch is by branches, of directions that turn."""
    found = []
    for together in (False, True):
        _, pointers = all_of_them()
        angle = Float(0)
        dr.enable_grad(angle)
        mei = interaction(djpt, directions(LANES, 1))
        wo = djpt.Transform4f().rotate([0.6, 0, 0.8], angle) @ Vector3f(directions(LANES, 2))
        if together:
            value = pointers.eval_pdf_sample(CTX, mei, wo, Float(0.5), Point2f(0.5, 0.4))[0]
        else:
            value = pointers.eval_pdf(CTX, mei, wo)[0]
        dr.forward(angle)
        found.append(in_numpy(dr.grad(value)))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-4, atol=1e-7)
    assert np.abs(found[0]).max() > 1e-3

"""Volumes: what they are at a point, as in Mitsuba; single entries; derivatives by the point and by the numbers."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import RenderError
from djpt.jit.types import Color3f, Float, Point3f, TensorXf
from tests.kit.arrays import floats, in_numpy, rows
from tests.kit.same_calls import same

COUNT = 400
POINTS = np.random.default_rng(1).uniform(-1.5, 2.5, (3, COUNT)).astype(np.float32)


def grid(channels: int, module: Any = djpt, **keys: Any) -> Any:
    """A turned and stretched grid of random numbers."""
    numbers = np.random.default_rng(channels).random((5, 4, 3, channels), dtype=np.float32)
    turned = module.ScalarTransform4f().translate([0.1, 0.2, 0.3]).rotate([0.6, 0, 0.8], 40).scale([2, 1, 0.5])
    return module.load_dict(
        {"type": "gridvolume", "data": module.TensorXf(numbers), "raw": True, "to_world": turned, **keys}
    )


def at(points: np.ndarray, module: Any = djpt) -> Any:
    """Interactions at some points."""
    it = dr.zeros(module.Interaction3f, points.shape[1])
    it.p = module.Point3f(points)
    return it


METHODS = {
    1: ["eval", "eval_1", "eval_n"],
    3: ["eval", "eval_1", "eval_3", "eval_n"],
    6: ["eval_1", "eval_6", "eval_n"],
}


@pytest.mark.sparse(8)
@pytest.mark.parametrize("channels", METHODS)
@pytest.mark.parametrize("filter_type", ["trilinear", "nearest"])
@pytest.mark.parametrize("wrap_mode", ["clamp", "repeat", "mirror"])
def test_lookups_are_mitsubas(mi: Any, channels: int, filter_type: str, wrap_mode: str) -> None:
    def ask(module: Any) -> Any:
        volume = grid(channels, module, filter_type=filter_type, wrap_mode=wrap_mode)
        return [getattr(volume, method)(at(POINTS, module)) for method in METHODS[channels]]

    same(ask, mi, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("channels", METHODS)
def test_questions_are_answered_as_in_mitsuba(mi: Any, channels: int) -> None:
    mine, his = grid(channels), grid(channels, mi)
    for corner in ("min", "max"):
        np.testing.assert_allclose(*(np.array(getattr(volume.bbox(), corner)) for volume in (mine, his)), atol=1e-6)
    assert list(mine.resolution()) == list(his.resolution()) == [3, 4, 5]
    assert mine.channel_count() == his.channel_count() == channels
    assert abs(mine.max() - his.max()) < 1e-6
    np.testing.assert_allclose(mine.max_per_channel(), np.array(mine.data).reshape(-1, channels).max(0))
    flat = np.array(mine.data).reshape(-1, channels).mean(0)
    middle = {1: flat[0], 3: flat @ [0.212671, 0.71516, 0.072169] if channels == 3 else 0, 6: flat.mean()}[channels]
    assert abs(mine.mean()[0] - middle) < 1e-4
    assert grid(channels, max_value=7.0).max() == grid(channels, mi, max_value=7.0).max() == 7


VALUES: list[Any] = [0.3, {"type": "rgb", "value": [0.1, 0.2, 0.6]}]


@pytest.mark.parametrize("value", VALUES)
def test_constants_are_mitsubas(mi: Any, value: Any) -> None:
    def ask(module: Any) -> Any:
        volume = module.load_dict({"type": "constvolume", "value": value})
        it = dr.zeros(module.Interaction3f)
        return volume.eval(it), volume.eval_1(it), volume.max(), list(volume.resolution()), volume.channel_count()

    same(ask, mi)


@pytest.mark.sparse(3)
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("wrap_mode", ["clamp", "repeat", "mirror"])
@pytest.mark.parametrize("filter_type", ["trilinear", "nearest"])
def test_picked_entries_have_the_right_mean(channels: int, wrap_mode: str, filter_type: str) -> None:
    """An integral over the uniform number: it has eight pieces, on which the entry is constant."""
    volume = grid(channels, wrap_mode=wrap_mode, filter_type=filter_type)
    count = 2**16
    u = floats((np.arange(count) + 0.5) / count)
    for k in range(6):
        it = at(POINTS[:, k : k + 1])
        found, exact = volume.pick(it, u), volume.eval(it)
        for a, b in zip(found, exact, strict=True):
            assert abs(dr.mean(a)[0] - b[0]) < 1e-3
        assert abs(dr.mean(volume.pick_1(it, u))[0] - volume.eval_1(it)[0]) < 1e-3
        entries = set(np.array(volume.data).ravel().tolist())
        assert {x for channel in found for x in np.array(channel).tolist()} <= entries


@pytest.mark.parametrize("wrap_mode", ["clamp", "repeat", "mirror"])
@pytest.mark.parametrize("counts", [(1, 1, 1), (2, 3, 2), (5, 4, 7)])
def test_cells_are_bounded_by_their_maxima(wrap_mode: str, counts: tuple[int, int, int]) -> None:
    volume = grid(1, wrap_mode=wrap_mode)
    maxima = volume.cell_maxima(counts)
    assert maxima.shape == counts[::-1] and maxima.max() == np.float32(volume.max())
    local = np.random.default_rng(4).random((3, 4000))
    found = in_numpy(volume.eval_1(at(volume.to_world.transform_point(local.T).T.astype(np.float32))))
    x, y, z = (local * np.array(counts)[:, None]).astype(int)
    assert (found <= maxima[z, y, x] + 1e-5).all()
    if counts == (1, 1, 1):
        return
    largest = np.zeros_like(maxima)
    np.maximum.at(largest, (z, y, x), found)
    assert (largest > 0.4 * maxima).mean() > 0.8, "the bounds are wide"


@pytest.mark.parametrize("wrap_mode", ["clamp", "repeat"])
def test_derivatives_by_the_point(wrap_mode: str) -> None:
    volume = grid(1, wrap_mode=wrap_mode)
    value, gradient = volume.eval_gradient(at(POINTS))
    np.testing.assert_allclose(in_numpy(value.x), in_numpy(volume.eval_1(at(POINTS))))
    p = Point3f(*rows(POINTS))
    for k in range(3):
        moved = Point3f(p)
        dr.enable_grad(moved)
        it = dr.zeros(djpt.Interaction3f, COUNT)
        it.p = moved
        dr.set_grad(moved, Point3f(*(float(k == c) for c in range(3))))
        slope = dr.forward_to(volume.eval_1(it))
        np.testing.assert_allclose(in_numpy(gradient[k]), in_numpy(slope), atol=2e-5)
    assert not dr.any(grid(1, filter_type="nearest").eval_gradient(at(POINTS))[1] != 0, axis=None)
    constant = djpt.load_dict({"type": "constvolume", "value": 0.5}).eval_gradient(at(POINTS))
    assert constant[0].x == 0.5 and constant[1].x == 0


@pytest.mark.parametrize("channels", METHODS)
def test_derivatives_by_the_numbers(channels: int) -> None:
    """Lookups are linear in the numbers: the gradient is the same at any of them."""
    volume = grid(channels)
    params = djpt.traverse(volume)
    start = np.array(params["data"])
    change = np.random.default_rng(8).random(start.shape).astype(np.float32)
    shares = floats(np.random.default_rng(9).random(COUNT))

    def total() -> Any:
        return sum((dr.sum(x * shares) for x in volume.eval_n(at(POINTS))), Float(0))

    dr.enable_grad(params["data"])
    params.update()
    dr.backward(total())
    slope = float((np.array(dr.grad(params["data"])) * change).sum())
    params["data"] = TensorXf(start + change)
    params.update()
    after = total()[0]
    params["data"] = TensorXf(start)
    params.update()
    assert abs(after - total()[0] - slope) < 1e-3 * abs(slope)


def test_edits_move_and_refine_a_grid() -> None:
    volume = djpt.load_dict({"type": "gridvolume", "data": np.ones((2, 2, 2))})
    params = djpt.traverse(volume)
    assert list(params.keys()) == ["data", "to_world"]
    params["data"] = np.arange(24, dtype=np.float32).reshape(4, 3, 2)
    params["to_world"] = djpt.ScalarTransform4f().scale(2)
    params.update()
    assert list(volume.resolution()) == [2, 3, 4] and volume.max() == 23
    assert list(volume.bbox().max) == [2, 2, 2]
    corner = dr.zeros(djpt.Interaction3f)
    corner.p = Point3f(2)
    assert volume.eval_1(corner) == 23
    assert volume.is_grey and not volume.is_constant


def test_what_a_volume_does_not_have() -> None:
    it = dr.zeros(djpt.Interaction3f)
    with pytest.raises(RenderError, match="has 1 channels, not 3"):
        grid(1).eval_3(it)
    with pytest.raises(RenderError, match="has 3 channels, not 6"):
        grid(3).eval_6(it)
    with pytest.raises(RenderError, match="has six channels, which are no colour"):
        grid(6).eval(it)
    with pytest.raises(RenderError, match="'ConstVolume' has no six numbers"):
        djpt.load_dict({"type": "constvolume"}).eval_6(it)


def test_places_without_numbers_read_nothing() -> None:
    """No coordinate whatsoever leads out of memory."""
    for wrap_mode in ("clamp", "repeat", "mirror"):
        volume = grid(1, wrap_mode=wrap_mode)
        for number in (dr.nan, dr.inf, -dr.inf, 3e38):
            it = dr.zeros(djpt.Interaction3f)
            it.p = Point3f(number)
            with dr.scoped_set_flag(dr.JitFlag.Debug):
                dr.eval(volume.pick_1(it, Float(0.5)), volume.eval_1(it))


def test_a_users_own_volume() -> None:
    class Ramp(djpt.Volume):
        def __init__(self, props: Any) -> None:
            djpt.Volume.__init__(self, props)
            self.slope = djpt.Float(props["slope"])

        def eval(self, it: Any, active: Any = True) -> Any:
            return self.slope * it.p.x

        def eval_1(self, it: Any, active: Any = True) -> Any:
            return self.slope * it.p.x

    djpt.register_volume("ramp", Ramp)
    blend = djpt.load_dict(
        {"type": "blendphase", "weight": {"type": "ramp", "slope": 2}, "a": {"type": "isotropic"}, "b": {"type": "hg"}}
    )
    mei = djpt.MediumInteraction3f()
    mei.p, mei.wi = [0.25, 0, 0], [0, 0, 1]
    ctx = djpt.PhaseFunctionContext()
    parts = [phase.eval_pdf(ctx, mei, [0, 0, -1])[1] for phase in (blend.phase_0, blend.phase_1)]
    assert dr.allclose(blend.eval_pdf(ctx, mei, [0, 0, -1])[1], dr.lerp(*parts, 0.5))
    assert type(blend.weight.eval(mei)) is Color3f

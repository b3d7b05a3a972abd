"""Textures: lookups as in Mitsuba, parameters, ranges, derivatives, and what an edit costs."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.dispatch.ensemble import Detached, Ensemble
from djpt.jit.types import Float, Point2f, UInt32
from djpt.validation import to_mitsuba
from djpt.validation.gradcheck.losses import quotient
from tests.kit.renders import ours, theirs
from tests.kit.textured_room import TURNED, bitmap, close, room, texels

PLANES: dict[str, Any] = {"whole": T(), "repeated": T().scale([3, -2, 1]), "turned": TURNED}


class Places:
    """Points with texture coordinates, far beyond the unit square as well, and on its edges."""

    def __init__(self, count: int = 3000) -> None:
        random = np.random.default_rng(1)
        edges = [[0, 0], [1, 1], [0.5, 0.5], [0, 1], [-1, 2], [0.25, 0.75], [-0.5, 1.5], [-2.25, 3.75]]
        points = [random.uniform(-4, 5, (count, 2)), random.uniform(-0.02, 1.02, (count, 2)), edges]
        self.points = np.concatenate(points).astype(np.float32)
        self.uv = self.moved(0, 0)

    def moved(self, du: float, dv: float) -> Point2f:
        u, v = (self.points + np.float32([du, dv])).T
        return Point2f(Float(np.ascontiguousarray(u)), Float(np.ascontiguousarray(v)))

    def theirs(self, mi: Any) -> Any:
        si = dr.zeros(mi.SurfaceInteraction3f, len(self.points))
        si.uv = mi.Point2f(self.uv)
        return si


class At:
    """All that textures ask of a surface point."""

    def __init__(self, uv: Point2f) -> None:
        self.uv = uv


def in_kernel(texture: Any, method: str, si: Any) -> Any:
    """What a method returns if it is called as kernels do: on a representative."""
    ensemble, lookup = Ensemble([texture]), Detached()
    lookup.prepare(ensemble.leaves())
    return ensemble.call(UInt32(0), lookup, lambda plugin: getattr(plugin, method)(si), None)


# ---------------------------------------------------------------- lookups


@pytest.mark.sparse(3)
@pytest.mark.parametrize("shape", [(4, 5, 3), (7, 2, 1), (1, 6, 3), (1, 1, 1)], ids=str)
@pytest.mark.parametrize("wrap_mode", ["repeat", "mirror", "clamp"])
@pytest.mark.parametrize("filter_type", ["bilinear", "nearest"])
def test_bitmap_lookups_are_mitsubas(filter_type: str, wrap_mode: str, shape: tuple[int, ...], mi: Any) -> None:
    places = Places()
    description = bitmap(texels(*shape), filter_type=filter_type, wrap_mode=wrap_mode)
    mine, reference = djpt.load_dict(description), mi.load_dict(description)
    for method in ("eval", "eval_1", "eval_1_grad"):
        expected = np.array(getattr(reference, method)(places.theirs(mi)))
        found = np.array(in_kernel(mine, method, At(places.uv)))
        np.testing.assert_allclose(found, expected, atol=2e-6)
        np.testing.assert_array_equal(np.array(getattr(mine, method)(At(places.uv))), found)
    np.testing.assert_allclose(mine.mean()[0], reference.mean()[0], atol=1e-6)


@pytest.mark.parametrize("plane", PLANES)
def test_to_uv_maps_as_in_mitsuba(plane: str, mi: Any) -> None:
    places, transform = Places(), PLANES[plane]
    square = texels(5, 5, 3)
    mine = djpt.load_dict(bitmap(square, to_uv=transform))
    reference = mi.load_dict(bitmap(square, to_uv=mi.ScalarTransform4f(transform.matrix.tolist())))
    for method, tolerance in (("eval", 2e-5), ("eval_1_grad", 2e-4)):
        found = np.array(in_kernel(mine, method, At(places.uv)))
        np.testing.assert_allclose(found, np.array(getattr(reference, method)(places.theirs(mi))), atol=tolerance)


def test_three_by_three_matrices_are_maps_of_uv_too(mi: Any) -> None:
    flat = TURNED.matrix[np.ix_([0, 1, 3], [0, 1, 3])]
    images = []
    for transform in (TURNED, flat, flat.tolist(), mi.ScalarTransform3f(flat.tolist())):
        texture = djpt.load_dict(bitmap(texels(3, 4, 3), to_uv=transform))
        images.append(np.array(texture.eval(At(Places(50).uv))))
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])
    squashed = djpt.load_dict(bitmap(texels(3, 4, 3), to_uv=np.diag([0.0, 0.0, 1.0])))
    assert np.ptp(np.array(squashed.eval(At(Places(50).uv))), axis=1).max() == 0


def test_gradients_by_uv_are_finite_differences() -> None:
    # Mitsuba 3.9.1 mixes up the axes of bitmaps that aren't square if to_uv turns them.
    places = Places()
    texture = djpt.load_dict(bitmap(texels(4, 6, 3), to_uv=TURNED))
    found = np.array(texture.eval_1_grad(At(places.uv)))

    def value(du: float, dv: float) -> np.ndarray:
        return np.array(texture.eval_1(At(places.moved(du, dv))), np.float64)

    slopes = np.stack([quotient(lambda x: value(x, 0), 1e-3), quotient(lambda x: value(0, x), 1e-3)])
    # Near the lines through texel centres both sides count.
    assert np.mean(np.abs(found - slopes) > 5e-3) < 0.05


def test_rows_run_with_v_and_columns_with_u() -> None:
    data = np.arange(12, dtype=np.float32).reshape(3, 4) / 12
    texture = djpt.load_dict({"type": "bitmap", "data": data})
    row, column = np.mgrid[:3, :4]
    centres = Point2f(*(Float(x.ravel().astype(np.float32)) for x in ((column + 0.5) / 4, (row + 0.5) / 3)))
    np.testing.assert_allclose(np.array(texture.eval_1(At(centres))), data.ravel(), atol=1e-6)


@pytest.mark.parametrize("wrap_mode", ["repeat", "mirror", "clamp"])
@pytest.mark.parametrize("filter_type", ["bilinear", "nearest"])
def test_no_uv_leads_out_of_memory(filter_type: str, wrap_mode: str) -> None:
    wild = Float([np.nan, np.inf, -np.inf, 1e38, -1e38, 3e9, -3e9, 16777217.0, 1 - 2**-24])
    texture = djpt.load_dict(bitmap(np.ones((3, 5, 3), np.float32), filter_type=filter_type, wrap_mode=wrap_mode))
    with dr.scoped_set_flag(dr.JitFlag.Debug):  # checks all addresses
        for uv in (Point2f(wild, 0.5), Point2f(0.5, wild), Point2f(wild, wild)):
            np.testing.assert_array_equal(np.array(texture.eval(At(uv))), 1)


@pytest.mark.parametrize(("filter_type", "count"), [("nearest", 1), ("bilinear", 4)])
def test_texels_are_loaded_by_packets(filter_type: str, count: int) -> None:
    if not djpt.variant().startswith("llvm"):
        pytest.skip("reads LLVM's code")
    texture = djpt.load_dict(bitmap(texels(8, 8, 3), filter_type=filter_type))
    uv = Places(10).uv
    dr.eval(uv)
    color = in_kernel(texture, "eval", At(uv))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        dr.eval(color)
        (code,) = (k["ir"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT)
    calls = [line for line in code.getvalue().splitlines() if "gather" in line and "call" in line]
    assert len(calls) == count
    assert all("gather_4x" in line for line in calls)


def test_a_scalar_bitmap_is_grey(mi: Any) -> None:
    texture = djpt.load_dict(bitmap(texels(3, 4, 1)))
    color = np.array(in_kernel(texture, "eval", At(Places(100).uv)))
    assert color.shape[0] == 3
    np.testing.assert_array_equal(color[0], color[2])
    np.testing.assert_array_equal(color[0], np.array(in_kernel(texture, "eval_1", At(Places(100).uv))))


# ---------------------------------------------------------------- checkerboards


@pytest.mark.parametrize("plane", PLANES)
def test_checkerboards_are_mitsubas(plane: str, mi: Any) -> None:
    places, transform = Places(), PLANES[plane]
    colors = {"color0": {"type": "rgb", "value": [0.9, 0.5, 0.1]}, "color1": 0.25}
    mine = djpt.load_dict({"type": "checkerboard", **colors, "to_uv": transform})
    described = {"type": "checkerboard", **colors, "to_uv": mi.ScalarTransform4f(transform.matrix.tolist())}
    expected = np.array(mi.load_dict(described).eval(places.theirs(mi)))
    found = np.array(in_kernel(mine, "eval", At(places.uv)))
    # The edges may move by a rounding.
    assert np.mean(np.abs(found - expected).max(axis=0) > 1e-6) < 2e-3


@pytest.mark.parametrize("plane", PLANES)
def test_scalars_of_checkerboards_are_mitsubas(plane: str, mi: Any) -> None:
    places = Places()
    inner = {"type": "checkerboard", "color0": 0.1, "color1": 0.9, "to_uv": T().scale(3)}
    outer = {"type": "checkerboard", "color0": inner, "color1": 0.5, "to_uv": PLANES[plane]}
    mine = djpt.load_dict(outer)
    theirs = mi.load_dict(to_mitsuba({"t": outer})["t"])
    expected = np.array(theirs.eval_1(places.theirs(mi)))
    assert len(np.unique(expected)) == 3
    # The edges may move by a rounding.
    assert np.mean(np.abs(np.array(in_kernel(mine, "eval_1", At(places.uv))) - expected) > 1e-6) < 2e-3


def test_scalars_of_a_checkerboard_have_its_colours_exchanged() -> None:
    texture = djpt.load_dict({"type": "checkerboard", "color0": 1.0, "color1": 0.0})
    uv = At(Places(500).uv)
    np.testing.assert_allclose(np.array(texture.eval_1(uv)), 1 - np.array(texture.eval(uv))[0], atol=1e-6)
    quarter = At(Point2f(Float([0.25, 0.75, 0.75, -0.25]), Float([0.25, 0.25, 0.75, 0.25])))
    np.testing.assert_allclose(np.array(texture.eval_1(quarter)), [0, 1, 0, 1], atol=1e-6)
    np.testing.assert_allclose(texture.mean()[0], 0.5, atol=1e-6)
    np.testing.assert_array_equal(np.array(texture.eval_1_grad(quarter)), 0)


def test_scalars_of_colours_are_mitsubas(mi: Any) -> None:
    rgb = {"type": "rgb", "value": [0.9, 0.3, 0.1]}
    expected = mi.load_dict(rgb).eval_1(dr.zeros(mi.SurfaceInteraction3f, 1))[0]
    np.testing.assert_allclose(djpt.load_dict(rgb).eval_1(None)[0], expected, rtol=1e-6)


# What a BSDF reads as a scalar.
SCALARS = {
    "roughness": lambda texture: {"type": "roughconductor", "alpha": texture},
    "principled": lambda texture: {"type": "principled", "roughness": texture, "metallic": 0.5},
    "weight": lambda texture: {
        "type": "blendbsdf",
        "weight": texture,
        "a": {"type": "diffuse", "reflectance": 0.1},
        "b": {"type": "diffuse", "reflectance": 0.9},
    },
    "opacity": lambda texture: {"type": "mask", "opacity": texture, "nested": {"type": "diffuse"}},
}


@pytest.mark.parametrize("name", SCALARS)
@pytest.mark.sparse(4)
def test_materials_with_checkered_scalars_are_mitsubas(name: str) -> None:
    pytest.importorskip("mitsuba")
    checks = {"type": "checkerboard", "color0": 0.15, "color1": 0.7, "to_uv": T().scale(4)}
    scene = room(0.5, environment={"type": "constant", "radiance": 0.3})
    scene["floor"]["bsdf"] = SCALARS[name](checks)
    assert close(ours(scene, 8), theirs(scene, 8)) > 0.98


def test_checkerboards_nest_bitmaps_and_checkerboards() -> None:
    inner = bitmap(texels(4, 4, 3), to_uv=T().scale([2, 2, 1]))
    nested = {"type": "checkerboard", "color0": inner, "color1": {"type": "checkerboard", "to_uv": T().scale(4)}}
    texture, pixels, second = (djpt.load_dict(d) for d in (nested, inner, nested["color1"]))
    places = Places(300)
    u, v = places.points.T
    first = ((u % 1) > 0.5) == ((v % 1) > 0.5)
    expected = np.where(first, *(np.array(t.eval(At(places.uv))) for t in (pixels, second)))
    np.testing.assert_array_equal(np.array(in_kernel(texture, "eval", At(places.uv))), expected)
    assert list(djpt.traverse(texture)) == [
        "to_uv", "color0.data", "color0.to_uv", "color1.to_uv", "color1.color0.value", "color1.color1.value"
    ]  # fmt: skip

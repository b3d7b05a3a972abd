"""Textures: lookups as in Mitsuba, parameters, ranges, derivatives, and what an edit costs."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.dispatch.ensemble import Detached, Ensemble
from djpt.errors import ParameterError, SceneError
from djpt.transforms import ScalarTransform4f as T
from djpt.types import Float, Point2f, TensorXf, UInt32
from djpt.validation import to_mitsuba
from tests.kit.mesh_scenes import ball, kernels
from tests.kit.renders import ours, theirs

TURNED = T().rotate([0, 0, 1], 30).scale([2, 3, 1]).translate([0.1, 0.2, 7])
PLANES: dict[str, Any] = {"whole": T(), "repeated": T().scale([3, -2, 1]), "turned": TURNED}


@pytest.fixture(scope="module")
def mi() -> Any:
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("llvm_ad_rgb")
    return mitsuba


def texels(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.1, 0.9, shape).astype(np.float32)


def bitmap(data: Any, **keys: Any) -> dict[str, Any]:
    """In both renderers' words: Mitsuba wants a tensor."""
    return {"type": "bitmap", "data": TensorXf(data), "raw": True, **keys}


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
    places, h = Places(), 1e-3
    texture = djpt.load_dict(bitmap(texels(4, 6, 3), to_uv=TURNED))
    found = np.array(texture.eval_1_grad(At(places.uv)))

    def value(du: float, dv: float) -> np.ndarray:
        return np.array(texture.eval_1(At(places.moved(du, dv))), np.float64)

    slopes = np.stack([value(h, 0) - value(-h, 0), value(0, h) - value(0, -h)]) / (2 * h)
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


# ---------------------------------------------------------------- in scenes


def room(floor: Any, wall: Any = 0.5, integrator: str = "path", **nodes: Any) -> dict[str, Any]:
    """A textured floor under a ball, a lamp above them."""
    camera = T().look_at(origin=[0, -3, 3], target=[0, 0, 0], up=[0, 0, 1])
    film = {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}}
    return {
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": 4},
        "sensor": {"type": "perspective", "fov": 40, "to_world": camera, "film": film},
        "floor": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": floor}},
        "ball": {
            "type": "sphere", "radius": 0.5, "center": [0, 0, 0.5],
            "bsdf": {"type": "twosided", "inner": {"type": "diffuse", "reflectance": wall}},
        },
        "lamp": {
            "type": "rectangle", "to_world": T().translate([0, 0, 4]).rotate([1, 0, 0], 180),
            "emitter": {"type": "area", "radiance": 4.0},
        },
        **nodes,
    }  # fmt: skip


def close(image: np.ndarray, reference: np.ndarray) -> float:
    """The share of pixels that agree."""
    return float(np.mean(np.abs(image - reference).max(axis=2) <= 1e-3 * np.maximum(1, reference.max(axis=2))))


FLOOR, WALL = "floor.bsdf.reflectance", "ball.bsdf.brdf_0.reflectance"


def test_textured_scenes_are_mitsubas_pixel_by_pixel() -> None:
    pytest.importorskip("mitsuba")
    floor = bitmap(texels(6, 8, 3), to_uv=T().scale([3, 2, 1]))
    wall = {"type": "checkerboard", "color0": bitmap(texels(5, 3, 1), filter_type="nearest"), "to_uv": T().scale(6)}
    scene = room(floor, wall)
    assert close(ours(scene, 8), theirs(scene, 8)) > 0.98


def test_a_textured_light_shines_as_its_mean() -> None:
    # Mitsuba draws points on textured lights by their brightness: same picture, other noise.
    pytest.importorskip("mitsuba")
    scene = room(0.5)
    scene["lamp"]["emitter"]["radiance"] = bitmap(5 * texels(3, 4, 3))
    np.testing.assert_allclose(ours(scene, 64).mean((0, 1)), theirs(scene, 64).mean((0, 1)), rtol=0.01)


def test_edits_of_texels_show() -> None:
    scene = djpt.load_dict(room(bitmap(texels(6, 8, 3))))
    params = djpt.traverse(scene)
    for size, seed in (((6, 8, 3), 1), ((3, 2, 3), 2), ((16, 9, 3), 3)):
        data = texels(*size, seed=seed)
        params.update({f"{FLOOR}.data": data, f"{FLOOR}.to_uv": TURNED})
        expected = djpt.render(djpt.load_dict(room(bitmap(data, to_uv=TURNED))), spp=2)
        np.testing.assert_allclose(np.array(djpt.render(scene, spp=2)), np.array(expected), atol=1e-6)
        assert params[f"{FLOOR}.data"].shape == size


def test_edits_of_textures_compile_nothing() -> None:
    wall = {"type": "checkerboard", "color0": bitmap(texels(4, 4, 3)), "to_uv": T().scale(6)}
    scene = djpt.load_dict(room(bitmap(texels(6, 8, 3)), wall))
    params = djpt.traverse(scene)

    def edited(seed: int, *size: int) -> set[Any]:
        def action() -> None:
            params.update({
                f"{FLOOR}.data": texels(*size, 3, seed=seed), f"{FLOOR}.to_uv": T().scale([seed, 2, 1]),
                f"{WALL}.to_uv": T().scale([1, seed, 1]), f"{WALL}.color0.data": texels(*size, 3, seed=seed),
            })  # fmt: skip
            dr.eval(djpt.render(scene, spp=2))

        return kernels(action)

    known = edited(1, 6, 8)
    assert edited(2, 6, 8) <= known
    assert edited(3, 12, 5) <= known


def test_many_bitmaps_share_one_trace() -> None:
    def count(n: int) -> int:
        balls = {
            f"ball{i}": {
                "type": "sphere", "radius": 0.1, "center": [0.3 * i - 1, -0.6, 0.2],
                "bsdf": {"type": "diffuse", "reflectance": bitmap(texels(2 + i, 3, 3, seed=i))},
            }
            for i in range(n)
        }  # fmt: skip
        scene = djpt.load_dict(room(0.5, **balls))
        return len(scene.bsdfs.groups)

    assert count(5) == count(1)


# ---------------------------------------------------------------- gradients


@pytest.mark.parametrize("integrator", ["path", "prb"])
@pytest.mark.parametrize("keys", [{}, {"filter_type": "nearest"}, {"wrap_mode": "mirror"}], ids=str)
def test_gradients_by_texels(keys: dict[str, Any], integrator: str) -> None:
    start = texels(3, 4, 3)
    wall = {"type": "checkerboard", "color0": bitmap(texels(2, 2, 1), **keys), "to_uv": T().scale(4)}
    floor = bitmap(start, to_uv=T().scale([1.5, 1.5, 1]), **keys)
    scene = djpt.load_dict(room(floor, wall, integrator))
    params = djpt.traverse(scene)
    data = {f"{FLOOR}.data": start, f"{WALL}.color0.data": texels(2, 2, 1)}

    def loss() -> Any:
        return dr.mean(dr.square(djpt.render(scene, params, spp=8, seed=2, seed_grad=2)), axis=None)

    for name in data:
        dr.enable_grad(params[name])
    params.update()
    dr.backward(loss())
    gradients = {name: np.array(dr.grad(params[name])) for name in data}
    for name, value in data.items():
        assert gradients[name].shape == value.shape
        params[name] = value
    params.update()
    for name, index in ((f"{FLOOR}.data", (1, 2, 1)), (f"{FLOOR}.data", (0, 0, 2)), (f"{WALL}.color0.data", (1, 0, 0))):
        values = []
        for sign in (1, -1):
            moved = data[name].copy()
            moved[index] += sign * 0.05
            params.update({name: moved})
            values.append(float(loss().array[0]))
            params.update({name: data[name]})
        slope = (values[0] - values[1]) / 0.1
        assert gradients[name][index] == pytest.approx(slope, rel=0.01, abs=2e-6)


@pytest.mark.parametrize("integrator", ["prb", "path", "direct"])
@pytest.mark.parametrize("shared", [True, False], ids=["shared", "own"])
def test_gradients_of_bitmaps_in_several_kinds_of_materials(shared: bool, integrator: str) -> None:
    # All of them small: Dr.Jit sums gradients of small arrays in a way of its own.
    start, random = texels(3, 4, 3), np.random.default_rng(4)

    def texture() -> dict[str, Any]:
        return {"type": "ref", "id": "wood"} if shared else bitmap(start)

    description = room(texture(), texture(), integrator)
    description["integrator"] = {"type": integrator}
    description["board"] = {
        "type": "rectangle", "to_world": T().translate([1.5, 0, 0.3]).scale(0.4),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "checkerboard", "color0": texture()}},
    }  # fmt: skip
    if shared:
        description["wood"] = bitmap(start)
    scene = djpt.load_dict(description)
    params = djpt.traverse(scene)
    names = [name for name in params if name.endswith(".data")]
    assert len(names) == (1 if shared else 3)
    tangent = random.random(start.shape).astype(np.float32)
    weights = TensorXf(random.random((24, 24, 3)).astype(np.float32))

    def loss() -> Any:
        return dr.sum((djpt.render(scene, params, spp=16, seed=1, seed_grad=1) * weights).array)

    def attach() -> None:
        for name in names:
            params[name] = start
            dr.enable_grad(params[name])

    attach()
    params.update()
    dr.backward(loss())
    reverse = sum(float(np.sum(np.array(dr.grad(params[name])) * tangent)) for name in names)
    attach()
    for name in names:
        dr.set_grad(params[name], TensorXf(tangent))
    params.update()
    forward = dr.forward_to(loss())[0]
    ends = []
    for sign in (1, -1):
        params.update(dict.fromkeys(names, start + sign * 0.02 * tangent))
        ends.append(float(loss()[0]))
    assert forward == pytest.approx((ends[0] - ends[1]) / 0.04, rel=2e-3)
    assert reverse == pytest.approx(forward, rel=1e-4)


def test_a_bitmap_is_recovered_from_its_picture() -> None:
    target = texels(3, 3, 3, seed=5)
    scene = djpt.load_dict(room(bitmap(target), integrator="prb"))
    params = djpt.traverse(scene)
    name = f"{FLOOR}.data"
    reference = djpt.render(scene, spp=16)
    opt = djpt.ad.Adam(lr=0.05, params={name: TensorXf(np.full_like(target, 0.5))})
    for step in range(60):
        opt[name] = dr.clip(opt[name], 0, 1)
        params.update(opt)
        image = djpt.render(scene, params, spp=4, seed=step)
        dr.backward(dr.mean(dr.square(image - reference), axis=None))
        opt.step()
    # The texels under the ball and behind it are hardly seen.
    assert np.median(np.abs(np.array(params[name]) - target)) < 0.03


# ---------------------------------------------------------------- ranges and errors


def test_texels_must_lie_in_the_range_of_their_parameter() -> None:
    bright = texels(3, 3, 3)
    bright[1, 2, 0] = 1.5
    for texture in (bitmap(bright), {"type": "checkerboard", "color1": bitmap(bright)}):
        with pytest.raises(SceneError, match=r"'reflectance' must lie in \[0, 1\], found 1.5"):
            djpt.load_dict({"type": "diffuse", "reflectance": texture})
    djpt.load_dict({"type": "area", "radiance": bitmap(bright)})
    with pytest.raises(SceneError, match="'radiance' must be at least 0, found -1"):
        djpt.load_dict({"type": "area", "radiance": bitmap(np.full((2, 2, 3), -1.0))})
    params = djpt.traverse(djpt.load_dict({"type": "diffuse", "reflectance": bitmap(texels(3, 3, 3))}))
    before = np.array(params["reflectance.data"])
    with pytest.raises(ParameterError, match=r"reflectance.data: must lie in \[0, 1\], found 1.5"):
        params["reflectance.data"] = bright
    np.testing.assert_array_equal(np.array(params["reflectance.data"]), before)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("data", np.full((3, 3, 3), np.nan), "must be finite, found nan in row 0, column 0"),
        ("data", np.zeros((3, 3, 1)), "must keep its 3 channels, found 1"),
        ("data", np.zeros((3, 3, 2)), r"must have the shape .* found \(3, 3, 2\)"),
        ("data", np.zeros((0, 3, 3)), r"must have the shape .* found \(0, 3, 3\)"),
        ("data", "red", "must be an array of numbers, found str 'red'"),
        ("to_uv", np.eye(2), "must be a 3x3 or 4x4 matrix"),
        ("to_uv", np.ones((3, 3)), "must be affine"),
    ],
)
def test_wrong_edits(name: str, value: Any, message: str) -> None:
    params = djpt.traverse(djpt.load_dict(bitmap(texels(3, 3, 3))))
    with pytest.raises(ParameterError, match=message):
        params[name] = value


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"to_uv": [1, 2]}, "'to_uv' must be a 3x3 or 4x4 matrix"),
        ({"filter_type": "cubic"}, "'filter_type' can't be 'cubic'; possible: bilinear, nearest"),
        ({"wrap_mode": "repeated"}, "'wrap_mode' can't be 'repeated'; did you mean 'repeat'"),
        ({"format": "fp8"}, "'format' can't be 'fp8'; possible: auto, fp16, variant"),
        ({"wrapmode": "repeat"}, "unknown key 'wrapmode' .* did you mean 'wrap_mode'"),
        ({"data": np.zeros((2, 2, 4))}, r"'data' must have the shape .* found \(2, 2, 4\)"),
        ({"data": np.zeros((2, 2), np.uint8)}, "'data' holds linear numbers, found bytes"),
        ({"data": [[1, 2], [3]]}, "'data' must be an array of numbers"),
        ({"data": [[1, np.inf]]}, "'data' must be finite, found inf in row 0, column 1"),
    ],
)
def test_wrong_keys(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict({"type": "bitmap", "data": texels(2, 2, 3), **keys})


def test_half_precision_rounds_texels() -> None:
    data = texels(3, 3, 3)
    texture = djpt.load_dict({"type": "bitmap", "data": data, "format": "fp16"})
    np.testing.assert_array_equal(np.array(texture.data), data.astype(np.float16).astype(np.float32))
    with pytest.raises(SceneError, match="must be finite, found inf"):
        djpt.load_dict({"type": "bitmap", "data": data * 1e6, "format": "fp16"})


# ---------------------------------------------------------------- attributes of meshes


@pytest.fixture(scope="module")
def painted(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A ball with a colour per vertex and a number per face."""
    shape, random = ball(8), np.random.default_rng(3)
    attributes = {
        "vertex_color": random.random((len(shape["positions"]), 3)),
        "face_heat": random.random((len(shape["faces"]), 1)),
    }
    mesh = djpt.Mesh("ball", shape["positions"], shape["faces"], shape["normals"], shape["texcoords"], None, attributes)
    path = tmp_path_factory.mktemp("painted") / "ball.ply"
    mesh.write_ply(str(path))
    return str(path)


def painted_room(file: str, texture: Any, **nodes: Any) -> dict[str, Any]:
    mesh = {"type": "ply", "filename": file, "bsdf": {"type": "diffuse", "reflectance": texture}}
    return room(0.5, **{"mesh": {**mesh, "to_world": T().translate([0, 0, 1]).scale(0.6)}, **nodes})


COLOR, HEAT = ({"type": "mesh_attribute", "name": name} for name in ("vertex_color", "face_heat"))


@pytest.mark.parametrize(
    "texture",
    [COLOR, {**HEAT, "scale": 0.7}, {"type": "checkerboard", "color0": COLOR, "color1": HEAT}],
    ids=["vertex", "face", "both"],
)
def test_attributes_of_meshes_are_mitsubas(painted: str, texture: dict[str, Any]) -> None:
    pytest.importorskip("mitsuba")
    scene = painted_room(painted, texture)
    assert close(ours(scene, 8), theirs(scene, 8)) > 0.98


@pytest.mark.parametrize("texture", [COLOR, HEAT], ids=["vertex", "face"])
def test_instances_show_the_attributes_of_their_mesh(painted: str, texture: dict[str, Any]) -> None:
    place = T().translate([0.2, 0, 1]).rotate([1, 2, 3], 40).scale([0.6, 0.4, 0.5])
    bsdf = {"type": "diffuse", "reflectance": texture}
    mesh = {"type": "ply", "filename": painted, "bsdf": bsdf}
    direct = room(0.5, mesh={**mesh, "to_world": place})
    group = {"type": "shapegroup", "mesh": mesh}
    placed = {"type": "instance", "group": {"type": "ref", "id": "group"}, "to_world": place}
    assert close(ours(room(0.5, group=group, placed=placed), 4), ours(direct, 4)) > 0.95


def test_attributes_follow_their_edits(painted: str) -> None:
    scene = djpt.load_dict(painted_room(painted, {**HEAT, "scale": 0.5}))
    params = djpt.traverse(scene)
    params["mesh.face_heat"] = Float(np.zeros_like(np.array(params["mesh.face_heat"])))
    params.update()
    black = np.array(djpt.render(scene, spp=4))
    expected = np.array(djpt.render(djpt.load_dict(painted_room(painted, 0.0)), spp=4))
    np.testing.assert_allclose(black, expected, atol=1e-6)


def test_attributes_must_be_there_and_in_range(painted: str) -> None:
    def problem(texture: dict[str, Any], **nodes: Any) -> str:
        with pytest.raises(SceneError) as error:
            djpt.load_dict(painted_room(painted, texture, **nodes))
        return str(error.value)

    missing = {"type": "mesh_attribute", "name": "vertex_colour"}
    assert "the mesh 'mesh' has no attribute 'vertex_colour'; found: vertex_color, face_heat" in problem(missing)
    sphere = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": COLOR}}
    assert "'other' isn't a mesh, and has no attribute 'vertex_color'" in problem(COLOR, other=sphere)
    assert "mesh: 'vertex_color' must lie in [0, 1], found " in problem({**COLOR, "scale": 3})
    with pytest.raises(SceneError, match="'name' must begin with 'vertex_' or 'face_', found 'color'"):
        djpt.load_dict({"type": "mesh_attribute", "name": "color"})
    with pytest.raises(SceneError, match="a mesh attribute can't be the colour of a light"):
        djpt.load_dict({"type": "area", "radiance": {"type": "checkerboard", "color0": COLOR}})


def test_gradients_by_the_scale_of_an_attribute(painted: str) -> None:
    scene = djpt.load_dict(painted_room(painted, {**HEAT, "scale": 0.5}))
    params = djpt.traverse(scene)
    name = "mesh.bsdf.reflectance.scale"

    def loss() -> Any:
        return dr.mean(djpt.render(scene, params, spp=4, seed=2, seed_grad=2), axis=None)

    dr.enable_grad(params[name])
    params.update()
    dr.backward(loss())
    gradient = dr.grad(params[name])[0]
    ends = []
    for value in (0.55, 0.45):
        params.update({name: value})
        ends.append(float(loss().array[0]))
    assert gradient == pytest.approx((ends[0] - ends[1]) / 0.1, rel=0.01)

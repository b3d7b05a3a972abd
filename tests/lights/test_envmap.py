"""Environment maps: densities, equality with Mitsuba, the seam and the poles, files, edits and errors."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.distributions import Hierarchical2D
from djpt.errors import ParameterError, SceneError
from djpt.jit.types import Point2f, TensorXf, Vector3f
from djpt.validation import agreement
from tests.kit.axes import unit
from tests.kit.chi_squared import SIGNIFICANCE, SPHERE, p_value, uniform
from tests.kit.kernels import Watched
from tests.kit.lit_floor import floor_scene
from tests.kit.renders import ours, pixels, theirs

TURNED = T().rotate(unit(1, 2, 3), 70)


def texels(rows: int, columns: int, kind: str = "plain") -> np.ndarray:
    """A picture with: nothing special, one bright texel, or brightness that grows by 10^4 from left to right."""
    data = np.random.default_rng(rows).random((rows, columns, 3)).astype(np.float32)
    if kind == "sun":
        data *= 0.01
        data[rows // 3, columns - 1] = [900, 800, 700]
    elif kind == "gradient":
        data *= np.geomspace(1e-2, 1e2, columns, dtype=np.float32)[None, :, None]
    return data


def light(data: np.ndarray, **keys: Any) -> dict[str, Any]:
    return {"type": "envmap", "data": data, **keys}


def emitter(data: np.ndarray, **keys: Any) -> Any:
    return djpt.load_dict({"type": "scene", "light": light(data, **keys)}).emitters()[0]


def towards(d: Any) -> Any:
    """What `eval` and `pdf_direction` look at."""
    return SimpleNamespace(wi=-d, d=d)


def direction(u: np.ndarray, v: np.ndarray) -> Vector3f:
    phi, theta = 2 * math.pi * u, math.pi * v
    xyz = np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)
    return Vector3f(*(np.ravel(x).astype(np.float32) for x in xyz))


# ---------------------------------------------------------------- densities

SIZES = [(3, 2), (5, 7), (7, 5), (33, 64), (64, 33), (3, 50), (50, 2)]
KINDS = ("plain", "sun", "gradient")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("rows", "columns"), SIZES)
def test_density_integrates_to_one(rows: int, columns: int, kind: str) -> None:
    """By the midpoint rule on each cell between texels, where the density is smooth."""
    fine = max(2, 400 // (rows - 1)), max(2, 400 // columns)
    v = (np.arange((rows - 1) * fine[0]) + 0.5) / ((rows - 1) * fine[0])
    u = ((np.arange(columns * fine[1]) + 0.5) / fine[1] + 0.5) / columns
    v, u = np.meshgrid(v, u, indexing="ij")
    found = np.array(emitter(texels(rows, columns, kind)).pdf_direction(djpt.Interaction3f(), towards(direction(u, v))))
    integral = (found * np.sin(math.pi * v).ravel()).mean() * 2 * math.pi**2
    assert integral == pytest.approx(1, abs=1e-3)


@pytest.mark.sparse(12)
@pytest.mark.parametrize("compensation", [False, True])
@pytest.mark.parametrize("kind", ("plain", "gradient"))
@pytest.mark.parametrize(("rows", "columns"), SIZES)
def test_samples_follow_the_density(rows: int, columns: int, kind: str, compensation: bool) -> None:
    sky = emitter(texels(rows, columns, kind), to_world=TURNED, mis_compensation=compensation)
    ds, weight = sky.sample_direction(djpt.Interaction3f(), Point2f(*uniform(2**17)))
    p, integral = p_value(SPHERE, ds.d, True, lambda d: sky.pdf_direction(djpt.Interaction3f(), towards(d)))
    assert integral == pytest.approx(1, abs=5e-3)
    assert p > SIGNIFICANCE
    np.testing.assert_allclose(np.array(ds.pdf), np.array(sky.pdf_direction(djpt.Interaction3f(), ds)), rtol=2e-2)
    np.testing.assert_allclose(np.array(ds.pdf * ds.weight), 1, rtol=1e-5)
    np.testing.assert_allclose(np.array(weight), np.array(sky.eval(towards(ds.d)) * ds.weight), rtol=2e-2, atol=1e-4)


def test_extreme_samples_stay_where_light_is() -> None:
    """Samples of 0 and of nearly 1 don't lead into black parts."""
    data = np.zeros((8, 16, 3), np.float32)
    data[3, 5] = 1
    ends = np.float32([0, 2**-24, 0.5, 1 - 2**-24])
    u, v = (x.ravel() for x in np.meshgrid(ends, ends))
    ds, weight = emitter(data).sample_direction(djpt.Interaction3f(), Point2f(u, v))
    assert np.isfinite(np.array(weight)).all() and np.isfinite(np.array(ds.d)).all()
    assert (np.abs(np.array(ds.uv.x) * 16 - 5.5) <= 1 + 1e-4).all()
    assert (np.abs(np.array(ds.uv.y) * 7 - 3) <= 1 + 1e-4).all()


def test_tree_of_one_cell_and_of_long_rows() -> None:
    for shape in ((2, 2), (2, 9), (9, 2), (4, 100)):
        distribution = Hierarchical2D()
        values = np.random.default_rng(1).random(shape)
        distribution.set(values)
        column, row, place, density = distribution.sample(Point2f(*uniform(4096)))
        assert np.array(column).max() == shape[1] - 2 and np.array(row).max() == shape[0] - 2
        x, y = np.array(place)
        i, j = np.array(row).astype(int), np.array(column).astype(int)
        low = values[i, j] * (1 - x) + values[i, j + 1] * x
        high = values[i + 1, j] * (1 - x) + values[i + 1, j + 1] * x
        corners = (values[:-1, :-1] + values[1:, :-1] + values[:-1, 1:] + values[1:, 1:]) / 4
        np.testing.assert_allclose(np.array(density), (low * (1 - y) + high * y) / corners.mean(), rtol=1e-4)


def test_compensated_rays_carry_all_the_light() -> None:
    data = texels(9, 16, "sun")
    rays = [
        emitter(data, mis_compensation=bool(c)).sample_ray(0, 0, *(Point2f(*uniform(256, 2, k)) for k in (1, 2)))
        for c in (0, 1)
    ]
    np.testing.assert_array_equal(np.array(rays[0][1]), np.array(rays[1][1]))


# ---------------------------------------------------------------- Mitsuba


@pytest.mark.sparse(8)
@pytest.mark.parametrize("keys", [{}, {"scale": 1.7, "to_world": TURNED}, {"mis_compensation": True}], ids=str)
@pytest.mark.parametrize(("rows", "columns"), [(5, 7), (33, 64), (64, 33), (3, 50)])
def test_methods_are_mitsubas(rows: int, columns: int, keys: dict[str, Any]) -> None:
    mi = pytest.importorskip("mitsuba")
    data, count = texels(rows, columns, "gradient"), 2**14
    mine = emitter(data, **keys)
    u = uniform(count)
    d = np.random.default_rng(3).normal(size=(3, count))
    d = Vector3f(*(d / np.linalg.norm(d, axis=0)).astype(np.float32))
    with djpt.validation.bridge._variant():
        described = djpt.validation.to_mitsuba({"light": {"type": "envmap", **keys}})["light"]
        other = mi.load_dict({**described, "bitmap": mi.Bitmap(data)})
        si, ds = dr.zeros(mi.SurfaceInteraction3f, count), dr.zeros(mi.DirectionSample3f, count)
        si.wi, ds.d = mi.Vector3f(-np.array(d)), mi.Vector3f(np.array(d))
        it = dr.zeros(mi.Interaction3f, count)
        sampled, weight = other.sample_direction(it, mi.Point2f(np.array(u)))
        expected = [other.eval(si), other.pdf_direction(it, ds), sampled.d, sampled.pdf, sampled.uv, weight]
        expected = [np.array(x) for x in expected]
    ds, weight = mine.sample_direction(djpt.Interaction3f(), Point2f(*u))
    found = [mine.eval(towards(d)), mine.pdf_direction(djpt.Interaction3f(), towards(d)), ds.d, ds.pdf, ds.uv, weight]
    for a, b in zip(found, expected, strict=True):
        # acos errs near the poles.
        assert np.isclose(np.array(a), b, rtol=1e-3, atol=1e-5 * np.abs(b).max()).mean() > 0.997


@pytest.mark.parametrize("integrator", ["path", "direct"])
@pytest.mark.sparse(2)
def test_compensated_image(tmp_path: Path, integrator: str) -> None:
    djpt.write(tmp_path / "sky.pfm", texels(16, 33, "gradient"))
    sky = {"type": "envmap", "filename": str(tmp_path / "sky.pfm"), "mis_compensation": True, "scale": 0.2}
    scene = floor_scene({"light": sky}, integrator={"type": integrator})
    assert agreement(ours(scene, 8, 1), theirs(scene, 8, 1), 1e-3).share > 0.99


def test_parameters_are_mitsubas() -> None:
    mi = pytest.importorskip("mitsuba")
    data = texels(5, 7)
    with djpt.validation.bridge._variant():
        other = mi.traverse(mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(data)}))
        names, expected = list(other.keys()), np.array(other["data"])
    params = djpt.traverse(emitter(data))
    assert list(params) == names
    np.testing.assert_array_equal(np.array(params["data"]), expected)


# ---------------------------------------------------------------- radiance


def test_texels_are_where_they_should_be() -> None:
    """At the texels' places, those of the first and last column and row included."""
    data = texels(9, 12)
    v, u = np.meshgrid(np.arange(9) / 8, (np.arange(12) + 0.5) / 12, indexing="ij")
    found = np.array(emitter(data).eval(towards(direction(u, v)))).T.reshape(9, 12, 3)
    np.testing.assert_allclose(found[1:-1], data[1:-1], atol=2e-5)
    # At a pole float32 doesn't know the angle about it: any of the row.
    for row in (0, -1):
        assert (found[row] >= data[row].min(axis=0) - 1e-3).all()
        assert (found[row] <= data[row].max(axis=0) + 1e-3).all()


@pytest.mark.parametrize("to_world", [T(), TURNED, T().scale([1, 1, -1])], ids=["plain", "turned", "mirrored"])
def test_no_seam(to_world: T) -> None:
    """Radiance and density change by little with little changes of direction, also across u = 0 and u = 1 / 2."""
    sky = emitter(texels(17, 32), to_world=to_world)
    v = np.linspace(0.05, 0.95, 400)
    matrix = to_world.matrix[:3, :3]
    for u in (0.0, 0.5, 0.5 / 32, 1 - 0.5 / 32):
        sides = []
        for offset in (-1e-5, 1e-5):
            d = Vector3f(*(matrix @ np.array(direction(np.full(400, u + offset), v))).astype(np.float32))
            sides.append(
                [np.array(sky.eval(towards(d))), np.array(sky.pdf_direction(djpt.Interaction3f(), towards(d)))]
            )
        for a, b in zip(*sides, strict=True):
            np.testing.assert_allclose(a, b, rtol=2e-2, atol=2e-3)


@pytest.mark.parametrize("sign", [1, -1])
def test_poles_are_finite(sign: int) -> None:
    sky = emitter(texels(17, 32))
    d = Vector3f([0, -0.0, 1e-20, 1e-7], sign, [0, 0, -1e-20, 1e-7])
    assert np.isfinite(np.array(sky.eval(towards(d)))).all()
    assert np.isfinite(np.array(sky.pdf_direction(djpt.Interaction3f(), towards(d)))).all()


def test_negative_texels_count() -> None:
    """The integral over directions is that of the radiance, and all that isn't black is sampled."""
    data = texels(9, 16) - 0.4
    assert data.min() < 0
    sky = emitter(data)
    ds, weight = sky.sample_direction(djpt.Interaction3f(), Point2f(*uniform(2**14)))
    v, u = np.meshgrid((np.arange(256) + 0.5) / 256, (np.arange(512) + 0.5) / 512, indexing="ij")
    expected = (
        (np.array(sky.eval(towards(direction(u, v)))) * np.sin(math.pi * v).ravel()).mean(axis=1) * 2 * math.pi**2
    )
    found = np.array(weight)
    error = found.std(axis=1) / math.sqrt(found.shape[1])
    assert (np.abs(found.mean(axis=1) - expected) < 4 * error + 1e-3).all()
    assert (np.array(ds.pdf) > 0).all() and (found.min(axis=1) < 0).all()


def test_white_map_is_constant_light() -> None:
    """The same image as a constant light's, within the noise of both."""
    scenes = [
        floor_scene({"light": sky}, size=32)
        for sky in (light(np.ones((9, 16, 3)), scale=0.5), {"type": "constant", "radiance": 0.5})
    ]
    images = [np.array([ours(scene, 64, seed) for seed in range(4)]) for scene in scenes]
    difference = images[0].mean(axis=0) - images[1].mean(axis=0)
    sigma = np.sqrt(sum(image.var(axis=0, ddof=1) for image in images) / 4)
    assert abs(difference.mean()) < 4 * np.sqrt((sigma**2).sum()) / sigma.size + 1e-5


def test_power() -> None:
    """The mean radiance over the sphere times (2 pi r)^2."""
    sky = emitter(texels(9, 12), scale=2.0)
    sky.set_bounds(np.zeros(3), 3.0)
    v, u = np.meshgrid((np.arange(800) + 0.5) / 800, (np.arange(120) + 0.5) / 120, indexing="ij")
    radiance = np.array(sky.eval(towards(direction(u, v)))).mean(axis=0)
    mean = np.average(radiance, weights=np.sin(math.pi * v).ravel())
    assert sky.power() == pytest.approx(mean * (6 * math.pi) ** 2, rel=1e-4)
    assert sky.bounds() is None


# ---------------------------------------------------------------- sources


@pytest.mark.parametrize("suffix", ["exr", "hdr", "pfm", "npy"])
def test_files(suffix: str, tmp_path: Path) -> None:
    data = texels(6, 8)
    djpt.write(tmp_path / f"sky.{suffix}", data)
    sky = djpt.load_dict({"type": "envmap", "filename": str(tmp_path / f"sky.{suffix}")})
    np.testing.assert_allclose(np.array(sky.data)[:, 1:-1], data, atol=5e-3 if suffix == "hdr" else 2e-7)


def test_objects() -> None:
    data = texels(6, 8)
    for sky in (
        light(data),
        light(TensorXf(data)),
        {"type": "envmap", "bitmap": data},
        {"type": "envmap", "bitmap": djpt.Image(data)},
    ):
        np.testing.assert_array_equal(np.array(djpt.load_dict(sky).data)[:, 1:-1], data)
    grey = np.array(djpt.load_dict(light(data[..., 0])).data)
    np.testing.assert_array_equal(grey[:, 1:-1], np.repeat(data[..., :1], 3, axis=2))


# ---------------------------------------------------------------- edits


def scene_with(data: np.ndarray, **keys: Any) -> dict[str, Any]:
    return floor_scene({"light": light(data, **keys)}, size=24, integrator={"type": "prb", "max_depth": 3})


def halo(data: np.ndarray) -> np.ndarray:
    return np.concatenate([data[:, -1:], data, data[:, :1]], axis=1)


@pytest.mark.parametrize("gradients", [(), ("light.data", "light.scale")], ids=["image", "gradient"])
def test_edits_compile_nothing(gradients: tuple[str, ...]) -> None:
    watched = Watched(scene_with(texels(8, 13)), gradients)
    edits: dict[str, list[Any]] = {
        "light.data": [halo(texels(8, 13, "sun")), halo(texels(8, 13))],
        "light.scale": [2.0, 0.0, 1.0],
        "light.to_world": [TURNED, T()],
    }
    found = {(key, k): watched.edit(**{key: v}) for key, values in edits.items() for k, v in enumerate(values)}
    assert not any(found.values()), found


def test_edited_or_from_the_start() -> None:
    data = texels(9, 17, "sun")
    scene = djpt.load_dict(scene_with(texels(8, 13)))
    params = djpt.traverse(scene)
    params.update({"light.data": TensorXf(halo(data)), "light.scale": 0.3, "light.to_world": TURNED})
    fresh = ours(scene_with(data, scale=0.3, to_world=TURNED), 4, 2)
    np.testing.assert_array_equal(pixels(djpt.render(scene, spp=4, seed=2)), fresh)


def test_halo_follows_the_texels() -> None:
    sky = emitter(texels(5, 7))
    params = djpt.traverse(sky)
    data = texels(5, 9)  # its outer columns are no halo
    params["data"] = TensorXf(data)
    params.update()
    np.testing.assert_array_equal(np.array(params["data"]), halo(data[:, 1:-1]))


BLACK = np.zeros((4, 4, 3), np.float32)
ONLY_POLES = BLACK.copy()
ONLY_POLES[[0, -1]] = 1


@pytest.mark.parametrize("compensated", [False, True])
def test_a_black_sky_is_sampled_uniformly(compensated: bool) -> None:
    """A script may begin with one, and make it brighter."""
    scene = djpt.load_dict(scene_with(BLACK, mis_compensation=compensated))
    assert not pixels(djpt.render(scene, spp=2)).any()
    params = djpt.traverse(scene)
    params["light.data"] = TensorXf(halo(texels(4, 4)))
    params.update()
    bright = djpt.load_dict(scene_with(texels(4, 4), mis_compensation=compensated))
    np.testing.assert_array_equal(pixels(djpt.render(scene, spp=2)), pixels(djpt.render(bright, spp=2)))
    params["light.data"] = TensorXf(halo(BLACK))
    params.update()
    assert not pixels(djpt.render(scene, spp=2)).any()


def test_a_sky_that_shines_at_the_poles_only() -> None:
    """The mean weight of directions is the integral of the radiance over the sphere."""
    sky = emitter(ONLY_POLES)
    rng = djpt.PCG32(size=1 << 16)
    sample = djpt.Point2f(rng.next_float32(), rng.next_float32())
    _, weight = sky.sample_direction(dr.zeros(djpt.Interaction3f), sample)
    # From theta = 0 the radiance falls to 0 over a third of pi.
    step = np.pi / 3
    integral = 2 * 2 * np.pi * (1 - np.sin(step) / step)
    np.testing.assert_allclose(dr.mean(weight.x)[0], integral, rtol=0.02)


# ---------------------------------------------------------------- errors

NAN = texels(4, 4)
NAN[1, 2, 0] = np.nan

REFUSED: list[tuple[dict[str, Any], str]] = [
    (light(NAN), "'data' must be finite, found nan in row 1, column 2"),
    (light(np.ones((4, 4, 2), np.float32)), r"'data' must have the shape"),
    ({"type": "envmap"}, "'envmap' needs one of filename, bitmap, data; found none"),
    ({"type": "envmap", "filename": "a.exr", "bitmap": texels(4, 4)}, "found 'filename' and 'bitmap'"),
    ({"type": "envmap", "filename": "no such file.exr"}, "'filename'.*no such file"),
    ({"type": "envmap", "bitmap": "sky.exr"}, "'bitmap' must be an image.*a file's name is given as 'filename'"),
    (light(texels(4, 4), scale=-1.0), "'scale' must be at least 0, found -1"),
    (light(texels(4, 4), to_world=T().scale([1, 2, 1])), "'to_world' must not shear, nor scale differently"),
    (light(texels(4, 4), mis_compensatoin=True), "unknown key 'mis_compensatoin'.*did you mean 'mis_compensation'"),
]


@pytest.mark.parametrize(("description", "message"), REFUSED, ids=range(len(REFUSED)))
def test_descriptions_refused(description: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict({"type": "scene", "light": description})


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("data", halo(NAN), "light.data: must be finite"),
        ("data", texels(4, 3), "light.data: must have at least 2 x 3 texels, found 1 x 4"),
        ("data", np.ones((4, 6), np.float32), "light.data: must have 3 channels, found 1"),
        ("scale", -1.0, "light.scale: must not be negative|light.scale: must be at least 0"),
        ("to_world", T().scale([1, 2, 1]), "light.to_world: must not shear"),
    ],
)
def test_edits_refused(key: str, value: Any, message: str) -> None:
    params = djpt.traverse(djpt.load_dict({"type": "scene", "light": light(texels(4, 4))}))
    before = params[f"light.{key}"]
    with pytest.raises(ParameterError, match=message):
        params[f"light.{key}"] = TensorXf(value) if isinstance(value, np.ndarray) else value
    assert params[f"light.{key}"] is before


@pytest.mark.parametrize("shape", [(1, 1), (2, 1), (2, 4), (3, 1)])
def test_of_a_small_image_the_last_texels_are_repeated(shape):
    image = texels(*shape)
    emitter = djpt.load_dict(light(image))
    data = np.array(djpt.traverse(emitter)["data"])[:, 1:-1]
    assert data.shape == (3, max(shape[1], 2), 3)
    assert np.array_equal(data[: shape[0], : shape[1]], image)
    assert np.array_equal(data[2], data[shape[0] - 1])
    assert np.array_equal(data[:, -1], data[:, shape[1] - 1])


# ---------------------------------------------------------------- lookups


@pytest.mark.parametrize("compensated", [False, True])
def test_one_lookup_gives_radiance_and_density(compensated: bool) -> None:
    sky = emitter(texels(16, 32, "sun"), to_world=TURNED, mis_compensation=compensated)
    rng = np.random.default_rng(1)
    there = towards(direction(rng.random(500), rng.random(500)))
    radiance, pdf = sky.eval_and_pdf(there, None, there)
    np.testing.assert_array_equal(np.array(radiance), np.array(sky.eval(there)))
    np.testing.assert_allclose(np.array(pdf), np.array(sky.pdf_direction(None, there)), rtol=1e-6)


def test_mirrors_alone_take_no_light_samples() -> None:
    plain = floor_scene({"sky": light(texels(16, 32, "sun"))}, size=32)
    mirror, glass = {"type": "conductor", "material": "Au"}, {"type": "dielectric"}
    shapes = {"sphere": glass, "rectangle": mirror, "disk": mirror, "cube": mirror}
    scene = {
        name: {**entry, "bsdf": shapes[entry["type"]]} if isinstance(entry, dict) and entry["type"] in shapes else entry
        for name, entry in plain.items()
    }
    assert not djpt.load_dict(scene).bsdfs.reflect_lights
    assert djpt.load_dict(plain).bsdfs.reflect_lights
    assert agreement(ours(scene, spp=16), theirs(scene, spp=16)).share > 0.98

"""The sky over many days: an instant of it, equality with Mitsuba, densities, the time of rays, edits, errors."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import Float, Point2f, Vector3f
from djpt.validation import agreement
from tests.kit.chi_squared import SIGNIFICANCE, SPHERE, p_value, uniform
from tests.kit.kernels import Watched
from tests.kit.lit_floor import floor_scene
from tests.kit.renders import ours, pixels, theirs

UPRIGHT = T().rotate([1, 0, 0], -90)
AT_THREE = {"window_start_time": 15.0, "window_end_time": 15.0}
"""A time of day whose date Mitsuba knows exactly, in Tokyo: 6 o'clock, universal time."""


def sky(**keys: Any) -> dict[str, Any]:
    return {"type": "timed_sunsky", **keys}


def directions(count: int) -> np.ndarray:
    """Directions above the horizon, (3, count)."""
    d = np.random.default_rng(2).normal(size=(3, count)).astype(np.float32)
    d[2] = np.abs(d[2])
    return d / np.linalg.norm(d, axis=0)


def answers(renderer: Any, light: dict[str, Any], count: int = 4096) -> dict[str, np.ndarray]:
    """Radiance, samples and densities of a light, at times between 0 and 1."""
    emitter, d = renderer.load_dict(light), directions(count)
    time = renderer.Float(np.random.default_rng(3).random(count, np.float32))
    si, ds = dr.zeros(renderer.SurfaceInteraction3f, count), dr.zeros(renderer.DirectionSample3f, count)
    si.time, si.wi, ds.time, ds.d = time, renderer.Vector3f(-d), time, renderer.Vector3f(d)
    sampled, weight = emitter.sample_direction(si, renderer.Point2f(*(np.array(u) for u in uniform(count))))
    found = {
        "radiance": emitter.eval(si),
        "direction": sampled.d,
        "density": sampled.pdf,
        "weight": weight,
        "density again": emitter.pdf_direction(si, ds),
    }
    return {name: np.array(value) for name, value in found.items()}


def far_apart(a: np.ndarray, b: np.ndarray, tolerance: float) -> float:
    """The share of entries that differ by more than a tolerance."""
    return float((np.abs(a - b) > tolerance * (np.abs(a) + 1e-3)).mean())


@pytest.mark.parametrize("complex_sun", [False, True])
def test_an_instant_is_a_sunsky(complex_sun: bool) -> None:
    keys = {"turbidity": 4.5, "albedo": 0.6, "sun_aperture": 12.0, "complex_sun": complex_sun}
    d = directions(4096)
    for hour, month in ((10.5, 3), (16.25, 8)):
        days = {"start_month": month, "start_day": 5, "end_year": 2025, "end_day": 6}
        still = djpt.load_dict({"type": "sunsky", "year": 2025, "month": month, "day": 5, "hour": hour, **keys})
        passing = djpt.load_dict(sky(window_start_time=hour - 1, window_end_time=hour + 1, **days, **keys))
        si = dr.zeros(djpt.SurfaceInteraction3f, d.shape[1])
        si.wi, si.time = Vector3f(-d), Float(0.5)
        a, b = (np.array(emitter.eval(si)) for emitter in (still, passing))
        assert far_apart(a, b, 2e-4) < 2e-3  # at the edge of the disc


@pytest.mark.slow
def test_the_same_sky_as_mitsubas() -> None:
    """Where Mitsuba's dates are exact, samples and densities agree for each number."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    light = sky(**AT_THREE, sun_scale=0.0, turbidity=5.0)
    mine, its = answers(djpt, light), answers(mi, light)
    for name, values in mine.items():
        assert far_apart(its[name], values, 1e-3) < 2e-3, name
    # Elsewhere its sun stands up to a quarter of a degree away.
    light = sky(sun_scale=0.0)
    mine, its = answers(djpt, light), answers(mi, light)
    for name, values in mine.items():
        assert far_apart(its[name], values, 3e-2) < 5e-2, name


def test_the_same_choice_between_sky_and_sun_as_mitsubas() -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    light = sky(**AT_THREE, sun_aperture=20.0, complex_sun=True)
    mine, its = answers(djpt, light), answers(mi, light)
    for name, values in mine.items():
        # Mitsuba computes the solid angle of the sun in single precision, 0.2 % off.
        assert far_apart(its[name], values, 4e-3) < 2e-3, name


@pytest.mark.parametrize("time", [0.1, 0.52])
@pytest.mark.sparse(2)
def test_directions_follow_the_density(time: float) -> None:
    emitter = djpt.load_dict(sky(sun_aperture=30.0, **AT_THREE))
    count, here = 2**17, Float(time)
    ds, weight = emitter.sample_direction(djpt.Interaction3f(time=here), Point2f(*uniform(count)))

    def density(d: Any) -> Any:
        at = djpt.DirectionSample3f(d=d, time=here)
        return emitter.pdf_direction(djpt.Interaction3f(), at)

    p, integral = p_value(SPHERE, ds.d, dr.max(dr.abs(weight)) > 0, density, fine=48)
    assert integral <= 1 + 5e-3
    assert p > SIGNIFICANCE


# ---------------------------------------------------------------- images


def scene(light: dict[str, Any], **options: Any) -> dict[str, Any]:
    camera = {"type": "perspective", "fov": 35, "shutter_open": 0.0, "shutter_close": 1.0}
    return floor_scene({"light": {"to_world": UPRIGHT, **light}}, camera, size=24, **options)


@pytest.mark.slow
def test_equal_pixels() -> None:
    pytest.importorskip("mitsuba")
    drawn = scene(sky(**AT_THREE, sun_scale=0.0))
    # Mitsuba 3.9.1 can't record this light.
    flags = (dr.JitFlag.SymbolicLoops, dr.JitFlag.SymbolicCalls)
    with dr.scoped_set_flag(flags[0], False), dr.scoped_set_flag(flags[1], False):
        expected = theirs(drawn, 8, 1)
    share = agreement(ours(drawn, 8, 1), expected, 3e-3).share
    print(f"{share:.4f}")
    assert share >= 0.99


def test_estimators_see_the_same_days() -> None:
    light = sky(sun_aperture=10.0, window_start_time=9.0, window_end_time=15.0)
    found = {
        name: ours(scene(light, integrator={"type": name, **keys}), 128).mean(axis=(0, 1))
        for name, keys in (("path", {"max_depth": 2}), ("direct", {}))
    }
    for image in found.values():
        np.testing.assert_allclose(image, found["path"], rtol=0.04)


def test_schedules_agree() -> None:
    drawn = djpt.load_dict(scene(sky(**AT_THREE, sun_aperture=10.0)))
    flat, wave = (pixels(djpt.render(drawn, spp=4, seed=5, schedule=name)) for name in ("flat", "wave"))
    np.testing.assert_allclose(flat, wave, rtol=1e-4, atol=1e-6)


def test_a_shut_camera_sees_one_instant() -> None:
    """The first hour of the first day, if the shutter opens at 0 and closes at once."""
    drawn = scene(sky(sun_scale=0.0, window_start_time=9.0))
    drawn["sensor"]["shutter_close"] = 0.0
    still = {**drawn, "light": {"type": "sunsky", "year": 2025, "month": 1, "day": 1, "hour": 9.0, "sun_scale": 0.0}}
    still["light"]["to_world"] = UPRIGHT
    a, b = (ours(description, 64).mean(axis=(0, 1)) for description in (drawn, still))
    np.testing.assert_allclose(a, b, rtol=0.02)


# ---------------------------------------------------------------- parameters


def test_an_edit_compiles_no_kernel() -> None:
    watched = Watched(scene(sky(**AT_THREE)))
    before = pixels(djpt.render(watched.scene, spp=4))
    watched.params["light.turbidity"] = 7.0
    watched.params["light.latitude"] = -20.0
    watched.params["light.window_start_time"] = 9.0
    watched.params["light.start_month"] = 5
    watched.params["light.end_month"] = 6
    watched.params.update()
    assert watched.new() == 0
    assert not np.allclose(before, pixels(djpt.render(watched.scene, spp=4)))


def test_an_edit_is_a_new_description() -> None:
    edited = djpt.load_dict(sky())
    params = djpt.traverse(edited)
    params["start_month"], params["end_month"], params["longitude"], params["sky_scale"] = 4, 6, 100.0, 2.0
    params.update()
    fresh = sky(start_month=4, end_month=6, longitude=100.0, sky_scale=2.0)
    si = dr.zeros(djpt.SurfaceInteraction3f, 64)
    si.wi, si.time = Vector3f(-directions(64)), Float(0.3)
    np.testing.assert_allclose(np.array(edited.eval(si)), np.array(djpt.load_dict(fresh).eval(si)), rtol=1e-6)
    with pytest.raises(djpt.ParameterError, match="the end must not be before the start"):
        params["end_year"] = 2020
        params.update()


@pytest.mark.parametrize("key", ["sky_scale", "sun_scale"])
def test_a_scale_of_0_stays_a_single_number(key: str) -> None:
    """Dr.Jit widens a literal 0 in place if only the plugin refers to it."""
    light = djpt.load_dict(sky())
    params = djpt.traverse(light)
    params[key] = attached_zero()
    params.update()
    assert dr.width(params[key]) == 1


def attached_zero() -> Float:
    zero = Float(0)
    dr.enable_grad(zero)
    return zero


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"window_start_time": 25.0}, r"'window_start_time' must lie in \[0, 24\], found 25"),
        ({"window_start_time": 9.0, "window_end_time": 8.0}, "'window_end_time' must not be less than"),
        ({"end_year": 2024}, "'end_year' is too early: the end must not be before the start, found 366 days earlier"),
        ({"shutter_open": 1.0, "shutter_close": 0.0}, "'shutter_close' must not be less than 'shutter_open'"),
        ({"sun_direction": [0, 0, 1]}, "unknown key 'sun_direction'"),
    ],
)
def test_errors(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(djpt.SceneError, match=message):
        djpt.load_dict({"type": "scene", "light": sky(**keys)})


def test_light_from_the_emitter_has_no_time() -> None:
    with pytest.raises(djpt.SceneError, match="has no time; take an integrator that starts at the camera"):
        djpt.render(djpt.load_dict(scene(sky(), integrator={"type": "ptracer"})), spp=1)
    ray, weight = djpt.load_dict(sky(**AT_THREE)).sample_ray(0.5, 0.0, Point2f(0.3, 0.4), Point2f(0.2, 0.7))
    assert ray.time[0] == 0.5 and dr.all(weight > 0)[0]

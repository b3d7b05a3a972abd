"""The sky and the sun: tables, the sun's way, the small disc, equality with Mitsuba, edits, derivatives."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
import djpt.emitters
from djpt.core.transforms import ScalarTransform4f as T
from djpt.emitters.sky.position import TimeAndPlace
from djpt.emitters.sky.tables import table
from djpt.jit.types import Color3f, Float, Point2f, Vector3f
from djpt.validation import agreement
from djpt.validation.gradcheck.losses import quotient
from tests.kit.chi_squared import uniform
from tests.kit.derivatives import by_both
from tests.kit.kernels import Watched
from tests.kit.lit_floor import floor_scene
from tests.kit.renders import ours, pixels, theirs

WAVELENGTHS = np.arange(320, 721, 40, dtype=np.float32)
"""Those of the model's spectra, in nm."""


def tables_of_mitsuba() -> dict[str, Any]:
    """All tables by name, float32; the first axes are named in `djpt.emitters.sky.tables`."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    folder = Path(mi.__file__).parent / "data" / "sunsky"
    model, sampling = (mi.tensor_io.read(folder / f"{name}.bin") for name in ("sunsky_datasets", "sampling_data"))

    # Averages over the wavelengths with the weights of the eye, in the units that Mitsuba's colours have.
    xyz = np.array(mi.cie1931_xyz(mi.Float(WAVELENGTHS)), np.float64)
    to_rgb = np.array(
        [[3.240479, -1.537150, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]]
    )
    count = len(WAVELENGTHS)
    sun, sky = sampling["sun_irradiance"], sampling["sky_irradiance"]
    tables = {
        "sky": np.concatenate(
            [np.moveaxis(model["sky_params_rgb"], -1, -2), model["sky_rad_rgb"][..., None, :]], axis=-2
        ),
        "sun": model["sun_rad_rgb"].reshape(10, 45, 18, 4),
        "irradiance": np.concatenate(
            [sun @ (to_rgb @ xyz).T / count, (sun @ xyz[1:2].T) / count, (sky @ xyz[1:2].T) / count], axis=-1
        ),
        "density": sampling["weights"],
    }
    return {name: table.astype(np.float32) for name, table in tables.items()}


if __name__ == "__main__":
    np.savez_compressed(sys.argv[1], **tables_of_mitsuba())


UPRIGHT = T().rotate([1, 0, 0], -90)


def sky(**keys: Any) -> dict[str, Any]:
    return {"type": "sunsky", "sun_direction": [0.3, 0.5, 0.6], **keys}


def radiance(emitter: Any, *directions: Any) -> np.ndarray:
    """(3, N), from directions in world space."""
    d = np.array(directions, np.float32).reshape(-1, 3)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    si = dr.zeros(djpt.SurfaceInteraction3f, len(d))
    si.wi = Vector3f(*(-d.T))
    return np.array(emitter.eval(si))


# ---------------------------------------------------------------- data


def test_tables_are_mitsubas() -> None:
    pytest.importorskip("mitsuba")

    for name, expected in tables_of_mitsuba().items():
        found = table(name)
        assert found.shape == expected.shape
        np.testing.assert_array_equal(np.array(found.numbers), expected.ravel(), err_msg=name)


def test_the_licence_of_the_tables_is_with_them() -> None:
    text = (Path(djpt.emitters.__file__).parent / "sky" / "LICENSE").read_text()
    assert "Lukas Hosek and Alexander Wilkie" in text and "Redistributions in binary form" in text


# ---------------------------------------------------------------- the sun's way


def test_days_since_the_epoch() -> None:
    noon = {"timezone": 0.0, "hour": 12.0}
    assert TimeAndPlace(year=2000, month=1, day=1, **noon).days() == 0
    assert TimeAndPlace(year=2000, month=3, day=1, **noon).days() == 60  # a leap year
    assert TimeAndPlace(year=1999, month=12, day=31, timezone=2.0, hour=8.0).days() == -1 - 6 / 24


def test_the_sun_at_noon_in_greenwich() -> None:
    """At the solstices it stands as far above and below the equator as the earth's axis is tilted."""
    for month, tilt in ((6, 23.44), (12, -23.44)):
        at = TimeAndPlace(latitude=51.48, longitude=0.0, timezone=0.0, year=2010, month=month, day=21, hour=12.05)
        x, y, z = at.sun_direction()
        assert math.degrees(math.asin(z)) == pytest.approx(90 - 51.48 + tilt, abs=0.1)
        assert x > 0 and abs(y) < 0.03  # in the south
        assert at.sun_direction() @ at.sun_direction() == pytest.approx(1)


def test_morning_is_in_the_east() -> None:
    morning, evening = (TimeAndPlace(hour=hour).sun_direction() for hour in (7.0, 17.0))
    assert morning[1] < -0.5 < 0.5 < evening[1]


def test_the_sun_of_mitsuba() -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    for keys in ({}, {"hour": 9.5}, {"year": 2024, "month": 2, "latitude": -33.9, "longitude": 18.4, "timezone": 2.0}):
        mine, its = djpt.load_dict({"type": "sunsky", **keys}), mi.load_dict({"type": "sunsky", **keys})
        a, b = (
            np.array(traverse(e)["sun_direction"]).ravel()
            for traverse, e in ((djpt.traverse, mine), (mi.traverse, its))
        )
        assert math.degrees(math.acos(min(float(a @ b), 1.0))) < 0.25


def test_night_is_dark() -> None:
    with pytest.warns(UserWarning, match="below the horizon"):
        emitter = djpt.load_dict({"type": "sunsky", "hour": 1.0})
    assert (radiance(emitter, [0, 0, 1], [1, 0, 0.1]) == 0).all()
    ds, weight = emitter.sample_direction(djpt.Interaction3f(), Point2f(0.3, 0.6))
    assert ds.pdf[0] == 0 and dr.all(weight == 0)[0]


# ---------------------------------------------------------------- the disc


@pytest.mark.parametrize("complex_sun", [False, True])
def test_the_disc_shines_as_the_irradiance_says(complex_sun: bool) -> None:
    """Small and large discs, plain and with dark edges, have the same mean radiance times solid angle."""
    found = []
    for aperture in (0.5358, 8.0):
        emitter = djpt.load_dict(sky(sky_scale=0.0, sun_aperture=aperture, complex_sun=complex_sun))
        ds, weight = emitter.sample_direction(djpt.Interaction3f(), Point2f(*uniform(2**14)))
        found.append(np.array(weight).mean(axis=1))
        angles = np.degrees(np.arccos(np.clip(np.array(dr.dot(ds.d, dr.normalize(Vector3f(0.3, 0.5, 0.6)))), -1, 1)))
        assert 0.45 * aperture < angles.max() < 0.51 * aperture + 0.03  # arccos of nearly 1
        assert (np.array(ds.pdf) > 0).all()
    plain = djpt.load_dict(sky(sky_scale=0.0)).sample_direction(djpt.Interaction3f(), Point2f(0.3, 0.3))[1]
    for power in found:
        np.testing.assert_allclose(power, np.array(plain).ravel(), rtol=0.02)


def test_the_small_sun_is_found_as_often_as_claimed() -> None:
    emitter = djpt.load_dict(sky())
    count = 2**16
    ds, _ = emitter.sample_direction(djpt.Interaction3f(), Point2f(*uniform(count)))
    on_disc = np.array(dr.norm(ds.d - dr.normalize(Vector3f(0.3, 0.5, 0.6))) < math.radians(0.5358 / 2))
    centre = djpt.DirectionSample3f()
    centre.d = dr.normalize(Vector3f(0.3, 0.5, 0.6))
    expected = (
        emitter.pdf_direction(djpt.Interaction3f(), centre)[0] * 2 * math.pi * (1 - math.cos(math.radians(0.2679)))
    )
    assert on_disc.mean() == pytest.approx(expected, abs=4 * math.sqrt(expected * (1 - expected) / count))


# ---------------------------------------------------------------- images


@pytest.mark.parametrize("keys", [{}, {"turbidity": 6.3, "complex_sun": True, "sun_scale": 0.2}], ids=["plain", "hazy"])
@pytest.mark.sparse(2)
def test_equal_pixels_with_the_true_sun(keys: dict[str, Any]) -> None:
    pytest.importorskip("mitsuba")
    scene = floor_scene({"light": sky(sun_direction=[-1, 2, 1.5], to_world=UPRIGHT, **keys)})
    share = agreement(ours(scene, 8, 1), theirs(scene, 8, 1), 3e-3).share
    print(f"{keys}: {share:.4f}")
    assert share >= 0.95


def test_an_edit_compiles_no_kernel() -> None:
    watched = Watched(floor_scene({"light": sky(to_world=UPRIGHT, sun_direction=[-1, 2, 1.5])}))
    before = pixels(djpt.render(watched.scene, spp=4))
    for turbidity, direction, scale in ((7.0, [1, 2, 0.5], 1.0), (2.0, [0, 1, 0], 3.0)):
        watched.params["light.turbidity"] = turbidity
        watched.params["light.sun_direction"] = direction
        watched.params["light.sky_scale"] = scale
        watched.params["light.albedo.value"] = 0.8
        watched.params.update()
        assert watched.new() == 0
        assert not np.allclose(before, pixels(djpt.render(watched.scene, spp=4)))


def test_an_edit_is_a_new_description() -> None:
    edited = djpt.load_dict({"type": "sunsky", "turbidity": 2.0, "hour": 9.5})
    params = djpt.traverse(edited)
    with pytest.raises(djpt.ParameterError, match="is computed from other parameters"):
        params["sun_direction"] = [0, 0, 1]
    with pytest.raises(djpt.ParameterError, match=r"turbidity: must lie in \[1, 10\], found 0.5"):
        params["turbidity"] = 0.5
    params["hour"], params["turbidity"], params["albedo.value"] = 12.25, 5.2, 0.7
    params.update()
    fresh = djpt.load_dict({"type": "sunsky", "turbidity": 5.2, "hour": 12.25, "albedo": 0.7})
    directions = np.random.default_rng(0).normal(size=(64, 3))
    np.testing.assert_allclose(radiance(edited, *directions), radiance(fresh, *directions), rtol=1e-5)


# ---------------------------------------------------------------- derivatives


def test_radiance_by_albedo_and_sun_direction() -> None:
    """Against differences of the radiance itself, away from the disc."""

    def value(albedo: list[float], direction: list[float]) -> float:
        emitter = djpt.load_dict(sky(albedo={"type": "rgb", "value": albedo}, sun_direction=direction, sun_scale=0.0))
        return float(radiance(emitter, [-1, 0.2, 0.7], [0.1, -0.9, 0.4]).sum())

    albedo, direction = [0.2, 0.4, 0.6], [0.3, 0.5, 0.6]
    emitter = djpt.load_dict(sky(albedo={"type": "rgb", "value": albedo}, sun_direction=direction, sun_scale=0.0))
    params = djpt.traverse(emitter)
    for key in ("albedo.value", "sun_direction"):
        dr.enable_grad(params[key])
    params.update()
    si = dr.zeros(djpt.SurfaceInteraction3f, 2)
    d = dr.normalize(Vector3f([-1, 0.1], [0.2, -0.9], [0.7, 0.4]))
    si.wi = -d
    dr.backward(dr.sum(emitter.eval(si), axis=None))
    gradient = np.array(params["albedo.value"].grad).ravel()
    for found, axis in zip(gradient, np.eye(3), strict=True):
        difference = quotient(lambda x, axis=axis: value(list(albedo + x * axis), direction), 2e-2)
        assert found == pytest.approx(difference, rel=2e-2)
    unit = np.array(direction) / np.linalg.norm(direction)
    across = np.cross(unit, [0, 0, 1])
    difference = quotient(lambda x: value(albedo, list(unit + x * across)), 2e-2)
    along = float(np.array(params["sun_direction"].grad).ravel() @ across)
    assert along == pytest.approx(difference, rel=2e-2)


def test_gradient_of_an_image() -> None:
    """By the sky's albedo, against a difference with the same seed."""

    light = sky(albedo=0.4, to_world=UPRIGHT, sun_direction=[-1, 2, 1.5], sun_scale=0.0)
    found, expected = by_both(djpt.load_dict(floor_scene({"light": light})), "light.albedo.value", 0.05, spp=8)
    assert found == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize("complex_sun", [False, True])
def test_light_by_the_direction_of_the_sun(complex_sun: bool) -> None:
    """The light that falls on a plate, as the sun moves: the edge of its disc moves, too."""
    light = sky(sun_aperture=40.0, sky_scale=0.0, complex_sun=complex_sun)
    place = T().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    scene = djpt.load_dict(
        {
            "type": "scene",
            "sensor": {"type": "perspective", "to_world": place, "film": film},
            "plate": {"type": "rectangle", "to_world": T().scale(9)},
            "light": light,
        }
    )
    params, theta = djpt.traverse(scene), Float(0)
    start, across = Vector3f([0.3, 0.5, 0.6]), Vector3f([0.2, -0.1, 0.3])

    def total(x: Float, integrator: str) -> Any:
        params["light.sun_direction"] = start + across * x
        params.update()
        image = djpt.render(scene, params, integrator=djpt.load_dict({"type": integrator, "max_depth": 2}), spp=16384)
        return dr.mean(image, axis=None)

    dr.enable_grad(theta)
    dr.set_grad(theta, 1.0)
    found = float(np.array(dr.forward_to(total(theta, "prb"))).ravel()[0])
    expected = quotient(lambda x: float(np.array(total(Float(x), "path")).ravel()[0]), 2e-2)
    assert found == pytest.approx(expected, rel=0.05)


def test_colours_of_the_sky() -> None:
    """Blue above, reddish and bright about a low sun."""
    emitter = djpt.load_dict(sky(sun_direction=[1, 0, 0.1], sun_scale=0.0))
    above, about = radiance(emitter, [-0.3, 0, 1], [1, 0, 0.2]).T
    assert above[2] > 1.5 * above[0] and about[0] > about[2] and about.sum() > 5 * above.sum()
    assert isinstance(emitter.dome.A, Color3f)


@pytest.mark.parametrize("plugin", ["sunsky", "timed_sunsky"])
@pytest.mark.parametrize("key", ["timezone", "longitude"])
def test_times_and_places_have_bounds(plugin: str, key: str) -> None:
    with pytest.raises(djpt.SceneError, match=rf"^{plugin}: '{key}' must lie in \[-1e\+06, 1e\+06\]"):
        djpt.load_dict({"type": plugin, key: 3.4e38})
    params = djpt.traverse(djpt.load_dict({"type": plugin}))
    with pytest.raises(djpt.ParameterError, match=f"{key}: must lie in"):
        params[key] = -1e10

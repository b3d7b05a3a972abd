"""Spectra of a scene description: the colours that Mitsuba turns them into."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.images.colorimetry import spectrum_to_rgb

SPECTRA = {
    "inside": [(400, 0.1), (500, 0.5), (600, 0.9)],
    "constant": [(360, 0.5), (830, 0.5)],
    "beyond the visible": [(300, 0.5), (400, 0.3), (410, 0.2), (420, 0.9), (900, 0.5)],
    "pure green": [(500, 1), (520, 1)],
    "pure red": [(640, 0.1), (700, 1)],
}


@pytest.mark.parametrize("pairs", SPECTRA.values(), ids=list(SPECTRA))
@pytest.mark.parametrize("key", ["reflectance", "radiance"])
def test_colours_are_mitsubas(pairs: list[tuple[float, float]], key: str) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    plugin = {"type": "diffuse" if key == "reflectance" else "constant", key: {"type": "spectrum", "value": pairs}}
    ours = np.array(djpt.traverse(djpt.load_dict(plugin))[f"{key}.value"])
    theirs = np.array(mi.traverse(mi.load_dict(plugin))[f"{key}.value"])
    np.testing.assert_allclose(ours, theirs, atol=2e-6)
    assert theirs.max() > 0


def test_a_number_is_grey() -> None:
    bsdf = djpt.load_dict({"type": "diffuse", "reflectance": {"type": "spectrum", "value": 0.25}})
    assert np.array(djpt.traverse(bsdf)["reflectance.value"]).ravel().tolist() == [0.25] * 3


def test_a_number_of_a_light_is_the_white_of_equal_energies() -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    light = {"type": "point", "intensity": {"type": "spectrum", "value": 50}}
    ours, theirs = (module.traverse(module.load_dict(light))["intensity.value"] for module in (djpt, mi))
    np.testing.assert_allclose(np.array(ours), np.array(theirs), rtol=1e-6)
    text = '<emitter version="3.0.0" type="constant"><spectrum name="radiance" value="1"/></emitter>'
    ours, theirs = (module.traverse(module.load_string(text))["radiance.value"] for module in (djpt, mi))
    np.testing.assert_allclose(np.array(ours), np.array(theirs), rtol=1e-6)


def test_two_lights_share_a_number() -> None:
    paint, ref = {"type": "spectrum", "value": 2.0}, {"type": "ref", "id": "paint"}
    sky, lamp = {"type": "constant", "radiance": ref}, {"type": "point", "intensity": ref}
    params = djpt.traverse(djpt.load_dict({"type": "scene", "paint": paint, "sky": sky, "lamp": lamp}))
    white = [2 * 1.20479, 2 * 0.948291, 2 * 0.908916]
    np.testing.assert_allclose(np.array(params["paint.value"]).ravel(), white, rtol=1e-5)


def test_equal_energy_is_the_white_of_the_colour_matching_functions() -> None:
    # Illuminant E has x = y = 1/3: its XYZ are equal, up to the tables' own 4e-4.
    rgb = spectrum_to_rgb([360, 830], [1, 1], under_d65=False)
    xyz = np.linalg.solve(
        [[3.240479, -1.53715, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]], rgb
    )
    np.testing.assert_allclose(xyz, 1, atol=5e-4)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("red", "'value' must be numbers, found str 'red'"),
        ([(400, 1)], "two or more pairs"),
        ([1, 2, 3], "two or more pairs"),
        ([(500, 1), (400, 1)], "increasing wavelengths"),
        ([(400, 1), (500, float("nan"))], "must be finite"),
    ],
)
def test_errors_name_the_node(value: Any, message: str) -> None:
    with pytest.raises(djpt.SceneError, match=message) as caught:
        djpt.load_dict({"type": "scene", "a": {"type": "diffuse", "reflectance": {"type": "spectrum", "value": value}}})
    assert str(caught.value).startswith("scene.a.reflectance: 'value'")


def test_a_reflectance_above_one_is_refused_for_a_number_and_clipped_for_a_spectrum() -> None:
    with pytest.raises(djpt.SceneError, match=r"must lie in \[0, 1\]"):
        djpt.load_dict({"type": "diffuse", "reflectance": {"type": "spectrum", "value": 1.5}})
    bright = {"type": "spectrum", "value": [(400, 1.5), (700, 1.5)]}
    bsdf = djpt.load_dict({"type": "diffuse", "reflectance": bright})
    assert np.array(djpt.traverse(bsdf)["reflectance.value"]).ravel().tolist() == [1.0, 1.0, 1.0]

"""Spectra as plugins: the numbers that Mitsuba has for them, as paint and as light."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt

CLAY = [0.1, 0.5, 0.9]
CASES: dict[str, dict[str, Any]] = {
    "srgb": {"type": "srgb", "color": CLAY},
    "srgb of a colour": {"type": "srgb", "color": {"type": "rgb", "value": CLAY}},
    "bright srgb": {"type": "srgb", "color": [2.0, 0.5, 0.9], "unbounded": True},
    "one raw number": {"type": "rawconstant", "value": 2.5},
    "three raw numbers": {"type": "rawconstant", "value": [2.5, -1.0, 2.0]},
    "d65": {"type": "d65"},
    "scaled d65": {"type": "d65", "scale": 0.3},
    "d65 with a colour": {"type": "d65", "scale": 0.5, "color": CLAY},
    "d65 with a texture": {"type": "d65", "scale": 3.0, "nested": {"type": "checkerboard"}},
    "uniform": {"type": "uniform", "value": 0.7},
    "uniform in a range": {"type": "uniform", "value": 0.7, "wavelength_min": 400.0, "wavelength_max": 700.0},
}
PAIRS = [(400.0, 0.1), (500.0, 0.5), (600.0, 0.2)]
SPECTRA: dict[str, dict[str, Any]] = {
    "regular": {"type": "regular", "wavelength_min": 400.0, "wavelength_max": 600.0, "values": "0.1, 0.5, 0.2"},
    "irregular": {"type": "irregular", "wavelengths": "400, 500, 600", "values": "0.1, 0.5, 0.2"},
    "nested regular": {"type": "regular", "value": {"type": "spectrum", "value": PAIRS}},
    "nested irregular": {"type": "irregular", "value": {"type": "spectrum", "value": PAIRS}},
}


def mitsuba() -> Any:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    return mi


def answers(module: Any, texture: Any, questions: tuple[str, ...] = ("eval", "eval_1", "mean", "max")) -> list[Any]:
    """What a texture says about a point of a surface; None where it has no answer."""
    si = dr.zeros(module.SurfaceInteraction3f)
    found: list[Any] = []
    for question in questions:
        try:
            answer = getattr(texture, question)(*([si] if question.startswith("eval") else []))
        except RuntimeError:
            found.append(None)
            continue
        found.append(np.array(answer).ravel())
    return found


@pytest.mark.parametrize("description", CASES.values(), ids=list(CASES))
def test_values_and_names_are_mitsubas(description: dict[str, Any]) -> None:
    mi = mitsuba()
    ours, theirs = djpt.load_dict(description), mi.load_dict(description)
    for own, other in zip(answers(djpt, ours), answers(mi, theirs), strict=True):
        if other is not None:
            np.testing.assert_allclose(own, other, rtol=1e-6)
    assert set(djpt.traverse(ours).keys()) == {key for key, _ in mi.traverse(theirs)}


@pytest.mark.parametrize("name", ["srgb", "one raw number", "three raw numbers", "uniform"])
def test_a_sampled_spectrum_is_the_colour(name: str) -> None:
    mi = mitsuba()
    weights = []
    for module in (djpt, mi):
        si = dr.zeros(module.SurfaceInteraction3f)
        weights.append(module.load_dict(CASES[name]).sample_spectrum(si, sample=si.wavelengths)[1])
    np.testing.assert_allclose(*(np.array(weight).ravel() for weight in weights), rtol=1e-6)
    with pytest.raises(djpt.DjptError, match="no wavelengths"):
        djpt.load_dict({"type": "checkerboard"}).sample_spectrum(None)


@pytest.mark.parametrize("user", [{"type": "constant"}, {"type": "diffuse"}], ids=["light", "paint"])
@pytest.mark.parametrize("name", ["srgb", "d65 with a colour", "three raw numbers", "scaled d65", "bright srgb"])
def test_users_see_mitsubas_numbers(name: str, user: dict[str, Any]) -> None:
    mi = mitsuba()
    key = "radiance" if user["type"] == "constant" else "reflectance"
    ours, theirs = (m.traverse(m.load_dict({**user, key: CASES[name]}))[f"{key}.value"] for m in (djpt, mi))
    np.testing.assert_allclose(np.array(ours).ravel(), np.array(theirs).ravel(), rtol=1e-6)


def test_three_raw_numbers_are_no_scalar() -> None:
    texture = djpt.load_dict(CASES["three raw numbers"])
    with pytest.raises(djpt.DjptError, match=r"eval_1\(\) is not defined for 3D-valued textures"):
        texture.eval_1(dr.zeros(djpt.SurfaceInteraction3f))


def test_raw_numbers_are_edited_in_their_own_shape() -> None:
    params = djpt.traverse(djpt.load_dict({"type": "rawconstant", "value": 0.5}))
    params["value"] = 7.0
    params.update()
    with pytest.raises(djpt.DjptError, match="must be one number"):
        params["value"] = [1.0, 2.0, 3.0]
    params["value"] = djpt.Float(-2)
    params.update()
    assert params["value"][0] == -2


def test_a_number_of_each_sort_in_one_scene() -> None:
    # One number and three are different kernels: a scene may have both.
    walls = {
        name: {
            "type": "rectangle",
            "to_world": djpt.ScalarTransform4f().translate([x, 0, 0]),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rawconstant", "value": value}},
        }
        for name, x, value in (("left", -1, 0.25), ("right", 1, [0.5, 0.25, 0.125]))
    }
    camera = {
        "type": "orthographic",
        "to_world": djpt.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0]).scale([2, 2, 1]),
        "film": {"type": "hdrfilm", "width": 2, "height": 1, "rfilter": {"type": "box"}},
    }
    exact = {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1}  # each sample is the albedo
    scene = {"type": "scene", "light": exact, **walls, "sky": {"type": "constant"}, "camera": camera}
    image = np.array(djpt.render(djpt.load_dict(scene), spp=4))
    shown = sorted(image.reshape(2, 3).tolist())
    np.testing.assert_allclose(shown, [[0.25] * 3, [0.5, 0.25, 0.125]], rtol=1e-5)


@pytest.mark.parametrize("description", SPECTRA.values(), ids=list(SPECTRA))
@pytest.mark.parametrize("user", [{"type": "constant"}, {"type": "diffuse"}], ids=["light", "paint"])
def test_spectra_have_the_colour_of_their_pairs(description: dict[str, Any], user: dict[str, Any]) -> None:
    mi = mitsuba()
    key = "radiance" if user["type"] == "constant" else "reflectance"
    mi.load_dict(description)  # Mitsuba loads it, and can't evaluate it
    ours = answers(djpt, getattr(djpt.load_dict({**user, key: description}), key), ("eval",))[0]
    pairs = {"type": "spectrum", "value": PAIRS}
    theirs = mi.traverse(mi.load_dict({**user, key: pairs}))[f"{key}.value"]
    np.testing.assert_allclose(ours, np.array(theirs).ravel(), rtol=1e-5, atol=1e-6)
    names = {name for name, _ in mi.traverse(mi.load_dict(description))}
    assert set(djpt.traverse(djpt.load_dict(description)).keys()) == names


@pytest.mark.parametrize("kelvin", [1500.0, 5000.0, 12000.0])
def test_black_bodies_are_plancks(kelvin: float) -> None:
    mi = mitsuba()
    wavelengths = np.linspace(360, 830, 1000)
    c, h, k = 2.99792458e8, 6.62607004e-34, 1.38064852e-23
    power = 2e-9 * h * c**2 / (wavelengths * 1e-9) ** 5 / np.expm1(h * c / (k * kelvin * wavelengths * 1e-9))
    pairs = {"type": "spectrum", "value": list(zip(wavelengths.tolist(), power.tolist(), strict=True))}
    ours = djpt.load_dict({"type": "constant", "radiance": {"type": "blackbody", "temperature": kelvin}})
    theirs = mi.traverse(mi.load_dict({"type": "constant", "radiance": pairs}))["radiance.value"]
    np.testing.assert_allclose(answers(djpt, ours.radiance, ("eval",))[0], np.array(theirs).ravel(), rtol=1e-5)


@pytest.mark.parametrize("kelvin", [5e-324, 1e-300, 1e-30, 1.0])
def test_cold_bodies_are_black(kelvin: float) -> None:
    body = djpt.load_dict({"type": "blackbody", "temperature": kelvin})
    assert not np.array(body.eval(None)).any()


def test_edits_change_the_colour() -> None:
    lamp = {"type": "constant", "radiance": {"type": "blackbody", "temperature": 3000.0}}
    light, hotter = djpt.load_dict(lamp), djpt.load_dict({**lamp, "radiance": {**lamp["radiance"], "temperature": 6e3}})
    params = djpt.traverse(light)
    params["radiance.temperature"] = 6000.0
    params.update()
    np.testing.assert_array_equal(*(answers(djpt, x.radiance, ("eval",))[0] for x in (light, hotter)))
    paint = djpt.load_dict({"type": "diffuse", "reflectance": SPECTRA["regular"]})
    params = djpt.traverse(paint)
    params["reflectance.values"] = djpt.Float(0.2, 0.2, 0.2)
    params.update()
    assert answers(djpt, paint.reflectance, ("eval",))[0].max() < 0.3
    with pytest.raises(djpt.DjptError, match="one per wavelength"):
        djpt.traverse(djpt.load_dict(SPECTRA["irregular"])).update({"values": [0.1, 0.2]})


def test_a_spectrum_may_be_a_file(tmp_path: Any) -> None:
    (tmp_path / "leaf.spd").write_text("# nm, share\n400 0.1\n500 0.5\n600 0.2\n")
    texture = djpt.load_dict({"type": "spectrum", "filename": str(tmp_path / "leaf.spd")})
    given = djpt.load_dict({"type": "spectrum", "value": PAIRS})
    np.testing.assert_array_equal(*(answers(djpt, x, ("eval",))[0] for x in (texture, given)))


@pytest.mark.parametrize(
    ("description", "message"),
    [
        ({"type": "srgb", "color": [2.0, 0, 0]}, "'color' must lie in .0, 1., found 2, or 'unbounded' be true"),
        ({"type": "srgb"}, "needs the key 'color'"),
        ({"type": "srgb", "color": 0.5}, "must be three numbers"),
        ({"type": "rawconstant", "value": [1, 2]}, "must be one or three numbers"),
        ({"type": "d65", "color": CLAY, "nested": {"type": "checkerboard"}}, "takes one texture or a 'color'"),
        ({"type": "blackbody", "temperature": 0.0}, "'temperature' must be greater than 0"),
        ({"type": "blackbody", "temperature": 1e3, "wavelength_min": 900, "wavelength_max": 999}, "no visible light"),
        ({"type": "regular", "wavelength_min": 400, "wavelength_max": 500, "values": "1"}, "two or more values"),
        (
            {"type": "regular", "wavelength_min": 400, "wavelength_max": 500, "values": "a"},
            "must be numbers separated by commas, found str 'a'",
        ),
        ({"type": "regular", "value": 3.0}, "must be a 'spectrum' of several wavelengths"),
        ({"type": "irregular", "wavelengths": "500, 400", "values": "1, 2"}, "increasing wavelengths"),
        ({"type": "spectrum", "filename": "nowhere.spd"}, "'filename' .*nowhere.spd"),
    ],
)
def test_errors_say_what_is_wrong(description: dict[str, Any], message: str) -> None:
    with pytest.raises(djpt.DjptError, match=message):
        djpt.load_dict(description)

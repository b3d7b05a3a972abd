"""Fresnel's equations, microfacets and spectra as scripts call them: the same numbers as Mitsuba's."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.errors import ArgumentError, FileError
from tests.kit.same_calls import same

COS = [-1.0, -0.4, 0.0, 0.1, 0.7, 1.0]
WI = [0.36, -0.48, 0.8]
WO = [-0.6, 0.0, 0.8]
TILTED = [0.0, 0.6, 0.8]
DIRECTIONS = [[0.1, -0.5, 0.0, 0.9], [0.3, 0.2, 0.0, -0.1], [0.9, 0.8, 1.0, 0.2]]
SAMPLES = [[0.1, 0.5, 0.9], [0.3, 0.2, 0.99]]

CALLS: list[Callable[[Any], Any]] = [
    *(lambda m, eta=eta: m.fresnel(COS, eta) for eta in (1.5, 1 / 1.5, 1.0)),
    *(lambda m, eta=eta: m.fresnel_conductor([0.1, 0.7, 1.0], eta) for eta in (1.5, [0.2, 3.0], [1.1, -2.0], 0.7)),
    lambda m: m.fresnel_conductor([0.1, 0.7, 1.0], m.Complex2f(0.2, 3) if hasattr(m, "Complex2f") else 0.2 + 3j),
    *(lambda m, eta=eta: m.fresnel_polarized(COS, eta) for eta in (1.5, 1 / 1.5, [0.2, 3.0], [1.3, -0.5])),
    *(lambda m, eta=eta: m.fresnel_diffuse_reflectance(eta) for eta in (0.7, 1.0, 1.5, 2.4)),
    lambda m: m.reflect(WI),
    lambda m: m.reflect(WI, TILTED),
    lambda m: m.refract(WI, -0.9, 0.7),
    lambda m: m.refract(WI, TILTED, -0.9, 0.7),
    lambda m: m.refract(wi=WI, cos_theta_t=-0.9, eta_ti=0.7),
    lambda m: m.refract(WI, m=TILTED, cos_theta_t=-0.9, eta_ti=0.7),
    lambda m: m.sph_to_dir([0, 1, 3], [0, -2, 1]),
    lambda m: m.dir_to_sph([[0, 0, 0.6, 1e-4], [0, 0, -0.64, 0], [1, -1, 0.48, 1]]),
    lambda m: m.luminance([1, 2, 3]),
    lambda m: m.luminance(m.Color3f([1, 0], [2, 1], [3, 0])),
    lambda m: m.luminance(c=[1, 2, 3]),
    lambda m: m.xyz_to_srgb([0.3, 0.4, 0.5]),
    lambda m: m.srgb_to_xyz([0.3, 0.4, 0.5]),
    lambda m: m.cie1931_xyz([300, 360, 452.3, 600, 830, 900]),
    lambda m: m.cie1931_y([300, 360, 452.3, 600, 830, 900]),
    lambda m: m.cie_d65([300, 360, 452.3, 600, 830, 900]),
    lambda m: m.linear_rgb_rec([300, 360, 452.3, 600, 830, 900]),
    lambda m: m.sample_rgb_spectrum([0.0, 0.1, 0.5, 0.99]),
    lambda m: m.pdf_rgb_spectrum([300.0, 400.0, 538.0, 830.0, 900.0]),
    lambda m: m.unpolarized_spectrum([1, 2, 3]),
    lambda m: m.depolarizer([1, 2, 3]),
    lambda m: m.spectrum_list_to_srgb([400, 500, 600], [0.1, 0.2, 0.3]),
    lambda m: m.spectrum_list_to_srgb([350, 500, 600, 900], [0.4, 0.2, 0.3, 0.5], True, True),
    lambda m: m.spectrum_list_to_srgb([400, 500, 600], [2.1, 3.2, 4.3], bounded=False),
    lambda m: [m.MI_CIE_MIN, m.MI_CIE_MAX, m.MI_CIE_Y_NORMALIZATION, m.MI_CIE_D65_NORMALIZATION],
]

DISTRIBUTIONS: list[Callable[[Any], Any]] = [
    lambda m: m.MicrofacetDistribution(m.MicrofacetType.Beckmann, 0.3),
    lambda m: m.MicrofacetDistribution(m.MicrofacetType.GGX, 0.3, False),
    lambda m: m.MicrofacetDistribution(m.MicrofacetType.GGX, 0.3, 0.5),
    lambda m: m.MicrofacetDistribution(m.MicrofacetType.Beckmann, 0.3, 0.5, False),
    lambda m: m.MicrofacetDistribution(m.MicrofacetType.GGX, alpha=0.2, sample_visible=False),
    lambda m: m.MicrofacetDistribution(type=m.MicrofacetType.GGX, alpha_u=m.Float(0.2), alpha_v=m.Float(0.4)),
]

QUERIES: list[Callable[[Any], Any]] = [
    lambda d: d.eval(DIRECTIONS),
    lambda d: d.pdf(WI, DIRECTIONS),
    lambda d: d.smith_g1(WI, DIRECTIONS),
    lambda d: d.G(WI, WO, DIRECTIONS),
    lambda d: d.sample(WI, SAMPLES),
    lambda d: d.sample_visible_11([0.2, 0.5, 0.9], SAMPLES),
    lambda d: [d.alpha(), d.alpha_u(), d.alpha_v(), int(d.type())],
    lambda d: [d.sample_visible(), d.is_isotropic(), d.is_anisotropic()],
]


@pytest.mark.sparse(3)
@pytest.mark.parametrize("call", CALLS)
def test_same_numbers(call: Callable[[Any], Any], mi: Any) -> None:
    same(call, mi, rtol=3e-5)


@pytest.mark.sparse(3)
@pytest.mark.parametrize("make", DISTRIBUTIONS)
def test_microfacets_have_mitsubas_numbers(make: Callable[[Any], Any], mi: Any) -> None:
    for query in QUERIES:
        same(lambda m, query=query: query(make(m)), mi, rtol=1e-3, atol=2e-5)

    def scaled(m: Any) -> Any:
        distribution = make(m)
        distribution.scale_alpha(2)
        return [distribution.alpha_u(), distribution.alpha_v(), distribution.eval(DIRECTIONS)]

    same(scaled, mi, rtol=1e-4)


def test_microfacets_by_names_and_properties(mi: Any) -> None:
    assert djpt.MicrofacetDistribution("ggx", 0.1).type() == djpt.MicrofacetType.GGX
    assert repr(djpt.MicrofacetDistribution("ggx", 0.1)) == repr(mi.MicrofacetDistribution(mi.MicrofacetType.GGX, 0.1))
    assert [int(kind) for kind in djpt.MicrofacetType] == [int(kind) for kind in mi.MicrofacetType]
    with pytest.raises(ArgumentError, match="unknown type 'gxx'; did you mean 'ggx'"):
        djpt.MicrofacetDistribution("gxx", 0.1)
    with pytest.raises(ArgumentError, match="one roughness is needed"):
        djpt.MicrofacetDistribution("ggx")


@pytest.mark.parametrize("eta", [1.5, 1 / 1.5])
def test_reflectance_of_rough_surfaces(eta: float, mi: Any) -> None:
    """Mitsuba integrates packets of directions, so it is given sixteen of them."""
    cos = np.linspace(0.05, 1, 16, dtype=np.float32)
    wi = [np.sqrt(1 - cos**2), np.zeros(16, np.float32), cos]
    same(lambda m: m.eval_reflectance(m.MicrofacetType.GGX, 0.3, 0.3, m.Vector3f(*wi), eta), mi, rtol=2e-3)


def test_indices_of_refraction_by_name() -> None:
    assert djpt.lookup_ior({}, "int_ior", "BK7") == 1.5046  # type: ignore[arg-type]
    assert djpt.lookup_ior({"int_ior": 1.7}, "int_ior", "bk7") == 1.7  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="unknown medium 'watr'; did you mean 'water'"):
        djpt.lookup_ior({"int_ior": "watr"}, "int_ior", "bk7")  # type: ignore[arg-type]


def test_spectra_in_files(tmp_path: Path, mi: Any) -> None:
    wavelengths, values = [400.0, 500.25, 600.0], [0.125, 0.5, 1e-3]
    path = tmp_path / "a.spd"
    djpt.spectrum_to_file(path, wavelengths, values)
    assert djpt.spectrum_from_file(path) == (wavelengths, values)
    np.testing.assert_allclose(mi.spectrum_from_file(str(path)), (wavelengths, values), rtol=1e-6)
    path.write_text("# a comment\n400 1 # here, too\n\n500 2\n")
    assert djpt.spectrum_from_file(str(path)) == ([400, 500], [1, 2])
    path.write_text("400 1\n500\n")
    with pytest.raises(FileError, match=":2: must be two numbers"):
        djpt.spectrum_from_file(path)
    with pytest.raises(FileError, match="there is no such file"):
        djpt.spectrum_from_file(tmp_path / "b.spd")
    with pytest.raises(RuntimeError, match=r"end in \.spd"):
        djpt.spectrum_from_file(tmp_path / "b.txt")


def test_clipped_colours_are_announced() -> None:
    with pytest.warns(UserWarning, match="is clipped"):
        colour = djpt.spectrum_list_to_srgb([400, 500, 600], [10, 0.2, 0.3], True, True)
    assert list(colour)[1:] == [0, 1]


def test_what_no_spectrum_is() -> None:
    with pytest.raises(ArgumentError, match="found 2 and 1"):
        djpt.spectrum_list_to_srgb([400, 500], [1])

"""Where the names for scripts are defined: the table that `djpt` looks them up in."""

from __future__ import annotations

__all__ = ["EXPORTS", "SUBMODULES"]

EXPORTS: dict[str, str] = {
    "djpt.scripting.angles": "dir_to_sph sph_to_dir",
    "djpt.scripting.distributions_1d": "ContinuousDistribution DiscreteDistribution IrregularContinuousDistribution",
    "djpt.scripting.distributions_2d": "DiscreteDistribution2D",
    "djpt.scripting.distributions_conditional": "ConditionalIrregular1D ConditionalRegular1D",
    "djpt.scripting.distributions_hierarchical": "Hierarchical2D0 Hierarchical2D1 Hierarchical2D2 Hierarchical2D3",
    "djpt.scripting.distributions_marginal": (
        "MarginalContinuous2D0 MarginalContinuous2D1 MarginalContinuous2D2 MarginalContinuous2D3 "
        "MarginalDiscrete2D0 MarginalDiscrete2D1 MarginalDiscrete2D2 MarginalDiscrete2D3"
    ),
    "djpt.scripting.fresnel": (
        "fresnel fresnel_conductor fresnel_diffuse_reflectance fresnel_polarized lookup_ior reflect refract"
    ),
    "djpt.scripting.microfacet": "MicrofacetDistribution MicrofacetType eval_reflectance",
    "djpt.scripting.qmc": "RadicalInverse radical_inverse_2 sobol_2",
    "djpt.scripting.random_numbers": (
        "Philox4x32 ScalarPCG32 permute permute_kensler sample_tea_32 sample_tea_64 sample_tea_float "
        "sample_tea_float32 sample_tea_float64"
    ),
    "djpt.scripting.spectra": (
        "MI_CIE_D65_NORMALIZATION MI_CIE_MAX MI_CIE_MIN MI_CIE_Y_NORMALIZATION cie1931_xyz cie1931_y cie_d65 "
        "depolarizer linear_rgb_rec luminance pdf_rgb_spectrum sample_rgb_spectrum spectrum_from_file "
        "spectrum_list_to_srgb spectrum_to_file srgb_to_xyz unpolarized_spectrum xyz_to_srgb"
    ),
}
"""The modules of names that are attributes of `djpt`, each with its names, separated by spaces."""

SUBMODULES: dict[str, str] = {
    "chi2": "djpt.chi2",
    "math": "djpt.math",
    "math_py": "djpt.scripting.statistics",
    "quad": "djpt.quad",
    "spline": "djpt.scripting.splines",
}
"""Attributes of `djpt` that are modules, with the modules that they stand for."""

"""Where the names for scripts are defined: the table that `djpt` looks them up in."""

from __future__ import annotations

from djpt.mitsuba.array_names import ARRAYS

__all__ = ["EXPORTS", "SUBMODULES", "VARIANT_MODULES"]

EXPORTS: dict[str, str] = {
    "djpt.description.endpoint": "Endpoint",
    "djpt.description.files": "FileResolver file_resolver set_file_resolver",
    "djpt.media.pointer": "MediumPtr",
    "djpt.shapes.mesh_pointer": "MeshPtr",
    "djpt.phase.pointer": "PhaseFunctionPtr",
    "djpt.textures.pointer": "TexturePtr",
    "djpt.distributions.marginal_2d": (
        "MarginalContinuous2D0 MarginalContinuous2D1 MarginalContinuous2D2 MarginalContinuous2D3 MarginalDiscrete2D0 "
        "MarginalDiscrete2D1 MarginalDiscrete2D2 MarginalDiscrete2D3"
    ),
    "djpt.films.base": "Film FilmFlags",
    "djpt.films.image_block": "ImageBlock",
    "djpt.integrators.base": "SamplingIntegrator",
    "djpt.integrators.paths.unidirectional": "MonteCarloIntegrator",
    "djpt.media.base": "Medium",
    "djpt.phase.base": "PhaseFunction",
    "djpt.phase.microflakes": "SGGXPhaseFunctionParams sggx_pdf sggx_projected_area sggx_sample",
    "djpt.core.records.flags": "DiscontinuityFlags PhaseFunctionContext PhaseFunctionFlags",
    "djpt.core.records.media": "MediumInteraction3f",
    "djpt.rfilters.base": "ReconstructionFilter",
    "djpt.samplers.base": "Sampler",
    "djpt.integrators.ad_integrator": "CppADIntegrator",
    "djpt.mitsuba.adjoint_integrators": "AdjointIntegrator",
    "djpt.mitsuba.angles": "dir_to_sph sph_to_dir",
    "djpt.mitsuba.arrays": " ".join(ARRAYS),
    "djpt.images.bitmap": "Bitmap",
    "djpt.mitsuba.constants": (
        "DEBUG MI_AUTHORS MI_CIE_D65_NORMALIZATION MI_CIE_MAX MI_CIE_MIN MI_CIE_Y_NORMALIZATION MI_ENABLE_CUDA "
        "MI_ENABLE_EMBREE MI_ENABLE_METAL MI_FILTER_RESOLUTION MI_VERSION MI_VERSION_MAJOR MI_VERSION_MINOR "
        "MI_VERSION_PATCH MI_YEAR"
    ),
    "djpt.mitsuba.denoiser": "OptixDenoiser",
    "djpt.distributions.distributions_1d": (
        "ContinuousDistribution DiscreteDistribution IrregularContinuousDistribution"
    ),
    "djpt.mitsuba.distributions": (
        "ConditionalIrregular1D ConditionalRegular1D DiscreteDistribution2D Hierarchical2D0 Hierarchical2D1 "
        "Hierarchical2D2 Hierarchical2D3"
    ),
    "djpt.mitsuba.fresnel": (
        "fresnel fresnel_conductor fresnel_diffuse_reflectance fresnel_polarized lookup_ior reflect refract"
    ),
    "djpt.mitsuba.log": (
        "Appender DefaultFormatter Formatter Log LogLevel Logger StreamAppender Thread log_level logger "
        "set_log_level set_logger"
    ),
    "djpt.mitsuba.microfacet": "MicrofacetDistribution MicrofacetType eval_reflectance",
    "djpt.mitsuba.objects": "Object ObjectType PluginManager TraversalCallback register_phasefunction",
    "djpt.sensors.projection_matrices": "orthographic_projection parse_fov perspective_projection",
    "djpt.mitsuba.random_numbers": (
        "Philox4x32 RadicalInverse ScalarPCG32 permute permute_kensler radical_inverse_2 sample_tea_32 sample_tea_64 "
        "sample_tea_float sample_tea_float32 sample_tea_float64 sobol_2"
    ),
    "djpt.core.records.ray_variants": (
        "Ray2d Ray2f Ray3d RayDifferential3f ScalarRay2d ScalarRay2f ScalarRay3d ScalarRay3f"
    ),
    "djpt.images.resampler": "BitmapReconstructionFilter FilterBoundaryCondition Resampler",
    "djpt.mitsuba.run": "Timer Version while_loop",
    "djpt.mitsuba.spectra": (
        "cie1931_xyz cie1931_y cie_d65 depolarizer linear_rgb_rec luminance pdf_rgb_spectrum sample_rgb_spectrum "
        "spectrum_from_file spectrum_list_to_srgb spectrum_to_file srgb_to_xyz unpolarized_spectrum xyz_to_srgb"
    ),
    "djpt.mitsuba.streams": "DummyStream FileStream MemoryMappedFile MemoryStream Stream",
    "djpt.images.structs": "Struct StructConverter",
    "djpt.mitsuba.tensor_io": "TensorFile",
    "djpt.core.transforms.projective": (
        "AffineTransform3d AffineTransform4d ProjectiveTransform3d ProjectiveTransform3f ProjectiveTransform4d "
        "ProjectiveTransform4f ScalarAffineTransform3d ScalarAffineTransform3f ScalarAffineTransform4d "
        "ScalarAffineTransform4f ScalarProjectiveTransform3d ScalarProjectiveTransform3f ScalarProjectiveTransform4d "
        "ScalarProjectiveTransform4f ScalarTransform3d ScalarTransform4d Transform3d Transform4d"
    ),
    "djpt.mitsuba.variants": "is_monochromatic is_polarized is_rgb is_spectral scoped_set_variant variant_context",
    "djpt.sensors.base": "Sensor",
    "djpt.sensors.projective": "ProjectiveCamera",
    "djpt.shapes.silhouettes.samples": "SilhouetteSample3f",
    "djpt.textures.base": "Texture",
    "djpt.volumes.base": "Volume",
    "djpt.volumes.volume_grid": "VolumeGrid",
}
"""The modules of names that are attributes of `djpt`, each with its names, separated by spaces."""

SUBMODULES: dict[str, str] = {
    "chi2": "djpt.mitsuba.chi2",
    "filesystem": "djpt.mitsuba.filesystem",
    "math": "djpt.mitsuba.math",
    "math_py": "djpt.mitsuba.statistics",
    "misc": "djpt.mitsuba.misc",
    "quad": "djpt.mitsuba.quad",
    "spline": "djpt.mitsuba.spline",
    "tensor_io": "djpt.mitsuba.tensor_io",
}
"""Attributes of `djpt` that are modules, with the modules that they stand for."""

VARIANT_MODULES = ("llvm_ad_rgb", "cuda_ad_rgb", "scalar_rgb", "python")
"""Mitsuba's modules that hold its names in one variant, or those written in Python; here they are `djpt` itself."""

"""The table of the names for scripts, which `djpt` looks them up in, and which of Mitsuba's are left out."""

from __future__ import annotations

from collections.abc import Iterator
from fnmatch import fnmatchcase

__all__ = ["ARRAYS", "EXPORTS", "REASONS", "SCALAR", "SUBMODULES", "VARIANT_MODULES", "reason"]

SCALAR = "Scalar"
"""The prefix of types that hold one value each, as Python sees it, in place of one per lane."""

FLOATS = {"f": "f", "d": "f64", "f16": "f16", "f32": "f", "f64": "f64"}
ENTRIES = FLOATS | {
    **dict.fromkeys(("i", "i32"), "i"),
    **dict.fromkeys(("u", "u32"), "u"),
    **{name: name for name in ("b", "i8", "i64", "u8", "u64")},
}
"""Mitsuba's suffixes for the types of entries, and those of Dr.Jit."""


def _families() -> Iterator[tuple[str, str]]:
    """Names without the prefix, each with the name of the type in Dr.Jit."""
    for stem, sizes, entries in (
        ("Array", "01234X", ENTRIES),
        ("Tensor", "X", ENTRIES),
        ("Matrix", "234", FLOATS),
        ("Quaternion", "4", FLOATS),
        ("Complex", "2", {name: entry for name, entry in FLOATS.items() if name != "f16"}),
        ("Texture", "123", FLOATS | {"f8u": "f8u"}),
    ):
        yield from ((f"{stem}{n}{name}", f"{stem}{n}{entry}") for n in sizes for name, entry in entries.items())
    # Dr.Jit has one kind of vector: what these names say about the meaning is for the reader.
    for stem, sizes, letters in (
        ("Vector", "01234", "iufd"),
        ("Point", "01234", "iufd"),
        ("Normal", "3", "fd"),
        ("Color", "013", "fd"),
    ):
        yield from ((f"{stem}{n}{name}", f"Array{n}{ENTRIES[name]}") for n in sizes for name in letters)
    for name in ("Float16", "Float32", "Float64", "Int8", "Int32", "Int64", "UInt8", "UInt32", "UInt64"):
        yield name, name
    yield from (("Float", "Float"), ("Int", "Int32"), ("UInt", "UInt32"), ("Bool", "Bool"), ("Mask", "Bool"))
    yield from (("PCG32", "PCG32"), ("Philox4x32", "Philox4x32"))


LANES = dict(_families())
ARRAYS = {
    **LANES,
    "Event": "Event",
    "Spectrum": "Array3f",
    "UnpolarizedSpectrum": "Array3f",
    **{SCALAR + name: entry for name, entry in LANES.items()},
}
"""The names, each with the name of the type in a module of Dr.Jit's: `drjit.scalar` for those with the prefix."""


# ---- the table of names ----------------------------------------------------------------------


EXPORTS: dict[str, str] = {
    "djpt.description.plugin": "Endpoint",
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
    "djpt.phase.sggx": "SGGXPhaseFunctionParams sggx_pdf sggx_projected_area sggx_sample",
    "djpt.core.records.flags": "DiscontinuityFlags PhaseFunctionContext PhaseFunctionFlags",
    "djpt.core.records.interactions": "MediumInteraction3f",
    "djpt.rfilters.base": "ReconstructionFilter",
    "djpt.samplers.base": "Sampler",
    "djpt.integrators.ad_integrator": "CppADIntegrator",
    "djpt.mitsuba.adjoint_integrators": "AdjointIntegrator",
    "djpt.mitsuba.math": "dir_to_sph sph_to_dir",
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
        "MicrofacetDistribution MicrofacetType eval_reflectance fresnel fresnel_conductor fresnel_diffuse_reflectance "
        "fresnel_polarized lookup_ior reflect refract"
    ),
    "djpt.mitsuba.log": (
        "Appender DefaultFormatter Formatter Log LogLevel Logger StreamAppender Thread log_level logger "
        "set_log_level set_logger"
    ),
    "djpt.mitsuba.objects": "Object ObjectType PluginManager TraversalCallback register_phasefunction",
    "djpt.sensors.projection_matrices": "orthographic_projection parse_fov perspective_projection",
    "djpt.sensors.projective": "ProjectiveCamera",
    "djpt.mitsuba.random_numbers": (
        "Philox4x32 RadicalInverse ScalarPCG32 permute permute_kensler radical_inverse_2 sample_tea_32 sample_tea_64 "
        "sample_tea_float sample_tea_float32 sample_tea_float64 sobol_2"
    ),
    "djpt.core.records.rays": ("Ray2d Ray2f Ray3d RayDifferential3f ScalarRay2d ScalarRay2f ScalarRay3d ScalarRay3f"),
    "djpt.images.resampler": "BitmapReconstructionFilter FilterBoundaryCondition Resampler",
    "djpt.mitsuba.misc": "Timer Version while_loop",
    "djpt.mitsuba.spectra": (
        "cie1931_xyz cie1931_y cie_d65 depolarizer linear_rgb_rec luminance pdf_rgb_spectrum sample_rgb_spectrum "
        "spectrum_from_file spectrum_list_to_srgb spectrum_to_file srgb_to_xyz unpolarized_spectrum xyz_to_srgb"
    ),
    "djpt.mitsuba.streams": "DummyStream FileStream MemoryMappedFile MemoryStream Stream ZStream",
    "djpt.images.structs": "Struct StructConverter",
    "djpt.mitsuba.tensor_io": "TensorFile",
    "djpt.core.transforms.lanes": (
        "AffineTransform3d AffineTransform4d ProjectiveTransform3d ProjectiveTransform3f ProjectiveTransform4d "
        "ProjectiveTransform4f ScalarAffineTransform3d ScalarAffineTransform3f ScalarAffineTransform4d "
        "ScalarAffineTransform4f ScalarProjectiveTransform3d ScalarProjectiveTransform3f ScalarProjectiveTransform4d "
        "ScalarProjectiveTransform4f ScalarTransform3d ScalarTransform4d Transform3d Transform4d"
    ),
    "djpt.mitsuba.util": "is_monochromatic is_polarized is_rgb is_spectral scoped_set_variant variant_context",
    "djpt.sensors.base": "Sensor",
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
    "math_py": "djpt.mitsuba.math",
    "misc": "djpt.mitsuba.misc",
    "quad": "djpt.mitsuba.quad",
    "spline": "djpt.mitsuba.spline",
    "tensor_io": "djpt.mitsuba.tensor_io",
}
"""Attributes of `djpt` that are modules, with the modules that they stand for."""

VARIANT_MODULES = ("llvm_ad_rgb", "cuda_ad_rgb", "scalar_rgb", "python")
"""Mitsuba's modules that hold its names in one variant, or those written in Python; here they are `djpt` itself."""


# ---- names that djpt leaves out on purpose ---------------------------------------------------


POLARISATION = "Polarisation: djpt computes with unpolarised light."
SPECTRAL = "Spectral rendering: djpt computes with red, green and blue."
LOADER = "The stages of the C++ scene loader: `djpt.xml.read_file` gives a description as a dict that can be edited."
MACHINERY = "Machinery between C++ and Python that has nothing to connect here."
BLOCKS = "Blocks of a picture: `djpt.render_to_file` renders pictures band by band, `djpt.render_passes` in rounds."
COMMAND_LINES = "Command lines: Python has `argparse`."
DEBUGGER = "A stop in a C++ debugger: Python has `breakpoint`."
PLANAR = "Transforms of the line don't exist in Python: Mitsuba raises a TypeError, too."

REASONS: dict[str, str] = {
    "mueller": POLARISATION,
    "mueller.*": POLARISATION,
    "srgb_model_*": SPECTRAL,
    "Conditional*1DSpectrum*": SPECTRAL,
    "Texture.spectral_resolution": SPECTRAL,
    "Texture.wavelength_range": SPECTRAL,
    "TexturePtr.*spectrum": SPECTRAL,
    "parser": LOADER,
    "parser.*": LOADER,
    "Properties.Reference*": LOADER,
    "Properties.ResolvedReference*": LOADER,
    "detail": MACHINERY,
    "detail.*": MACHINERY,
    "StructConverter*": MACHINERY,
    "Object.ptr": MACHINERY,
    "get_property": MACHINERY,
    "set_property": MACHINERY,
    "*Transform3?.extract": PLANAR,
    "misc.trap_debugger": DEBUGGER,
    "Spiral": BLOCKS,
    "Spiral.*": BLOCKS,
    "ArgParser": COMMAND_LINES,
    "ArgParser.*": COMMAND_LINES,
}
"""Reasons by pattern. ``*`` stands for any characters, as in file names."""


FORMER: dict[str, str] = {
    "Loop": "Mitsuba has dropped it; write `while` in a function under `@dr.syntax`, or call `dr.while_loop`.",
}
"""Names of earlier versions of Mitsuba, and what to write in place of them."""


def reason(path: str) -> str:
    """Why a name is left out; empty if there is no reason."""
    return next((why for pattern, why in (REASONS | FORMER).items() if fnmatchcase(path, pattern)), "")

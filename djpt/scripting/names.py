"""Where the names for scripts are defined: the table that `djpt` looks them up in."""

from __future__ import annotations

from djpt.scripting.array_names import ARRAYS

__all__ = ["EXPORTS", "SUBMODULES", "VARIANT_MODULES"]

EXPORTS: dict[str, str] = {
    "djpt.scripting.arrays": " ".join(ARRAYS),
    "djpt.films.base": "Film FilmFlags",
    "djpt.films.image_block": "ImageBlock",
    "djpt.rfilters.base": "ReconstructionFilter",
    "djpt.samplers.base": "Sampler",
    "djpt.scripting.bitmap": "Bitmap",
    "djpt.scripting.conversion": "StructConverter",
    "djpt.scripting.denoiser": "OptixDenoiser",
    "djpt.scripting.resampler": "BitmapReconstructionFilter FilterBoundaryCondition MI_FILTER_RESOLUTION Resampler",
    "djpt.scripting.structs": "Struct",
    "djpt.scripting.transforms": (
        "AffineTransform3d AffineTransform4d ProjectiveTransform3d ProjectiveTransform3f ProjectiveTransform4d "
        "ProjectiveTransform4f ScalarAffineTransform3d ScalarAffineTransform3f ScalarAffineTransform4d "
        "ScalarAffineTransform4f ScalarProjectiveTransform3d ScalarProjectiveTransform3f ScalarProjectiveTransform4d "
        "ScalarProjectiveTransform4f ScalarTransform3d ScalarTransform4d Transform3d Transform4d"
    ),
    "djpt.scripting.variants": "is_monochromatic is_polarized is_rgb is_spectral scoped_set_variant variant_context",
    "djpt.sensors.base": "Sensor",
    "djpt.sensors.projective": "ProjectiveCamera",
    "djpt.shapes.base": "Shape",
    "djpt.textures.base": "Texture",
}
"""The modules of names that are attributes of `djpt`, each with its names, separated by spaces."""

SUBMODULES: dict[str, str] = {}
"""Attributes of `djpt` that are modules, with the modules that they stand for."""

VARIANT_MODULES = ("llvm_ad_rgb", "cuda_ad_rgb", "scalar_rgb")
"""Mitsuba's modules that hold its names in one variant; here they are `djpt` itself."""

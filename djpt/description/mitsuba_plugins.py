"""The plugins of Mitsuba 3.9.1 by kind: what they are called, and why djpt lacks some."""

from __future__ import annotations

__all__ = ["LACKING", "MITSUBA", "mitsuba_kind_of"]

MITSUBA = {
    "bsdf": (
        "blendbsdf bumpmap circular conductor dielectric diffuse hair mask measured measured_polarized normalmap null "
        "plastic polarizer pplastic principled principledthin retarder roughconductor roughdielectric roughplastic "
        "thindielectric twosided"
    ),
    "emitter": "area constant directional directionalarea envmap point projector spot sunsky timed_sunsky",
    "shape": (
        "blender bsplinecurve cube cylinder disk ellipsoids ellipsoidsmesh instance linearcurve merge obj ply "
        "rectangle sdfgrid serialized shapegroup sphere"
    ),
    "sensor": "batch distant irradiancemeter orthographic perspective radiancemeter thinlens",
    "film": "hdrfilm specfilm",
    "rfilter": "box catmullrom gaussian lanczos mitchell tent",
    "sampler": "independent ldsampler multijitter orthogonal stratified",
    "texture": (
        "bitmap blackbody checkerboard d65 irregular mesh_attribute rawconstant regular rgb spectrum srgb uniform "
        "volume"
    ),
    "integrator": (
        "aov depth direct direct_projective moment path prb prb_basic prb_projective prbvolpath ptracer stokes "
        "volpath volpathmis volprim_rf_basic"
    ),
    "medium": "heterogeneous homogeneous",
    "phase": "blendphase hg isotropic rayleigh sggx tabphase",
    "volume": "constvolume gridvolume",
}
"""The plugins of Mitsuba 3.9.1 by kind."""

LACKING = {
    "blender": "it reads meshes in Blender's memory; export them as 'ply', 'obj' or 'serialized'",
    "measured_polarized": (
        "it is a table of Mueller matrices, and djpt computes no polarisation; take a 'roughconductor' or 'measured'"
    ),
    "specfilm": "it holds spectra, and djpt computes colours; take 'hdrfilm'",
    "stokes": "it shows polarisation, which djpt doesn't compute; take the integrator nested in it",
}
"""The plugins that djpt lacks: why, and what to do."""


def mitsuba_kind_of(name: str) -> str | None:
    """The kind that a name has in Mitsuba, or None."""
    return next((kind for kind, names in MITSUBA.items() if name in names.split()), None)

"""The cases in which derivatives by a camera's place aren't known if vertices stay where they are, and their refusal.

See `djpt.rendering.gradients.camera_in_media`, and `unproven` for all other motion.
"""

from __future__ import annotations

from collections.abc import Iterator

from djpt.core.records import BSDFFlags, has_flag
from djpt.description.plugin import Plugin
from djpt.description.registry import name_of
from djpt.rendering.gradients.unproven import (
    Case,
    Rendering,
    far_planes,
    named,
    nested_bsdfs,
    of_lobes,
    unknown_outlines,
    without_silhouettes,
)

__all__ = ["CAMERA_CASES"]

BENT = ("normalmap", "bumpmap")


def other_cameras(rendering: Rendering) -> Iterator[str]:
    """Cameras whose density isn't attached, that move in time, or sample more than their film."""
    assert rendering.camera is not None
    for camera in rendering.camera.members():
        if not camera.density_moves:
            yield f"{named(camera)} is the camera"
        elif rendering.scene.in_time or camera.moves:
            yield f"the scene of {named(camera)} changes in time"
        elif camera.film().sample_border():
            yield f"the film of {named(camera)} has 'sample_border'"


def smooth_surfaces(rendering: Rendering) -> Iterator[str]:
    """Mirrors and smooth glass, and surfaces that let a part of the light pass straight through."""
    yield from of_lobes(rendering, BSDFFlags.DeltaReflection | BSDFFlags.DeltaTransmission)
    for shape, bsdf in rendering.bsdfs():
        if has_flag(bsdf.flags(), BSDFFlags.Null) and name_of(type(bsdf)) != "null":
            yield f"'{shape.id()}' has the BSDF {named(bsdf)}"


def tilted_normals(rendering: Rendering) -> Iterator[str]:
    """Surfaces with normal maps or bump maps."""
    for shape, bsdf in rendering.bsdfs():
        for nested in nested_bsdfs(bsdf):
            if name_of(type(nested)) in BENT:
                yield f"'{shape.id()}' has the BSDF {named(nested)}"


def unfollowed_media(rendering: Rendering) -> Iterator[str]:
    """Media that emit light, that jump from voxel to voxel, or that overlap."""
    if rendering.scene.geometry.overlaps:
        yield "bodies overlap"
    for medium in rendering.scene.every_medium.plugins:
        if medium.emits():
            yield f"{named(medium)} emits light"
        volumes = (getattr(medium, name, None) for name in medium.children)
        for volume in (v for v in volumes if isinstance(v, Plugin)):
            if getattr(volume, "filter_type", "") == "nearest":
                yield f"{named(medium)} has the volume {named(volume)}"


def parallel_sky(rendering: Rendering) -> Iterator[str]:
    """Environments that a camera with parallel rays sees."""
    assert rendering.camera is not None
    for camera in rendering.camera.members():
        for emitter in rendering.scene.emitters():
            if emitter.is_environment() and not camera.is_central and not rendering.integrator.hide_emitters:
                yield f"{named(camera)} sees {named(emitter)}"


CAMERA_CASES: tuple[Case, ...] = (
    Case(
        "shapes or lights that move as well",
        "what appears and disappears at their outlines is left out",
        "differentiate by the camera alone, or render without media with 'prb_projective'",
        without_silhouettes,
    ),
    Case(
        "a camera other than `perspective`, `thinlens` and `orthographic`, or one of these with further numbers of a "
        "lens; a film with `sample_border`; anything that changes in time",
        "how much of the film a vertex covers isn't followed",
        "use one of these cameras, or render without media with 'prb_projective'",
        other_cameras,
    ),
    Case(
        "mirrors, smooth glass, plastic and `mask`",
        "what is seen in them moves otherwise than vertices that stay",
        "use rough materials, or render without media with 'prb_projective'",
        smooth_surfaces,
    ),
    Case(
        "a `normalmap` or a `bumpmap`",
        "where bent normals turn away from the camera light jumps, and that isn't followed",
        "use a mesh with the detail in its vertices",
        tilted_normals,
    ),
    Case(
        "media that emit light, or whose grid has the filter `nearest`; bodies that overlap",
        "how their light, or the edges of their voxels, move isn't followed",
        "use a lamp, or the filter 'trilinear'",
        unfollowed_media,
    ),
    Case(
        "an environment that an `orthographic` camera sees",
        "all its rays show one direction, and that turns with the camera",
        "use a 'perspective' camera, or 'hide_emitters'",
        parallel_sky,
    ),
    Case(
        "a camera whose far plane cuts or hides a shape; an infinite `plane` whose horizon it sees",
        "what ends there isn't followed",
        "give 'far_clip' a larger value, and in place of the plane a large rectangle",
        far_planes,
        needs_numbers=True,
    ),
    Case(
        "a `linearcurve` or an implicit surface",
        "its outlines aren't followed",
        "use a mesh, or of curves a 'bsplinecurve'",
        unknown_outlines,
        needs_numbers=True,
    ),
)
"""The cases of cameras that move, by integrators whose `follows_camera` is true, those that are found fastest first."""

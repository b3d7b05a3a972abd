"""Light and media that an integrator can't show."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING

from djpt.core.records import BSDFFlags, EmitterFlags, has_flag
from djpt.errors import RenderError

if TYPE_CHECKING:
    from djpt.integrators.base import Integrator
    from djpt.scene.scene import Scene

__all__ = ["refuse_scattering_media", "warn_of_unrendered"]


def scattering_media(scene: Scene) -> list[str]:
    """The names of a scene's media that scatter light."""
    return [medium.id() for medium in scene.every_medium.plugins if medium.phase is not None]


def refuse_scattering_media(name: str, scene: Scene) -> None:
    """Raise `RenderError` if a scene has media that the integrator of this name can't follow light through."""
    found = scattering_media(scene)
    if found:
        raise RenderError(
            f"'{name}' doesn't follow light through scattering media, found {', '.join(found)}; "
            "possible: the integrator 'volpath'"
        )


def warn_of_unrendered(integrator: Integrator, scene: Scene) -> None:
    """Warn of the materials and lights of a scene that stay black, and of its media that don't show.

    No number of samples changes that.
    """
    name = type(integrator).__name__
    delta = [bsdf.id() for bsdf in scene.bsdfs.plugins if has_flag(bsdf.flags(), BSDFFlags.Delta)]
    if delta and not integrator.shows_delta:
        warn(
            f"'{name}' without BSDF samples can't show mirrors, smooth glass or openings: "
            f"these lobes of {', '.join(delta)} stay black"
        )
    unseen = scattering_media(scene)
    if unseen and integrator.needs_light and not integrator.follows_media:
        warn(
            f"'{name}' doesn't follow light through media: it leaves out {', '.join(unseen)}; "
            "render with the integrator 'volpath'"
        )
    if integrator.starts_at_lights or not integrator.needs_light:
        return
    lights = [e for e in scene.emitters() if has_flag(e.flags(), EmitterFlags.Delta)]
    beams = [e.id() for e in lights if e.on_shape]
    if beams:
        warn(f"'{name}' can't show light that leaves a surface in one direction only: {stay_black(beams)}")
    points = [] if integrator.samples_lights else [e.id() for e in lights if not e.on_shape]
    if points:
        warn(
            f"'{name}' doesn't sample lights, and finds none that is a point or shines in one direction by "
            f"chance: {stay_black(points)}"
        )


def warn(message: str) -> None:
    """Warn the caller of `render`, which checks the scene by way of `make_job` and `Integrator.check_scene`."""
    warnings.warn(message, stacklevel=levels_to_caller())


def stay_black(names: Sequence[str]) -> str:
    """``a stays black``, ``a, b stay black``."""
    return f"{', '.join(names)} stay{'s' if len(names) == 1 else ''} black"


def levels_to_caller() -> int:
    """The levels from the calling function up to the code outside of djpt that called it, for `warnings.warn`."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).split(".")[0] == "djpt":
        level, frame = level + 1, frame.f_back
    return level

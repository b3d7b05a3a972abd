"""A gallery of materials: a ball with each of them, and the sheet of all pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import SceneError, near_miss

__all__ = ["GLASS", "MATERIALS", "PANELS", "Panel", "panels", "shader_ball", "sheet"]

Progress = Callable[[int, int], None]


def shader_ball(bsdf: dict[str, Any] | None = None, size: int = 256) -> dict[str, Any]:
    """A ball in a ring on a chequered floor, under a softbox and a faint sky: a stage for materials.

    The ball has the radius 1 and its poles above and below. `bsdf` (default: rough gold) is listed as `ball.bsdf`;
    the picture has `size` x `size` pixels, 256 samples each, and paths have up to 12 edges.
    """
    checks = {"type": "checkerboard", "color0": 0.42, "color1": 0.2, "to_uv": T().scale([40, 40, 1])}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 12},
        "sensor": {
            "type": "perspective",
            "fov": 26,
            "to_world": T().look_at(origin=[0, -6, 2.9], target=[0, 0, 0.92], up=[0, 0, 1]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "gaussian"}},
            "sampler": {"type": "independent", "sample_count": 256},
        },
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.40, 0.41, 0.43]}},
        "softbox": softbox([-4.0, -3.0, 4.6], [2.0, 2.0, 1], 7.0),
        "strip": softbox([5.0, -0.5, 2.6], [0.5, 2.4, 1], 3.5),
        "floor": {
            "type": "rectangle",
            "to_world": T().rotate([0, 0, 1], 45).scale(40),
            "bsdf": {"type": "diffuse", "reflectance": checks},
        },
        "stand": {
            "type": "cylinder",
            "p1": [0, 0, 0.25],
            "radius": 0.6,
            "bsdf": {"type": "twosided", "inner": {"type": "diffuse", "reflectance": 0.1}},
        },
        # Placed such that its centre is one radius away from the rim of the ring.
        "ball": {
            "type": "sphere",
            "center": [0, 0, 0.25 + 0.8],
            "bsdf": bsdf or {"type": "roughconductor", "material": "Au", "alpha": 0.2},
        },
    }


def softbox(place: Sequence[float], half: Sequence[float], radiance: float) -> dict[str, Any]:
    """A rectangular lamp that shines onto the ball."""
    return {
        "type": "rectangle",
        "to_world": T().look_at(origin=place, target=[0, 0, 1], up=[0, 0, 1]).scale(half),
        "bsdf": {"type": "diffuse", "reflectance": 0.0},
        "emitter": {"type": "area", "radiance": radiance},
    }


# ---- images that some materials need -----------------------------------------------------


def dots(rows: int, columns: int, radius: float) -> NDArray[np.float32]:
    """A height field of round domes, (256, 512): 1 in their middles, 0 between them; every other row is shifted."""
    v, u = np.meshgrid((np.arange(256) + 0.5) / 256, (np.arange(512) + 0.5) / 512, indexing="ij")
    row = np.floor(v * rows)
    # On a sphere, columns get narrower towards the poles.
    x = ((u * columns + 0.5 * (row % 2)) % 1 - 0.5) * np.sin(np.pi * v) * 2 * rows / columns
    y = v * rows - row - 0.5
    return np.asarray(np.maximum(1 - (x**2 + y**2) / radius**2, 0), np.float32)


def normals_of(height: NDArray[np.float32], depth: float) -> NDArray[np.float32]:
    """The normal map (H, W, 3) of a height field that repeats."""
    slope_v, slope_u = (np.roll(height, 1, axis) - np.roll(height, -1, axis) for axis in (0, 1))
    normal = np.stack([depth * slope_u, depth * slope_v, np.ones_like(height)], axis=-1)
    unit = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.asarray(0.5 + 0.5 * unit, np.float32)


def bitmap(data: NDArray[np.float32]) -> dict[str, Any]:
    """A bitmap texture of raw numbers."""
    return {"type": "bitmap", "data": data, "raw": True}


def squares(u: float, v: float, color0: Any = 1.0, color1: Any = 0.0) -> dict[str, Any]:
    """A pattern of `u` by `v` pairs of squares."""
    return {"type": "checkerboard", "color0": color0, "color1": color1, "to_uv": T().scale([u, v, 1])}


def rgb(*value: float) -> dict[str, Any]:
    """A colour."""
    return {"type": "rgb", "value": list(value)}


# ---- the panels ----------------------------------------------------------------------------

CLAY, TEAL, PLUM, LEAF = rgb(0.62, 0.25, 0.16), rgb(0.06, 0.34, 0.40), rgb(0.32, 0.08, 0.30), rgb(0.25, 0.5, 0.1)
OCHRE, NAVY, WHITE = rgb(0.75, 0.45, 0.1), rgb(0.03, 0.07, 0.25), rgb(0.8, 0.8, 0.78)


@dataclass(frozen=True)
class Panel:
    """One picture of the sheet."""

    title: str
    """The plugin's name."""
    subtitle: str
    """The feature that distinguishes the panel from the plugin's other panels."""
    bsdf: Callable[[], dict[str, Any]]

    def scene(self, size: int) -> dict[str, Any]:
        """The description of the panel's scene."""
        return shader_ball(self.bsdf(), size)


def plugin(type: str, **parameters: Any) -> dict[str, Any]:
    """The description of a plugin."""
    return {"type": type, **parameters}


def panel(subtitle: str, type: str, **parameters: Any) -> Panel:
    """The panel of a material; what takes time to compute may be given as a function."""
    return Panel(type, subtitle, lambda: plugin(type, **{k: v() if callable(v) else v for k, v in parameters.items()}))


METAL_PATCHES = plugin("twosided", inner=plugin("roughconductor", material="Cu", alpha=0.25))
PAINTED_SIDES = plugin(
    "twosided", front=plugin("plastic", diffuse_reflectance=TEAL), back=plugin("diffuse", reflectance=OCHRE)
)
GLOSSY = {"diffuse_reflectance": NAVY, "specular_reflectance": 0.6, "exponent": 60.0}

MATERIALS: dict[str, Panel] = {
    "diffuse": panel("reflectance", "diffuse", reflectance=CLAY),
    "checkerboard": panel("a checkerboard", "diffuse", reflectance=squares(8, 4, WHITE, TEAL)),
    "twosided": Panel(
        "twosided", "in a mask: two sides", lambda: plugin("mask", opacity=squares(4, 3), inner=PAINTED_SIDES)
    ),
    "mask": panel(
        "opacity: a bitmap", "mask", opacity=lambda: bitmap(1 - np.sign(dots(9, 12, 0.38))), inner=METAL_PATCHES
    ),
    "null": panel("no surface", "null"),
    "phong": panel("exponent 60", "phong", **GLOSSY),
    "blinn": panel("exponent 60", "blinn", **GLOSSY),
    "plastic": panel("smooth coat", "plastic", diffuse_reflectance=PLUM),
    "roughplastic": panel("alpha 0.15", "roughplastic", diffuse_reflectance=PLUM, alpha=0.15),
    "pplastic": panel("brushed", "pplastic", diffuse_reflectance=TEAL, alpha_u=0.05, alpha_v=0.3),
    "hair": panel("a coat of dark hair", "hair", azimuthal_roughness=0.6),
    "polarizer": panel("half of all light", "polarizer"),
    "retarder": panel("tinted", "retarder", transmittance=rgb(0.9, 0.95, 0.7)),
    "circular": panel("tinted", "circular", transmittance=rgb(0.7, 0.9, 0.95)),
    "blendbsdf": panel(
        "plaster and gold",
        "blendbsdf",
        weight=squares(6, 3),
        first=plugin("diffuse", reflectance=WHITE),
        second=plugin("roughconductor", material="Au", alpha=0.15),
    ),
    "bumpmap": panel(
        "heights",
        "bumpmap",
        heights=lambda: bitmap(dots(9, 12, 0.45)),
        scale=0.08,
        inner=plugin("roughplastic", diffuse_reflectance=LEAF, alpha=0.1),
    ),
    "normalmap": panel(
        "an image of normals",
        "normalmap",
        normalmap=lambda: bitmap(normals_of(-dots(14, 24, 0.46), 3.0)),
        inner=plugin("roughconductor", material="Ag", alpha=0.15),
    ),
    "mirror": panel("reflectance 0.9", "mirror", reflectance=0.9),
    "conductor": panel("gold", "conductor", material="Au"),
    "roughconductor": panel("copper, alpha 0.2", "roughconductor", material="Cu", alpha=0.2, distribution="ggx"),
    "anisotropic": panel(
        "silver, 0.05 x 0.4", "roughconductor", material="Ag", alpha_u=0.05, alpha_v=0.4, distribution="ggx"
    ),
    "dielectric": panel("diamond", "dielectric", int_ior="diamond"),
    "thindielectric": panel("a bubble", "thindielectric"),
    "roughdielectric": panel("alpha 0.15", "roughdielectric", int_ior=1.5, alpha=0.15, distribution="ggx"),
    "principled": panel(
        "clearcoat on paint",
        "principled",
        base_color=rgb(0.55, 0.03, 0.03),
        roughness=0.45,
        metallic=0.3,
        clearcoat=1.0,
        clearcoat_gloss=0.95,
    ),
    "metallic": panel(
        "metallic, anisotropic",
        "principled",
        base_color=rgb(0.85, 0.6, 0.45),
        metallic=1.0,
        roughness=0.35,
        anisotropic=0.8,
    ),
    "sheen": panel(
        "rough, with sheen", "principled", base_color=rgb(0.012, 0.008, 0.06), roughness=1.0, sheen=1.0, sheen_tint=0.3
    ),
    "spec_trans": panel(
        "spec_trans 1", "principled", base_color=rgb(0.75, 0.95, 0.85), roughness=0.12, spec_trans=1.0, eta=1.4
    ),
    "principledthin": panel(
        "paper: diff_trans 1.2", "principledthin", base_color=rgb(0.9, 0.75, 0.5), roughness=0.6, diff_trans=1.2
    ),
}
"""The panels of all materials, by name; every plugin occurs at least once."""


def glass(subtitle: str, int_ior: float = 1.5, **parameters: Any) -> Panel:
    """The panel of a ball of glass in air."""
    return panel(subtitle, "glass", ext_ior=1.0, int_ior=int_ior, **parameters)


GLASS: dict[str, Panel] = {
    "glass-reflection": glass("reflection only", transmission=False),
    "glass-refraction-1": glass("refraction only, IOR 1", reflection=False, int_ior=1.0),
    "glass-refraction": glass("refraction only, IOR 1.5", reflection=False),
    "glass-1": glass("IOR 1", int_ior=1.0),
    "glass": glass("IOR 1.5"),
    "glass-absorption": glass("with absorption", absorption=rgb(0.9, 0.25, 0.12)),
}
"""The panels of glass: its two lobes alone and together, with and without refraction, and coloured glass."""

PANELS = {**MATERIALS, **GLASS}
"""All panels by the names that ``djpt gallery`` takes."""


# ---- the sheet -------------------------------------------------------------------------------


def panels(names: Sequence[str] = ()) -> list[Panel]:
    """The panels of the given names; without names, all panels.

    Raises:
        SceneError: there is no panel of that name.
    """
    for name in names:
        if name not in PANELS:
            raise SceneError(f"the gallery has no panel '{name}'{near_miss(name, PANELS)}")
    return [PANELS[name] for name in names or PANELS]


class Labelled(Protocol):
    """A picture with a title and a subtitle."""

    @property
    def title(self) -> str: ...

    @property
    def subtitle(self) -> str: ...

    def scene(self, size: int) -> dict[str, Any]:
        """The description of the scene in the picture."""


def sheet(
    panels: Sequence[Labelled],
    size: int = 200,
    spp: int = 512,
    seed: int = 0,
    columns: int = 6,
    progress: Progress | None = None,
    begin: Callable[[str], None] | None = None,
) -> NDArray[np.uint8]:
    """Render panels and put them side by side, with labels: (H, W, 3) bytes of sRGB.

    Args:
        panels: The panels, row by row.
        size: Width and height of a panel in pixels.
        spp: Samples per pixel.
        seed: The seed of all panels.
        columns: Panels in a row.
        progress: Called with (samples done, samples in all).
        begin: Called before each panel, with a line that says which one it is.
    """
    from djpt.description.loader import load_dict
    from djpt.images.sheets import Tile, captioned_sheet, shown
    from djpt.rendering.render import render

    tiles: list[Tile] = []
    each = size * size * spp

    def show(done: int, total: int) -> None:
        if progress is not None:
            progress(len(tiles) * each + each * done // total, len(panels) * each)

    for i, panel in enumerate(panels):
        if begin is not None:
            begin(f"{i + 1} of {len(panels)}: {panel.title}, {panel.subtitle}")
        image = render(load_dict(panel.scene(size)), spp=spp, seed=seed, progress=show)
        tiles.append(Tile(panel.title, panel.subtitle, shown(image)))
    return captioned_sheet(tiles, columns)

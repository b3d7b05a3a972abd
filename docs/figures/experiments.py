"""The experiments of a guide: its code runs as it stands, and what it has found is drawn."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

import djpt
from djpt.images.sheets import LIGHT, Tile, captioned_sheet, enlarged, shown
from djpt.validation.report import difference_picture
from places import IMAGES, ROOT

sys.path.append(str(ROOT))  # for the code blocks of the tests

from tests.kit.documents import sections

__all__ = ["carpet", "paints", "unknown_sky", "valleys"]

PAGE = "docs/guides/albedo-experiments.md"
DIMMED = 0.2
"""The brightness at which skies are shown, so that their lamps aren't white."""

PAPER, INK, FAINT = (tuple(channel / 255 for channel in color) for color in LIGHT)


def experiment(heading: str) -> dict[str, Any]:
    """Run the code below a heading of the page; what it has defined."""
    names: dict[str, Any] = {"__name__": heading}
    for block in sections(PAGE)[heading]:
        block.run(names)
    return names


def large(image: Any, width: int = 320) -> NDArray[np.uint8]:
    """A picture whose pixels are squares, at least `width` wide."""
    return enlarged(shown(image), width)


def difference(image: Any, other: Any, scale: float, width: int = 320) -> NDArray[np.uint8]:
    """A signed difference in the same size."""
    return enlarged(difference_picture(image, other, scale), width)


def axes(columns: int, width: float, height: float) -> tuple[Any, Any]:
    """An empty figure of Matplotlib in the colours of the sheets, and its axes, side by side."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=120, facecolor=PAPER, layout="constrained")
    found = figure.subplots(1, columns, squeeze=False)[0]
    for each in found:
        each.set_facecolor(PAPER)
        each.tick_params(colors=FAINT, labelcolor=INK)
        for spine in each.spines.values():
            spine.set_color(FAINT)
    return figure, found


# ---------------------------------------------------------------- the paints of the Cornell box


def paints() -> None:
    """The start, the target, the result; and each number with its error, as large as standard errors say it may be."""
    names = experiment("The paints of the Cornell box")
    target, after = np.array(names["target"]), np.array(names["after"])
    tiles = [
        Tile("start", "all paints are grey", large(names["start"])),
        Tile("target", f"{names['TARGET_SPP']} spp", large(target)),
        Tile("found", f"{names['ITERATIONS']} steps of {names['SPP']} spp", large(after)),
        Tile("found - target", "full scale 0.05", difference(after, target, 0.05)),
    ]
    djpt.write(IMAGES / "paints.png", captioned_sheet(tiles))

    figure, (axis,) = axes(1, 10.4, 3.2)
    for i, (name, color) in enumerate(names["PAINTS"].items()):
        key = f"{name}.reflectance.value"
        off, error = names["found"].average[key].ravel() - color, names["errors"][key]
        for channel, hue in enumerate(("#b2182b", "#4d9221", "#2166ac")):
            place = 4 * i + channel
            axis.bar(place, 4 * error[channel], 0.8, -2 * error[channel], color=hue, alpha=0.22, linewidth=0)
            axis.plot(place, off[channel], "o", color=hue, markersize=5)
    axis.use_sticky_edges = False  # bars end inside of the frame
    axis.axhline(0, color=FAINT, linewidth=0.8)
    axis.set_xticks([4 * i + 1 for i in range(len(names["PAINTS"]))], list(names["PAINTS"]))
    axis.set_ylabel("found - truth")
    axis.set_title("dots: the errors; bars: two standard errors to either side", fontsize=10, color=INK)
    figure.savefig(IMAGES / "paints_errors.png")


# ---------------------------------------------------------------- a texture from three views


def carpet() -> None:
    """The three views above, and the texture below: where it starts, what is true, what is found, and the error."""
    names = experiment("A texture from three views")
    truth, found = names["truth"], names["found"].average[names["key"]]
    views = [
        Tile(f"target, view {i}", f"{names['TARGET_SPP']} spp", large(target))
        for i, target in enumerate(names["targets"])
    ]
    again = Tile("found, view 0", "with the texture found", large(names["after"][0]))
    off = np.abs(found - truth).mean()
    textures = [
        Tile("start", "grey", large(np.full_like(truth, 0.5))),
        Tile("truth", f"{names['TEXELS']} x {names['TEXELS']} texels", large(truth)),
        Tile("found", f"mean error {off:.3f}", large(found)),
        Tile("found - truth", "full scale 0.2", difference(found, truth, 0.2)),
    ]
    djpt.write(IMAGES / "carpet.png", captioned_sheet([*views, again, *textures], columns=4))


# ---------------------------------------------------------------- colour and roughness under an unknown sky


def unknown_sky() -> None:
    """The ball at the start, in truth, and as found; the skies; and the ball under another one."""
    names = experiment("Colour and roughness under an unknown sky")
    size = 320
    relit = names["relit"]
    given = [
        Tile("start", "grey, under a grey sky", large(names["start"][0], size)),
        Tile("target", "the first of three views", large(names["targets"][0], size)),
        Tile("found", f"{names['ITERATIONS']} steps of one view", large(names["after"][0], size)),
    ]
    new = [Tile(name, "under a sky not seen before", shown(image)) for name, image in relit.items()]
    djpt.write(IMAGES / "unknown_sky.png", captioned_sheet(given))
    djpt.write(IMAGES / "unknown_sky_relit.png", captioned_sheet(new))
    truth, found = names["true_sky"]["data"], names["found"].average["sky.data"][:, 1:-1]
    skies = [
        Tile("the true sky", f"{truth.shape[0]} x {truth.shape[1]} texels", large(DIMMED * truth, 400)),
        Tile("the sky found", f"mean error {np.abs(found - truth).mean():.2f}", large(DIMMED * found, 400)),
        Tile("found - true", "full scale 1", difference(found, truth, 1.0, 400)),
    ]
    djpt.write(IMAGES / "unknown_sky_texels.png", captioned_sheet(skies))


# ---------------------------------------------------------------- albedo times light


def valleys() -> None:
    """The loss over albedo and radiance, and the way that the search took, for each of the rooms."""
    names = experiment("Albedo times light")
    figure, panels = axes(len(names["ROOMS"]), 12.4, 4.2)
    albedos, radiances = np.linspace(0.15, 1.0, 24), np.linspace(1.0, 4.0, 24)
    for axis, (name, options) in zip(panels, names["ROOMS"].items(), strict=True):
        losses = landscape(names, options, albedos, radiances)
        steps = np.arange(-5, -0.4, 0.5)
        shade = axis.contourf(albedos, radiances, np.log10(losses), steps, cmap="GnBu_r", extend="both")
        path = np.array(names["paths"][name])
        axis.plot(*path.T, color="#b2182b", linewidth=1.5)
        axis.plot(*path[0], "o", color="#b2182b", markersize=5)
        axis.plot(names["ALBEDO"], names["RADIANCE"], "*", color="white", markeredgecolor=INK, markersize=13)
        low, high = names["sure"][name].curvatures
        below = "0" if low < 1e-6 * high else f"{low:.2g}"
        axis.set_title(f"{name}\neigenvalues {below} and {high:.2g}", fontsize=10, color=INK)
        axis.set_xlabel("albedo")
    panels[0].set_ylabel("radiance of the lamp")
    bar = figure.colorbar(shade, ax=panels, label="log10 of the loss", shrink=0.9)
    bar.outline.set_edgecolor(FAINT)
    figure.savefig(IMAGES / "valleys.png")


def landscape(
    names: dict[str, Any], options: dict[str, Any], albedos: NDArray[np.float64], radiances: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The loss of a room at all pairs of values, with one seed, so that noise hides nothing, (radiances, albedos)."""
    scene = names["room"](names["ALBEDO"], names["RADIANCE"], **options)
    params = djpt.traverse(scene)

    def image(albedo: float, radiance: float) -> NDArray[np.float64]:
        for key, value in ((names["PAINT"], albedo), (names["LAMP"], radiance)):
            params[key] = djpt.TensorXf(np.full((1, 1, 1), value, np.float32))
        params.update()
        return np.array(djpt.render(scene, spp=16), np.float64)

    target = image(names["ALBEDO"], names["RADIANCE"])
    # At the truth the loss would be 0, whose logarithm can't be drawn.
    return np.array([[np.mean((image(a, e) - target) ** 2) + 1e-6 for a in albedos] for e in radiances])

"""The command ``djpt denoise``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

import djpt
from djpt.apps.cli import options
from djpt.apps.cli.console import Command, say
from djpt.core.files import require_different
from djpt.errors import FileError, near_miss

if TYPE_CHECKING:
    from djpt.rendering.denoising.filtering import Guides, Pixels

__all__ = ["command"]

ALBEDO = ("albedo",)
NORMAL = ("normal", "sh_normal", "normals", "nn", "geo_normal")
"""Names of layers, those that are preferred first."""


@click.command("denoise", cls=Command)
@click.argument("image", metavar="IMAGE", type=click.Path(path_type=Path))
@options.output("exr hdr pfm npy (linear), png jpg (sRGB). Default: IMAGE with _denoised before its extension")
@options.denoiser
@click.option("--albedo", metavar="LAYER", help="Layer of the exr with the albedo. Default: 'albedo', if present.")
@click.option("--normal", metavar="LAYER", help="Layer of the exr with normals. Default: 'normal', 'sh_normal', ..")
@click.option("--clean", is_flag=True, help="The albedo and normals are free of noise.")
@options.quiet
def command(
    image: Path, output: Path | None, denoiser: str, albedo: str | None, normal: str | None, clean: bool, quiet: bool
) -> None:
    """Remove noise from a rendered image.

    If IMAGE is an exr with layers for albedo and normals, they guide the filter; the integrator 'aov' and
    'djpt render --denoise --raw' write such layers. Render with the box filter: wider ones spread the noise.
    """
    from djpt.apps.cli.tone import carried, channels_for, layers
    from djpt.images.image import check_writable, read_metadata
    from djpt.rendering.denoising.filtering import check_method, colour_count, denoise_pixels

    target = output or image.with_name(f"{image.stem}_denoised{image.suffix}")
    check_writable(target)
    require_different({"--output": target}, {"IMAGE": image})
    check_method(denoiser)
    pixels, names = channels_of(image)
    colours = colour_count(pixels, names or None)
    guides = guides_of(image, pixels, names, albedo, normal)
    cleaned = denoise_pixels(pixels, guides, colours, denoiser, clean)
    alpha = pixels.shape[2] > colours and (names[colours] == "A" if names else pixels.shape[2] in (2, 4))
    shown = names or [str(i) for i in range(pixels.shape[2])]
    shown = ["A" if alpha and i == colours else name for i, name in enumerate(shown)]
    kept = channels_for(target, shown, colours + alpha)
    facts = {**(read_metadata(image) if image.suffix.lower() == ".exr" else {}), "denoised": denoiser}
    named = names[:kept] if names and target.suffix.lower() == ".exr" else None
    djpt.write(target, cleaned[..., :kept], named, metadata=carried(target, facts))
    if not quiet:
        used = [name for name, guide in vars(guides).items() if guide is not None]
        say(f"{target}: {pixels.shape[1]} x {pixels.shape[0]}, {denoiser}, guided by {' and '.join(used) or 'nothing'}")
        if names[kept:]:
            say(f"without {', '.join(layers(names[kept:]))}: exr and npy hold all channels")


def channels_of(path: Path) -> tuple[Pixels, list[str]]:
    """The pixels of a file as float32, and the names of its channels, if it is an exr; otherwise there are none."""
    import numpy as np

    from djpt.images.exr import read_layers
    from djpt.images.image import read_pixels, reading

    if path.suffix.lower() != ".exr":
        return read_pixels(path), []
    with reading(path):
        found = read_layers(path)
        return np.asarray(found.pixels, np.float32), list(found.names)


def guides_of(path: Path, pixels: Pixels, names: Sequence[str], albedo: str | None, normal: str | None) -> Guides:
    """The layers that guide the filter: those that were asked for, else those with one of the usual names."""
    from djpt.rendering.denoising.filtering import Guides

    found: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        layer, dot, _ = name.rpartition(".")
        if dot:
            found.setdefault(layer, []).append(i)
    possible = {layer: channels for layer, channels in found.items() if len(channels) == 3}

    def chosen(wanted: str | None, usual: Sequence[str]) -> Pixels | None:
        if wanted is not None and wanted not in possible:
            raise FileError(f"'{path}' has no layer '{wanted}' of three channels{near_miss(wanted, possible)}")
        layer = wanted or next((name for name in usual if name in possible), None)
        return None if layer is None else pixels[..., possible[layer]]

    return Guides(albedo=chosen(albedo, ALBEDO), normal=chosen(normal, NORMAL))

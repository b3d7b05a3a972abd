"""The commands ``djpt tonemap``, ``denoise`` and ``merge``, which make images of others; and what files can hold."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

import djpt
from djpt.apps.cli import options
from djpt.apps.cli.console import Command, number_or_word, say
from djpt.core.files import require_different
from djpt.errors import FileError, RenderError, near_miss
from djpt.images.formats import DISPLAY_FORMATS, FORMATS, METADATA
from djpt.images.image import check_writable, read_metadata, read_pixels, reading

if TYPE_CHECKING:
    from djpt.rendering.denoising.filtering import Guides, Pixels

__all__ = ["Stored", "Tone", "denoise", "merge", "tonemap"]


class Tone:
    """The options of tone mapping, checked before anything is rendered.

    Args:
        target: the picture's file.
        operator: see `djpt.tonemap`.
        exposure: stops, or ``auto``.
        white_balance: kelvin, or three numbers with commas.

    Raises:
        RenderError: the file isn't a picture for displays, or an option is wrong.
    """

    def __init__(self, target: Path, operator: str, exposure: str, white_balance: str | None) -> None:
        if target.suffix.lower() not in DISPLAY_FORMATS:
            raise RenderError(f"tone-mapped pictures are written as png or jpg, found '{target}'")
        self.operator = operator
        self.exposure: float | str = number_or_word(exposure)
        self.white_balance: Any = None
        if white_balance is not None:
            parts = [number_or_word(part) for part in white_balance.split(",")]
            self.white_balance = parts[0] if len(parts) == 1 else parts
        self.apply(np.zeros((1, 1, 3), np.float32))
        self.facts = {"tonemap": operator, "exposure": exposure}
        if white_balance is not None:
            self.facts["whiteBalance"] = white_balance

    def apply(self, image: Any) -> Any:
        """The image for displays."""
        return djpt.tonemap(image, self.operator, self.exposure, self.white_balance)


def carried(target: Path, facts: dict[str, Any]) -> dict[str, Any]:
    """The metadata, if a file of this format can carry them; else none."""
    return facts if target.suffix.lower() in METADATA else {}


# ---- the part of an image that goes into a file ----------------------------------------------


class Stored:
    """An image file, and the channels of an image that its format holds: see `channels_for`."""

    def __init__(self, path: Path, names: Sequence[str], colours: int) -> None:
        self.path, self.names = path, list(names)
        self.kept = channels_for(path, names, colours)
        """The number of channels that are written, from the first."""

    def write(self, pixels: Any, facts: dict[str, Any] | None = None, named: bool = True) -> None:
        """Write an image of all channels, with metadata if the format carries them, and with names in an exr."""
        names = self.names[: self.kept] if named and self.path.suffix.lower() == ".exr" else None
        djpt.write(self.path, pixels[..., : self.kept], names, metadata=carried(self.path, facts or {}))

    def say_left_out(self) -> None:
        """Print which layers the file doesn't hold, if there are any."""
        if self.names[self.kept :]:
            say(f"without {', '.join(layers(self.names[self.kept :]))}: exr and npy hold all channels")


def channels_for(target: Path, names: Sequence[str], colours: int) -> int:
    """The number of an image's channels, from the first, that are written to a file: all, or those of the colour.

    Args:
        target: the file, whose extension is one of the known formats.
        names: of all channels.
        colours: how many of them are the colour's, perhaps with alpha, which is left out where a format has none.

    Raises:
        RenderError: the format doesn't hold this colour.
    """
    suffix = target.suffix.lower()
    possible = FORMATS[suffix].channels
    if not possible or len(names) in possible:
        return len(names)
    for count in (colours, colours - 1) if names[colours - 1] == "A" else (colours,):
        if count in possible:
            return count
    raise RenderError(
        f"can't write '{target}': {suffix[1:]} holds {' or '.join(map(str, possible))} channels, this film makes "
        f"{' '.join(names[:colours])}; exr and npy hold any"
    )


def layers(names: Sequence[str]) -> list[str]:
    """The layers that channels belong to, such as ``albedo`` for ``albedo.R``, in order and once each."""
    return list(dict.fromkeys(name.rpartition(".")[0] or name for name in names))


# ---- tone mapping ----------------------------------------------------------------------------


@click.command("tonemap", cls=Command)
@click.argument("image", metavar="IMAGE", type=click.Path(path_type=Path))
@options.output("Picture, png or jpg. Default: the name of IMAGE with .png")
@click.option("--tonemap", "operator", default="srgb", help="srgb (clipped), reinhard, aces or agx.")
@options.exposure
@options.white_balance
@options.quiet
def tonemap(
    image: Path, output: Path | None, operator: str, exposure: str, white_balance: str | None, quiet: bool
) -> None:
    """Convert a high-dynamic-range image to a picture for displays.

    IMAGE holds linear values: exr, hdr, pfm or npy. Its metadata are kept.
    """
    target = output or image.with_suffix(".png")
    check_writable(target)
    require_different({"--output": target}, {"IMAGE": image})
    tone = Tone(target, operator, exposure, white_balance)
    pixels = read_pixels(image)
    # The first channels of an image with layers are the colour.
    shown = tone.apply(pixels if pixels.shape[2] <= 4 else pixels[..., :3])
    facts = read_metadata(image) if image.suffix.lower() == ".exr" else {}
    djpt.write(target, shown, metadata=carried(target, {**facts, **tone.facts}))
    if not quiet:
        say(f"{target}: {shown.shape[1]} x {shown.shape[0]}")


# ---- denoising -------------------------------------------------------------------------------

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
def denoise(
    image: Path, output: Path | None, denoiser: str, albedo: str | None, normal: str | None, clean: bool, quiet: bool
) -> None:
    """Remove noise from a rendered image.

    If IMAGE is an exr with layers for albedo and normals, they guide the filter; the integrator 'aov' and
    'djpt render --denoise --raw' write such layers. Render with the box filter: wider ones spread the noise.
    """
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
    stored = Stored(target, shown, colours + alpha)
    facts = {**(read_metadata(image) if image.suffix.lower() == ".exr" else {}), "denoised": denoiser}
    stored.write(cleaned, facts, named=bool(names))
    if not quiet:
        used = [name for name, guide in vars(guides).items() if guide is not None]
        say(f"{target}: {pixels.shape[1]} x {pixels.shape[0]}, {denoiser}, guided by {' and '.join(used) or 'nothing'}")
        if names:
            stored.say_left_out()


def channels_of(path: Path) -> tuple[Pixels, list[str]]:
    """The pixels of a file as float32, and the names of its channels, if it is an exr; otherwise there are none."""
    from djpt.images.exr import read_layers

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


# ---- merging ---------------------------------------------------------------------------------


@click.command("merge", cls=Command)
@click.argument("checkpoints", metavar="CHECKPOINT..", nargs=-1, required=True, type=click.Path(path_type=Path))
@options.output("Image (exr hdr pfm npy png jpg) or checkpoint (djpt) to write.")
@options.quiet
def merge(checkpoints: tuple[Path, ...], output: Path | None, quiet: bool) -> None:
    """Merge checkpoints of one scene.

    `djpt render --checkpoint` writes them; each render needs its own seed.
    """
    if output is None:
        raise RenderError("no output file: give -o image.exr, or -o all.djpt to merge more later")
    if output.suffix.lower() != ".djpt":
        check_writable(output)
    require_different({"--output": output}, {f"checkpoint {n}": path for n, path in enumerate(checkpoints, 1)})
    total = djpt.Accumulation.load(checkpoints[0])
    for path in checkpoints[1:]:
        total += djpt.Accumulation.load(path)
    width, height = total.size
    stored = None
    if output.suffix.lower() == ".djpt":
        total.save(output)
    else:
        colours = next((i for i, name in enumerate(total.channels) if "." in name), len(total.channels))
        stored = Stored(output, total.channels, max(1, colours))
        stored.write(total.image().numpy())
    if not quiet:
        say(f"{output}: {width} x {height}, {total.spp} spp, error {total.error().overall:.2%}")
        if stored is not None:
            stored.say_left_out()

"""Options and arguments that several commands have."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import click
from click.shell_completion import CompletionItem

__all__ = [
    "SCENE",
    "columns",
    "complete_scene",
    "define",
    "denoiser",
    "exposure",
    "height",
    "integrator",
    "output",
    "quiet",
    "rfilter",
    "scene",
    "seed",
    "size",
    "white_balance",
    "width",
]

Decorated = TypeVar("Decorated", bound=Callable[..., object])

SCENE = (
    "SCENE is an XML file, a model (glb, gltf, obj, stl, off, 3mf, ply, usd), or a built-in scene; see 'djpt scenes'."
)
"""The end of the help of a command."""


def complete_scene(context: click.Context, option: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete the name of a scene in a shell: built-in scenes, and files."""
    from djpt.scenes import NAMES

    names = [CompletionItem(name) for name in NAMES if name.startswith(begun)]
    return [*names, CompletionItem(begun, type="file")]


scene = click.argument("scene", metavar="SCENE", shell_complete=complete_scene)
seed = click.option("--seed", type=int, default=0, help="Seed; equal seeds give equal images.")
width = click.option("--width", type=int, help="Width in pixels; keeps the aspect ratio unless --height is given.")
height = click.option("--height", type=int, help="Height in pixels; keeps the aspect ratio unless --width is given.")
size = click.option("--size", type=int, help="Width in pixels; keeps the aspect ratio. Default: the scene's.")
columns = click.option("--columns", type=int, help="Pictures per row. Default: all.")
rfilter = click.option("--rfilter", help="Reconstruction filter. Default: the scene's.")
integrator = click.option("--integrator", help="Integrator. Default: the scene's.")
define = click.option(
    "-D", "define", metavar="NAME=VALUE", multiple=True, help="A parameter of the file; may be repeated."
)
denoiser = click.option(
    "--denoiser", default="oidn", help="oidn (Open Image Denoise) or nlm (non-local means, no extra package)."
)
exposure = click.option(
    "--exposure", metavar="STOPS", default="0", help="Exposure in stops, or 'auto'; for png and jpg."
)
white_balance = click.option(
    "--white-balance", metavar="LIGHT", help="Illuminant that appears white: kelvin, or R,G,B; for png and jpg."
)
quiet = click.option("--quiet", "-q", is_flag=True, help="Print errors only.")


def output(what: str, default: str | None = None) -> Callable[[Decorated], Decorated]:
    """The option ``--output``, a file; `what` says which kinds, and what the default is if none is given here."""
    return click.option("--output", "-o", type=click.Path(path_type=Path), default=default, help=what)

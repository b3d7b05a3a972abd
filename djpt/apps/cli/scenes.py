"""The command ``djpt scenes``."""

from __future__ import annotations

import click

from djpt.apps.cli.console import Command

__all__ = ["command"]


@click.command("scenes", cls=Command)
def command() -> None:
    """List the built-in scenes."""
    from djpt import scenes

    width = max(len(name) for name in scenes.NAMES)
    for name in scenes.NAMES:
        summary = (getattr(scenes, name).__doc__ or "").strip().splitlines()
        print(f"{name:<{width}}  {summary[0] if summary else ''}".rstrip())

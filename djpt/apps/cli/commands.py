"""The commands of the command line, each imported when it is asked for."""

# ruff: noqa: F401 (the names are read by `lazily`)

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if TYPE_CHECKING:
    from djpt.apps.cli.animation import animate as animate
    from djpt.apps.cli.animation import turntable as turntable
    from djpt.apps.cli.compare import command as compare
    from djpt.apps.cli.doctor import command as doctor
    from djpt.apps.cli.gradcheck import command as gradcheck
    from djpt.apps.cli.info import info as info
    from djpt.apps.cli.info import scenes as scenes
    from djpt.apps.cli.ladder import command as ladder
    from djpt.apps.cli.pictures import denoise as denoise
    from djpt.apps.cli.pictures import merge as merge
    from djpt.apps.cli.pictures import tonemap as tonemap
    from djpt.apps.cli.render import command as render
    from djpt.apps.cli.strips import bounces as bounces
    from djpt.apps.cli.strips import gallery as gallery
    from djpt.apps.cli.strips import spp as spp
    from djpt.apps.cli.strips import strategies as strategies
    from djpt.apps.cli.validate import command as validate
    from djpt.apps.cli.view import command as view
    from djpt.apps.cli.worker import command as worker
else:
    __getattr__, __dir__, __all__ = lazily(__name__)

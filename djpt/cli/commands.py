"""The commands of the command line, each imported when it is asked for."""

# ruff: noqa: F401 (the names are read by `lazily`)

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.lazy import lazily

if TYPE_CHECKING:
    from djpt.cli.animate import command as animate
    from djpt.cli.bounces import command as bounces
    from djpt.cli.compare import command as compare
    from djpt.cli.denoise import command as denoise
    from djpt.cli.doctor import command as doctor
    from djpt.cli.gallery import command as gallery
    from djpt.cli.gradcheck import command as gradcheck
    from djpt.cli.info import command as info
    from djpt.cli.ladder import command as ladder
    from djpt.cli.merge import command as merge
    from djpt.cli.render import command as render
    from djpt.cli.scenes import command as scenes
    from djpt.cli.spp import command as spp
    from djpt.cli.strategies import command as strategies
    from djpt.cli.tonemap import command as tonemap
    from djpt.cli.turntable import command as turntable
    from djpt.cli.validate import command as validate
    from djpt.cli.view import command as view
    from djpt.cli.worker import command as worker
else:
    __getattr__, __dir__, __all__ = lazily(__name__)

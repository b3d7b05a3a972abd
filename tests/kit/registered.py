"""Plugins that tests register, which other tests mustn't see."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from djpt.description import registry

__all__ = ["only_here"]


@contextmanager
def only_here() -> Iterator[None]:
    """Forget plugins that were registered meanwhile, but for those of djpt itself, which are registered when needed."""
    plugins = registry._plugins
    before = dict(plugins)
    yield
    for name, (_, factory) in list(plugins.items()):
        if name in before:
            plugins[name] = before[name]
        elif not registry.is_own(factory):
            del plugins[name]

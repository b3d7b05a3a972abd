"""From a scene to an image and its derivatives."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if TYPE_CHECKING:
    from djpt.rendering.scene import make_scene as make_scene
else:
    __getattr__, __dir__, __all__ = lazily(__name__)

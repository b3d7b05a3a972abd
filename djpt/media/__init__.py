"""Media, one per file. The file registers its medium; one line here says where it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if TYPE_CHECKING:
    from djpt.media.base import Medium as Medium
    from djpt.media.heterogeneous import Heterogeneous as Heterogeneous
    from djpt.media.homogeneous import Homogeneous as Homogeneous
else:
    __getattr__, __dir__, __all__ = lazily(__name__)

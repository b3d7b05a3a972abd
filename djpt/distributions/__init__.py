"""Densities given by tables of numbers, and ways to sample them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if TYPE_CHECKING:
    from djpt.distributions.discrete import Discrete as Discrete
    from djpt.distributions.discrete import DiscreteDistribution2D as DiscreteDistribution2D
    from djpt.distributions.hierarchical_2d import Hierarchical2D as Hierarchical2D
else:
    __getattr__, __dir__, __all__ = lazily(__name__)

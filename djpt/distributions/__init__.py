"""Densities given by tables of numbers, and ways to sample them."""

from __future__ import annotations

from djpt.distributions.discrete import Discrete
from djpt.distributions.discrete_2d import DiscreteDistribution2D
from djpt.distributions.hierarchical_2d import Hierarchical2D

__all__ = ["Discrete", "DiscreteDistribution2D", "Hierarchical2D"]

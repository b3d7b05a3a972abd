"""Seeds of images: Python's numbers, or arrays of one number whose value isn't known while kernels are traced."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.jit.kernels import opaque
from djpt.jit.types import UInt32
from djpt.samplers.hashing import sample_tea_32

__all__ = ["Seed", "gradient_seed", "opaque_seed"]

Seed = Any
"""An `int` below 2^32, or a `UInt32` of width 1."""


def opaque_seed(seed: Seed, base: int) -> UInt32:
    """The sum of a seed and a sampler's own, modulo 2^32, as an input of kernels."""
    if isinstance(seed, int):
        return dr.opaque(UInt32, (seed + base) & 0xFFFFFFFF)
    return opaque(seed + UInt32(base))


def gradient_seed(seed: Seed, seed_grad: Seed) -> Seed:
    """The seed of the gradient's samples: as in Mitsuba a hash of `seed`, unless `seed_grad` is given (not 0)."""
    if not isinstance(seed_grad, int) or seed_grad:
        return seed_grad
    hashed = sample_tea_32(UInt32(seed), UInt32(1))[0]
    return int(hashed[0]) if isinstance(seed, int) else hashed

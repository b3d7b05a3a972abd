"""Hashes, permutations and seeds, from which random numbers are made."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.jit.kernels import opaque, while_loop
from djpt.jit.types import Float64, UInt32

__all__ = ["Seed", "gradient_seed", "opaque_seed", "permute_kensler", "quotient", "remainder", "sample_tea_32"]


def sample_tea_32(v0: UInt32 | int, v1: UInt32 | int, rounds: int = 4) -> tuple[UInt32, UInt32]:
    """Tiny Encryption Algorithm as a hash of two 32-bit words.

    F. Zafar, M. Olano and A. Curtis, "GPU Random Numbers via the Tiny Encryption Algorithm",
    HPG 2010. Equals `mitsuba.sample_tea_32` bit for bit.
    """
    a, b = UInt32(v0), UInt32(v1)
    total = 0
    for _ in range(rounds):
        total = (total + 0x9E3779B9) & 0xFFFFFFFF
        a = a + (((b << 4) + 0xA341316C) ^ (b + total) ^ ((b >> 5) + 0xC8013EA4))
        b = b + (((a << 4) + 0xAD90777D) ^ (a + total) ^ ((a >> 5) + 0x7E95761E))
    return a, b


def quotient(x: UInt32, n: UInt32) -> UInt32:
    """The quotient floor(x / n), by doubles: processors divide vectors of floats, but not of integers.

    It is exact: no quotient of 32-bit integers lies within a double's rounding error below an integer.
    """
    return UInt32(Float64(x) / Float64(n))


def remainder(x: UInt32, n: UInt32) -> UInt32:
    """The remainder of x / n."""
    return x - quotient(x, n) * n


def permute_kensler(index: UInt32, n: UInt32, seed: UInt32) -> UInt32:
    """The image of `index`, which must be below n, under the permutation number `seed` of [0, n).

    A bijection of [0, 2^b), the smallest power of two that holds n, is repeated until it ends below n.
    A. Kensler, "Correlated Multi-Jittered Sampling", Pixar Technical Memo 13-01, 2013.
    Equals `mitsuba.permute_kensler`.
    """
    w = n - 1
    for shift in (1, 2, 4, 8, 16):
        w = w | (w >> shift)

    def step(i: UInt32) -> UInt32:
        # Multiplications by odd numbers and xors of lower by higher bits: each can be undone modulo 2^b.
        i = (i ^ seed) * 0xE170893D
        i = i ^ (seed >> 16)
        i = i ^ ((i & w) >> 4)
        i = (i ^ (seed >> 8)) * 0x0929EB3F
        i = i ^ (seed >> 23)
        i = i ^ ((i & w) >> 1)
        i = i * (1 | (seed >> 27)) * 0x6935FA69
        i = (i ^ ((i & w) >> 11)) * 0x74DCB303
        i = (i ^ ((i & w) >> 2)) * 0x9E501CC3
        i = (i ^ ((i & w) >> 2)) * 0xC860A3DF
        i = i & w
        return i ^ (i >> 5)

    (index,) = while_loop((step(index),), lambda i: i >= n, lambda i: (step(i),), label="permute")
    return remainder(index + seed, n)


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

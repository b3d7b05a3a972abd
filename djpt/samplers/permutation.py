"""Random permutations of [0, n) that are computed, not stored."""

from __future__ import annotations

from djpt.jit.kernels import while_loop
from djpt.jit.types import Float64, UInt32

__all__ = ["permute_kensler", "quotient", "remainder"]


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

"""Hashes of seeds, and permutations that are computed."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.errors import ArgumentError
from djpt.jit.kernels import float_in
from djpt.jit.types import PCG32, Bool, Float64, UInt32, UInt64, backend, converting
from djpt.samplers import hashing, ldsampler, permutation

__all__ = [
    "PCG32",
    "Philox4x32",
    "ScalarPCG32",
    "permute",
    "permute_kensler",
    "sample_tea_32",
    "sample_tea_64",
    "sample_tea_float",
    "sample_tea_float32",
    "sample_tea_float64",
]

Philox4x32 = backend.Philox4x32
ScalarPCG32 = dr.scalar.PCG32


def sample_tea_32(v0: Any, v1: Any, rounds: int = 4) -> tuple[Any, Any]:
    """Two 32-bit hashes of two 32-bit words: see `djpt.samplers.hashing`. Of two Python integers they are such, too."""
    hashes = hashing.sample_tea_32(UInt32(v0), UInt32(v1), rounds)
    return (hashes[0][0], hashes[1][0]) if are_integers(v0, v1) else hashes


def sample_tea_64(v0: Any, v1: Any, rounds: int = 4) -> Any:
    """Both hashes of `sample_tea_32` as one 64-bit integer; the second one is its upper half."""
    low, high = hashing.sample_tea_32(UInt32(v0), UInt32(v1), rounds)
    word = UInt64(low) + (UInt64(high) << 32)
    return word[0] if are_integers(v0, v1) else word


def sample_tea_float32(v0: Any, v1: Any, rounds: int = 4) -> Any:
    """A number in [0, 1) from the upper 23 bits of the second hash of `sample_tea_32`."""
    _, word = hashing.sample_tea_32(UInt32(v0), UInt32(v1), rounds)
    number = float_in((word >> 9) | 0x3F800000) - 1
    return number[0] if are_integers(v0, v1) else number


def sample_tea_float64(v0: Any, v1: Any, rounds: int = 4) -> Any:
    """A number in [0, 1) in double precision, from the upper 52 bits of `sample_tea_64`."""
    low, high = hashing.sample_tea_32(UInt32(v0), UInt32(v1), rounds)
    word = UInt64(low) + (UInt64(high) << 32)
    doubles: Any = dr.reinterpret_array(Float64, (word >> 12) | 0x3FF0000000000000)
    number = doubles - 1
    return number[0] if are_integers(v0, v1) else number


sample_tea_float = sample_tea_float32


def are_integers(*values: Any) -> bool:
    """Whether these are Python's integers."""
    return all(isinstance(value, int) for value in values)


@converting
def permute(value: UInt32, size: int, seed: UInt32, rounds: int = 4) -> UInt32:
    """The image of `value` under the permutation number `seed` of [0, size), a power of two.

    A network of random swaps, each decided by `rounds` rounds of `sample_tea_32`.
    """
    if size < 1 or size & (size - 1):
        raise ArgumentError(f"permute(): 'size' must be a power of two, found {size}")
    # Not `ldsampler.permute`, which is a loop: the size is known here.
    for layer in range(size.bit_length() - 1):
        value = ldsampler.swap(1 << layer, value, seed, rounds)
    return value


@converting
def permute_kensler(i: UInt32, l: int, p: UInt32, active: Bool | bool = True) -> UInt32:  # noqa: E741
    """The image of `i` under the permutation number `p` of [0, l), by A. Kensler, see `djpt.samplers.permutation`."""
    if l == 1:
        return dr.zeros(UInt32, dr.width(i))
    # Lane-wide, as loops ask for.
    return permutation.permute_kensler(i | (p & 0), UInt32(l), p)

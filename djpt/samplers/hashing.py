"""Integer hashing of seeds."""

from __future__ import annotations

from djpt.jit.types import UInt32

__all__ = ["sample_tea_32"]


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

"""Photons and the memory that a pass fills with them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.memory import RESERVE, shortage
from djpt.core.warp import direction_at, place_of
from djpt.errors import RenderError
from djpt.jit.types import ArrayXf, Bool, Color3f, Float, Int32, Normal3f, Point2f, Point3f, UInt32, Vector2f, Vector3f

__all__ = [
    "MOST_MEDIA",
    "NOWHERE",
    "WORDS",
    "Photon",
    "PhotonStore",
    "bytes_of",
    "coded",
    "decoded",
    "direction_in",
    "edges_and_medium",
    "memory_for",
    "require_memory",
    "unpacked",
    "word_of",
]

WORDS = 8
"""The words of 32 bits that a photon takes, and one packet of memory."""

WEIGHTS = 2
"""Additional words of photons that have weights."""

FOUND = 9
"""The words per photon, at most, that it takes to find its cell: its hash value, its number among those that have it,
its place in their order, and three for each hash value, of which there are less than two to a photon."""

PER_PATH, PER_PATH_IN_MEDIA = 6, 8
"""The numbers of photons per path for which memory is allocated at first, without media and with some."""

NORMAL_DIGITS, EDGES_DIGITS = 8, 16
"""Binary digits of a coordinate of a photon's normal, and of its number of edges: together they make a word."""

MOST_EDGES = 2**EDGES_DIGITS - 1
"""The largest number of edges that a photon stores; longer paths are clamped to it."""

NOWHERE = 0xFF
"""The number of no medium: that of photons on surfaces."""

MOST_MEDIA = NOWHERE - 1
"""The most media whose numbers photons can store."""

IN_MEDIUM = 0xFF
"""The word's first coordinate of a normal where there is a medium instead, whose number is the second: no normal has
it."""

MOST = 2**27
"""The most photons of a pass: their numbers are counted in 32 bits, with room for those that don't fit."""


@dataclass
class Photon:
    """A vertex of a light path: where light of a certain power arrives on a surface, or is scattered in a medium."""

    p: Point3f
    n: Normal3f
    """The surface's geometric normal, which is kept to about a degree; it means nothing in a medium."""
    edges: Float
    """The number of edges of the light path until there: a whole number, of which `MOST_EDGES` are kept."""
    d: Vector3f
    """The direction in which it travels."""
    flux: Color3f
    """The power that it would carry if it were the only light path; in a medium, the scattered part of it."""
    vcm: Float = field(default_factory=lambda: Float(0))
    vc: Float = field(default_factory=lambda: Float(0))
    """Both are the light path's, for weights: see `djpt.integrators.bidirectional.subpath.Subpath`; 0 where there are
    none."""
    medium: UInt32 | None = None
    """The number of the medium that it is in, or `NOWHERE` on a surface; None if no medium scatters light."""


def bytes_each(weighted: bool) -> int:
    """The bytes that a photon takes: as it was stored, once more in its cell if it has no weights, and to find it."""
    return 4 * (WORDS + (WEIGHTS if weighted else WORDS) + FOUND)


def bytes_of(paths: int, weighted: bool) -> int:
    """An estimate of the memory that the photons of some light paths take, with weights or without."""
    return PER_PATH * paths * bytes_each(weighted)


def require_memory(owner: str, paths: int, weighted: bool, photons: int = 0) -> None:
    """Raise `RenderError` if the photons of a pass don't fit into memory.

    Args:
        owner: the name of the integrator.
        paths: light paths of the pass.
        weighted: whether photons have weights.
        photons: their photons; 0: an estimate.
    """
    photons = photons or PER_PATH * paths
    missing = shortage(photons * bytes_each(weighted) + RESERVE)
    if photons > MOST or missing is not None:
        problem = missing or f"has more than {MOST}"
        raise RenderError(
            f"{owner}: the map of {photons} photons of {paths} light paths {problem}; lower 'photon_count'"
        )


class PhotonStore:
    """Memory that the lanes of a light walk fill with photons, in any order."""

    def __init__(self, owner: str, paths: int, weighted: bool, in_media: bool = False) -> None:
        """Room for the photons of some light paths.

        Args:
            owner: the integrator's name, for messages.
            paths: light paths of a pass.
            weighted: whether photons have weights; else weights are discarded.
            in_media: whether some photons are in media, and all know which.

        Raises:
            RenderError: They need more memory than is free.
        """
        self._owner, self._paths, self.weighted, self.in_media = owner, paths, weighted, in_media
        self._make_room((PER_PATH_IN_MEDIA if in_media else PER_PATH) * paths)

    def _make_room(self, photons: int) -> None:
        require_memory(self._owner, self._paths, self.weighted, photons)
        self._room, self._limit = photons, dr.opaque(UInt32, photons)
        self.photons, self.weights = memory_for(photons, self.weighted)

    def clear(self) -> None:
        """Forget all photons."""
        self._count = dr.opaque(UInt32, 0, 1)

    @property
    def sinks(self) -> Any:
        """The arrays to which kernels add photons."""
        return self._count, self.photons, self.weights

    def add(self, photon: Photon, active: Bool) -> None:
        """Store a photon. Those for which there is no room are only counted."""
        place: Any = dr.scatter_inc(self._count, UInt32(0), active)
        active = active & (place < self._limit)
        dr.scatter(self.photons, packed(photon), place, active)
        if self.weighted:
            dr.scatter(self.weights, Vector2f(photon.vcm, photon.vc), place, active)

    def count(self) -> int | None:
        """The number of photons, once the walk has ended; None if there was no room: then there is for another walk.

        Raises:
            RenderError: There isn't enough memory.
        """
        found = int(self._count[0])
        if found <= self._room:
            return found
        self._make_room(found + found // 4)
        return None

    def places_in_media(self, count: int) -> NDArray[np.float32]:
        """The positions of those of the `count` photons that are in media, (n, 3)."""
        if not count or not self.in_media:
            return np.zeros((0, 3), np.float32)
        packets = np.array(self.photons).reshape(-1, WORDS)[:count]
        place = packets[:, 3].view(np.uint32) >> EDGES_DIGITS
        there = packets[(place & (2**NORMAL_DIGITS - 1)) == IN_MEDIUM]
        return np.asarray(there[:, :3])


def memory_for(photons: int, weighted: bool) -> tuple[Float, Float]:
    """Memory for the packets of some photons, and for their weights, if they have any."""
    return dr.empty(Float, WORDS * photons), dr.empty(Float, WEIGHTS * photons if weighted else 0)


def packed(photon: Photon) -> ArrayXf:
    """A photon as a packet, without its weights."""
    p, flux = photon.p, photon.flux
    edges = dr.minimum(UInt32(photon.edges), MOST_EDGES)
    place = coded(photon.n, NORMAL_DIGITS)
    if photon.medium is not None:
        place = dr.select(photon.medium == NOWHERE, place, IN_MEDIUM | (photon.medium << NORMAL_DIGITS))
    word: Any = dr.reinterpret_array(Float, edges | (place << EDGES_DIGITS))
    return ArrayXf([p.x, p.y, p.z, Float(word), flux.x, flux.y, flux.z, word_of(photon.d)])


def edges_and_medium(word: UInt32) -> tuple[Float, UInt32]:
    """The number of edges of a photon, and of its medium or `NOWHERE`, by the word of its packet."""
    place = word >> EDGES_DIGITS
    inside = (place & (2**NORMAL_DIGITS - 1)) == IN_MEDIUM
    return Float(word & MOST_EDGES), dr.select(inside, place >> NORMAL_DIGITS, NOWHERE)


def unpacked(packet: ArrayXf, weights: Vector2f | None, in_media: bool = False) -> Photon:
    """The photon of a packet, and of weights if it has some; `in_media`: whether it knows its medium."""
    x, y, z, word, red, green, blue, way = packet
    bits: Any = dr.reinterpret_array(UInt32, word)
    n = Normal3f(decoded(UInt32(bits) >> EDGES_DIGITS, NORMAL_DIGITS))
    edges, medium = edges_and_medium(UInt32(bits))
    photon = Photon(Point3f(x, y, z), n, edges, direction_in(way), Color3f(red, green, blue))
    if in_media:
        photon.medium = medium
    return photon if weights is None else replace(photon, vcm=weights.x, vc=weights.y)


DIGITS = 16
"""Binary digits of a coordinate of a direction that fills a word."""


def coded(d: Vector3f, digits: int) -> UInt32:
    """A unit vector in a whole number with twice as many binary `digits` as each of its two coordinates has."""
    half = half_of(digits)
    low, high = (UInt32(Int32(dr.round(dr.fma(c, half, half)))) for c in place_of(d)[0])
    return low | (high << digits)


def decoded(bits: UInt32, digits: int) -> Vector3f:
    """The unit vector encoded by `coded`."""
    inverse = 1 / half_of(digits)
    u, v = (dr.fma(Float(Int32(c)), inverse, -1) for c in (bits & (2**digits - 1), bits >> digits))
    return direction_at(Point2f(u, v))


def word_of(d: Vector3f) -> Float:
    """A unit vector stored in the bits of a `Float`, which isn't meaningful as a number."""
    word: Any = dr.reinterpret_array(Float, coded(d, DIGITS))
    return Float(word)


def direction_in(word: Float) -> Vector3f:
    """The unit vector stored by `word_of`."""
    bits: Any = dr.reinterpret_array(UInt32, word)
    return decoded(UInt32(bits), DIGITS)


def half_of(digits: int) -> int:
    """The steps from the square's centre to its side."""
    return int(2 ** (digits - 1) - 1)

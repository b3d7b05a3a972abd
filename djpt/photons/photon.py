"""Photons and the memory that a pass fills with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.errors import RenderError
from djpt.process.memory import RESERVE, shortage
from djpt.types import Array4f, Bool, Color3f, Float, Point3f, UInt32, Vector3f

__all__ = ["Photon", "PhotonStore", "bytes_of", "require_memory"]

PACKETS = 3
"""The packets of four numbers that a photon takes."""

BYTES = 2 * PACKETS * 16 + 16
"""The bytes of a photon: as it was stored, once more in its cell, and what is needed to find the cell."""

PER_PATH = 6
"""Photons of a path that there is memory for at first."""

MOST = 2**28
"""The most photons of a pass: their numbers are counted in 32 bits, with room for those that don't fit."""


@dataclass
class Photon:
    """A vertex of a light path: where light of a certain power arrives on a surface."""

    p: Point3f
    edges: Float
    """The number of edges of the light path until there: a whole number."""
    d: Vector3f
    """The direction in which it travels."""
    flux: Color3f
    """The power that it carries, of all light paths together, as if there were no others."""
    vcm: Float
    vc: Float
    """Both are the light path's, for weights: see `djpt.integrators.both_ends.End`; 0 where there are none."""


def bytes_of(paths: int) -> int:
    """An estimate of the memory that the photons of some light paths take."""
    return PER_PATH * paths * BYTES


def require_memory(owner: str, paths: int, photons: int = 0) -> None:
    """Raise `RenderError` if the photons of a pass are more than memory holds.

    Args:
        owner: the name of the integrator.
        paths: light paths of the pass.
        photons: their photons; 0: an estimate.
    """
    photons = photons or PER_PATH * paths
    missing = shortage(photons * BYTES + RESERVE)
    if photons > MOST or missing is not None:
        problem = missing or f"has more than {MOST}"
        raise RenderError(
            f"{owner}: the map of {photons} photons of {paths} light paths {problem}; lower 'photon_count'"
        )


class PhotonStore:
    """Memory that the lanes of a light walk fill with photons, in any order."""

    def __init__(self, owner: str, paths: int) -> None:
        """Room for the photons of some light paths; `owner` is the integrator's name, for messages.

        Raises:
            RenderError: They take more memory than is free.
        """
        self._owner, self._paths = owner, paths
        self._make_room(PER_PATH * paths)

    def _make_room(self, photons: int) -> None:
        require_memory(self._owner, self._paths, photons)
        self._room, self._limit = photons, dr.opaque(UInt32, photons)
        self.packets = [dr.empty(Float, 4 * photons) for _ in range(PACKETS)]

    def clear(self) -> None:
        """Forget all photons."""
        self._count = dr.opaque(UInt32, 0, 1)

    @property
    def sinks(self) -> Any:
        """What kernels that add photons write to."""
        return self._count, self.packets

    def add(self, photon: Photon, active: Bool) -> None:
        """Keep a photon. Those for which there is no room are counted only."""
        place: Any = dr.scatter_inc(self._count, UInt32(0), active)
        active = active & (place < self._limit)
        for memory, packet in zip(self.packets, packed(photon), strict=True):
            dr.scatter(memory, packet, place, active)

    def count(self) -> int | None:
        """The number of photons, once the walk has ended; None if there was no room: then there is, to walk again.

        Raises:
            RenderError: There can't be.
        """
        found = int(self._count[0])
        if found <= self._room:
            return found
        self._make_room(found + found // 4)
        return None


def packed(photon: Photon) -> list[Array4f]:
    """A photon as packets: the place, the way, the power."""
    p, d, flux = photon.p, photon.d, photon.flux
    return [
        Array4f(p.x, p.y, p.z, photon.edges),
        Array4f(d.x, d.y, d.z, photon.vcm),
        Array4f(flux.x, flux.y, flux.z, photon.vc),
    ]


def unpacked(place: Array4f, way: Array4f, power: Array4f) -> Photon:
    """The photon that three packets hold."""
    return Photon(
        p=Point3f(place[0], place[1], place[2]),
        edges=place[3],
        d=Vector3f(way[0], way[1], way[2]),
        flux=Color3f(power[0], power[1], power[2]),
        vcm=way[3],
        vc=power[3],
    )

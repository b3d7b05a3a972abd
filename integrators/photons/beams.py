"""Beams: the edges of light paths in media, and the memory that a pass fills with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.memory import RESERVE, shortage
from djpt.errors import RenderError
from djpt.integrators.photons.cells import Segment
from djpt.integrators.photons.photon import EDGES_DIGITS, MOST_EDGES, PhotonStore
from djpt.jit.types import ArrayXf, Bool, Color3f, Float, Point3f, UInt32, Vector3f

__all__ = ["Beam", "BeamStore"]

WORDS = 8
"""The words of 32 bits of a packet, of which a beam has two: where it is, and what it carries."""

PER_PATH = 8
"""The number of beams per light path for which memory is allocated at first."""

FAR = 1e15
"""The length of beams without an end, whose square is still a number."""


@dataclass
class Beam:
    """An edge of a light path in a medium: light that may be scattered anywhere along it."""

    o: Point3f
    d: Vector3f
    length: Float
    edges: Float
    """The number of edges of the light path, this one included: see `Photon.edges`."""
    medium: UInt32
    flux: Color3f
    """The power where the beam begins, if this were the only light path that leaves beams."""
    vcm: Float
    vc: Float
    before: Float
    """These three are the light path's before it has arrived: see `djpt.integrators.bidirectional.subpath.Subpath`."""

    @property
    def segment(self) -> Segment:
        """Where the beam is."""
        return Segment(self.o, self.d, self.length)


class BeamStore(PhotonStore):
    """Memory for photons, and for the beams of some of the light paths."""

    def __init__(self, owner: str, paths: int, weighted: bool, in_media: bool, beam_paths: int) -> None:
        """Room for the photons of `paths` light paths, and for the beams of `beam_paths` of them.

        Raises:
            RenderError: They need more memory than is free.
        """
        super().__init__(owner, paths, weighted, in_media)
        self._make_beam_room(PER_PATH * beam_paths)

    def _make_beam_room(self, beams: int) -> None:
        missing = shortage(4 * 2 * WORDS * beams + RESERVE)
        if missing is not None:
            raise RenderError(f"{self._owner}: {beams} beams of light paths {missing}; lower 'beam_count'")
        self._beam_room, self._beam_limit = beams, dr.opaque(UInt32, beams)
        self._places, self._loads = (dr.empty(Float, max(1, WORDS * beams)) for _ in range(2))

    def clear(self) -> None:
        super().clear()
        self._beam_count = dr.opaque(UInt32, 0, 1)

    @property
    def sinks(self) -> Any:
        return super().sinks, self._beam_count, self._places, self._loads

    def add_beam(self, beam: Beam, active: Bool) -> None:
        """Store a beam. Those for which there is no room are only counted."""
        number: Any = dr.scatter_inc(self._beam_count, UInt32(0), active)
        active = active & (number < self._beam_limit)
        bits = dr.minimum(UInt32(beam.edges), MOST_EDGES) | (beam.medium << EDGES_DIGITS)
        word: Any = dr.reinterpret_array(Float, bits)
        place = ArrayXf([*beam.o, dr.minimum(beam.length, FAR), *beam.d, Float(word)])
        load = ArrayXf([*beam.flux, beam.vcm, beam.vc, beam.before, Float(0), Float(0)])
        dr.scatter(self._places, place, number, active)
        dr.scatter(self._loads, load, number, active)

    def count(self) -> int | None:
        count = super().count()
        beams = int(self._beam_count[0])
        if beams > self._beam_room:
            self._make_beam_room(beams + beams // 4)
            return None
        return count

    @property
    def beams(self) -> int:
        """The number of beams, once the walk has ended."""
        return int(self._beam_count[0])

    def beam(self, i: UInt32, there: Bool) -> Beam:
        """The beam of a number."""
        lanes = dr.width(i, there)
        x, y, z, length, dx, dy, dz, word = dr.gather(ArrayXf, self._places, i, there, shape=(WORDS, lanes))
        red, green, blue, vcm, vc, before, _, _ = dr.gather(ArrayXf, self._loads, i, there, shape=(WORDS, lanes))
        found: Any = dr.reinterpret_array(UInt32, word)
        bits = UInt32(found)
        return Beam(
            Point3f(x, y, z),
            Vector3f(dx, dy, dz),
            length,
            Float(bits & MOST_EDGES),
            bits >> EDGES_DIGITS,
            Color3f(red, green, blue),
            vcm,
            vc,
            before,
        )

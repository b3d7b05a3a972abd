"""The tree whose searches are steps that all lanes take together. The contract is `RayTree`."""

from __future__ import annotations

import dataclasses
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.geometry.bvh.steps.records import WORDS, Records
from djpt.geometry.bvh.steps.search import search
from djpt.geometry.bvh.steps.traversal import Cursor, load, load_second, start, triangle_corners, turn
from djpt.geometry.query import Found
from djpt.jit.types import Bool, Float, Point3f, UInt32, Vector3f

__all__ = ["StepTree"]


@dataclasses.dataclass
class StepTree(Records):
    """Records with the searches that `djpt.geometry.bvh` has for them."""

    stepwise: bool = True

    @staticmethod
    def of(records: Records) -> StepTree:
        """The tree of some records."""
        return StepTree(**{field.name: getattr(records, field.name) for field in dataclasses.fields(records)})

    @property
    def bytes(self) -> int:
        return 4 * dr.width(self.words)

    def search(
        self, ray: Ray3f, any_hit: bool, active: Bool | bool = True, through_lights: Bool | None = None
    ) -> Found:
        return search(self, ray, any_hit, active, through_lights)

    def start(
        self, o: Point3f, d: Vector3f, maxt: Float, active: Bool | bool, hit: UInt32 | int, weights: bool
    ) -> Cursor:
        return start(self, o, d, maxt, active, hit, weights)

    def turn(self, cursor: Cursor, o: Point3f, d: Vector3f, any_hit: Bool, through_lights: Bool | None) -> Cursor:
        return turn(self, cursor, o, d, any_hit, through_lights)

    def row(self, record: UInt32) -> list[UInt32]:
        return load_second(self.words, record)

    def word(self, record: UInt32, index: int, active: Bool | bool = True) -> UInt32:
        word: Any = dr.gather(UInt32, self.words, record * WORDS + (WORDS // 2 + index), active)
        return UInt32(word)

    def map_rows(self, record: UInt32) -> list[UInt32]:
        return load(self.words, record)

    def corners(self, record: UInt32) -> tuple[Point3f, Point3f, Point3f]:
        return triangle_corners(load(self.words, record))

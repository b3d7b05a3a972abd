"""Local automatic differentiation: the derivative of one path vertex.

Path replay (`djpt.rendering.gradients.replay`) walks a path twice: first to compute its radiance, then
vertex by vertex to differentiate it. At a vertex only few expressions depend on parameters,
so instead of attaching the whole scene, `Leaves` hands the vertex *fresh* AD leaves for
exactly the values that it looks up. After differentiating that one expression, the leaves'
gradients are added to the parameters that they were copies of.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.lookup import MAX_CHAIN, Numbers, Rows, is_one_of
from djpt.description.plugin import ParamFlags, Plugin
from djpt.dispatch.ensemble import Detached, Leaf, TableLeaf
from djpt.dispatch.tables import Buffer, entry_size
from djpt.errors import RenderError
from djpt.jit.kernels import opaque
from djpt.jit.types import Bool, Float, UInt32
from djpt.rendering.gradients.entry_sums import EntrySums, Repeated, entry_sums, prepare_functions, summed
from djpt.scene.scene import Scene
from djpt.sensors.base import Sensor

__all__ = [
    "Accumulator",
    "Leaves",
    "Numbering",
    "Parameter",
    "Tangents",
    "attached_parameters",
    "components",
    "motion_parameters",
    "placing",
    "prepare_tables",
    "unused_values",
]


@dataclass(frozen=True)
class Parameter:
    """A value of the scene that has gradients enabled."""

    owner: Plugin
    attribute: str

    @property
    def value(self) -> Any:
        """The current (attached) value."""
        return getattr(self.owner, self.attribute)

    @property
    def is_table(self) -> bool:
        """True for a tensor that kernels read entry by entry."""
        return self.attribute in self.owner.tables

    @property
    def flags(self) -> ParamFlags:
        """The flags that `traverse` reports."""
        return {**self.owner.values, **self.owner.tables}.get(self.attribute, ParamFlags.Differentiable)

    @property
    def size(self) -> int:
        """Number of components of a uniform value."""
        return int(dr.size_v(type(self.value))) if dr.depth_v(self.value) > 1 else 1


def attached_parameters(scene: Scene) -> list[Parameter]:
    """All parameters of the scene with gradients enabled, each once.

    Raises:
        RenderError: One of them is a value that path replay has no derivative for.
    """
    found: dict[tuple[int, str], Parameter] = {}
    for ensemble in scene.ensembles():
        for group in ensemble.groups:
            for leaf in group.leaves():
                for owner in leaf.owners:
                    value = getattr(owner, leaf.attribute)
                    if not dr.grad_enabled(value):
                        continue
                    parameter = Parameter(owner, leaf.attribute)
                    if not parameter.flags.differentiable:
                        raise RenderError(f"no gradient is available for '{owner.id()}.{leaf.attribute}'")
                    found[id(owner), leaf.attribute] = parameter
    return list(found.values())


def prepare_tables(scene: Scene) -> None:
    """Compile what adds up the gradients of the scene's tables, which frozen functions can't."""
    leaves = (leaf for ensemble in scene.ensembles() for leaf in ensemble.leaves() if isinstance(leaf, TableLeaf))
    attached = (t for leaf in leaves for t in leaf.rows() if dr.grad_enabled(t))
    prepare_functions({entry_size(tensor) for tensor in attached})


def motion_parameters(scene: Scene, sensor: Sensor | None = None) -> list[Parameter]:
    """The parameters of shapes, and of a sensor, that place them and have gradients.

    `djpt.shapes.silhouettes.moving` says how they are read.
    """
    return [*placing(scene.shapes()), *placing([] if sensor is None else sensor.members())]


def placing(owners: Sequence[Any]) -> list[Parameter]:
    """The parameters that place shapes or sensors and have gradients."""
    return [Parameter(owner, name) for owner in owners for name in owner.attached_names()]


def unused_values(scene: Scene, parameters: Sequence[Parameter]) -> list[Any]:
    """The values of the scene that have gradients but aren't among the `parameters` that its image depends on.

    They belong to plugins that stand in the scene for others to refer to. (Shapes have no values with gradients.)
    """
    used = {(id(p.owner), p.attribute) for p in parameters}
    found: dict[tuple[int, str], Any] = {}
    waiting: list[Any] = [plugin for _, plugin in scene.named if plugin.kind != "shape"]
    while waiting:
        plugin = waiting.pop()
        for name in (*plugin.values, *plugin.tables):
            value = getattr(plugin, name)
            if (id(plugin), name) not in used and dr.grad_enabled(value):
                found[id(plugin), name] = value
        children = (getattr(plugin, name) for name in plugin.children)
        waiting += [child for child in children if isinstance(child, Plugin) and child.kind != "shape"]
    return list(found.values())


class Numbering:
    """The numbers of the parameters that leaves read, for each member of a group; built before kernels are traced."""

    def __init__(self, parameters: Sequence[Parameter], leaves: Sequence[Leaf], values: Detached) -> None:
        number = {(id(p.owner), p.attribute): i for i, p in enumerate(parameters)}
        self._of_leaf = {
            id(leaf): [number.get((id(owner), leaf.attribute)) for owner in leaf.owners] for leaf in leaves
        }
        self.leaves = [leaf for leaf in leaves if any(n is not None for n in self._of_leaf[id(leaf)])]
        # Found before the image is launched: to read a value is to wait for all kernels under way.
        self.vanishing = frozenset(i for i, p in enumerate(parameters) if values.vanishes(p.owner, p.attribute))
        """The numbers of the parameters that may make a factor of paths vanish: see `may_vanish`."""

    def of(self, leaf: Leaf) -> list[int | None]:
        """The number of the parameter of each member, or None."""
        return self._of_leaf.get(id(leaf), [])


class Tangents:
    """The given changes of the parameters in forward mode, looked up like the values themselves."""

    def __init__(self, numbering: Numbering, changes: Sequence[Any]) -> None:
        self._tables: dict[int, Any] = {}
        for leaf in numbering.leaves:
            numbers = numbering.of(leaf)
            if isinstance(leaf, TableLeaf):
                tensors = [dr.detach(tensor) for tensor in leaf.rows()]
                given = [dr.zeros_like(t) if n is None else changes[n] for t, n in zip(tensors, numbers, strict=True)]
                self._tables[id(leaf)] = Buffer(given, leaf.identity())
                continue
            zero = dr.zeros(type(leaf.rows()[0]))
            rows = [zero if n is None else opaque(changes[n]) for n in numbers]
            self._tables[id(leaf)] = Rows(rows, [-1 if n is None else n for n in numbers])

    def at(self, leaf: Leaf, slot: UInt32) -> Any:
        """The change of a leaf's value."""
        return self._tables[id(leaf)].at(slot)

    def entry(self, leaf: TableLeaf, address: UInt32) -> Any:
        """The change of the entry at an address of a leaf's buffer."""
        return self._tables[id(leaf)].read(address)


class Leaves:
    """A `Lookup` that returns fresh AD leaves for attached parameters and remembers them."""

    def __init__(self, values: Detached, numbering: Numbering, tangents: Tangents | None = None) -> None:
        self._values, self._numbering, self._tangents = values, numbering, tangents
        self.taken: list[tuple[Leaf, UInt32, Any]] = []
        self.read: list[tuple[TableLeaf, UInt32, Any]] = []
        """The entries of tables that were read: leaf, address, and the entry as an AD leaf."""

    def attaches(self, leaf: Leaf) -> bool:
        return any(n is not None for n in self._numbering.of(leaf))

    def vanishing_members(self, leaf: Leaf) -> list[int]:
        return [k for k, n in enumerate(self._numbering.of(leaf)) if n in self._numbering.vanishing]

    def plain(self) -> Detached:
        return self._values

    def buffer(self, leaf: TableLeaf) -> Buffer:
        """The tensors of a leaf."""
        return self._values.buffer(leaf)

    def __call__(self, leaf: Leaf, slot: UInt32) -> Any:
        value = self._values(leaf, slot)
        if not self.attaches(leaf):
            return value
        if isinstance(leaf, TableLeaf):
            return LeafTable(self, leaf, slot)
        fresh = type(value)(dr.detach(value))
        dr.enable_grad(fresh)
        if self._tangents is not None:
            dr.set_grad(fresh, self._tangents.at(leaf, slot))
        self.taken.append((leaf, slot, fresh))
        return fresh

    def entry(self, leaf: TableLeaf, slot: UInt32, index: UInt32, active: Bool | bool) -> Any:
        """One entry of a table as an AD leaf."""
        buffer = self.buffer(leaf)
        address = buffer.address(slot, index)
        fresh = dr.detach(buffer.read(address, active))
        dr.enable_grad(fresh)
        if self._tangents is not None:
            dr.set_grad(fresh, self._tangents.entry(leaf, address))
        self.read.append((leaf, address, fresh))
        return fresh


@dataclass
class LeafTable:
    """A `Table` whose entries become AD leaves as they are read."""

    leaves: Leaves
    leaf: TableLeaf
    slot: UInt32
    attached = True

    def at(self, index: UInt32, active: Bool | bool = True) -> Any:
        """Entry number `index`, as an AD leaf: see `djpt.dispatch.tables.Table`."""
        return self.leaves.entry(self.leaf, self.slot, index, active)


class Accumulator:
    """The sums of the leaves' gradients: in registers of each lane, or in memory if there are many.

    Gradients of tables are always summed in memory.

    Register sums are added up in a fixed order at the end. Sums in memory are atomic additions,
    whose rounding may differ from run to run.
    """

    def __init__(self, parameters: Sequence[Parameter], numbering: Numbering, values: Detached, lanes: int) -> None:
        self.parameters, self._numbering, self._lanes = parameters, numbering, lanes
        self._starts: list[int] = []
        self.size = 0
        for parameter in parameters:
            self._starts.append(self.size)
            self.size += 0 if parameter.is_table else parameter.size
        self.in_registers = sum(not parameter.is_table for parameter in parameters) <= MAX_CHAIN
        self._repeated = None if self.in_registers else Repeated(self.size, lanes)
        self._memory = Float() if self._repeated is None else dr.zeros(Float, self.size * self._repeated.count)
        # Members without a parameter point beyond the end.
        self._start_of = {
            id(leaf): Numbers([self.size if n is None else self._starts[n] for n in numbering.of(leaf)])
            for leaf in numbering.leaves
            if not isinstance(leaf, TableLeaf)
        }
        self._tables: dict[int, tuple[TableLeaf, Buffer, EntrySums]] = {}
        for leaf in numbering.leaves:
            if isinstance(leaf, TableLeaf):
                buffer = values.buffer(leaf)
                self._tables[id(leaf)] = (leaf, buffer, entry_sums(buffer, lanes))
        self.has_tables = bool(self._tables)
        self._calls = any(sums.calls for _, _, sums in self._tables.values())

    def start(self) -> list[Float]:
        """The sums at the start of the loop: one per component, or none; and one that uses the results of calls."""
        count = (self.size if self.in_registers else 0) + self._calls
        return [dr.zeros(Float, self._lanes) for _ in range(count)]

    def add(self, sums: list[Float], leaves: Leaves, active: Bool) -> list[Float]:
        """Add the gradients of all leaves taken at a vertex."""
        sums = list(sums)
        for leaf, slot, value in leaves.taken:
            gradient = components(dr.grad(value))
            if self._repeated is None:
                for first, mine in self.places(leaf, slot):
                    for c, component in enumerate(gradient):
                        sums[first + c] = sums[first + c] + dr.select(mine & active, component, 0)
            else:
                start = self._start_of[id(leaf)].at(slot)
                for c, component in enumerate(gradient):
                    at = self._repeated.address(start + c)
                    dr.scatter_add(self._memory, component, at, active & (start < self.size))
        for place, (_, _, entries) in self._tables.items():
            read = [(address, dr.grad(entry)) for leaf, address, entry in leaves.read if id(leaf) == place]
            taken = entries.add(read, active)
            if entries.calls:
                sums[-1] = sums[-1] + dr.select(taken, 1, 0)
        return sums

    def places(self, leaf: Leaf, slot: UInt32) -> Iterator[tuple[int, Bool]]:
        """The first register sum of each parameter that a leaf may have read, and where it has."""
        numbers = self._numbering.of(leaf)
        for number in {n for n in numbers if n is not None}:
            yield self._starts[number], is_one_of(slot, [i for i, n in enumerate(numbers) if n == number])

    def gradients(self, sums: list[Float]) -> list[Any]:
        """The finished gradients, one per parameter, of the parameters' types."""
        if self._repeated is None:
            totals = [dr.sum(s) for s in sums[: self.size]]
        else:
            total = summed(self._memory, self.size, self._repeated.count)
            totals = [dr.gather(Float, total, UInt32(i)) for i in range(self.size)]
        dr.eval(totals)
        result: list[Any] = []
        for parameter, start in zip(self.parameters, self._starts, strict=True):
            if parameter.is_table:
                result.append(self._table_gradient(parameter))
                continue
            kind = type(parameter.value)
            parts = totals[start : start + parameter.size]
            result.append(kind(*parts))
        return result

    def _table_gradient(self, parameter: Parameter) -> Any:
        shape = parameter.value.shape
        total = dr.zeros(Float, dr.prod(shape))
        # A texture may stand in several groups: each has a buffer.
        for leaf, buffer, sums in self._tables.values():
            if leaf.attribute == parameter.attribute and parameter.owner in leaf.owners:
                total += buffer.unpacked(sums.total(), id(parameter.owner), shape)
        return type(parameter.value)(total, shape)


def components(value: Any) -> list[Float]:
    """The components of a number or a vector."""
    return [value[c] for c in range(len(value))] if dr.depth_v(value) > 1 else [value]

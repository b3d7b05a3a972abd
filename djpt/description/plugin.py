"""What every node of a scene description is: a plugin with values, children and statics."""

from __future__ import annotations

import enum
import textwrap
from collections.abc import Hashable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from djpt.description.inference import Inferred, reporting, sorts_of

if TYPE_CHECKING:
    from djpt.description.properties import Properties

__all__ = ["ParamFlags", "Plugin", "TraversalCallback"]


INFERRED = ("bsdf", "emitter", "texture")
"""Kinds of plugins whose methods run in kernels and need nothing but their attributes."""


class ParamFlags(enum.IntFlag):
    """What `traverse()` says of a parameter."""

    NonDifferentiable = 0
    Differentiable = 1
    Discontinuous = 2


class TraversalCallback(Protocol):
    """What `Plugin.traverse` reports to."""

    def put(
        self,
        name: str,
        value: Any,
        flags: ParamFlags = ParamFlags.NonDifferentiable,
        attribute: str | None = None,
    ) -> None:
        """Report a parameter, or a nested `Plugin` (whose own parameters get the prefix `name`).

        A parameter is written back with ``setattr(plugin, attribute or name, value)``.
        """


class Plugin:
    """A node of the scene: built from checked properties, edited through `traverse()`.

    A plugin keeps four sorts of attributes, and says which is which:

    * `values`: Dr.Jit arrays of width 1 that may differ between instances and that edits
      may change. Kernels read them as opaque inputs, so an edit compiles nothing.
    * `tables`: tensors of any shape, such as the texels of a bitmap. Kernels read single entries, through a
      `djpt.dispatch.tables.Table` that stands in the tensor's place.
    * `children`: attributes that hold further plugins (a texture in a BSDF).
    * `statics`: everything else that a kernel depends on (a distribution's name, a flag).
      Instances with equal class, statics and children are traced **once**, with per-lane
      values: methods called in kernels must therefore read only these four sorts.

    BSDFs, textures and emitters may also declare nothing, as in Mitsuba: see `djpt.description.inference`.

    Plugins don't know the scene that they are part of.
    """

    kind: ClassVar[str] = ""
    """`bsdf`, `shape`, `emitter`, `texture`, `sensor`, `film`, `rfilter`, `sampler`, `integrator` or `scene`."""

    values: ClassVar[Mapping[str, ParamFlags]] = Inferred("values", {})  # type: ignore[assignment]
    tables: ClassVar[Mapping[str, ParamFlags]] = {}
    children: ClassVar[Sequence[str]] = Inferred("children", ())  # type: ignore[assignment]
    statics: ClassVar[Sequence[str]] = Inferred("statics", ())  # type: ignore[assignment]

    infers: ClassVar[bool] = False
    """Does the class declare none of these? Then they are inferred from its instances' attributes."""

    id: str = ""

    def __init__(self, props: Properties) -> None:
        self.id = props.id

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        own = (name for base in cls.__mro__ if base is not Plugin for name in vars(base))
        cls.infers = cls.kind in INFERRED and not {"values", "tables", "children", "statics"} & set(own)
        if cls.infers and "traverse" in vars(cls):
            cls.traverse = reporting(cls.traverse)  # type: ignore[method-assign]

    @property
    def _identity(self) -> Hashable:
        """What sets an instance apart whose class declares nothing."""
        return sorts_of(self).identity

    def __repr__(self) -> str:
        """The plugin's type, and its parameters and nested plugins as a tree; a script's `to_string` if it has one."""
        if hasattr(self, "to_string"):
            return str(self.to_string())
        listing = _Listing()
        self.traverse(listing)
        body = textwrap.indent(",\n".join(listing.lines), "  ")
        return f"{type(self).__name__}[\n{body}\n]" if body else f"{type(self).__name__}[]"

    def traverse(self, callback: TraversalCallback) -> None:
        """Report all parameters; by default the `values`, the `tables` and the `children`."""
        if self.infers and type(self).traverse is not Plugin.traverse:
            return  # called by the override, which reports what it wants
        for name, flags in {**self.values, **self.tables}.items():
            callback.put(name, getattr(self, name), flags)
        for name in self.children:
            child = getattr(self, name)
            if isinstance(child, Plugin):
                callback.put(name, child)

    def check_parameter(self, name: str, value: Any) -> Any:
        """Convert and check a value that is about to be assigned; raise `ParameterError` if it can't be."""
        return value

    def parameters_changed(self, keys: Sequence[str]) -> None:
        """Recompute what was derived from the parameters named in `keys`."""


class _Listing:
    """Collects ``name = value`` lines for `Plugin.__repr__`."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def put(
        self,
        name: str,
        value: Any,
        flags: ParamFlags = ParamFlags.NonDifferentiable,
        attribute: str | None = None,
    ) -> None:
        text = repr(value)
        self.lines.append(f"{name} = {text}" if len(text) < 400 or isinstance(value, Plugin) else f"{name} = [...]")

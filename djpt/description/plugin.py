"""The base class of all nodes of a scene: a plugin with values, tables, children and statics."""

from __future__ import annotations

import enum
import functools
import textwrap
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import drjit as dr

from djpt.description.class_names import CLASS_NAMES
from djpt.description.registry import name_of
from djpt.errors import DjptError, RenderError
from djpt.jit.backends import variant
from djpt.jit.frozen import Holder
from djpt.jit.types import Float

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from djpt.description.properties import Allowed, Properties

__all__ = ["HIDDEN", "Endpoint", "Frame", "NotMovable", "ParamFlags", "Plugin", "TraversalCallback", "is_plain"]


class NotMovable(DjptError):
    """A plugin that can't be moved into a frame: what it does in other coordinates isn't known."""


class Frame(Protocol):
    """The map p -> scale (p - center) from the scene's own coordinates, as plugins see it that move along.

    Radiance and irradiance stay as they are. What goes with a power of the unit of length follows that power of the
    scale: the intensity of lights without size its square, what media do per unit of length its inverse.
    """

    @property
    def scale(self) -> float:
        """The length of the unit in the frame: a power of two."""

    def point(self, p: Any) -> NDArray[np.float64]:
        """Points (3,) or (N, 3) of the scene, in the frame."""

    def moved(self, to_world: Any) -> Any:
        """The `to_world` in the frame of something that has a size."""

    def moved_unscaled(self, to_world: Any) -> Any:
        """The `to_world` in the frame of something without a size, such as a camera."""

    def rescaled(self, plugin: Any, power: int) -> Any:
        """A texture or volume times a power of the scale; itself for a scale of 1, and None for None."""

    def copy_of(self, plugin: Any) -> Any:
        """A nested plugin in the frame: a copy, always the same, or itself if nothing in it differs there.

        What isn't a plugin is returned as it is.

        Raises:
            NotMovable: it can't be moved.
        """

    def copied(self, plugin: Any) -> Any:
        """A copy of a plugin that hasn't moved.

        Raises:
            NotMovable: its class doesn't say how it moves.
        """


# ---- the base class --------------------------------------------------------------------------


INFERRED = ("bsdf", "emitter", "medium", "phase", "texture", "volume")
"""Kinds of plugins whose methods run in kernels and need nothing but their attributes."""


class ParamFlags(enum.IntFlag):
    """The properties of a parameter that `traverse()` reports; the numbers are Mitsuba's."""

    Differentiable = 0
    NonDifferentiable = 1
    Discontinuous = 2
    ReadOnly = 4

    @property
    def differentiable(self) -> bool:
        """True if derivatives with respect to the parameter are computed."""
        return not self & ParamFlags.NonDifferentiable


HIDDEN = ParamFlags.NonDifferentiable
"""The flags of values that kernels read and `traverse` doesn't report: what a plugin computes from its parameters."""


class TraversalCallback:
    """The object that `Plugin.traverse` reports parameters to; subclasses override `put`."""

    def put(
        self,
        name: str,
        value: Any,
        flags: ParamFlags | None = None,
        attribute: str | None = None,
    ) -> None:
        """Report a parameter, or a nested `Plugin` (whose own parameters get the prefix `name`).

        A parameter is written back with ``setattr(plugin, attribute or name, value)``.

        Args:
            name: the parameter's name, or the prefix
            value: the parameter, or the plugin
            flags: the parameter's (default: not differentiable), or what is added to those of all that is nested in
                the plugin (default: nothing)
            attribute: the attribute that holds the parameter, if it has another name
        """
        raise NotImplementedError(f"{type(self).__name__}.put")

    def put_value(self, name: str, value: Any, flags: ParamFlags | None = None) -> None:
        """`put` for a parameter: a former name."""
        self.put(name, value, flags)

    def put_object(self, name: str, obj: Plugin, flags: ParamFlags | None = None) -> None:
        """`put` for a nested plugin: a former name."""
        self.put(name, obj, flags)

    put_parameter = put_value


class Inferred:
    """A class attribute that stands for a missing declaration: empty, or inferred from each instance."""

    def __init__(self, sort: str, empty: Any) -> None:
        self.sort, self.empty = sort, empty

    def __get__(self, plugin: Plugin | None, owner: type) -> Any:
        if plugin is None or not plugin.infers:
            return self.empty
        return getattr(sorts_of(plugin), self.sort)


class Plugin(Holder):
    """A node of the scene: built from checked properties, edited through `traverse()`.

    A plugin has four sorts of attributes, which its class declares:

    * `values`: Dr.Jit arrays of width 1 that may differ between instances and that edits
      may change. Kernels read them as opaque inputs, so an edit compiles nothing.
    * `tables`: tensors of any shape, such as the texels of a bitmap. Kernels read single entries, through a
      `djpt.dispatch.tables.Table` that stands in the tensor's place.
    * `children`: attributes that hold further plugins (a texture in a BSDF).
    * `statics`: everything else that a kernel depends on (a distribution's name, a flag).
      Instances with equal class, statics and children are traced **once**, with per-lane
      values: methods called in kernels must therefore read only these four sorts.

    BSDFs, textures, emitters, media, phase functions and volumes may also declare nothing, as in Mitsuba: all their
    attributes count then, see `sorts_of`.

    Plugins don't know the scene that they are part of.
    """

    kind: ClassVar[str] = ""
    """The kind: `bsdf shape emitter texture medium phase volume sensor film rfilter sampler integrator` or `scene`."""

    values: ClassVar[Mapping[str, ParamFlags]] = Inferred("values", {})  # type: ignore[assignment]
    tables: ClassVar[Mapping[str, ParamFlags]] = {}
    children: ClassVar[Sequence[str]] = Inferred("children", ())  # type: ignore[assignment]
    statics: ClassVar[Sequence[str]] = Inferred("statics", ())  # type: ignore[assignment]

    allowed: ClassVar[Mapping[str, Allowed]] = {}
    """The ranges of parameters that are numbers: see `check_parameter`."""

    settings: ClassVar[Sequence[str]] = ()
    """Attributes, fixed by the description, that the plugin's text shows besides its parameters, if it has them."""

    infers: ClassVar[bool] = False
    """True if the class declares none of these, so that they are inferred from the attributes of instances."""

    in_any_frame: ClassVar[bool] = False
    """True if what it does in other coordinates is known, so that scenes may be rendered in a frame of another unit: it
    looks at no places and lengths but those that the inherited `move_into` converts, an integrator only at those that
    it converts by `Scene.units`. Counts for the class that says so, not for those derived from it; a class with a
    `move_into` of its own needn't say it."""

    motion: Any = None
    """The animated transform of what moves, an `AnimatedTransform4f`: its own space then is what `to_world` and all
    else refer to."""

    _id: str = ""

    def __init__(self, props: Properties | Plugin | None = None) -> None:
        self._id = "" if props is None else props.id()

    def id(self) -> str:
        """The plugin's name in the scene, in messages and in `traverse`."""
        return self._id

    def set_id(self, id: str) -> None:
        """Give the plugin another name."""
        self._id = id

    @property
    def placing(self) -> Any:
        """What `traverse` reports as `to_world`: the transform, or the animated one of what moves."""
        return self.to_world if self.motion is None else self.motion  # type: ignore[attr-defined]

    def class_name(self) -> str:
        """The name of the plugin's class in Mitsuba, where it has one."""
        name = name_of(type(self))
        return CLASS_NAMES.get(name, type(self).__name__) if name else type(self).__name__

    def variant_name(self) -> str:
        """The variant that the plugin computes in."""
        return variant()

    @classmethod
    def says(cls, name: str) -> bool:
        """Whether the class itself says that its attribute `name` is true; what a base says isn't enough."""
        return bool(vars(cls).get(name, False))

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        own = (name for base in cls.__mro__ if base is not Plugin for name in vars(base))
        cls.infers = cls.kind in INFERRED and not {"values", "tables", "children", "statics"} & set(own)
        if cls.infers and "traverse" in vars(cls):
            cls.traverse = reporting(cls.traverse)  # type: ignore[method-assign]

    @property
    def _identity(self) -> Hashable:
        """The key that tells apart instances of a class that declares nothing."""
        return sorts_of(self).identity

    def __repr__(self) -> str:
        """The type, with settings, parameters and nested plugins as a tree; a script's `to_string` if it has one."""
        if hasattr(self, "to_string"):
            return str(self.to_string())
        listing = _Listing()
        for name in self.settings:
            if hasattr(self, name):
                listing.put(name, getattr(self, name))
        self.traverse(listing)
        body = textwrap.indent(",\n".join(listing.lines), "  ")
        return f"{self.class_name()}[\n{body}\n]" if body else f"{self.class_name()}[]"

    def traverse(self, callback: TraversalCallback) -> None:
        """Report all parameters; by default the `values`, the `tables` and the `children`."""
        if self.infers and type(self).traverse is not Plugin.traverse:
            return  # called by the override, which reports the parameters itself
        for name, flags in {**self.values, **self.tables}.items():
            callback.put(name, getattr(self, name), flags)
        for name in self.children:
            child = getattr(self, name)
            if isinstance(child, Plugin):
                callback.put(name, child)

    def expand(self) -> list[Plugin]:
        """The plugins that stand in the place of this one in the node around it: usually itself alone."""
        return [self]

    def stand_alone(self) -> None:
        """Prepare for questions outside of a scene: called if the plugin is the root of a description."""

    def move_into(self, frame: Frame) -> None:
        """Move this plugin, a copy that was made for this, into a working frame, in which its scene is rendered.

        By default only what is nested in it moves: right for plugins that look at no places and have no lengths. A
        class that has some overrides it. Those of a class that neither overrides it nor says that it is right for
        them, by `in_any_frame`, keep their scenes out of frames.

        Raises:
            NotMovable: It isn't known what the plugin does in other coordinates.
        """
        self.move_nested(frame)

    def move_nested(self, frame: Frame) -> None:
        """Put the nested plugins as they are in the working frame in the place of those that differ there."""
        for name in self.children:
            nested = getattr(self, name)
            moved = frame.copy_of(nested)
            if moved is not nested:
                setattr(self, name, moved)

    def as_property(self) -> Any:
        """The result of a script's ``props[key]`` for this plugin: the plugin, or the value that it stands for."""
        return self

    def check_parameter(self, name: str, value: Any) -> Any:
        """Convert and check a value that is about to be assigned; raise a `DjptError` if it can't be.

        Whoever assigns it makes that a `ParameterError` with the parameter's name. By default numbers must lie in the
        ranges that are `allowed`.
        """
        allowed = self.allowed.get(name)
        return value if allowed is None else allowed.checked(value)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        """Recompute what was derived from the parameters named in `keys`."""


class _Listing(TraversalCallback):
    """A traversal callback that collects ``name = value`` lines for `Plugin.__repr__`."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def put(
        self,
        name: str,
        value: Any,
        flags: ParamFlags | None = None,
        attribute: str | None = None,
    ) -> None:
        text = repr(value)
        self.lines.append(f"{name} = {text}" if len(text) < 400 or isinstance(value, Plugin) else f"{name} = [...]")


# ---- plugins that declare nothing -------------------------------------------------------------
#
# A class from a script written for Mitsuba has any attributes, and may report some of
# them in `traverse`. So all attributes count: Dr.Jit arrays of width 1 are values, plugins are children, and
# instances are traced as one only if all their other attributes are equal.

PLAIN = (bool, int, float, str, bytes, type(None), enum.Enum)


@dataclass
class Sorts:
    """The attributes of a plugin, sorted by how kernels use them."""

    values: Mapping[str, ParamFlags]
    children: Sequence[str]
    identity: Hashable
    """A key that differs between plugins that can't be traced as one."""
    statics: Sequence[str] = ("_identity",)


def sorts_of(plugin: Plugin) -> Sorts:
    """Sort the attributes of a plugin whose class declares nothing."""
    reported, unreported = Collection(), ParamFlags.Differentiable
    if type(plugin).traverse is not Plugin.traverse:
        plugin.traverse(reported)
        unreported = ParamFlags.NonDifferentiable
    values: dict[str, ParamFlags] = {}
    children: list[str] = []
    others: list[Hashable] = []
    for name, value in vars(plugin).items():
        if isinstance(value, list):
            value = tuple(value)
        if name == "_id":
            continue
        if isinstance(value, Plugin):
            children.append(name)
        elif is_uniform(value):
            values[name] = reported.flags.get(name, unreported)
        else:
            others.append((name, type(value), value) if is_plain(value) else (name, id(plugin)))
    return Sorts(values, children, (tuple(values), tuple(children), tuple(others)))


def is_uniform(value: Any) -> bool:
    """True if `value` is a Dr.Jit number, vector or matrix of width 1."""
    if not dr.is_array_v(value) or dr.is_tensor_v(value) or not dr.is_jit_v(value):
        return False
    kind = type(value)
    return (dr.depth_v(kind) == 1 or dr.size_v(kind) > 0) and dr.width(value) == 1


def is_plain(value: Any) -> bool:
    """True if `value` consists of Python's own immutable types."""
    return all(map(is_plain, value)) if isinstance(value, (tuple, frozenset)) else isinstance(value, PLAIN)


class Collection(TraversalCallback):
    """A traversal callback that collects the names of the attributes that are reported."""

    def __init__(self) -> None:
        self.flags: dict[str, ParamFlags] = {}

    def put(self, name: str, value: Any, flags: Any = None, attribute: str | None = None) -> None:
        """Note a parameter: see `TraversalCallback.put`."""
        self.flags[attribute or name] = ParamFlags.NonDifferentiable if flags is None else flags


class Report(TraversalCallback):
    """The callback that a script's `traverse` reports to; finds the attribute that holds a reported value.

    A value that no attribute holds, such as ``callback.put("x", Point3f(1))``, becomes the attribute of that name:
    `parameters_changed` finds edits there.
    """

    def __init__(self, plugin: Plugin, callback: TraversalCallback) -> None:
        self._plugin, self._callback = plugin, callback

    def put(self, name: str, value: Any, flags: Any = None, attribute: str | None = None) -> None:
        """Report a parameter or a nested plugin, as in Mitsuba."""
        if not isinstance(value, Plugin):
            flags = ParamFlags.NonDifferentiable if flags is None else ParamFlags(int(flags))
            attribute = attribute or self._attribute(name, value, flags)
            value = getattr(self._plugin, attribute)
            if not is_uniform(value):  # a constant of the kernel: it would get no gradient
                flags |= ParamFlags.NonDifferentiable
        self._callback.put(name, value, flags, attribute)

    def _attribute(self, name: str, value: Any, flags: ParamFlags) -> str:
        attributes = vars(self._plugin)
        holders = [name, *attributes]
        for holder in holders:
            if attributes.get(holder) is value and value is not None:
                return holder
        if not hasattr(self._plugin, name):
            is_leaf = isinstance(value, float) and flags.differentiable
            setattr(self._plugin, name, dr.opaque(Float, value) if is_leaf else value)
        return name


def reporting(traverse: Callable[..., None]) -> Callable[..., None]:
    """Wrap a script's `traverse`, so that it is called with a `Report`."""

    @functools.wraps(traverse)
    def wrapper(self: Plugin, callback: TraversalCallback) -> None:
        traverse(self, Report(self, callback))

    return wrapper


# ---- emitters and sensors, the ends of light paths -------------------------------------------


class Endpoint(Plugin):
    """An end of light paths: rays leave it, and directions towards it can be sampled.

    The questions are Mitsuba's; an endpoint that has no answer to one raises `djpt.RenderError`. What is sampled is
    radiance for emitters and importance, of which light that arrives counts so much, for sensors.
    """

    shape: Any = None
    """The shape that it stands in; set by the scene."""
    _medium: Any = None
    m_needs_sample_2: bool = True
    """The result of `needs_sample_2`; scripts written for Mitsuba set it."""
    m_needs_sample_3: bool = True
    """The result of `needs_sample_3`; scripts written for Mitsuba set it."""

    def __init__(self, props: Properties | Plugin | None = None) -> None:
        super().__init__(props)

    # ---- where it is --------------------------------------------------------------------------

    @property
    def carrier(self) -> Any:
        """The animated transform that moves it, its own or that of its shape; None if it stays."""
        return self.motion if self.shape is None else self.shape.motion

    def world_transform_anim(self) -> Any:
        """The `djpt.AnimatedTransform4f` that moves it, which its own `to_world` is; None if it stays."""
        return self.motion

    def get_shape(self) -> Any:
        """The shape that it stands in, or None."""
        return self.shape

    def set_shape(self, shape: Any) -> None:
        """Put it into a shape."""
        self.shape = shape

    def get_medium(self) -> Any:
        """The medium that it was put into, or None; `djpt.scene.media_placement.Media` finds that of a sensor."""
        return self._medium

    def set_medium(self, medium: Any) -> None:
        """Put it into a medium; only sensors are asked for theirs."""
        self._medium = medium

    def set_scene(self, scene: Any) -> None:
        """Take the size of a scene that it isn't part of: what is far away depends on it."""
        self.set_bounds(*scene.bounding_sphere())

    def set_bounds(self, center: Any, radius: float) -> None:
        """Take the bounding sphere of a scene."""

    def world_transform(self) -> Any:
        """The transform from its own space to the world's; that of the shape if it stands in one."""
        return getattr(self if self.shape is None else self.shape, "to_world", None)

    def bbox(self) -> Any:
        """The box about it, world space."""
        raise self.unanswered("no bounding box")

    # ---- samples --------------------------------------------------------------------------------

    def needs_sample_2(self) -> bool:
        """True if `sample_ray` may look at its second sample."""
        return self.m_needs_sample_2

    def needs_sample_3(self) -> bool:
        """True if `sample_ray` may look at its third sample."""
        return self.m_needs_sample_3

    def sample_ray(self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True) -> Any:
        """A ray that leaves it, and its weight."""
        raise self.unanswered("no rays")

    def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
        """A direction from the point `it` towards it, and what arrives along it over the density."""
        raise self.unanswered("no directions to sample")

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """The density of `sample_direction` at `ds`, per unit solid angle."""
        raise self.unanswered("no density of directions")

    def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """The light that arrives along a direction of `sample_direction`."""
        raise self.unanswered("nothing that arrives from a given direction")

    def sample_position(self, ref: Any, ds: Any, active: Any = True) -> Any:
        """A point of it at the time `ref`, from the sample `ds`, and 1 / density."""
        raise self.unanswered("no surface to sample")

    def pdf_position(self, ps: Any, active: Any = True) -> Any:
        """The density of `sample_position`, per unit area."""
        raise self.unanswered("no density of positions")

    def eval(self, si: Any, active: Any = True) -> Any:
        """The light that leaves its surface at `si` towards `si.wi`."""
        raise self.unanswered("no surface to look at")

    def sample_wavelengths(self, si: Any, sample: Any, active: Any = True) -> Any:
        """Sample wavelengths: none, and the value of `eval`."""
        raise self.unanswered("no surface to look at")

    def unanswered(self, what: str) -> RenderError:
        """The error of a question that it has no answer to."""
        return RenderError(f"{self.id()}: the {self.kind} '{type(self).__name__}' has {what}")

"""The checked view of one node of a scene description."""

from __future__ import annotations

import builtins
import contextlib
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import as_array, as_integer, as_number, as_vector, describe
from djpt.core.transforms import ScalarTransform4f, as_transform
from djpt.description.entries import REQUIRED, Entries
from djpt.description.plugin import Plugin
from djpt.description.registry import kind_of, lookup
from djpt.errors import DjptError, SceneError, near_miss
from djpt.jit.frozen import recording

if TYPE_CHECKING:
    from djpt.textures.base import Texture

__all__ = ["LARGEST", "REQUIRED", "Allowed", "Merging", "Properties", "bounds"]

LARGEST = 1e30
"""The bound of radiance and its like: sums of a hundred million such samples are finite in single precision."""


class Allowed(NamedTuple):
    """A range of numbers; a bound of None is no bound."""

    low: float | None = None
    high: float | None = None
    low_open: bool = False
    """True if `low` itself is outside of the range."""

    def within(self, other: Allowed) -> Allowed:
        """The intersection of two ranges."""
        lows = [x for x in (self.low, other.low) if x is not None]
        highs = [x for x in (self.high, other.high) if x is not None]
        low = max(lows, default=None)
        low_open = any(a.low_open and a.low == low for a in (self, other))
        return Allowed(low, min(highs, default=None), low_open)

    def require(self, numbers: NDArray[Any], where: str = "") -> None:
        """Raise `SceneError` if a number lies outside; `where` starts the message."""
        # Numbers may be float32, which rounds 0.1 up: the bounds are compared as float32, too.
        smallest = -np.inf if self.low is None else np.float32(self.low)
        largest = np.inf if self.high is None else np.float32(self.high)
        # Nearly always the extremes tell; a NaN among them doesn't.
        if self.low is None and self.high is None:
            return
        if numbers.size and (self.high is None or numbers.max() <= largest):
            least = numbers.min()
            if least > smallest or (least == smallest and not self.low_open):
                return
        outside = numbers[(numbers <= smallest if self.low_open else numbers < smallest) | (numbers > largest)]
        if outside.size:
            raise SceneError(f"{where} must {self._missed_by(outside[0])}, found {outside[0]:.6g}".lstrip())

    def checked(self, value: Any) -> Any:
        """The value that a parameter is about to take, itself; raise `SceneError` if a number in it lies outside.

        While `dr.freeze` records, numbers aren't known, and nothing is checked.
        """
        if not recording():
            self.require(as_array(dr.detach(value) if dr.is_array_v(value) else value))
        return value

    def _missed_by(self, number: float) -> str:
        """The range in words; of `LARGEST`, which only the largest numbers miss, only those hear."""
        if self.high != LARGEST:
            return bounds(self.low, self.high, self.low_open)
        return bounds(None, self.high) if number > LARGEST else bounds(self.low, None, self.low_open)


def bounds(low: float | None, high: float | None, low_open: bool = False, high_open: bool = False) -> str:
    """Put a range in words: ``lie in [0, 1]``, ``be at least 1``, ``be greater than 0``."""
    if low is not None and high is not None:
        return f"lie in {'(' if low_open else '['}{low:g}, {high:g}{')' if high_open else ']'}"
    if low is not None:
        return f"be {'greater than' if low_open else 'at least'} {low:g}"
    return f"be {'less than' if high_open else 'at most'} {high:g}"


# ---- plugins that are described alike --------------------------------------------------------


APART = ("shape", "emitter")
"""The kinds of plugins of which each stays itself, however alike their descriptions are."""


@dataclass
class Merging:
    """The plugins that a loader has built from descriptions, and which of them are alike.

    Mitsuba makes one object of all nodes of equal type and equal entries; their names don't count. Here each node
    stays a plugin of its own, and `alike` tells which would have been one.
    """

    keys: set[str] = field(default_factory=set)
    """The keys of a scene's entries that are described, rather than plugins that existed before."""
    first: dict[int, int] = field(default_factory=dict)
    """By the `id()` of a plugin, that of the first one that is described alike."""
    known: dict[Hashable, int] = field(default_factory=dict)
    """The first plugin of each description."""

    def of(self, keys: set[str]) -> Merging:
        """The same, for a node of which the entries of these keys are described."""
        return Merging(keys, self.first, self.known)

    def note(self, plugin: Plugin, type_name: str, values: Mapping[str, Any]) -> None:
        """Note a plugin that was built from a node of this type with these entries, nested plugins among them."""
        if plugin.kind not in APART:
            entries = frozenset((key, self.content(value)) for key, value in values.items())
            self.first[id(plugin)] = self.known.setdefault((type_name, entries), id(plugin))

    def content(self, value: Any) -> Hashable:
        """A key that equal entries share. Arrays and other objects are equal to themselves alone."""
        if isinstance(value, Plugin):
            return Plugin, self.alike(value)
        if isinstance(value, (bool, int, float, str)):
            return type(value), value
        if isinstance(value, (list, tuple)):
            if {*map(type, value)} == {float}:
                return float, tuple(value)
            return tuple, tuple(map(self.content, value))
        return object, id(value)

    def alike(self, plugin: Any) -> int:
        """A number that a plugin shares with those that are described alike."""
        return self.first.get(id(plugin), id(plugin))


# ---- the view --------------------------------------------------------------------------------


class Properties(Entries):
    """The entries of a node, handed out by type and checked, to its plugin's constructor.

    Every getter raises `SceneError` with the node's path if an entry is missing, of the wrong
    type or out of range. Entries that no getter asked for are unknown keys: see `check_all_used`.

    Args:
        plugin_name: the node's ``type``, or properties to be copied.
        node: path for messages, such as ``scene.white``; default: `plugin_name`.
        values: the entries without ``type`` and ``id``; nested nodes are plugins already.
        id: the value of `Plugin.id`; default: `node`.
        place: gives the text that replaces `node` in messages about the entry of a key; default: `node`.
        merging: what Mitsuba's loader would merge, if `load_dict` was told to optimise, for `djpt.Scene`: a
            `djpt.description.properties.Merging`.
    """

    def __init__(
        self,
        plugin_name: str | Entries = "",
        node: str | None = None,
        values: Mapping[str, Any] | None = None,
        id: str | None = None,
        place: Callable[[str], str] | None = None,
        merging: Merging | None = None,
    ) -> None:
        super().__init__(plugin_name, node, values, id)
        self._place_of = place
        self.merging = merging
        self._animated: set[str] = set()
        """The keys whose animations have been taken."""

    def get_texture(self, name: str, default: builtins.float = REQUIRED) -> Texture:
        """The entry as a texture; numbers and colours become constant textures."""
        return self.texture(name, default)

    get_emissive_texture = get_unbounded_texture = get_texture

    # ---- errors ----------------------------------------------------------------------

    def error(self, key: str, problem: str) -> SceneError:
        """Make the error to raise for an entry: ``scene.x: 'fov' must be a float, found str 'abc'``."""
        return SceneError(f"{self._place(key)}: '{key}' {problem}")

    @contextlib.contextmanager
    def naming(self, key: str) -> Iterator[None]:
        """Make errors about a value those of an entry, see `error`."""
        try:
            yield
        except DjptError as error:
            raise self.error(key, str(error)) from None

    def placed(self, error: SceneError) -> SceneError:
        """The same error, with the node in front if its message names neither the node nor one of its entries.

        What the constructor of a plugin calls, transforms for instance, doesn't know whose numbers it was given.
        """
        text = str(error)
        if any(place in text for place in {self.node, *map(self._place, self._values)}):
            return error
        return SceneError(f"{self.node}: {text}")

    def _place(self, key: str) -> str:
        return self.node if self._place_of is None else self._place_of(key)

    def _check_range(
        self, key: str, value: float, low: float | None, high: float | None, low_open: bool, high_open: bool
    ) -> None:
        too_low = low is not None and (value <= low if low_open else value < low)
        too_high = high is not None and (value >= high if high_open else value > high)
        if too_low or too_high:
            raise self.error(key, f"must {bounds(low, high, low_open, high_open)}, found {value:.9g}")

    # ---- values ----------------------------------------------------------------------

    def raw(self, key: str, default: Any = REQUIRED) -> Any:
        """The entry as it is in the description, for plugins that check it themselves."""
        return self._take(key, default)

    def float(
        self,
        key: str,
        default: builtins.float = REQUIRED,
        *,
        low: builtins.float | None = None,
        high: builtins.float | None = None,
        low_open: bool = False,
        high_open: bool = False,
    ) -> builtins.float:
        """A finite number between `low` and `high` (which are included unless open)."""
        value = self._take(key, default)
        if key not in self._values:
            return default
        try:
            number = as_number(value)
        except SceneError as error:
            raise self.error(key, str(error)) from None
        self._check_range(key, number, low, high, low_open, high_open)
        return number

    def integer(self, key: str, default: int = REQUIRED, *, low: int | None = None, high: int | None = None) -> int:
        """A whole number of 32 bits from `low` to `high`, both included."""
        value = self._take(key, default)
        if key not in self._values:
            return default
        try:
            number = as_integer(value)
        except SceneError as error:
            raise self.error(key, str(error)) from None
        self._check_range(key, number, low, high, False, False)
        if not -(2**31) <= number < 2**32:
            raise self.error(key, f"must fit into 32 bits, found {describe(number)}")
        return number

    def boolean(self, key: str, default: bool = REQUIRED) -> bool:
        """True or false; numbers are refused."""
        value = self._take(key, default)
        if not isinstance(value, (bool, np.bool_)):
            raise self.error(key, f"must be True or False, found {describe(value)}")
        return bool(value)

    def string(self, key: str, default: str = REQUIRED, *, choices: Iterable[str] | None = None) -> str:
        """A string, one of `choices` if given."""
        value = self._take(key, default)
        if not isinstance(value, str):
            raise self.error(key, f"must be a string, found {describe(value)}")
        if choices is not None and value not in (options := list(choices)):
            raise self.error(key, f"can't be '{value}'{near_miss(value, options)}")
        return value

    def vector(self, key: str, default: Sequence[builtins.float] = REQUIRED) -> NDArray[np.float64]:
        """Three finite numbers, (3,) float64."""
        value = self._take(key, default)
        try:
            return as_vector(value)
        except SceneError as error:
            raise self.error(key, str(error)) from None

    def animation(self, key: str = "to_world") -> Any:
        """The `AnimatedTransform4f` of an entry; None if there is none. `transform` then gives the identity."""
        value = self._values.get(key)
        if not (isinstance(value, Plugin) and value.kind == "animation"):
            return None
        self._animated.add(key)
        return self._take(key, REQUIRED)

    def transform(self, key: str = "to_world", default: ScalarTransform4f | None = None) -> ScalarTransform4f:
        """An invertible affine transform; default: the identity.

        What moves stays in its own space: of an animation that has been taken the transform is the identity.
        """
        value = self._take(key, ScalarTransform4f() if default is None else default)
        if isinstance(value, Plugin) and value.kind == "animation":
            if key not in self._animated:
                raise self.error(key, f"can't be animated: a '{self.plugin_name()}' doesn't move")
            return ScalarTransform4f()
        try:
            return as_transform(value)
        except SceneError as error:
            raise self.error(key, str(error)) from None

    # ---- plugins ---------------------------------------------------------------------

    def texture(
        self,
        key: str,
        default: builtins.float = REQUIRED,
        *,
        low: builtins.float | None = None,
        high: builtins.float | None = None,
    ) -> Texture:
        """A texture of colours; a number becomes a constant grey. Its values must lie between `low` and `high`.

        Images may exceed `high`, with a warning.
        """
        texture = self._texture(key, default, "rgb")
        texture.restrict_colors(Allowed(low, high), f"{self._place(key)}: '{key}'")
        return texture

    def texture_1(
        self,
        key: str,
        default: builtins.float = REQUIRED,
        *,
        low: builtins.float | None = None,
        high: builtins.float | None = None,
        low_open: bool = False,
    ) -> Texture:
        """A texture of scalars, to be read with `eval_1`; a number becomes a constant texture.

        Its values must lie between `low` (included unless `low_open`) and `high`.
        """
        texture = self._texture(key, default, "uniform")
        texture.restrict(Allowed(low, high, low_open), f"{self._place(key)}: '{key}'")
        return texture

    def _texture(self, key: str, default: builtins.float, constant: str) -> Texture:
        value = self._take(key, default)
        if not isinstance(value, Plugin):
            if isinstance(value, (list, tuple, np.ndarray)):
                hint = "write {'type': 'rgb', 'value': [r, g, b]} for a colour"
                raise self.error(key, f"must be a number or a texture, found {describe(value)}; {hint}")
            # Mitsuba accepts its own colour type here, which is a Dr.Jit 3-array as well.
            colour = dr.is_array_v(value) and not dr.is_tensor_v(value) and dr.size_v(value) == 3
            if not colour:
                try:
                    value = as_number(value)
                except SceneError as error:
                    problem = str(error).replace("a float", "a number or a texture")
                    raise self.error(key, problem) from None
            constant = "rgb" if colour else constant
            path = f"{self.id()}.{key}"
            value = lookup("texture", constant)(Properties("rgb", f"{self._place(key)}.{key}", {"value": value}, path))
        elif value.kind != "texture":
            raise self.error(key, f"must be a number or a texture, found {name_of(value)}")
        texture: Texture = value
        texture.used_by(kind_of(self.plugin_name()) or "")
        return texture

    def volume(
        self,
        key: str,
        default: builtins.float = REQUIRED,
        *,
        low: builtins.float | None = None,
        high: builtins.float | None = None,
    ) -> Any:
        """A `djpt.volumes.Volume`; a number or a constant texture becomes a constant volume.

        Its values must lie between `low` and `high`.
        """
        value = self._take(key, default)
        if not (isinstance(value, Plugin) and value.kind == "volume"):
            path = f"{self.id()}.{key}"
            value = lookup("volume", "constvolume")(
                Properties("constvolume", f"{self._place(key)}.{key}", {"value": value}, path)
            )
        value.restrict(Allowed(low, high), f"{self._place(key)}: '{key}'")
        return value

    def plugin(self, key: str, kind: str, default: Any = REQUIRED) -> Any:
        """The plugin of `kind` under `key`."""
        value = self._take(key, default)
        if key in self._values and not (isinstance(value, Plugin) and value.kind == kind):
            raise self.error(key, f"must be {article(kind)}, found {name_of(value)}")
        return value

    def child(self, kind: str, default: Any = None) -> Any:
        """The only nested plugin of `kind`, under any key."""
        found = self.children(kind)
        if len(found) > 1:
            keys = ", ".join(f"'{key}'" for key, _ in found)
            raise SceneError(f"{self.node}: '{self.plugin_name()}' takes one {kind}, found {len(found)}: {keys}")
        if not found and default is REQUIRED:
            raise SceneError(f"{self.node}: '{self.plugin_name()}' needs a nested {kind}")
        return found[0][1] if found else default

    def children(self, kind: str) -> list[tuple[str, Any]]:
        """All nested plugins of `kind` with their keys, in order."""
        found = [(k, v) for k, v in self._values.items() if isinstance(v, Plugin) and v.kind == kind]
        self._used.update(key for key, _ in found)
        return found

    # ---- what is left ----------------------------------------------------------------

    def check_all_used(self) -> None:
        """Raise `SceneError` for the first key that the plugin didn't ask for."""
        for key, value in self._values.items():
            if key in self._used or key in self._asked:
                continue
            own = kind_of(self.plugin_name()) or "plugin"
            name = f"'{self.plugin_name()}'" if own == self.plugin_name() else f"{own} '{self.plugin_name()}'"
            held = f" ({article(value.kind)})" if isinstance(value, Plugin) else ""
            hint = near_miss(key, self._asked - self._used)
            raise SceneError(f"{self._place(key)}: unknown key '{key}'{held} of {name}{hint}")


def name_of(value: Any) -> str:
    """Describe an entry for a message: ``the film 'hdrfilm'``, ``str 'abc'``."""
    if not isinstance(value, Plugin):
        return describe(value)
    return f"the {value.kind} '{value.id()}'" if value.id() else article(value.kind)


def article(kind: str) -> str:
    """Put the article before a kind: ``a film``, ``an emitter``."""
    return f"{'an' if kind[:1] in 'aeio' or kind == 'rfilter' else 'a'} {kind}"

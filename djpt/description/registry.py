"""The registry of plugins: names, and the factory behind each.

The last line of a plugin's file registers it, in djpt as in a user's own package::

    register_bsdf("diffuse", Diffuse)

A package lists its plugins in its ``pyproject.toml``, with the module that registers each when it is imported::

    [project.entry-points."djpt.plugins"]
    "bsdf.chalk" = "chalk_and_cheese.chalk"

A factory takes the checked `Properties` of a node and returns a `Plugin`; usually it is
the plugin's class. A name belongs to one kind, as in Mitsuba.
"""

from __future__ import annotations

import functools
import importlib
import re
import sys
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from djpt.errors import SceneError, near_miss

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

__all__ = [
    "LACKING",
    "MITSUBA",
    "PACKAGES",
    "entries",
    "kind_of",
    "load",
    "lookup",
    "mitsuba_kind_of",
    "name_of",
    "names",
    "plugin_modules",
    "register",
    "register_bsdf",
    "register_emitter",
    "register_film",
    "register_integrator",
    "register_medium",
    "register_phase",
    "register_rfilter",
    "register_sampler",
    "register_scene",
    "register_sensor",
    "register_shape",
    "register_texture",
    "register_volume",
    "registered",
    "unknown",
]

Factory = Callable[[Any], Any]
"""Builds a `Plugin` from the `Properties` of a node: usually the plugin's class."""

# Plugins are known to the process, as modules are: a file registers its plugin when it is imported, which happens once.
_plugins: dict[str, tuple[str, Factory]] = {}
# Those of djpt's names that djpt has registered: a user's plugin of such a name stays when djpt's is imported later.
_own_names: set[str] = set()
_own_packages_imported = False


def register(kind: str, name: str, factory: Factory) -> None:
    """Make `name` known as a plugin of `kind`.

    Registering a name again replaces its factory (a notebook cell may be run twice).

    Raises:
        SceneError: `name` isn't a valid name, `factory` can't be called, or the name belongs to another kind.
    """
    if not isinstance(name, str) or not name:
        raise SceneError(f"register_{kind}: a plugin's name must be a string, found {name!r}")
    if not callable(factory):
        raise SceneError(f"register_{kind}: the factory of '{name}' must be callable, found {factory!r}")
    known = _plugins.get(name)
    taken = known[0] if known is not None else mitsuba_kind_of(name)
    if taken not in (None, kind):
        # Also names of Mitsuba that djpt lacks are taken: a description must mean the same in both.
        raise SceneError(f"register_{kind}: '{name}' is the name of another kind of plugin already: {taken}")
    first_own = is_own(factory) and name not in _own_names
    if first_own:
        _own_names.add(name)
    if first_own and known is not None and not is_own(known[1]):
        return  # the user replaced a plugin of djpt before its package was imported
    _plugins[name] = (kind, factory)


def is_own(factory: Factory) -> bool:
    """Whether the factory stands in one of the packages of djpt's plugins."""
    return str(getattr(factory, "__module__", "")).rpartition(".")[0] in PACKAGES


def registering(kind: str, what: str) -> Callable[[str, Factory], None]:
    """The function that registers plugins of a kind; `what` they are, for its documentation."""

    def function(name: str, constructor: Factory) -> None:
        register(kind, name, constructor)

    function.__name__ = function.__qualname__ = f"register_{kind}"
    function.__doc__ = f"Register {what}."
    return function


register_bsdf = registering("bsdf", "a scattering model; `constructor(props)` returns a `djpt.materials.BSDF`")
register_emitter = registering("emitter", "a light source; `constructor(props)` returns a `djpt.emitters.Emitter`")
register_film = registering("film", "a film; `constructor(props)` returns a plugin of kind `film`")
register_integrator = registering(
    "integrator", "an estimator; `constructor(props)` returns a `djpt.integrators` integrator"
)
register_medium = registering(
    "medium", "a participating medium; `constructor(props)` returns a plugin of kind `medium`"
)
register_phase = registering("phase", "a phase function; `constructor(props)` returns a `djpt.phase.PhaseFunction`")
register_rfilter = registering(
    "rfilter", "a reconstruction filter; `constructor(props)` returns a plugin of kind `rfilter`"
)
register_sampler = registering(
    "sampler", "a source of sample points; `constructor(props)` returns a `djpt.samplers.Sampler`"
)
register_scene = registering("scene", "a kind of scene; `constructor(props)` returns a `djpt.Scene`")
register_sensor = registering("sensor", "a camera; `constructor(props)` returns a plugin of kind `sensor`")
register_shape = registering("shape", "a shape; `constructor(props)` returns a `djpt.shapes.Shape`")
register_texture = registering("texture", "a texture; `constructor(props)` returns a `djpt.textures.Texture`")
register_volume = registering(
    "volume", "a volume of numbers or colours; `constructor(props)` returns a `djpt.volumes.Volume`"
)


def registered(kind: str | None = None) -> dict[str, Factory]:
    """All plugins by name, or those of one kind; packages that list plugins as entry points are imported.

    Raises:
        SceneError: Such a package can't be imported.
    """
    _import_own_packages()
    for name in entries():
        _import_home(name)
    # In an order that doesn't depend on what was imported first.
    return {name: factory for name, (of, factory) in sorted(_plugins.items()) if kind in (None, of)}


def names(kind: str | None = None) -> list[str]:
    """The names of all plugins, or of those of one kind, in order. Nothing is imported."""
    kinds = {name: entry.kind for name, entry in entries().items()}
    kinds |= {name: place.kind for name, place in plugin_modules().items()}
    kinds |= {name: of for name, (of, _) in _plugins.items()}
    return sorted(name for name, of in kinds.items() if kind in (None, of))


def kind_of(name: str) -> str | None:
    """The kind of the plugin of that name, or None. Nothing is imported."""
    if name in _plugins:
        return _plugins[name][0]
    place = plugin_module(name) or entries().get(name)
    return place.kind if place is not None else None


def name_of(factory: Factory) -> str | None:
    """The name that `factory` was registered by, or None."""
    return next((name for name, (_, known) in _plugins.items() if known is factory), None)


def lookup(kind: str | None, name: str, fitting: Collection[str] | None = None) -> Factory:
    """The factory of a plugin.

    Args:
        kind: the kind that is needed here, or None for any.
        name: the plugin's name, a node's ``type``.
        fitting: the kinds whose names the message lists. Default: `kind`.

    Raises:
        SceneError: no plugin of that kind has that name; the message lists the names that exist. Or it is the entry
            point of a package that can't be imported, or that registers no such plugin.
    """
    _import_home(name)
    if name in _plugins and kind in (None, _plugins[name][0]):
        return _plugins[name][1]
    if name in _plugins:
        raise SceneError(f"expected the kind '{kind}', found the {_plugins[name][0]} '{name}'")
    their_kind = mitsuba_kind_of(name)
    if their_kind is not None and kind in (None, their_kind):
        raise SceneError(f"Mitsuba's {their_kind} '{name}' isn't supported: {LACKING[name]}")
    raise unknown(kind, name, fitting)


def unknown(kind: str | None, name: str, fitting: Collection[str] | None = None) -> SceneError:
    """The error for a name that no plugin of a kind has, with the names that exist of it, or of `fitting` kinds."""
    kind = next(iter(fitting)) if kind is None and fitting is not None and len(fitting) == 1 else kind
    known = names(kind) if kind or fitting is None else (each for of in fitting for each in names(of))
    return SceneError(f"unknown {kind or 'plugin'} '{name}'{near_miss(name, known)}")


def _import_home(name: str) -> None:
    """Let the file that a plugin of djpt or of an installed package stands in register it."""
    if name in _plugins:
        return
    if (place := plugin_module(name)) is not None:
        # While all packages are being imported, each comes in its turn.
        if not _own_packages_imported:
            importlib.import_module(place.module)
    elif (entry := entries().get(name)) is not None:
        load(entry)
        if _plugins.get(name, ("",))[0] != entry.kind:
            raise SceneError(f"{entry} was imported, but registers no {entry.kind} '{name}'")


def _import_own_packages() -> None:
    """Let djpt's packages register their plugins, once."""
    global _own_packages_imported
    if _own_packages_imported:
        return
    # Set before the imports: a package that is being imported may look up a plugin.
    _own_packages_imported = True
    try:
        for package in map(importlib.import_module, PACKAGES):
            for public in package.__all__:
                getattr(package, public)
    except ImportError:
        _own_packages_imported = False  # so that the next call raises the same error
        raise


# ---- djpt's own plugins by name, read from the sources so that nothing is imported -----------


PACKAGES = (
    "djpt.textures",
    "djpt.materials",
    "djpt.shapes",
    "djpt.emitters",
    "djpt.media",
    "djpt.phase",
    "djpt.volumes",
    "djpt.rfilters",
    "djpt.films",
    "djpt.samplers",
    "djpt.sensors",
    "djpt.integrators",
    "djpt.rendering",
)
"""The packages that djpt's own plugins stand in. Usually a plugin's file bears its name."""

LINE = re.compile(r'^register_(\w+)\("(\w+)"', re.MULTILINE)


class PluginModule(NamedTuple):
    """The `kind` of a plugin, and the `module` that registers it when it is imported."""

    kind: str
    module: str


@functools.cache
def plugin_module(name: str) -> PluginModule | None:
    """The module of djpt's plugin of that name, or None. The file of that name is read first, and usually no other."""
    if name.isidentifier():
        for package, folder in folders().items():
            file = folder / f"{name}.py"
            if file.is_file() and name in (found := modules_in(package, file)):
                return found[name]
    return plugin_modules().get(name)


@functools.cache
def plugin_modules() -> dict[str, PluginModule]:
    """The modules of all of djpt's plugins, by name."""
    found: dict[str, PluginModule] = {}
    for package, folder in folders().items():
        for file in sorted(folder.glob("*.py")):
            found |= modules_in(package, file)
    return found


@functools.cache
def folders() -> dict[str, Path]:
    """The folders of the packages; a package of plugins is on disk, as djpt is."""
    djpt = Path(__file__).parents[1]
    return {package: djpt.joinpath(*package.split(".")[1:]) for package in PACKAGES}


def modules_in(package: str, file: Path) -> dict[str, PluginModule]:
    """The modules of the plugins that a file of a package registers."""
    lines = LINE.findall(file.read_text(encoding="utf-8"))
    return {name: PluginModule(kind, f"{package}.{file.stem}") for kind, name in lines}


# ---- plugins of installed packages, found by entry points ------------------------------------


GROUP = "djpt.plugins"
"""The group of entry points that packages list their plugins in."""


class Entry(NamedTuple):
    """The `kind` and `name` of a plugin, the entry `point` of the module that registers it, and its `distribution`."""

    kind: str
    name: str
    point: EntryPoint
    distribution: str

    def __str__(self) -> str:
        return f"the entry point '{self.point.name} = {self.point.value}' of the package '{self.distribution}'"


def entries() -> dict[str, Entry]:
    """The entries of all packages that can be imported now, by the plugin's name.

    Raises:
        SceneError: An entry isn't called ``kind.name``, or two packages have a plugin of one name.
    """
    return found_on(tuple(sys.path))


@functools.cache
def found_on(path: Sequence[str]) -> dict[str, Entry]:
    """`entries` of the packages on a search path, which is read once."""
    # Takes as long to import as all else that a small scene needs; most sessions never ask.
    from importlib.metadata import distributions

    found: dict[str, Entry] = {}
    for distribution in distributions(path=list(path)):
        for point in distribution.entry_points.select(group=GROUP):
            kind, _, name = point.name.partition(".")
            entry = Entry(kind, name, point, distribution.name)
            if not (kind.isidentifier() and name):
                raise SceneError(
                    f"the package '{entry.distribution}' has an entry point '{point.name}' in the group '{GROUP}'; "
                    "expected a kind and a name, such as 'bsdf.chalk'"
                )
            # The first on the path hides others of its name, as with imports.
            if found.setdefault(name, entry).distribution != entry.distribution:
                raise SceneError(f"two packages have a plugin '{name}': {found[name]}, and {entry}")
    return found


def load(entry: Entry) -> None:
    """Import the module of an entry, which registers its plugin.

    Raises:
        SceneError: It can't be imported.
    """
    try:
        entry.point.load()
    except Exception as error:
        raise SceneError(f"{entry} can't be imported: {type(error).__name__}: {error}") from error


# ---- the plugins of Mitsuba 3.9.1 ------------------------------------------------------------


MITSUBA = {
    "bsdf": (
        "blendbsdf bumpmap circular conductor dielectric diffuse hair mask measured measured_polarized normalmap null "
        "plastic polarizer pplastic principled principledthin retarder roughconductor roughdielectric roughplastic "
        "thindielectric twosided"
    ),
    "emitter": "area constant directional directionalarea envmap point projector spot sunsky timed_sunsky",
    "shape": (
        "blender bsplinecurve cube cylinder disk ellipsoids ellipsoidsmesh instance linearcurve merge obj ply "
        "rectangle sdfgrid serialized shapegroup sphere"
    ),
    "sensor": "batch distant irradiancemeter orthographic perspective radiancemeter thinlens",
    "film": "hdrfilm specfilm",
    "rfilter": "box catmullrom gaussian lanczos mitchell tent",
    "sampler": "independent ldsampler multijitter orthogonal stratified",
    "texture": (
        "bitmap blackbody checkerboard d65 irregular mesh_attribute rawconstant regular rgb spectrum srgb uniform "
        "volume"
    ),
    "integrator": (
        "aov depth direct direct_projective moment path prb prb_basic prb_projective prbvolpath ptracer stokes "
        "volpath volpathmis volprim_rf_basic"
    ),
    "medium": "heterogeneous homogeneous",
    "phase": "blendphase hg isotropic rayleigh sggx tabphase",
    "volume": "constvolume gridvolume",
}
"""The plugins of Mitsuba 3.9.1 by kind."""

LACKING = {
    "blender": "it reads meshes in Blender's memory; export them as 'ply', 'obj' or 'serialized'",
    "measured_polarized": (
        "it is a table of Mueller matrices, and djpt computes no polarisation; take a 'roughconductor' or 'measured'"
    ),
    "specfilm": "it holds spectra, and djpt computes colours; take 'hdrfilm'",
    "stokes": "it shows polarisation, which djpt doesn't compute; take the integrator nested in it",
}
"""The plugins that djpt lacks: why, and what to do."""


def mitsuba_kind_of(name: str) -> str | None:
    """The kind that a name has in Mitsuba, or None."""
    return next((kind for kind, names in MITSUBA.items() if name in names.split()), None)

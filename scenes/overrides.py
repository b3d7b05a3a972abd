"""Scene descriptions found by name, and changed before they are loaded: image size, filter, integrator.

For command lines and comparisons, which take a scene as it is and vary one thing. Works on dicts of
Mitsuba's schema, so the same change reaches djpt and Mitsuba.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from typing import Any, cast

from djpt.core.files import require_regular
from djpt.description.files import Document
from djpt.errors import FileError, SceneError, near_miss, nearest

__all__ = ["described", "integrator_name", "override", "reduced", "rfilter_name"]

SENSORS = frozenset(
    [
        "perspective",
        "thinlens",
        "orthographic",
        "fisheye",
        "panorama",
        "radiancemeter",
        "irradiancemeter",
        "distant",
        "batch",
    ]
)
"""The types of nodes that hold a film."""

WIDTH, HEIGHT = 768, 576
"""The default size of a film in pixels."""

METERS = frozenset({"radiancemeter", "irradiancemeter", "distant"})
"""The types of sensors that measure numbers and take no pictures."""

INTEGRATORS = frozenset(
    {"path", "direct", "depth", "aov", "moment", "ptracer", "stokes", "volpath", "volpathmis"}
    | {"prb", "prb_basic", "prbvolpath", "direct_projective", "prb_projective", "volprim_rf_basic"}
    | {"raycast", "whitted", "distributed", "path_naive", "path_nee", "bdpt"},
)

KEPT: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("depth", "aov", "moment"), ()),
    # The depth of a tree of rays isn't the depth of a path.
    **dict.fromkeys(("direct", "raycast", "whitted", "distributed"), ("hide_emitters",)),
    **dict.fromkeys(("path_nee", "prb_basic"), ("max_depth", "hide_emitters")),
}
"""The settings that an integrator takes over from the scene's, by name; djpt's others take over `COMMON`."""

OTHER_FILES = {
    "a picture": frozenset(
        {".exr", ".hdr", ".pfm", ".npy", ".png", ".jpg", ".jpeg", ".bmp", ".tga", ".ppm", ".tif", ".tiff", ".webp"}
    ),
    "a movie": frozenset({".gif", ".mp4", ".webm", ".mov", ".avi"}),
    "a mesh, which a scene holds as a shape,": frozenset({".serialized"}),
    "a file of Blender, which Mitsuba's add-on exports as XML,": frozenset({".blend"}),
    "a checkpoint, which 'djpt merge' reads,": frozenset({".djpt"}),
}
"""The kinds of other files that may be mistaken for scenes, with their extensions."""

COMMON = ("max_depth", "rr_depth", "hide_emitters")


def described(
    scene: Mapping[str, Any] | str | os.PathLike[str], parameters: Mapping[str, str] | None = None
) -> tuple[str, dict[str, Any]]:
    """The name and the description of a scene: a dict, a built-in name, or an XML file.

    `parameters` are values for the ``$name`` of a file. Raises `SceneError` for unknown names, with those that
    there are, and the errors of `djpt.load_file`.
    """
    from djpt.models.formats import is_model, read_model

    if is_model(scene):
        path = os.fspath(cast("str | os.PathLike[str]", scene))
        if not os.path.lexists(path):
            raise FileError(f"can't read '{path}': there is no such file{scene_like(path)}")
        document = read_model(path, **(parameters or {}))
        return document.name, document
    if isinstance(scene, os.PathLike) or (isinstance(scene, str) and scene.lower().endswith(".xml")):
        # Before Dr.Jit and NumPy are imported: a misspelt name is found out at once.
        if not os.path.lexists(scene):
            raise FileError(f"can't read '{os.fspath(scene)}': there is no such file{scene_like(os.fspath(scene))}")
        require_regular(scene)
        from djpt.description.xml.reading import read_file

        document = read_file(scene, trusted=True, root=None, **(parameters or {}))
        return document.name, document
    from djpt import scenes

    if parameters:
        from djpt.core.numeric import describe

        what = f"'{scene}'" if isinstance(scene, str) else describe(scene)
        raise SceneError(f"only scene files (XML) have parameters, found {', '.join(parameters)} for {what}")
    if isinstance(scene, Document):
        return scene.name, scene.copy()
    if isinstance(scene, Mapping):
        return "scene", dict(scene)
    if not isinstance(scene, str):
        raise SceneError(f"a scene is a dict, a file or the name of a built-in scene, found {type(scene).__name__}")
    if scene not in scenes.NAMES:
        raise SceneError(f"{not_a_scene(scene)}{near_miss(scene, scenes.NAMES)}")
    return scene, getattr(scenes, scene)()


def not_a_scene(name: str) -> str:
    """The message about a name that is neither a built-in scene nor an XML file."""
    suffix = os.path.splitext(name)[1].lower()
    for kind, suffixes in OTHER_FILES.items():
        if suffix in suffixes:
            return f"'{name}' is {kind} and not a scene; a scene is an XML file, such as 'scene.xml', or built-in"
    file = f"; the file would be '{name}.xml'" if os.path.exists(f"{name}.xml") else ""
    return f"unknown scene '{name}'{file}"


def scene_like(missing: str) -> str:
    """A suggestion for the name of a scene file that doesn't exist: a file beside it, or a built-in scene."""
    from djpt import scenes

    folder, name = os.path.split(missing)
    try:
        files = [entry for entry in os.listdir(folder or ".") if entry.lower().endswith(".xml")]
    except OSError:
        return ""
    beside = nearest(name, files)
    if beside is not None:
        return f"; did you mean '{os.path.join(folder, beside)}'?"
    built_in = nearest(os.path.splitext(name)[0], scenes.NAMES)
    return f"; did you mean the built-in scene '{built_in}'?" if built_in else ""


def override(
    scene: Mapping[str, Any],
    *,
    width: int | None = None,
    height: int | None = None,
    rfilter: str | Mapping[str, Any] | None = None,
    integrator: str | Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """A copy of `scene` with changes for all of its sensors; `None` changes nothing.

    * `width`, `height`: pixels of the film, except that of meters. With one given, the other keeps the shape of
      the image.
    * `rfilter`: the reconstruction filter, by name or as a dict.
    * `integrator`: by name or as a dict; replaces the scene's. A name keeps the other settings of the
      scene's integrator that both have: `max_depth`, `rr_depth`, `hide_emitters`.

    The given dicts are not modified. Raises `SceneError` if there is no sensor to change, if it is a
    plugin object already, or if a film whose size shall change has a crop window.
    """
    result = scene.copy() if isinstance(scene, Document) else dict(scene)
    if integrator is not None:
        _set_integrator(result, integrator)
    if width is None and height is None and rfilter is None:
        return result
    films = list(_films(result))
    if not films:
        raise SceneError("the scene has no sensor described by a dict, so its film can't be changed")
    for key, sensor, name, film in films:
        if (width is not None or height is not None) and sensor["type"] not in METERS:
            _set_size(film, f"{key}.{name}", width, height)
        if rfilter is not None:
            for other in [k for k, node in film.items() if isinstance(node, Mapping) and k != "rfilter"]:
                del film[other]
            film["rfilter"] = {"type": rfilter} if isinstance(rfilter, str) else dict(rfilter)
        result[key] = {**sensor, name: film}
    return result


def reduced(scene: Mapping[str, Any], side: int) -> dict[str, Any]:
    """A copy of `scene` whose pictures are at most `side` pixels wide and high; they keep their aspect ratio.

    Smaller pictures stay as they are, as do films with a crop window and sensors that aren't described by a dict.
    """
    result = scene.copy() if isinstance(scene, Document) else dict(scene)
    for key, sensor, name, film in _films(scene):
        width, height = film.get("width", WIDTH), film.get("height", HEIGHT)
        cropped = any(entry.startswith("crop_") for entry in film)
        if max(width, height) > side and not cropped and sensor["type"] not in METERS:
            _set_size(film, f"{key}.{name}", *((side, None) if width >= height else (None, side)))
            result[key] = {**sensor, name: film}
    return result


def rfilter_name(scene: Mapping[str, Any]) -> str:
    """The type of the first sensor's reconstruction filter; Mitsuba's default is `gaussian`."""
    _, _, _, film = next(_films(scene), (None, None, None, {}))
    return next((str(node.get("type")) for node in film.values() if isinstance(node, Mapping)), "gaussian")


def integrator_name(scene: Mapping[str, Any]) -> str:
    """The type of the scene's integrator; the default is `path`."""
    for key, node in scene.items():
        if isinstance(node, Mapping) and (key == "integrator" or node.get("type") in INTEGRATORS):
            return str(node.get("type"))
    return "path"


def _films(scene: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any], str, dict[str, Any]]]:
    """Each sensor that dicts describe, with its film: its key and node, the key of the film and a copy of its node."""
    for key, sensor in scene.items():
        if isinstance(sensor, Mapping) and sensor.get("type") in SENSORS:
            nodes = {name: node for name, node in sensor.items() if isinstance(node, Mapping)}
            name = next((name for name, node in nodes.items() if str(node.get("type", "")).endswith("film")), "film")
            film = sensor.get(name, {"type": "hdrfilm"})
            if isinstance(film, Mapping):
                yield key, sensor, name, dict(film)


def _set_size(film: dict[str, Any], node: str, width: int | None, height: int | None) -> None:
    if any(key.startswith("crop_") for key in film):
        raise SceneError(f"{node}: the film has a crop window, so its size can't be changed from outside")
    old_width, old_height = film.get("width", WIDTH), film.get("height", HEIGHT)
    if width is None:
        assert height is not None
        width = max(1, round(old_width * height / old_height))
    elif height is None:
        height = max(1, round(old_height * width / old_width))
    film["width"], film["height"] = width, height


def _set_integrator(scene: dict[str, Any], integrator: str | Mapping[str, Any]) -> None:
    key, old = "integrator", {}
    for name, node in scene.items():
        if isinstance(node, Mapping) and node.get("type") in INTEGRATORS:
            key, old = name, dict(node)
            break
    if not isinstance(integrator, str):
        scene[key] = dict(integrator)
        return
    # Integrators of others are only known to accept this one.
    takes = KEPT.get(integrator, COMMON if integrator in INTEGRATORS else ("hide_emitters",))
    kept = {name: old[name] for name in takes if name in old}
    scene[key] = {"type": integrator, **kept}

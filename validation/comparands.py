"""The things that can be compared: scenes, stored images, references, and functions that render."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.errors import SceneError
from djpt.images.formats import FORMATS
from djpt.images.image import Image, read_pixels
from djpt.scenes.overrides import described, integrator_name, override, rfilter_name
from djpt.validation.bridge import Renderer, mitsuba_renderer
from djpt.validation.metrics import ComparisonError
from djpt.validation.references import Reference, is_reference, read_reference, readable

__all__ = [
    "Comparand",
    "as_renderer",
    "comparand_of",
    "djpt_renderer",
    "is_described",
    "mitsuba_comparand",
    "scene_comparand",
    "told_apart",
]


@dataclass(frozen=True)
class Comparand:
    """One of the two things that are compared: a renderer, or an image, or a reference.

    * `title`: what it is called.
    * `renderer`: renders with any seed; None for images.
    * `paired`: renders in place of `renderer` where both sides have one and the same seed: numbers lights in the order
      of the description, which Mitsuba with its defaults does not.
    * `image`: pixels whose noise isn't known, (H, W, C).
    * `reference`: a stored image with its noise.
    * `description`: the scene, if it is one.
    * `facts`: what was rendered, for people to read.
    """

    title: str
    renderer: Renderer | None = None
    paired: Renderer | None = None
    image: npt.NDArray[np.float32] | None = None
    reference: Reference | None = None
    description: Mapping[str, Any] | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def independent_pixels(self) -> bool:
        """True if it is known that pixels share no samples: true of scenes under the box filter."""
        if self.reference is not None:
            return self.reference.independent_pixels
        return self.description is not None and rfilter_name(self.description) == "box"

    @property
    def distinctions(self) -> tuple[str, ...]:
        """The settings that may differ between two scenes in one renderer: the integrator, the schedule."""
        if self.description is None:
            return ()
        return integrator_name(self.description), str(self.facts.get("schedule", ""))


def comparand_of(value: Any, schedule: str = "auto", **changes: Any) -> Comparand:
    """The side that `value` stands for.

    Args:
        value: A scene (dict, built-in name, XML file) or a scene loaded by djpt or Mitsuba; the path of an image or
            of a reference; an array or a `Reference`; or a function, see `as_renderer`.
        schedule: djpt's schedule.
        changes: Changes of a scene's description: see `djpt.scenes.overrides.override`. What is no description
            keeps its size and its filter.

    Raises:
        ComparisonError: The value can't be compared, or isn't a scene that could have another integrator.
        SceneError: The scene is wrong, or the value isn't one of these.
        FileError: The file can't be read.
    """
    changed = {key: change for key, change in changes.items() if change is not None}
    if is_described(value):
        return scene_comparand(override(described(value)[1], **changed), schedule)
    if "integrator" in changed:
        raise ComparisonError(
            f"compare: only a scene description can be given another integrator, not {kind_of(value)}"
        )
    if isinstance(value, (str, os.PathLike)):
        return file_comparand(Path(value))
    if isinstance(value, Reference):
        return Comparand("reference", reference=value, facts=value.facts)
    module = type(value).__module__.partition(".")[0]
    if module == "mitsuba" and type(value).__name__ == "Scene":
        return Comparand("Mitsuba", loaded_in_mitsuba(value), facts={"what": "a scene loaded in Mitsuba"})
    if module == "djpt" and type(value).__name__ == "Scene":
        return Comparand("djpt", loaded_in_djpt(value, schedule), facts={"what": "a scene loaded in djpt"})
    if hasattr(value, "numpy") or isinstance(value, (np.ndarray, Image)):
        return Comparand("image", image=pixels_of(value), facts={"what": "an array"})
    if callable(value):
        name = getattr(value, "__name__", type(value).__name__)
        return Comparand(name, as_renderer(value), facts={"what": f"the function {name}"})
    raise SceneError(
        "a scene is a dict, a file or the name of a built-in scene; what can be compared with it is also an image, "
        f"a reference or a function that renders, found {kind_of(value)}"
    )


def is_described(value: Any) -> bool:
    """True if a value is a scene's description: a dict, a built-in name or an XML file."""
    if isinstance(value, (str, os.PathLike)):
        return Path(value).suffix.lower() not in FORMATS
    return isinstance(value, Mapping)


def scene_comparand(description: Mapping[str, Any], schedule: str = "auto") -> Comparand:
    """A scene in djpt."""
    facts = {"what": "a scene in djpt", "schedule": schedule, "description": readable(description)}
    return Comparand(
        "djpt",
        djpt_renderer(description, schedule),
        lambda spp, seed: djpt_renderer(description, schedule, optimize=False)(spp, seed),  # loaded if it is needed
        description=description,
        facts=facts,
    )


def mitsuba_comparand(description: Mapping[str, Any]) -> Comparand:
    """A scene in Mitsuba."""
    return Comparand(
        "Mitsuba",
        mitsuba_renderer(description),
        mitsuba_renderer(description, optimize=False),
        description=description,
        facts={"what": "a scene in Mitsuba", "description": readable(description)},
    )


def file_comparand(path: Path) -> Comparand:
    """An image file; one that `store_reference` wrote brings its noise along."""
    if is_reference(path):
        reference = read_reference(path)
        return Comparand(path.name, reference=reference, facts={"file": str(path), **reference.facts})
    return Comparand(path.name, image=read_pixels(path), facts={"what": "an image", "file": str(path)})


# ---- renderers -----------------------------------------------------------------------------------


def djpt_renderer(scene: Mapping[str, Any], schedule: str = "auto", optimize: bool = True) -> Renderer:
    """Load `scene` into djpt once, to be rendered many times; `optimize` is that of `djpt.load_dict`."""
    from djpt.description.loader import load_dict

    return loaded_in_djpt(load_dict(scene, optimize=optimize), schedule)


def loaded_in_djpt(scene: Any, schedule: str) -> Renderer:
    """Render a scene that djpt has loaded."""
    from djpt.rendering.render import render

    def renderer(spp: int, seed: int) -> npt.NDArray[np.float32]:
        return np.array(render(scene, spp=spp, seed=seed, schedule=schedule), np.float32)

    return renderer


def loaded_in_mitsuba(scene: Any) -> Renderer:
    """Render a scene that Mitsuba has loaded, in the variant that is set."""
    import mitsuba

    mi: Any = mitsuba

    def renderer(spp: int, seed: int) -> npt.NDArray[np.float32]:
        return np.array(mi.render(scene, spp=spp, seed=seed), np.float32)

    return renderer


def as_renderer(function: Callable[..., Any]) -> Renderer:
    """Any function that gives an image, as ``renderer(spp, seed)``.

    It is called with those of the arguments `spp` and `seed` that it names; if it names none, with as many as it
    requires, `spp` first, a single one being the seed. It returns an array (H, W) or (H, W, C), linear. Without
    random numbers its noise is 0, which the tests take into account.
    """
    wanted = inspect.signature(function).parameters
    every = any(each.kind is inspect.Parameter.VAR_KEYWORD for each in wanted.values())
    by_name = [name for name in ("spp", "seed") if every or name in wanted]
    required = sum(
        each.default is inspect.Parameter.empty
        and each.kind in (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
        for each in wanted.values()
    )

    def renderer(spp: int, seed: int) -> npt.NDArray[np.float32]:
        given = {"spp": spp, "seed": seed}
        if by_name:
            return pixels_of(function(**{name: given[name] for name in by_name}))
        return pixels_of(function(*((), (seed,), (spp, seed))[min(required, 2)]))

    return renderer


def pixels_of(value: Any) -> npt.NDArray[np.float32]:
    """An image of any kind as linear float32, (H, W, C). Raises `FileError` for other shapes and types."""
    pixels = Image(value).numpy()
    if pixels.dtype == np.uint8:
        raise ComparisonError("compare: an array of bytes has no linear values; convert it, or write it to a file")
    return np.asarray(pixels, np.float32)


def told_apart(a: Comparand, b: Comparand) -> tuple[Comparand, Comparand]:
    """The two sides with different titles: two of djpt are called by their integrators or their schedules."""
    if a.title != b.title:
        return a, b
    for names in zip(a.distinctions, b.distinctions, strict=False):
        if names[0] != names[1]:
            return replace(a, title=f"{a.title}, {names[0]}"), replace(b, title=f"{b.title}, {names[1]}")
    return replace(a, title=f"A, {a.title}"), replace(b, title=f"B, {b.title}")


def kind_of(value: Any) -> str:
    """The description of a value, for messages."""
    return f"'{value}'" if isinstance(value, (str, os.PathLike)) else f"a {type(value).__name__}"

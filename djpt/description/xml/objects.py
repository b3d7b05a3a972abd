"""The tags that stand for plugins, and the plugins that each can hold."""

from __future__ import annotations

from djpt.description.registry import kind_of, mitsuba_kind_of, unknown
from djpt.description.xml.source import Element

__all__ = ["OBJECTS", "check_type", "check_types", "is_object"]

OBJECTS = {
    "scene": "scene",
    "bsdf": "bsdf",
    "emitter": "emitter",
    "film": "film",
    "integrator": "integrator",
    "medium": "medium",
    "phase": "phase",
    "rfilter": "rfilter",
    "sampler": "sampler",
    "sensor": "sensor",
    "shape": "shape",
    "texture": "texture",
    "volume": "volume",
}
"""The tags of objects, and the kind of plugin that each holds."""


def is_object(element: Element) -> bool:
    """True if an element stands for a plugin."""
    return element.tag in OBJECTS or (element.tag == "spectrum" and "type" in element.attributes)


def check_types(root: Element) -> None:
    """Check the plugins of an element and of all below it, before anything is converted.

    Raises `SceneError` for the first one that doesn't exist, as `check_type`. Types with parameters are left out.
    """
    elements = [root]
    while elements:
        element = elements.pop()
        if is_object(element) and "$" not in element.attributes.get("type", "$"):
            check_type(element)
        elements += reversed(element.children)


def check_type(element: Element) -> None:
    """Raise `SceneError` if neither djpt nor Mitsuba has the plugin of an element, or if its tag is another."""
    expected, name = OBJECTS.get(element.tag, "texture"), element.attributes["type"]
    kind = kind_of(name) or mitsuba_kind_of(name)
    if kind is None:
        raise element.error(str(unknown(expected, name)))
    if kind != expected:
        tag = next((tag for tag, of in OBJECTS.items() if of == kind), kind)
        raise element.error(f"'{name}' is a {kind}; write <{tag} type=...>")

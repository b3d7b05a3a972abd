"""Descriptions of plugins and scenes, made of the parameters that plugins declare."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st

from djpt.description.registry import names
from tests.fuzz.declarations import KINDS, NEEDED, Declaration, declared
from tests.fuzz.values import Code, nonsense, value

__all__ = ["plugin", "scene"]

SLOW = ("direct_projective", "prb_projective", "distributed", "batch", "moment")
"""Plugins that ask for more work than a case has time for."""

NESTED = {
    "twosided": ("bsdf",), "mask": ("bsdf",), "blendbsdf": ("bsdf", "bsdf"), "bumpmap": ("bsdf", "texture"),
    "normalmap": ("bsdf",), "blendphase": ("phase", "phase"), "merge": ("shape",), "instance": ("shape",),
    "shapegroup": ("shape",), "volume": ("volume",),
}  # fmt: skip
"""The plugins that must be nested in others, by kind."""

UNTAMED = ("implicit", "metaballs", "instance", "shapegroup", "mesh_attribute", "tabphase", "sggx", "aov", "normalmap")
"""Plugins that need more than a description of their parameters tells."""

TEXTS = ("raw", "string", "child", "children", "plugin")
"""Sorts of parameters for which a random value is hardly ever right."""


@st.composite
def plugin(draw: st.DrawFn, kind: str, depth: int = 3, wild: bool = True) -> Any:
    """A description of a plugin of some kind, with up to `depth` levels of plugins in it.

    If `wild`, keys and values may be wrong, and numbers extreme; if not, the plugin can probably be made.
    """
    if wild and draw(chance(40)):
        return draw(nonsense())

    def inner(kind: str) -> st.SearchStrategy[Any]:
        return plugin(kind, max(0, depth - 1), wild)

    possible = [name for name in names(kind) if name not in SLOW and (wild or name not in UNTAMED)]
    name = draw(st.sampled_from([name for name in possible if depth or name not in NESTED] or possible))
    node: dict[str, Any] = {"type": name}
    if not wild or draw(st.booleans()):
        node |= {key: Code("(lambda p: p.x)") if callable(x) else x for key, x in NEEDED.get(name, {}).items()}
        node |= {f"in{i}": draw(inner(kind)) for i, kind in enumerate(NESTED.get(name, ()))}
    for declaration in declared(name):
        if declaration.key in node or not is_given(draw, declaration, depth, wild):
            continue
        key = declaration.key
        if declaration.sort in ("child", "children"):
            key = draw(st.sampled_from([key, f"a_{key}", f"b_{key}"]))
        if wild and draw(chance(12)):
            node[key] = draw(nonsense())
        else:
            node[key] = draw(value(declaration, wild, inner))
    if wild and draw(chance(15)):
        node[draw(st.sampled_from(["id", "x", "to_wrld", "", "a.b", "é", "type"]))] = draw(nonsense())
    return node


def is_given(draw: st.DrawFn, declaration: Declaration, depth: int, wild: bool) -> bool:
    """Whether a description has a parameter."""
    if declaration.required:
        return True
    if not wild and declaration.sort in TEXTS and not declaration.choices:
        return False
    if declaration.sort in ("plugin", "child", "children", "volume") and depth == 0:
        return False
    return draw(chance(3 if wild else 4))


def chance(n: int) -> st.SearchStrategy[bool]:
    """True once in `n` times; false is the simpler."""
    return st.integers(0, n - 1).map(lambda k: k == n - 1)


LIGHTS = (
    {"type": "constant"},
    {"type": "point", "position": [0, 3, -3]},
    {"type": "directional", "direction": [0, -1, 1]},
    {"type": "spot", "to_world": Code("T().look_at(origin=[0, 0, -4], target=[0, 0, 0], up=[0, 1, 0])")},
    {"type": "envmap", "filename": "a.exr"},
)
CAMERAS = ("perspective", "orthographic", "thinlens", "fisheye", "panorama")
LOOK = Code("T().look_at(origin=[0, 0, -4], target=[0, 0, 0], up=[0, 1, 0])")


@st.composite
def scene(draw: st.DrawFn, wild: bool = True) -> Any:
    """A description of a scene: a sensor, some shapes, a light, and what else comes."""
    film = {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}
    sensor: Any = {"type": draw(st.sampled_from(CAMERAS)), "film": film, "to_world": LOOK}
    if sensor["type"] == "thinlens":
        sensor["aperture_radius"] = 0.1
    if wild and draw(chance(4)):
        sensor = draw(plugin("sensor", 1, wild))
    node: dict[str, Any] = {"type": "scene", "sensor": sensor}
    node["light"] = draw(st.sampled_from(LIGHTS)) if draw(st.booleans()) else draw(light(wild))
    if draw(st.booleans()):
        node["integrator"] = draw(plugin("integrator", 1, wild))
    node["material"] = draw(plugin("bsdf", 2, wild))
    for i in range(draw(st.integers(1, 2))):
        shape = draw(plugin("shape", 2, wild))
        if isinstance(shape, dict) and shape.get("type") not in ("merge", "instance", "shapegroup"):
            shape = {key: entry for key, entry in shape.items() if "bsdf" not in key}
            shape["bsdf"] = {"type": "ref", "id": "material"}
        node[f"shape{i}"] = shape
    if draw(chance(4)):
        medium = draw(plugin("medium", 2, wild))
        node |= {"fog": {"type": "sphere", "bsdf": {"type": "null"}, "interior": medium}}
        node["integrator"] = {"type": draw(st.sampled_from(["volpath", "volpathmis"])), "max_depth": 8}
    if wild and draw(chance(3)):
        node["more"] = draw(st.sampled_from(KINDS).flatmap(lambda kind: plugin(kind, 2, wild)))
    return node


@st.composite
def light(draw: st.DrawFn, wild: bool) -> Any:
    """A light: on a rectangle if it must lie on a shape."""
    found = draw(plugin("emitter", 1, wild))
    if isinstance(found, dict) and found["type"] in ("area", "directionalarea"):
        return {"type": "rectangle", "to_world": Code("T().translate([0, 0, -3])"), "emitter": found}
    return found

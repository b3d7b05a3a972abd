"""Descriptions: what is accepted, how names and references resolve, and plugins of one's own."""

from __future__ import annotations

import copy
import gc
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.description import registry
from djpt.description.properties import Properties
from djpt.errors import SceneError
from djpt.jit.types import Color3f, Float, Point3f, UInt32
from djpt.textures import ConstantTexture, Texture


def scene(**nodes: Any) -> dict[str, Any]:
    return {"type": "scene", "white": {"type": "diffuse"}, **nodes}


def color(texture: Any) -> list[float]:
    return [round(float(x), 6) for x in np.array(texture.eval(None)).ravel()]


# ---------------------------------------------------------------- what is accepted


def test_names_and_references() -> None:
    loaded = djpt.load_dict(
        scene(
            early={"type": "rectangle", "bsdf": {"type": "ref", "id": "late"}},
            late={"type": "diffuse", "id": "renamed"},
            nested={"type": "sphere", "own": {"type": "twosided", "inner": {"type": "diffuse", "id": "deep"}}},
            by_key={"type": "cube", "b": {"type": "ref", "id": "white"}},
            by_id={"type": "cube", "b": {"type": "ref", "id": "renamed"}},
            by_path={"type": "cube", "b": {"type": "ref", "id": "nested.own"}},
            by_deep_id={"type": "cube", "b": {"type": "ref", "id": "deep"}},
        )
    )
    shapes = {shape.id(): shape for shape in loaded.shapes()}
    assert list(shapes) == ["early", "nested", "by_key", "by_id", "by_path", "by_deep_id"]
    assert shapes["early"].bsdf() is shapes["by_id"].bsdf() and shapes["early"].bsdf().id() == "renamed"
    assert shapes["by_path"].bsdf() is shapes["nested"].bsdf() and shapes["nested"].bsdf().id() == "nested.own"
    assert shapes["by_deep_id"].bsdf() is shapes["nested"].bsdf().front
    assert shapes["by_key"].bsdf().id() == "white"


def test_one_dict_object_in_two_places_makes_two_plugins() -> None:
    shared = {"type": "diffuse"}
    loaded = djpt.load_dict(scene(a={"type": "cube", "b": shared}, c={"type": "cube", "b": shared}))
    a, c = loaded.shapes()
    assert a.bsdf() is not c.bsdf()


def test_plugins_as_values() -> None:
    bsdf = djpt.load_dict({"type": "diffuse", "reflectance": 0.25})
    loaded = djpt.load_dict(
        scene(
            made=bsdf,
            a={"type": "cube", "b": bsdf},
            c={"type": "cube", "b": {"type": "ref", "id": "made"}},
        )
    )
    assert [shape.bsdf() for shape in loaded.shapes()] == [bsdf, bsdf]


def test_the_description_is_not_modified() -> None:
    description = djpt.cornell_box()
    before = copy.deepcopy(description)
    djpt.load_dict(description, parallel=False, optimize=False)
    assert description == before


NEED_FILES = ["obj", "ply", "serialized", "sdfgrid", "linearcurve", "bsplinecurve", "ellipsoids", "ellipsoidsmesh"]
"""Shapes that need a file, or as many numbers as a file has."""


SQUARE = djpt.Mesh("square", [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])


@pytest.mark.parametrize("kind", ["bsdf", "sensor", "film", "shape", "emitter", "sampler", "rfilter", "integrator"])
def test_any_plugin_can_be_the_root(kind: str) -> None:
    for name, factory in registry.registered(kind).items():
        if not registry.is_own(factory):
            continue  # Other tests register plugins of their own.
        required = {
            "twosided": {"b": {"type": "diffuse"}},
            "deforming": {"a": SQUARE, "b": SQUARE},
            "mask": {"b": {"type": "diffuse"}},
            "bumpmap": {"b": {"type": "diffuse"}, "t": {"type": "checkerboard"}},
            "normalmap": {"b": {"type": "diffuse"}, "normalmap": 0.5},
            "blendbsdf": {"b": {"type": "diffuse"}, "c": {"type": "diffuse"}},
            "aov": {"aovs": "d:depth"},
            "moment": {"image": {"type": "path"}},
            "batch": {"view": {"type": "perspective"}},
            "envmap": {"data": np.ones((3, 6, 3))},
            "thinlens": {"aperture_radius": 0.1},
            "implicit": {"function": lambda p: p.z},
            "metaballs": {"balls": [[0, 0, 0, 1]]},
            "shapegroup": {"inner": {"type": "sphere"}},
            "instance": {"group": {"type": "shapegroup", "inner": {"type": "sphere"}}},
        }
        if name in (
            "obj",
            "ply",
            "serialized",
            "sdfgrid",
            "linearcurve",
            "bsplinecurve",
            "ellipsoids",
            "ellipsoidsmesh",
            "merge",
            "measured",
        ):
            continue  # These need files, see tests/geometry; `merge` is its parts, see tests/scenes/test_merge.py.
        plugin = djpt.load_dict({"type": name, **required.get(name, {})})
        assert plugin.kind == kind and plugin.id() == name


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0.25, [0.25] * 3),
        (1, [1] * 3),
        (np.float32(0.5), [0.5] * 3),
        (Float(0.5), [0.5] * 3),
        ({"type": "rgb", "value": [0.1, 0.2, 0.3]}, [0.1, 0.2, 0.3]),
        ({"type": "rgb", "value": (0, 1, 0.5)}, [0, 1, 0.5]),
        ({"type": "rgb", "value": np.array([0.1, 0.2, 0.3])}, [0.1, 0.2, 0.3]),
        ({"type": "rgb", "value": Color3f(0.1, 0.2, 0.3)}, [0.1, 0.2, 0.3]),
        ({"type": "rgb", "value": 0.75}, [0.75] * 3),
    ],
    ids=str,
)
def test_colours(value: Any, expected: list[float]) -> None:
    assert color(djpt.load_dict({"type": "diffuse", "reflectance": value}).reflectance) == pytest.approx(expected)


def test_default_colours_and_shared_textures() -> None:
    assert color(djpt.load_dict({"type": "diffuse"}).reflectance) == [0.5] * 3
    loaded = djpt.load_dict(
        scene(tint={"type": "rgb", "value": 0.25}, a={"type": "diffuse", "reflectance": {"type": "ref", "id": "tint"}})
    )
    assert dict(djpt.traverse(loaded)).keys() == {"white.reflectance.value", "tint.value"}


def test_mitsubas_objects(mi: Any) -> None:
    transform = mi.ScalarTransform4f().translate([1, 2, 3])
    assert djpt.load_dict({"type": "rectangle", "to_world": transform}).to_world == T().translate([1, 2, 3])
    assert djpt.load_dict({"type": "rectangle", "to_world": transform.matrix}).to_world == T().translate([1, 2, 3])
    tinted = djpt.load_dict({"type": "diffuse", "reflectance": mi.ScalarColor3f(0.1, 0.2, 0.3)})
    assert color(tinted.reflectance) == pytest.approx([0.1, 0.2, 0.3])
    light = djpt.load_dict({"type": "point", "position": mi.ScalarPoint3f(1, 2, 3)})
    assert np.array(light.position).ravel().tolist() == [1, 2, 3]
    # Mitsuba's own Cornell box, with its transform objects
    assert len(djpt.load_dict(mi.cornell_box()).shapes()) == 8


@pytest.mark.parametrize("position", [[1, 2, 3], (1, 2.0, 3), np.array([1, 2, 3]), Point3f(1, 2, 3)], ids=str)
def test_vectors(position: Any) -> None:
    light = djpt.load_dict({"type": "point", "position": position})
    assert np.array(light.position).ravel().tolist() == [1, 2, 3]


def test_integers_of_every_form() -> None:
    for count in (7, np.int64(7), np.array(7), UInt32(7)):
        assert djpt.load_dict({"type": "independent", "sample_count": count}).sample_count() == 7


# ---------------------------------------------------------------- registering plugins


class Stripes(Texture):
    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.count = props.integer("count", low=1)

    def restrict(self, allowed: Any, where: str) -> None:
        pass


def test_own_plugins() -> None:
    djpt.register_texture("test_stripes", Stripes)
    bsdf = djpt.load_dict({"type": "diffuse", "reflectance": {"type": "test_stripes", "count": 3}})
    assert bsdf.reflectance.count == 3
    with pytest.raises(SceneError, match=r"^test_stripes: 'test_stripes' needs the key 'count'$"):
        djpt.load_dict({"type": "test_stripes"})


def test_registering_again_replaces() -> None:
    class Other(Stripes):
        pass

    djpt.register_texture("test_stripes", Stripes)
    djpt.register_texture("test_stripes", Other)  # running a notebook's cell again
    assert registry.lookup("texture", "test_stripes") is Other
    djpt.register_texture("rgb", Other)
    try:
        assert type(djpt.load_dict({"type": "rgb", "count": 2})) is Other
    finally:
        djpt.register_texture("rgb", ConstantTexture)
    assert type(djpt.load_dict({"type": "rgb", "value": 2})) is ConstantTexture


def test_factories_are_checked() -> None:
    with pytest.raises(SceneError, match=r"register_bsdf: 'sphere' is the name of another kind .*: shape"):
        djpt.register_bsdf("sphere", Stripes)
    with pytest.raises(SceneError, match=r"register_bsdf: 'envmap' is the name of another kind .*: emitter"):
        djpt.register_bsdf("envmap", Stripes)
    with pytest.raises(SceneError, match="register_bsdf: a plugin's name must be a string, found 3"):
        djpt.register_bsdf(3, Stripes)  # type: ignore[arg-type]
    with pytest.raises(SceneError, match="register_bsdf: the factory of 'x' must be callable"):
        djpt.register_bsdf("x", None)  # type: ignore[arg-type]
    djpt.register_bsdf("test_nothing", lambda props: None)  # type: ignore[arg-type, return-value]
    with pytest.raises(SceneError, match=r"^test_nothing: the factory of 'test_nothing' returned None, not"):
        djpt.load_dict({"type": "test_nothing"})


def test_lookup_by_kind() -> None:
    with pytest.raises(SceneError, match="expected the kind 'bsdf', found the shape 'sphere'"):
        registry.lookup("bsdf", "sphere")
    with pytest.raises(SceneError, match="unknown film 'hdrfil'; did you mean 'hdrfilm'"):
        registry.lookup("film", "hdrfil")


def test_loading_collects_no_garbage_and_leaves_the_collector_as_it_was() -> None:
    collections: list[str] = []

    def note(phase: str, info: dict[str, int]) -> None:
        collections.append(phase)

    scene = {"type": "scene"} | {f"ball{i}": {"type": "sphere", "center": [i, 0, 0]} for i in range(200)}
    nested: list[Any] = []
    was_on = gc.isenabled()
    try:
        for on in (True, False):
            (gc.enable if on else gc.disable)()
            gc.collect()
            gc.callbacks.append(note)
            nested.append(djpt.load_dict(scene))
            gc.callbacks.remove(note)
            assert gc.isenabled() == on
    finally:
        (gc.enable if was_on else gc.disable)()
    # When the collector is on again.
    assert collections.count("start") <= 2

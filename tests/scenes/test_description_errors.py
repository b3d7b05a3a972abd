"""Wrong descriptions: what each mistake says."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import djpt
from djpt.core.limits import MAX_DEPTH
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import SceneError
from djpt.jit.types import Float


def scene(**nodes: Any) -> dict[str, Any]:
    return {"type": "scene", "white": {"type": "diffuse"}, **nodes}


NAN = math.nan


LOOP: dict[str, Any] = {"type": "twosided"}


LOOP["inner"] = LOOP


DEEP: dict[str, Any] = {"type": "diffuse"}


for _ in range(MAX_DEPTH):
    DEEP = {"type": "twosided", "inner": DEEP}


CHAIN = {f"r{i}": {"type": "ref", "id": f"r{i + 1}"} for i in range(2 * MAX_DEPTH)}


def sphere(**entries: Any) -> dict[str, Any]:
    return scene(ball={"type": "sphere", **entries})


def white(**entries: Any) -> dict[str, Any]:
    return {"type": "scene", "white": {"type": "diffuse", **entries}}


MISTAKES: dict[str, tuple[Any, str]] = {
    # form
    "no dict": ([1], r"^load_dict: a scene description is a dict, found list \[1\]$"),
    "None": (None, r"^load_dict: a scene description is a dict, found None$"),
    "empty": ({}, r"^scene: the key 'type' is missing \(found: nothing\)$"),
    "no type": (scene(a={"id": "x", "b": 2}), r"^scene\.a: the key 'type' is missing \(found: b, id\)$"),
    "type number": (scene(a={"type": 3}), r"^scene\.a: 'type' must be a string, found int 3$"),
    "type list": ({"type": ["scene"]}, r"^scene: 'type' must be a string, found list"),
    "key number": (scene(a={"type": "sphere", 3: 4}), r"^scene\.a: keys must be strings, found int 3$"),
    "empty key": (scene(**{"": {"type": "sphere"}}), r"^scene: keys must be strings, found str ''$"),
    "dotted key": (scene(**{"a.b": {"type": "sphere"}}), r"^scene: the key 'a\.b' contains a '\.'"),
    "id number": (scene(a={"type": "sphere", "id": 3}), r"^scene\.a: 'id' must be a name, found int 3$"),
    "contains itself": (scene(a=LOOP), r"^scene\.a\.inner: the dict contains itself$"),
    "too deep": (scene(a=DEEP), rf": nested deeper than {MAX_DEPTH} levels$"),
    "scene in scene": (scene(a={"type": "scene"}), r"^scene\.a: a scene can't be nested$"),
    # names
    "unknown plugin": (
        scene(a={"type": "difuse"}),
        r"^scene\.a: unknown plugin 'difuse'; did you mean 'diffuse'\? \(possible: diffuse.* and \d+ more\)$",
    ),
    "of Mitsuba": (
        scene(a={"type": "measured_polarized"}),
        r"^scene\.a: Mitsuba's bsdf 'measured_polarized' isn't supported: .* no polarisation; take a 'rough",
    ),
    "unknown key": (
        white(reflectence=0.5),
        r"^scene\.white: unknown key 'reflectence' of bsdf 'diffuse'; did you mean 'reflectance'\?",
    ),
    "unknown key with a texture": (
        white(reflectence={"type": "rgb", "value": 0.5}),
        r"^scene\.white: unknown key 'reflectence' \(a texture\) of bsdf 'diffuse'; did you mean 'reflectance'\?",
    ),
    "number in a scene": (scene(a=3), r"^scene: unknown key 'a' of 'scene'; possible: allow_thread"),
    "box in a sphere": (sphere(a={"type": "box"}), r"^scene\.ball: unknown key 'a' \(an rfilter\) of shape 'sphere'"),
    "two names": (
        scene(a={"type": "cube", "id": "x"}, b={"type": "cube", "id": "x"}),
        r"^scene\.b: the name 'x' is already taken by scene\.a$",
    ),
    "name of another": (scene(a={"type": "cube", "id": "white"}), r"^scene\.a: the name 'white' is already taken"),
    # references
    "missing reference": (
        sphere(bsdf={"type": "ref", "id": "whit"}),
        r"^scene\.ball\.bsdf: nothing has the id 'whit'; did you mean 'white'\? \(possible: white\)$",
    ),
    "missing path": (sphere(bsdf={"type": "ref", "id": "ball.bsd"}), r"^scene\.ball\.bsdf: nothing has the id"),
    "reference alone": ({"type": "ref", "id": "x"}, r"^ref: nothing has the id 'x'$"),
    "reference to itself": (scene(a={"type": "ref", "id": "a"}), r"^scene\.a: references form a cycle: a -> a$"),
    "reference without id": (sphere(b={"type": "ref"}), r"^scene\.ball\.b: a reference needs an 'id' .* found None$"),
    "reference by number": (sphere(b={"type": "ref", "id": 1}), r"^scene\.ball\.b: a reference .* found int 1$"),
    "reference with more": (
        sphere(b={"type": "ref", "id": "white", "idd": 1}),
        r"^scene\.ball\.b: unknown key 'idd' of a reference; did you mean 'id'\?",
    ),
    "circle": (
        scene(
            a={"type": "twosided", "b": {"type": "ref", "id": "c"}},
            c={"type": "twosided", "b": {"type": "ref", "id": "a"}},
        ),
        r"^scene\.a: references form a cycle: a -> a\.b -> c -> c\.b -> a$",
    ),
    "long chain": ({"type": "scene", **CHAIN}, r": nested deeper than|nothing has the id"),
    "reference of the wrong kind": (
        sphere(b={"type": "ref", "id": "lens"}, lens={"type": "perspective"}),
        r"^scene\.ball: unknown key|nothing has the id",
    ),
    "two bsdfs": (
        sphere(a={"type": "diffuse"}, b={"type": "ref", "id": "white"}),
        r"^scene\.ball: 'sphere' takes one bsdf, found 2: 'a', 'b'$",
    ),
    # types
    "float": (sphere(radius="1"), r"^scene\.ball: 'radius' must be a float, found str '1'$"),
    "float from bool": (sphere(radius=True), r"^scene\.ball: 'radius' must be a float, found bool True$"),
    "float from None": (sphere(radius=None), r"^scene\.ball: 'radius' must be a float, found None$"),
    "float from list": (sphere(radius=[1.0]), r"^scene\.ball: 'radius' must be a float, found list \[1\.0\]$"),
    "float from plugin": (sphere(radius={"type": "diffuse"}), r"^scene\.ball: 'radius' must be a float, found Diff"),
    "float nan": (sphere(radius=NAN), r"^scene\.ball: 'radius' must be finite .* found float nan$"),
    "float too large": (sphere(radius=1e39), r"^scene\.ball: 'radius' must be finite in single precision"),
    "int too large": (sphere(radius=10**400), r"^scene\.ball: 'radius' must be finite in single precision"),
    "wide float": (sphere(radius=Float(1, 2)), r"^scene\.ball: 'radius' must be a float, found Float \[1, 2\]$"),
    "range": (sphere(radius=0), r"^scene\.ball: 'radius' must be greater than 0, found 0$"),
    "boolean": (sphere(flip_normals=1), r"^scene\.ball: 'flip_normals' must be True or False, found int 1$"),
    "integer": (
        {"type": "independent", "sample_count": 64.0},
        r"^independent: 'sample_count' must be an integer, found float 64\.0$",
    ),
    "integer range": (
        {"type": "independent", "sample_count": 0},
        r"^independent: 'sample_count' must be at least 1, found 0$",
    ),
    "string": ({"type": "hdrfilm", "pixel_format": 3}, r"^hdrfilm: 'pixel_format' must be a string, found int 3$"),
    "choice": (
        {"type": "hdrfilm", "pixel_format": "rbg"},
        r"^hdrfilm: 'pixel_format' can't be 'rbg'; did you mean 'rgb'\?",
    ),
    "vector": (sphere(center=[1, 2]), r"^scene\.ball: 'center' must be three numbers, found list \[1, 2\]$"),
    "vector nan": (sphere(center=[1, 2, NAN]), r"^scene\.ball: 'center' must be finite"),
    "vector string": (sphere(center="origin"), r"^scene\.ball: 'center' must be numbers, found str 'origin'$"),
    "film of no pixels": ({"type": "hdrfilm", "width": 0, "height": 0}, r"^hdrfilm: 'width' must be at least 1"),
    "no transform": (sphere(to_world=None), r"^scene\.ball: 'to_world' must be a 4x4 matrix, found None$"),
    # transforms
    "nan transform": (sphere(to_world=np.full((4, 4), NAN)), r"^scene\.ball: 'to_world' must be finite"),
    "singular": (
        sphere(to_world=T().scale([1, 1, 0])),
        r"^scene\.ball: 'to_world' must be invertible, found a singular matrix",
    ),
    "projective": (sphere(to_world=np.ones((4, 4))), r"^scene\.ball: 'to_world' must be affine"),
    "3x3": (sphere(to_world=np.eye(3)), r"^scene\.ball: 'to_world' must be a 4x4 matrix, found .*\(3, 3\)$"),
    "transform by name": (sphere(to_world="identity"), r"^scene\.ball: 'to_world' must be numbers, found str"),
    # textures
    "reflectance": (white(reflectance=1.2), r"^scene\.white: 'reflectance' must lie in \[0, 1\], found 1\.2$"),
    "rgb reflectance": (
        white(reflectance={"type": "rgb", "value": [0.5, -0.25, 0]}),
        r"^scene\.white: 'reflectance' must lie in \[0, 1\], found -0\.25$",
    ),
    "nan reflectance": (white(reflectance=NAN), r"^scene\.white: 'reflectance' must be finite"),
    "text": (white(reflectance="red"), r"^scene\.white: 'reflectance' must be a number or a texture, found str 'red'$"),
    "list": (
        white(reflectance=[0.1, 0.2, 0.3]),
        r"^scene\.white: 'reflectance' must be a number or a texture, found list .*; write \{'type': 'rgb'",
    ),
    "bsdf": (
        white(reflectance={"type": "diffuse"}),
        r"^scene\.white: 'reflectance' must be a number or a texture, found the bsdf 'white\.reflectance'$",
    ),
    "rgb without value": (
        white(reflectance={"type": "rgb", "val": 1}),
        r"^scene\.white\.reflectance: 'rgb' needs the key 'value'; did you mean 'val'\?",
    ),
    "rgb of two": (
        white(reflectance={"type": "rgb", "value": [1, 2]}),
        r"^scene\.white\.reflectance: 'value' must be one or three numbers, found list \[1, 2\]$",
    ),
    "rgb text": (
        white(reflectance={"type": "rgb", "value": "#fff"}),
        r"^scene\.white\.reflectance: 'value' must be numbers, found str '#fff'$",
    ),
    "negative light": ({"type": "point", "intensity": -1}, r"^point: 'intensity' must be at least 0, found -1$"),
}  # fmt: skip


@pytest.mark.parametrize(("description", "message"), MISTAKES.values(), ids=MISTAKES.keys())
def test_mistakes(description: Any, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict(description)


def test_an_array_with_gradients_is_no_plain_number() -> None:
    import drjit as dr

    x = Float(0.5)
    dr.enable_grad(x)
    with pytest.raises(SceneError, match=r"ball: 'radius' must be plain numbers, found an array with gradients"):
        djpt.load_dict(sphere(radius=x))


values = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), st.binary(max_size=3),
    st.lists(st.floats(), max_size=4), st.just(np.array([])), st.just(np.array("x")), st.just(np.full((4, 4), 1e300)),
    st.just(object()), st.just(Float()), st.just(dict), st.just({1, 2}), st.just(np.array([None])), st.just(1 + 1j),
)  # fmt: skip


NODES = {
    "sphere": ("radius", "center", "to_world", "flip_normals"),
    "diffuse": ("reflectance",),
    "rgb": ("value",),
    "perspective": ("fov", "focal_length", "fov_axis", "near_clip", "to_world", "principal_point_offset_x"),
    "point": ("position", "intensity"),
    "hdrfilm": ("width", "crop_width", "crop_offset_x", "pixel_format", "sample_border"),
    "independent": ("sample_count", "seed"),
}


@settings(max_examples=300, deadline=None)
@given(st.sampled_from([(name, key) for name, keys in NODES.items() for key in keys]), values)
def test_no_value_crashes(place: tuple[str, str], value: Any) -> None:
    name, key = place
    try:
        djpt.load_dict({"type": name, key: value})
    except SceneError as error:
        assert str(error).startswith(name) and len(str(error)) < 2000


@pytest.mark.parametrize(
    "numbers",
    [
        {"type": "cylinder", "p0": [0, 0, 1e38], "p1": [0, 0, -3e38]},
        {"type": "cone", "angle": 89.9999999, "length": 3e38},
        {"type": "sphere", "center": [1e38, 0, 0], "to_world": T().scale(10)},
        {"type": "radiancemeter", "origin": [3e38, 0, 0], "direction": [1, 0, 0]},
    ],
    ids=lambda numbers: numbers["type"],
)
def test_errors_of_transforms_name_the_plugin(numbers: dict[str, Any]) -> None:
    """The transform that a constructor makes of numbers doesn't know whose they are."""
    with pytest.raises(SceneError, match=f"^{numbers['type']}: "):
        djpt.load_dict(numbers)


def test_solids_may_be_small_beside_their_distance() -> None:
    far = djpt.load_dict({"type": "paraboloid", "vertex": [0, 0, 2.0**53]})
    np.testing.assert_allclose(far.to_world.matrix[:3, :3], np.eye(3))

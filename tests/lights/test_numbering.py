"""Lights and sensors have Mitsuba's numbers, with its loader's defaults and with `optimize=False`."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.shapes.numbering import in_buckets
from tests.kit.meshes import tetrahedron_file

POINT = {"type": "point", "position": [1, 1, 3], "intensity": 20.0}
VIEW = {
    "type": "perspective",
    "fov": 50,
    "to_world": T().look_at(origin=[0, -9, 5], target=[0, 0, 0.5], up=[0, 0, 1]),
    "film": {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}},
}


@pytest.fixture
def mi() -> Any:
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("llvm_ad_rgb")
    return mitsuba


def lamp(kind: str, radiance: float, **keys: Any) -> dict[str, Any]:
    """A shape that shines down from its own place; `radiance` tells the lights apart."""
    place = T().translate([1.5 * radiance - 6, 0, 3]).rotate([1, 0, 0], 180).scale(0.3)
    return {"type": kind, "to_world": place, "emitter": {"type": "area", "radiance": radiance}, **keys}


def mesh(radiance: float, **keys: Any) -> dict[str, Any]:
    return lamp("ply", radiance, filename=tetrahedron_file(), **keys)


def scene(**nodes: Any) -> dict[str, Any]:
    return {"type": "scene", "integrator": {"type": "path", "max_depth": 3}, "sensor": VIEW, **nodes}


def numbered(loaded: Any, traverse: Any) -> list[str]:
    """The lights in their order: the radiance of area lights, the class of others."""
    names = []
    for emitter in loaded.emitters():
        params = traverse(emitter)
        keys = [key for key in dict(params) if key.startswith("radiance")]
        is_area = "Area" in emitter.class_name()
        names.append(f"{np.ravel(params[keys[0]])[0]:.0f}" if is_area else emitter.class_name().removesuffix("Light"))
    return names


BALLS = {"type": "merge", "x": lamp("rectangle", 2), "y": lamp("sphere", 3), "z": lamp("cube", 4)}
SCENES: dict[str, dict[str, Any]] = {
    "a rectangle before a sphere and a point": {"a": lamp("rectangle", 1), "b": lamp("sphere", 2), "p": POINT},
    "a cube before a disk": {"a": lamp("cube", 1), "b": lamp("disk", 2)},
    "a mesh file before a point": {"a": mesh(1), "p": POINT},
    "two meshes around a point": {"a": mesh(1), "p": POINT, "b": lamp("rectangle", 2)},
    "curved shapes only": {"a": lamp("sphere", 1), "p": POINT, "b": lamp("disk", 2), "c": lamp("cylinder", 3)},
    "an area light by reference": {
        "light": {"type": "area", "radiance": 1.0},
        "a": {"type": "rectangle", "e": {"type": "ref", "id": "light"}},
        "b": lamp("sphere", 2),
    },
}


@pytest.mark.parametrize("optimize", [True, False])
@pytest.mark.parametrize("name", SCENES)
def test_lights_are_numbered_as_in_mitsuba(mi: Any, name: str, optimize: bool) -> None:
    description = scene(**SCENES[name])
    mine = djpt.load_dict(description, optimize=optimize)
    reference = mi.load_dict(djpt.validation.to_mitsuba(description), optimize=optimize)
    assert numbered(mine, djpt.traverse) == numbered(reference, mi.traverse)


def test_the_default_is_to_number_lights_of_meshes_last(mi: Any) -> None:
    description = scene(**SCENES["two meshes around a point"])
    assert numbered(djpt.load_dict(description), djpt.traverse) == ["Point", "2", "1"]
    assert numbered(djpt.load_dict(description, optimize=False), djpt.traverse) == ["1", "Point", "2"]
    text = djpt.to_xml(description)
    assert numbered(djpt.load_string(text), djpt.traverse) == numbered(mi.load_string(text), mi.traverse)
    kept = numbered(djpt.load_string(text, optimize=False), djpt.traverse)
    assert kept == numbered(mi.load_string(text, optimize=False), mi.traverse) == ["1", "Point", "2"]


@pytest.mark.parametrize("optimize", [True, False])
def test_shapes_that_exist_already_are_never_merged(mi: Any, optimize: bool) -> None:
    others = {"a": lamp("rectangle", 1), "b": lamp("sphere", 2), "p": POINT}
    found = []
    for module, translated in ((djpt, dict), (mi, djpt.validation.to_mitsuba)):
        described: dict[str, Any] = {"type": "scene", **others}
        loaded = module.load_dict(translated(lamp("rectangle", 3)))
        description = translated(described) | {"c": loaded, **translated({"d": lamp("disk", 4)})}
        found.append(numbered(module.load_dict(description, optimize=optimize), module.traverse))
    assert found[0] == found[1] == (["3", "2", "Point", "4", "1"] if optimize else ["1", "2", "Point", "3", "4"])


def most_frequent(mi: Any, description: dict[str, Any], optimize: bool) -> list[str]:
    """Mitsuba's most frequent order: with several meshes it depends on addresses in memory, which differ."""
    translated = djpt.validation.to_mitsuba(description)
    alive = [mi.load_dict(translated, optimize=optimize) for _ in range(40)]
    ((order, _),) = Counter(tuple(numbered(loaded, mi.traverse)) for loaded in alive).most_common(1)
    return list(order)


@pytest.mark.parametrize("optimize", [True, False])
@pytest.mark.parametrize(
    "nodes",
    [
        {"a": lamp("rectangle", 1), "b": mesh(2), "p": POINT, "c": lamp("cube", 3)},
        {"a": lamp("rectangle", 1), "balls": BALLS, "p": POINT},
    ],
    ids=["three meshes", "a merge among others"],
)
def test_several_meshes_have_mitsubas_most_frequent_order(mi: Any, nodes: dict[str, Any], optimize: bool) -> None:
    description = scene(**nodes)
    mine = numbered(djpt.load_dict(description, optimize=optimize), djpt.traverse)
    assert mine == most_frequent(mi, description, optimize)


def test_meshes_of_equal_materials_are_one_group(mi: Any) -> None:
    """Twenty meshes are more than the first buckets, whose order turns then; the two groups that they form are not."""
    grey, red = ({"type": "diffuse", "reflectance": {"type": "rgb", "value": [x, 0.5, 0.5]}} for x in (0.5, 0.9))
    walls = {f"wall{i}": {"type": "rectangle", "bsdf": {**(grey, red)[i % 2]}} for i in range(20)}
    description = scene(a=lamp("rectangle", 1), b=lamp("cube", 2), **walls, p=POINT)
    mine = numbered(djpt.load_dict(description), djpt.traverse)
    assert mine == most_frequent(mi, description, optimize=True) == ["Point", "2", "1"]


def test_buckets_have_the_order_of_the_cpp_library() -> None:
    """As GCC 14's `std::unordered_set<int>` lists 0 to 31 where the hash of a number is the number."""
    assert in_buckets(range(4)) == [3, 2, 1, 0]
    assert in_buckets(range(14)) == [13, *range(13)]
    assert in_buckets(range(32)) == [31, 30, 29, *reversed(range(13)), *range(13, 29)]


@pytest.mark.parametrize("optimize", [True, False])
def test_sensors_of_meshes_are_numbered_as_in_mitsuba(mi: Any, optimize: bool) -> None:
    def meter(size: int) -> dict[str, Any]:
        film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
        return {"type": "irradiancemeter", "film": film}

    nodes = {"a": {"type": "rectangle", "meter": meter(1)}, "b": {"type": "sphere", "meter": meter(2)}, "view": VIEW}
    description = {"type": "scene", **nodes}
    mine = djpt.load_dict(description, optimize=optimize).sensors()
    reference = mi.load_dict(djpt.validation.to_mitsuba(description), optimize=optimize).sensors()
    sizes = [tuple(np.ravel(sensor.film().size())) for sensor in reference]
    assert [tuple(np.ravel(sensor.film().size())) for sensor in mine] == sizes
    assert sizes == ([(2, 2), (24, 24), (1, 1)] if optimize else [(1, 1), (2, 2), (24, 24)])


def test_a_mesh_with_attributes_is_numbered_where_it_stands(mi: Any, tmp_path: Path) -> None:
    properties = "".join(f"property float {name}\n" for name in "xyzrgb")
    faces = "element face 1\nproperty list uchar int vertex_indices\n"
    vertices = "0 0 0 1 0 0\n1 0 0 0 1 0\n0 1 0 0 0 1\n"
    file = tmp_path / "coloured.ply"
    file.write_text(
        f"ply\nformat ascii 1.0\nelement vertex 3\n{properties}{faces}end_header\n{vertices}3 0 1 2\n", "ascii"
    )
    description = scene(a=lamp("ply", 1, filename=str(file)), b=lamp("rectangle", 2), p=POINT)
    mine, reference = djpt.load_dict(description), mi.load_dict(djpt.validation.to_mitsuba(description))
    assert numbered(mine, djpt.traverse) == numbered(reference, mi.traverse) == ["1", "Point", "2"]


# ---- pictures ------------------------------------------------------------------------------------

PAINTS: tuple[dict[str, Any], ...] = (
    {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.5, 0.3]}},
    {"type": "plastic", "int_ior": 1.9},
    {"type": "roughplastic", "alpha": 0.1},
    {"type": "dielectric", "int_ior": "diamond"},
    {"type": "roughdielectric", "alpha": 0.1},
    {"type": "conductor", "material": "Au"},
    {"type": "roughconductor", "alpha": 0.1, "distribution": "ggx"},
    {"type": "principled", "roughness": 0.4, "metallic": 0.5},
)


def stage() -> dict[str, Any]:
    """Balls of many materials under a mesh, the sky and a point, in this order."""
    balls = {
        f"ball{i}": {"type": "sphere", "center": [2.2 * (i % 4) - 3.3, 1.2 - 2.4 * (i // 4), 1], "bsdf": paint}
        for i, paint in enumerate(PAINTS)
    }
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": [0.2, 0.25, 0.3]}}
    floor = {"type": "rectangle", "to_world": T().scale(8)}
    return scene(lamp=mesh(6), sky=sky, point=POINT, floor=floor, **balls)


def test_pictures_of_one_seed_are_mitsubas_with_its_defaults(mi: Any) -> None:
    """The shares of equal pixels are 0.99 and more where the orders agree, and less than 0.6 where they don't."""
    description = stage()
    shares = {}
    for optimize in (True, False):
        expected = djpt.validation.mitsuba_renderer(description, optimize=optimize)(8, 3)
        for ours in (True, False):
            image = np.array(djpt.render(djpt.load_dict(description, optimize=ours), spp=8, seed=3))
            shares[ours, optimize] = djpt.validation.agreement(image, expected, 1e-3).share
    assert shares[True, True] > 0.99 and shares[False, False] > 0.99, shares
    assert shares[True, False] < 0.6 and shares[False, True] < 0.6, shares


def test_comparisons_at_equal_seeds_number_lights_alike() -> None:
    pytest.importorskip("mitsuba")
    description = scene(
        a=lamp("rectangle", 1), b=lamp("sphere", 2), c=mesh(3), d=lamp("cube", 4), p=POINT, floor={"type": "rectangle"}
    )
    result = djpt.validation.compare(description, spp=16, same_seed=0.99)
    assert result.same_seed is not None and result.same_seed.share > 0.99

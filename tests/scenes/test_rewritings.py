"""One scene in other words is one scene: the same bits while emitters keep their numbers, the same light otherwise."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.scenes import SCENES
from djpt.validation.statistics import Batches, mean_test

pytestmark = pytest.mark.narrow

Description = dict[str, Any]
NOT_NODES = ("type", "id")
SIZE = 16


def room() -> Description:
    """Lamps of three kinds among diffuse and glossy things, under a sky; what shines is met by chance as well."""
    coloured = {"type": "rgb", "value": [4.0, 2.0, 1.0]}
    checks = {"type": "checkerboard", "color0": 6.0, "color1": 1.0}
    down = T().rotate([1, 0, 0], 180)
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 5},
        "sensor": {
            "type": "perspective",
            "fov": 50,
            "to_world": T().look_at(origin=[0, -6, 3], target=[0, 0, 1], up=[0, 0, 1]),
            "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}},
        },
        "clay": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.5, 0.4]}},
        "floor": {"type": "rectangle", "to_world": T().scale(5), "bsdf": {"type": "ref", "id": "clay"}},
        "panel": {
            "type": "rectangle",
            "to_world": T().translate([-1, 1, 3]) @ down,
            "emitter": {"type": "area", "radiance": checks},
        },
        "ball": {"type": "sphere", "center": [0.8, -0.5, 0.7], "radius": 0.7, "bsdf": {"type": "ref", "id": "clay"}},
        "bulb": {
            "type": "sphere",
            "center": [1.5, 0.8, 2.5],
            "radius": 0.5,
            "emitter": {"type": "area", "radiance": coloured},
        },
        "block": {
            "type": "cube",
            "to_world": T().translate([-1, 0, 0.61]).rotate([0, 0, 1], 20).scale(0.6),
            "bsdf": {"type": "roughconductor", "alpha": 0.4},
        },
        "sky": {"type": "constant", "radiance": 0.2},
    }


# ---------------------------------------------------------------- rewritings


def drawn_out(scene: Description, kind: str, first: bool) -> Description:
    """With what is nested in shapes as `kind` standing in the scene, before all else or after it."""
    apart, rest = {}, {}
    for key, node in scene.items():
        if isinstance(node, dict) and node.get(kind, {}).get("type", "ref") != "ref":
            name = f"{kind} of {key}"
            apart[name] = node[kind]
            node = {**node, kind: {"type": "ref", "id": name}}
        rest[key] = node
    top = {"type": rest.pop("type")}
    return {**top, **apart, **rest} if first else {**top, **rest, **apart}


def renamed(scene: Description) -> Description:
    """With keys that say nothing, and the names as ids."""
    result: Description = {}
    for number, (key, node) in enumerate(scene.items()):
        if isinstance(node, dict) and node["type"] != "ref":
            result[f"node {number}"] = {"id": key, **node}
        else:
            result[key] = node
    return result


def dark_last(scene: Description) -> Description:
    """With materials, and shapes that don't shine, after all else."""
    dark = [key for key, node in scene.items() if isinstance(node, dict) and not shines(node)]
    return {**{key: node for key, node in scene.items() if key not in dark}, **{key: scene[key] for key in dark}}


def shines(node: Description) -> bool:
    return "emitter" in node or node["type"] in ("constant", "area", "ref")


def prebuilt(scene: Description) -> Description:
    """With plugins in place of dicts that refer to nothing and that nothing refers to by an id."""
    return {key: node if refers(node) or "id" in node else djpt.load_dict(node) for key, node in scene.items()}


def refers(node: Any) -> bool:
    return not isinstance(node, dict) or node["type"] == "ref" or any(map(refers_below, node.values()))


def refers_below(node: Any) -> bool:
    return isinstance(node, dict) and refers(node)


def in_a_file(scene: Description, split: bool) -> Any:
    """Written to a file of Mitsuba's format, or to several that include each other, and read again."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.xml"
        djpt.xml.dict_to_xml(scene, path, split_files=split)
        return djpt.load_file(path, optimize=False)


Rewriting = Callable[[Description], Description]
REWRITINGS: dict[str, Rewriting] = {
    "lights by reference, first": lambda scene: drawn_out(scene, "emitter", first=True),
    "lights by reference, last": lambda scene: drawn_out(scene, "emitter", first=False),
    "materials by reference, first": lambda scene: drawn_out(scene, "bsdf", first=True),
    "materials by reference, last": lambda scene: drawn_out(scene, "bsdf", first=False),
    "ids in place of keys": renamed,
    "what is dark last": dark_last,
}
LOADERS: dict[str, Callable[[Description], Any]] = {
    "dict": lambda scene: djpt.load_dict(scene, optimize=False),
    "plugins": lambda scene: djpt.load_dict(prebuilt(scene), optimize=False),
    "file": lambda scene: in_a_file(scene, split=False),
    "files": lambda scene: in_a_file(scene, split=True),
}


def pixels(scene: Any, **options: Any) -> np.ndarray:
    return np.array(djpt.render(scene, **{"spp": 4, "seed": 1, **options}))


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    return pixels(djpt.load_dict(room(), optimize=False))


@pytest.mark.sparse(3)
@pytest.mark.parametrize("loader", LOADERS)
@pytest.mark.parametrize("name", REWRITINGS)
def test_each_rewriting_gives_the_same_bits(name: str, loader: str, image: np.ndarray) -> None:
    np.testing.assert_array_equal(pixels(LOADERS[loader](REWRITINGS[name](room()))), image)


@settings(max_examples=25, deadline=None, derandomize=True)
@example(names=["lights by reference, last", "what is dark last"], loader="files")
@given(names=st.lists(st.sampled_from(sorted(REWRITINGS)), min_size=2, max_size=4), loader=st.sampled_from([*LOADERS]))
@pytest.mark.slow
def test_rewritings_of_rewritings_do(names: list[str], loader: str) -> None:
    scene = room()
    for name in names:
        scene = REWRITINGS[name](scene)
    np.testing.assert_array_equal(pixels(LOADERS[loader](scene)), pixels(djpt.load_dict(room(), optimize=False)))


# ---------------------------------------------------------------- the same light


def backwards(scene: Description) -> Description:
    """In the opposite order, which numbers the emitters anew."""
    return {"type": "scene", **dict(reversed([(key, node) for key, node in scene.items() if key != "type"]))}


DEPTH = 4
SAMPLES = 64
EFFORT = 8
"""Samples of integrators that meet lights by chance, for one of those that sample them."""
INTEGRATORS: dict[str, int] = {"path": SAMPLES, "path_nee": SAMPLES, "ptracer": SAMPLES, "prb_basic": EFFORT * SAMPLES}
SUBJECTS: dict[str, Callable[[], Description]] = {
    # Paths hardly meet the lights of scenes for bdpt and sppm.
    **{
        n: s
        for n, s in SCENES.items()
        if n != "cornell_box_boxfilter" and s()["integrator"]["type"] not in ("bdpt", "sppm")
    },
    "room": room,
    "room, lights by reference": lambda: drawn_out(room(), "emitter", first=True),
    "room, backwards": lambda: backwards(drawn_out(room(), "emitter", first=True)),
}
BATCHES = 8


def averages(scene: Any, integrator: Description, spp: int, first_seed: int) -> Batches:
    plugin, found = djpt.load_dict(integrator), Batches(SIZE)
    for seed in range(BATCHES):
        found.add(pixels(scene, integrator=plugin, spp=spp, seed=first_seed + seed))
    return found


def small(name: str) -> Any:
    scene = SUBJECTS[name]()
    scene["sensor"]["film"].update(width=SIZE, height=SIZE, rfilter={"type": "box"})
    return djpt.load_dict(scene)


@pytest.mark.sparse(8)
@pytest.mark.parametrize("name", SUBJECTS)
def test_light_that_is_sampled_is_light_that_is_met(name: str) -> None:
    """A light that counts twice where lights are sampled would not count twice where a path meets it."""
    scene = small(name)
    reference = averages(scene, {"type": "path_naive", "max_depth": DEPTH}, EFFORT * SAMPLES, 100)
    for key, spp in INTEGRATORS.items():
        found = averages(scene, {"type": key, "max_depth": DEPTH}, spp, 500)
        result = mean_test(found, reference, 1e-4, equal_variance=False)
        assert result.passed, f"{key}: {result}"


@pytest.mark.sparse(12)
@pytest.mark.parametrize("name", SUBJECTS)
def test_direct_light_is_that_of_short_paths(name: str) -> None:
    scene = small(name)
    reference = averages(scene, {"type": "path_naive", "max_depth": 2}, EFFORT * SAMPLES, 100)
    result = mean_test(averages(scene, {"type": "direct"}, SAMPLES, 500), reference, 1e-4, equal_variance=False)
    assert result.passed, result

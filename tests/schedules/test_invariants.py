"""What must not change an image, and what must not compile a kernel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.rendering.schedules import passes
from djpt.validation import agreement
from tests.kit.axes import unit
from tests.kit.kernels import Watched
from tests.kit.renders import box, lights, ours, pixels, spheres
from tests.kit.threads import threads

pytestmark = pytest.mark.narrow

PATH = {"type": "path", "max_depth": 5, "rr_depth": 3}


# ---------------------------------------------------------------- identical bits

SPP = 20
KINDS = [(schedule, rfilter) for schedule in ("flat", "wave") for rfilter in ("box", "gaussian")]


class Renderer:
    """One loaded scene per kind of kernel, and its image in one piece."""

    def __init__(self) -> None:
        self._made: dict[Any, tuple[Any, np.ndarray]] = {}

    def __call__(self, schedule: str, rfilter: str) -> tuple[Any, np.ndarray]:
        key = schedule, rfilter
        if key not in self._made:
            scene = djpt.load_dict(box((23, 17), rfilter, PATH))
            self._made[key] = scene, pixels(djpt.render(scene, spp=SPP, seed=1, schedule=schedule))
        return self._made[key]


whole = Renderer()


@settings(max_examples=12, deadline=None)
@given(pass_spp=st.integers(1, SPP + 3), count=st.sampled_from([1, 2]))
@pytest.mark.parametrize(("schedule", "rfilter"), KINDS)
@pytest.mark.sparse(4)
def test_passes_and_threads(schedule: str, rfilter: str, pass_spp: int, count: int) -> None:
    scene, image = whole(schedule, rfilter)
    with threads(count):
        split = pixels(djpt.render(scene, spp=SPP, seed=1, schedule=schedule, pass_spp=pass_spp))
    np.testing.assert_array_equal(split, image)


@pytest.mark.parametrize(("schedule", "rfilter"), KINDS)
def test_again_from_the_start(schedule: str, rfilter: str) -> None:
    image = ours(box((23, 17), rfilter, PATH), SPP, 1, schedule=schedule)
    np.testing.assert_array_equal(image, whole(schedule, rfilter)[1])


def test_large_images_in_bands() -> None:
    """Above 2^16 pixels stored samples come in bands of rows."""
    scene = djpt.load_dict(box((300, 500), "gaussian", {"type": "depth"}))
    image = pixels(djpt.render(scene, spp=5))
    for count, pass_spp in ((1, 2), (2, 1)):
        with threads(count):
            np.testing.assert_array_equal(pixels(djpt.render(scene, spp=5, pass_spp=pass_spp)), image)


@pytest.mark.sparse(6)
@pytest.mark.parametrize("rows", [1, 5])
@pytest.mark.parametrize(("schedule", "rfilter"), [*KINDS, ("flat", "lanczos")])
def test_bands_do_not_matter(schedule: str, rfilter: str, rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also with bands that are lower than the reach of the filter, and with a border."""
    film = {"crop_width": 17, "crop_height": 19, "crop_offset_x": 3, "crop_offset_y": 1, "sample_border": True}
    scene = djpt.load_dict(box((23, 21), rfilter, PATH, **film))
    image = pixels(djpt.render(scene, spp=6, seed=1, schedule=schedule))
    width = 17 + 2 * scene.sensors()[0].film().border
    for name in ("SUMMED_PIXELS", "FILTERED_PIXELS"):
        monkeypatch.setattr(passes, name, rows * width)
    monkeypatch.setattr(passes, "STORED_PIXELS", (rows * width, rows * width))
    np.testing.assert_array_equal(pixels(djpt.render(scene, spp=6, seed=1, schedule=schedule)), image)


@pytest.mark.parametrize("spp", [128, 200])
def test_several_lanes_per_pixel(spp: int) -> None:
    """Small images with many samples share a pixel's samples among lanes."""
    scene = djpt.load_dict(box(8, "box", PATH))
    image = pixels(djpt.render(scene, spp=spp))
    for pass_spp in (7, 64):
        np.testing.assert_array_equal(pixels(djpt.render(scene, spp=spp, pass_spp=pass_spp)), image)


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_gradients_repeat(rfilter: str) -> None:
    scene = djpt.load_dict(box(16, rfilter, {"type": "prb", "max_depth": 4}))
    params = djpt.traverse(scene)

    def gradient() -> np.ndarray:
        dr.enable_grad(params["red.reflectance.value"])
        params.update()
        dr.backward(dr.mean(djpt.render(scene, params, spp=8).array))
        result = np.array(dr.grad(params["red.reflectance.value"]))
        dr.disable_grad(params["red.reflectance.value"])
        params.set_dirty("red.reflectance.value")
        params.update()
        return result

    first = gradient()
    assert np.abs(first).min() > 0
    for count in (1, 2):
        with threads(count):
            np.testing.assert_array_equal(gradient(), first)


def test_progress_reports_every_pass() -> None:
    seen: list[tuple[int, int]] = []
    djpt.render(djpt.load_dict(box(16, "gaussian", PATH)), spp=10, pass_spp=4, progress=lambda *n: seen.append(n))
    assert [done for done, _ in seen] == [4 * 256, 8 * 256, 10 * 256]
    assert {total for _, total in seen} == {10 * 256}


# ---------------------------------------------------------------- schedules


@pytest.mark.parametrize("edit", [None, spheres, lights()], ids=["box", "spheres", "lights"])
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.sparse(4)
def test_flat_against_wave(rfilter: str, edit: Any) -> None:
    scene = djpt.load_dict(box(128, rfilter, PATH, edit))
    shares = []
    for seed in range(2):
        flat, wave = (pixels(djpt.render(scene, spp=8, seed=seed, schedule=s)) for s in ("flat", "wave"))
        shares.append(agreement(flat, wave, 1e-5).share)
    assert np.mean(shares) >= 0.999


def test_seeds_differ() -> None:
    scene = djpt.load_dict(box(16, "box", PATH))
    a, b = (pixels(djpt.render(scene, spp=4, seed=seed)) for seed in (0, 1))
    assert np.mean(a != b) > 0.5


# ---------------------------------------------------------------- no kernel for an edit


VALUES: dict[str, list[Any]] = {
    "red.reflectance.value": [[0.1, 0.2, 0.3], [0.0, 0.0, 0.0], [1.0, 1.0, 1.0], 0.5],
    "light.emitter.radiance.value": [[1.0, 2.0, 3.0], 0.0, 7.0],
    "sensor.to_world": [T().look_at([0.1, 0.2, 3.5], [0, 0, 0], [0, 1, 0]), T().translate([0, 0, 3])],
    "sensor.x_fov": [50.0, 20.0],
    "sensor.principal_point_offset_x": [0.1],
    "sensor.near_clip": [0.1],
    "sensor.film.size": [[20, 30], [32, 32], [100, 7]],
}
GRADIENTS = ("red.reflectance.value", "white.reflectance.value", "light.emitter.radiance.value")
WATCHED: dict[str, Callable[[], Watched]] = {
    "flat, box": lambda: Watched(box(16, "box", PATH)),
    "flat, gaussian": lambda: Watched(box(16, "gaussian", PATH)),
    "wave": lambda: Watched(box(16, "gaussian", PATH), schedule="wave"),
    "direct": lambda: Watched(box(16, "box", {"type": "direct"})),
    "prb, box": lambda: Watched(box(16, "box", {**PATH, "type": "prb"}), GRADIENTS),
    "prb, gaussian": lambda: Watched(box(16, "gaussian", {**PATH, "type": "prb"}), GRADIENTS),
}


@pytest.mark.parametrize("name", WATCHED)
@pytest.mark.sparse(8)
def test_edits_compile_nothing(name: str) -> None:
    watched = WATCHED[name]()
    if name.startswith("prb"):
        # Derivatives by a factor that may vanish have a kernel of their own, compiled once.
        assert watched.edit(**{"red.reflectance.value": [0.0, 0.3, 1.0]}) == 1
    found = {}
    for key, values in VALUES.items():
        for value in values:
            found[key, str(value)] = watched.edit(**{key: value})
    for option in ({"seed": 5}, {"spp": 7}, {"seed_grad": 9}, {"spp_grad": 3}):
        found[str(option)] = watched.new(**option)
    assert {key: count for key, count in found.items() if count} == {}


@pytest.mark.sparse(4)
@pytest.mark.parametrize("option", [{"spp": 1}, {"spp": 64}, {"pass_spp": 2}], ids=str)
@pytest.mark.parametrize("name", WATCHED)
def test_sample_counts_compile_nothing(name: str, option: dict[str, int]) -> None:
    """One sample, several lanes per pixel, several passes."""
    assert WATCHED[name]().new(**option) == 0


MOVES = {
    "box moved": ("large-box", T().translate([0.1, 0.05, 0.1])),
    "box turned": ("large-box", T().rotate([0, 1, 0], 20)),
    "box raised": ("small-box", T().scale([1.0, 1.2, 1.0])),
    "box mirrored back": ("small-box", T().rotate([0, 1, 0], 180)),
    "wall moved": ("back", T().translate([0, 0, -0.3])),
    "floor moved": ("floor", T().translate([0, -0.2, 0])),
    "lamp moved": ("light", T().translate([0.1, -0.05, 0.2])),
}


def transform(watched: Watched, shape: str, motion: T) -> int:
    """Apply `motion` on the left of a shape's transform."""
    key = f"{shape}.to_world"
    if key in watched.params:
        return watched.edit(**{key: motion @ watched.params[key]})
    key = f"{shape}.vertex_positions"
    corners = np.array(watched.params[key]).reshape(-1, 3) @ motion.matrix[:3, :3].T + motion.matrix[:3, 3]
    return watched.edit(**{key: djpt.Float(corners.astype(np.float32).ravel())})


@pytest.mark.parametrize("gradients", [(), GRADIENTS], ids=["image", "gradient"])
@pytest.mark.parametrize("name", MOVES)
@pytest.mark.sparse(3)
def test_moves_compile_nothing(name: str, gradients: tuple[str, ...]) -> None:
    watched = Watched(box(16, "box", {**PATH, "type": "prb"}), gradients)
    assert transform(watched, *MOVES[name]) == 0
    shape, motion = MOVES[name]
    assert transform(watched, shape, motion.inverse()) == 0


@pytest.mark.sparse(4)
@pytest.mark.parametrize("name", MOVES)
def test_moved_in_place_or_from_the_start(name: str) -> None:
    """An edited scene shows what a scene described so would show."""
    shape, motion = MOVES[name]
    description = box(48, "box", PATH)
    watched = Watched(description)
    transform(watched, shape, motion)
    edited = pixels(djpt.render(watched.scene, spp=4, seed=2))
    description[shape]["to_world"] = motion @ description[shape]["to_world"]
    assert agreement(edited, ours(description, 4, 2), 1e-3).share > 0.995


ENDS_ALIGNMENT = {
    "box tumbled": ("small-box", T().rotate(unit(1, 2, 3), 40), T().rotate(unit(3, 1, 2), 10)),
    "box sheared": ("small-box", T().scale([0.7, 1.2, 0.9]), T().scale([0.9, 1.2, 0.7])),
    "wall turned": ("back", T().rotate([0, 1, 0], 3), T().rotate([0, 1, 0], 2)),
    "upright box tilted": ("large-box", T().rotate([0, 0, 1], 5), T().rotate([1, 0, 0], 7)),
}


@pytest.mark.parametrize("name", ENDS_ALIGNMENT)
@pytest.mark.sparse(2)
def test_ending_an_alignment_compiles_once(name: str) -> None:
    """A face that leaves a shared axis gets one of its own; then it may turn and return freely."""
    shape, first, then = ENDS_ALIGNMENT[name]
    watched = Watched(box(16, "box", PATH))
    assert transform(watched, shape, first) <= 1
    assert transform(watched, shape, then) == 0
    assert transform(watched, shape, then.inverse()) == 0
    assert transform(watched, shape, first.inverse()) == 0
    assert transform(watched, shape, first) == 0


def test_turning_every_way_compiles_little() -> None:
    """A wall that is turned either way pokes through its neighbours, which may then cast shadows: known after that."""
    watched = Watched(box(16, "box", PATH))
    turns = [transform(watched, "back", T().rotate([0, 1, 0], angle)) for angle in (3, -6, 9, -4, -4, 2)]
    assert turns[0] <= 1
    assert turns[1] <= 1
    assert not any(turns[2:])


def test_lights_and_spheres_move_freely() -> None:
    def edit(scene: dict[str, Any]) -> None:
        spheres(scene)
        lights("point")(scene)

    watched = Watched(box(16, "box", PATH, edit))
    assert watched.edit(**{"point.position": [0.1, 0.2, 0.3]}) == 0
    assert watched.edit(**{"point.intensity.value": [0.1, 0.2, 0.3]}) == 0
    ball = watched.params["small-sphere.to_world"]
    assert watched.edit(**{"small-sphere.to_world": T().translate([0.1, 0.2, 0]) @ ball}) == 0
    assert watched.edit(**{"small-sphere.to_world": T().rotate([1, 0, 0], 30).scale(0.2)}) == 0

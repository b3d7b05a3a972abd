"""`sppm` and `vcm`: the means of `path`, closed forms, and what they refuse."""

from __future__ import annotations

import itertools
import math
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core import memory
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import RenderError, SceneError
from djpt.integrators.photons import photon
from tests.integrators.test_bdpt import MATERIALS
from tests.kit.emitters import NAMES, entry, plugin_of
from tests.kit.lit_floor import floor_scene
from tests.kit.renders import box
from tests.kit.threads import assert_same_for_any_threads

KINDS = ("sppm", "vcm")

MERGING: dict[str, dict[str, Any]] = {"sppm": {}, "vcm": {"merging": "everywhere"}}
"""Settings with which photons are gathered at all vertices."""


def image(scene: Any, kind: str, spp: int, seed: int = 0, **keys: Any) -> np.ndarray:
    loaded = djpt.load_dict(scene) if isinstance(scene, dict) else scene
    return np.array(djpt.render(loaded, integrator=djpt.load_dict({"type": kind, **keys}), spp=spp, seed=seed))


def assert_close_to_path(
    scene: dict[str, Any], kind: str, depth: int = 4, tolerance: float = 0.02, **keys: Any
) -> None:
    """Assert that the means of images and of their quarters agree up to noise and a small radius' blur."""
    loaded = djpt.load_dict(scene)
    settings = {"initial_radius": 0.05, "photon_count": 20_000, **keys} if kind != "bdpt" else keys
    ours = np.stack([image(loaded, kind, 64, seed, max_depth=depth, **settings) for seed in range(4)])
    shared = {key: value for key, value in keys.items() if key in ("hide_emitters", "emitter_choice")}
    theirs = np.stack([image(loaded, "path", 512, 50 + seed, max_depth=depth, **shared) for seed in range(4)])
    half = ours.shape[1] // 2
    for rows, columns in itertools.product((slice(half), slice(half, None)), repeat=2):
        a, b = (batch[:, rows, columns].mean(axis=(1, 2)) for batch in (ours, theirs))
        error = 4 * np.sqrt(a.var(axis=0, ddof=1) / 4 + b.var(axis=0, ddof=1) / 4)
        assert (np.abs(a.mean(axis=0) - b.mean(axis=0)) <= error + tolerance * b.mean(axis=0) + 1e-6).all()


LIT = {plugin_of(name): name for name in reversed(NAMES) if plugin_of(name) != "directionalarea"}
"""One name for each kind of light."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_floor_under_waves(kind: str) -> None:
    """The pool with a lamp so large that `path` finds it, too."""
    scene = djpt.scenes.pool()
    scene["sensor"]["film"].update(width=16, height=16, rfilter={"type": "box"})
    scene["lamp"]["to_world"] = scene["lamp"]["to_world"].scale(10)
    scene["lamp"]["emitter"]["radiance"] = 20.0
    assert_close_to_path(scene, kind, depth=8, initial_radius=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("plugin", LIT)
@pytest.mark.parametrize("kind", KINDS)
def test_lights(kind: str, plugin: str) -> None:
    assert_close_to_path(floor_scene({"light": entry(LIT[plugin])}, size=16), kind, **MERGING[kind])


@pytest.mark.parametrize("kind", ["sppm", pytest.param("vcm", marks=pytest.mark.slow)])
def test_beams_are_shown(kind: str) -> None:
    """Light that leaves a surface in one direction only arrives by photons of a single edge, too."""
    scene = djpt.load_dict(floor_scene({"light": entry("directionalarea-rectangle")}, size=16))
    keys = {"initial_radius": 0.05, "photon_count": 100_000}
    ours = image(scene, kind, 1024, max_depth=3, **keys).mean()
    assert ours == pytest.approx(image(scene, "ptracer", 1024, max_depth=3).mean(), rel=0.02)


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        pytest.param(kind, name, marks=() if (kind, name) == ("sppm", "coats") else pytest.mark.slow)
        for kind, name in itertools.product(KINDS, MATERIALS)
    ],
)
def test_materials(kind: str, name: str) -> None:
    """Mirrors on top of what scatters, refraction, normals that differ from the surface, openings, absorption."""
    scene = floor_scene(size=16)
    scene["ball"]["bsdf"], scene["small"]["bsdf"] = MATERIALS[name]
    assert_close_to_path(scene, kind, 5, tolerance=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_long_paths_and_roulette(kind: str) -> None:
    scene = djpt.scenes.furnace(0.8)
    scene["sensor"]["film"].update(width=16, height=16)
    for depth, expected in ((6, (1 - 0.8**6) / 0.2), (-1, 5.0)):
        found = image(scene, kind, 256, max_depth=depth, rr_depth=3, initial_radius=0.02)
        assert found.mean() == pytest.approx(expected, rel=0.03)


def test_short_paths_need_no_photons() -> None:
    """With two edges, `sppm` is `path`, number by number."""
    scene = djpt.load_dict(box(16))
    for depth in (0, 1, 2):
        found, expected = (image(scene, kind, 16, max_depth=depth) for kind in ("sppm", "path"))
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)


def test_without_photons_vcm_is_bdpt() -> None:
    """In a ball that holds none, connections have all the weight."""
    scene = djpt.load_dict(box(16))
    found = image(scene, "vcm", 16, max_depth=5, initial_radius=1e-6, photon_count=10)
    np.testing.assert_allclose(found, image(scene, "bdpt", 16, max_depth=5), rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize(
    ("heuristic", "radius"),
    [("balance", 0.01), *(pytest.param(h, r, marks=pytest.mark.slow) for h, r in (("balance", 0.06), ("power", 0.03)))],
)
def test_weights_add_up(heuristic: str, radius: float) -> None:
    """Whether mergings count little or nearly everything."""
    assert_close_to_path(box(16), "vcm", 5, heuristic=heuristic, initial_radius=radius, merging="everywhere")


def test_weights_add_up_behind_gloss() -> None:
    """The same random numbers with hardly any mergings and with many: only the weights differ, and the noise."""
    scene = box(16)
    for name in ("floor", "back", "large-box", "small-box"):
        scene[name]["bsdf"] = {"type": "roughconductor", "material": "none", "alpha": 0.35}
    loaded, keys = djpt.load_dict(scene), {"max_depth": 5, "alpha": 1.0, "photon_count": 20_000, "heuristic": "balance"}
    few, many = (
        np.mean([image(loaded, "vcm", 64, seed, initial_radius=radius, **keys).mean() for seed in range(4)])
        for radius in (1e-5, 0.06)
    )
    assert many == pytest.approx(few, rel=0.006)


def test_coverage_and_hidden_lamps_are_those_of_path() -> None:
    scene = floor_scene(size=16)
    scene["sensor"]["film"]["pixel_format"] = "rgba"
    loaded = djpt.load_dict(scene)
    expected = image(loaded, "path", 16, max_depth=3, hide_emitters=True)[..., 3]
    for kind in KINDS:
        found = image(loaded, kind, 16, max_depth=3, hide_emitters=True, photon_count=1000)[..., 3]
        np.testing.assert_allclose(found, expected, atol=1e-6)


# ---------------------------------------------------------------- the radius


@pytest.mark.slow
def test_caustic_of_a_parabolic_mirror() -> None:
    """Extrapolated to the radius 0 from two radii, since the blur goes with the radius' square.

    No method without photons could find it, if the screen were seen in a mirror.
    """
    scene = djpt.load_dict(djpt.scenes.parabolic_mirror())
    keys = {"max_depth": 3, "alpha": 1.0, "photon_count": 50_000}
    wide, narrow = (image(scene, "sppm", 160, initial_radius=r, **keys).mean(axis=2) for r in (0.05, 0.025))
    found = (4.0 * narrow - wide) / 3
    place = 3 * (np.arange(64) + 0.5) / 64 - 1.5
    r = np.hypot(*np.meshgrid(place, place))
    expected = (np.where(r < 1, 0.9 / 0.25 / (1 + r**2) ** 2, 0) + 2.5 / (2.5**2 + r**2) ** 1.5) / np.pi
    rings = np.arange(0, 1.5, 0.15)
    for low, high in itertools.pairwise(rings):
        # At the rim of the beam the blur is no matter of squares.
        ring = (r >= low) & (r < high) & (np.abs(r - 1) > 0.1)
        if ring.any():
            assert found[ring].mean() == pytest.approx(expected[ring].mean(), rel=0.01)


def test_radii_shrink() -> None:
    own = djpt.load_dict({"type": "vcm", "alpha": 0.5})
    assert own.radius(0.5, 15) == pytest.approx(0.5 * 16**-0.25)
    constant = djpt.load_dict({"type": "sppm", "alpha": 1.0})
    assert constant.radius(0.5, 15) == 0.5


def mirrored_lamp(extent: float = 50.0, size: int = 16, wall: float = 1.0) -> dict[str, Any]:
    """A point light 1 above a large floor beside a mirror, of which the camera sees a square below the light."""
    return {
        "type": "scene",
        "floor": {"type": "rectangle", "to_world": T().scale(extent), "bsdf": {"type": "diffuse", "reflectance": 0.8}},
        "mirror": {
            "type": "rectangle",
            "to_world": T().translate([wall, 0, 0]).rotate([0, 1, 0], -90).scale(extent),
            "bsdf": {"type": "conductor", "material": "none"},
        },
        "light": {"type": "point", "position": [0, 0, 1], "intensity": 1.0},
        "sensor": {
            "type": "perspective",
            "fov": 30.0,
            "to_world": T().look_at(origin=[0, 0, 3], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
        },
    }


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.sparse(2)
def test_point_light_beside_a_mirror(kind: str) -> None:
    """The light and its mirror image: inverse squares and cosines."""
    half = 3 * math.tan(math.radians(15))
    place = (np.arange(256) + 0.5) / 128 * half - half
    x, y = np.meshgrid(place, place)
    expected = 0.8 / math.pi * sum(((x - at) ** 2 + y**2 + 1) ** -1.5 for at in (0.0, 2.0)).mean()
    found = image(mirrored_lamp(), kind, 1024, max_depth=6)
    assert found.mean() == pytest.approx(expected, rel=5e-3)


def first_radius_in(
    scene: dict[str, Any], kind: str, monkeypatch: pytest.MonkeyPatch, seed: int = 0, **keys: Any
) -> float:
    """The first radius that an image is made with."""
    found: list[float] = []
    plugin = djpt.load_dict({"type": kind, "max_depth": 4, **keys})
    monkeypatch.setattr(type(plugin), "radius", lambda self, first, number: found.append(first) or first)
    djpt.render(djpt.load_dict(scene), integrator=plugin, spp=1, seed=seed)
    return found[0]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.sparse(2)
def test_first_radius_follows_from_what_is_seen(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not from the size of the scene, and not from the seed."""
    near = first_radius_in(mirrored_lamp(50.0), kind, monkeypatch)
    assert near == first_radius_in(mirrored_lamp(50.0), kind, monkeypatch, seed=1)
    assert 0.005 < near < 0.04
    assert first_radius_in(mirrored_lamp(5000.0), kind, monkeypatch) == pytest.approx(near, rel=0.05)


def test_largest_radius_follows_from_the_width_of_what_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not from how far away it is: a distant camera with a long lens sees the same."""

    def radius(sensor: dict[str, Any]) -> float:
        scene = mirrored_lamp()
        scene["sensor"] = {**scene["sensor"], **sensor}
        return first_radius_in(scene, "sppm", monkeypatch, photon_count=1)

    def sample_wi(distance: float) -> Any:
        return T().look_at(origin=[0, 0, distance], target=[0, 0, 0], up=[0, 1, 0])

    near = radius({})
    assert near == pytest.approx(6 * math.tan(math.radians(15)) / 72, rel=0.1)
    lens = 2 * math.degrees(math.atan(math.tan(math.radians(15)) / 10))
    assert radius({"fov": lens, "to_world": sample_wi(30.0)}) == pytest.approx(near, rel=0.1)
    parallel = mirrored_lamp()["sensor"]
    del parallel["fov"]
    parallel["type"] = "orthographic"
    assert radius({}) == near
    first, second = (
        first_radius_in(
            {**mirrored_lamp(), "sensor": {**parallel, "to_world": sample_wi(distance).scale([0.5, 0.5, 1])}},
            "sppm",
            monkeypatch,
            photon_count=1,
        )
        for distance in (3.0, 30.0)
    )
    assert first == second == pytest.approx(1 / 72, rel=0.01)


@pytest.mark.parametrize(("kind", "passes"), [("sppm", 4), ("vcm", 1)])
@pytest.mark.sparse(2)
def test_light_paths_of_no_pass_are_wasted(kind: str, passes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A last pass of a few samples would trace as many light paths as the others: films are often powers of two."""
    numbers: set[int] = set()
    plugin = djpt.load_dict({"type": kind, "max_depth": 4})
    monkeypatch.setattr(type(plugin), "radius", lambda self, first, number: numbers.add(number) or first)
    djpt.render(djpt.load_dict(mirrored_lamp(size=16)), integrator=plugin, spp=1024)
    assert numbers == set(range(passes))


@pytest.mark.parametrize(("name", "passes"), [("lamp_behind_pane", 4), ("cornell_box", 1)])
def test_as_many_light_paths_as_camera_paths_that_merge(
    name: str, passes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All that look through the pane, so 256 samples of 16 x 16 pixels have 2^16; of the box a sixteenth."""
    numbers: set[int] = set()
    plugin = djpt.load_dict({"type": "vcm", "max_depth": 4})
    monkeypatch.setattr(type(plugin), "radius", lambda self, first, number: numbers.add(number) or first)
    scene = djpt.scenes.SCENES[name]()
    scene["sensor"]["film"].update(width=16, height=16)
    djpt.render(djpt.load_dict(scene), integrator=plugin, spp=1024)
    assert numbers == set(range(passes))


def test_edges_are_not_dark() -> None:
    """Half of the disk about a point near a wall holds no photons: with a wide one that is several per cent."""
    scene = djpt.load_dict(box(16))
    keys = {"max_depth": 4}
    ours, theirs = image(scene, "sppm", 256, initial_radius=0.06, alpha=1.0, **keys), image(scene, "path", 2048, **keys)
    assert ours[8:].mean() == pytest.approx(theirs[8:].mean(), rel=0.006)


# ---------------------------------------------------------------- contracts


@pytest.mark.parametrize("radius", [0.1, 0.0])  # 0: the default
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.sparse(4)
def test_image_is_the_same_for_any_threads_passes_and_memory(
    kind: str, radius: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = djpt.load_dict(box(8, "gaussian"))
    plugin = djpt.load_dict({"type": kind, "max_depth": 5, "photon_count": 500, "initial_radius": radius})

    def render(**arguments: Any) -> np.ndarray:
        return np.array(djpt.render(scene, integrator=plugin, spp=6, **{"seed": 4, **arguments}))

    first = assert_same_for_any_threads(render)
    np.testing.assert_array_equal(render(pass_spp=3), first)
    done = []
    np.testing.assert_array_equal(render(progress=lambda k, n: done.append((k, n))), first)
    assert done[-1][0] == done[-1][1]
    assert (render(seed=5) != first).any()
    monkeypatch.setattr(photon, "PER_PATH", 1)
    np.testing.assert_array_equal(render(), first)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_refused(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = djpt.load_dict(box(8))
    for keys, problem in (
        ({"photon_count": 0}, "photon_count"),
        ({"alpha": 0.0}, "alpha"),
        ({"alpha": 1.5}, "alpha"),
        ({"initial_radius": -1.0}, "initial_radius"),
        ({"emitter_choice": "tree"}, "emitter_choice"),
        ({"bounces": True, "max_depth": 3} if kind == "sppm" else {"strategies": True, "max_depth": 3}, "photons"),
    ):
        with pytest.raises(SceneError, match=problem):
            djpt.load_dict({"type": kind, **keys})
    with pytest.raises(RuntimeError) as found:
        dr.freeze(lambda: djpt.render(scene, integrator=djpt.load_dict({"type": kind}), spp=1))()
    assert "dr.freeze can't record photon maps" in str(found.value.__cause__)
    monkeypatch.setattr(memory, "free_memory", lambda: 2**30)
    with pytest.raises(RenderError, match=r"photons of 40000000 light paths takes about .*lower 'photon_count'"):
        image(scene, kind, 1, photon_count=40_000_000)


def test_images_that_fill_no_pass_have_fewer_light_paths() -> None:
    """Down to a least number, unless their number is given; `sppm` has nothing else that it could show."""
    found = {kind: djpt.load_dict({"type": kind}) for kind in ("sppm", "vcm", "upbp")}
    for fraction, paths in ((1 / 64, 2**14), (0.5, 2**15), (1.0, 2**16), (3.0, 2**16)):
        assert found["vcm"].paths_of_pass(fraction) == found["upbp"].paths_of_pass(fraction) == paths
    assert found["sppm"].paths_of_pass(0.5) == 2**18
    assert djpt.load_dict({"type": "vcm", "photon_count": 500}).paths_of_pass(0.5) == 500

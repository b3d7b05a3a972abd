"""Equal seeds, equal pixels: djpt against Mitsuba, sample for sample.

Rounding flips a decision here and there (an edge, a roulette), so a small share of pixels may
differ. Smaller images than those of the main table allow a single flipped path.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from djpt.core.transforms import ScalarTransform4f as T
from djpt.validation import agreement
from tests.kit.renders import Edit, box, lights, ours, spheres, theirs, two_sided

pytest.importorskip("mitsuba")

PATH = {"type": "path", "max_depth": 4}
AOVS = "albedo:albedo,depth:depth,p:position,uv:uv,n:geo_normal,s:sh_normal,du:dp_du,dv:dp_dv,prim:prim_index"


def share(description: dict[str, Any], spp: int, tolerance: float, seeds: int = 1) -> float:
    """Share of pixels that agree, averaged over seeds."""
    pairs = [(ours(description, spp, seed), theirs(description, spp, seed)) for seed in range(seeds)]
    assert all(a.shape == b.shape for a, b in pairs)
    return float(np.mean([agreement(a, b, tolerance).share for a, b in pairs]))


@pytest.mark.parametrize("rr_depth", [5, 1000])
@pytest.mark.parametrize("spp", [4, 16])
@pytest.mark.sparse(4)
def test_box_filter(spp: int, rr_depth: int) -> None:
    path = {"type": "path", "max_depth": 8, "rr_depth": rr_depth}
    assert share(box(128, "box", path), spp, 1e-3, seeds=2) >= 0.999


@pytest.mark.sparse(9)
@pytest.mark.parametrize("rr_depth", [5, 1000])
@pytest.mark.parametrize("spp", [4, 16])
@pytest.mark.parametrize("rfilter", ["gaussian", "tent"])
def test_wide_filters(rfilter: str, spp: int, rr_depth: int) -> None:
    """One flipped hit spreads over 5 x 5 pixels: hence several seeds."""
    path = {"type": "path", "max_depth": 8, "rr_depth": rr_depth}
    assert share(box(128, rfilter, path), spp, 1e-4, seeds=4) >= 0.999


# ---------------------------------------------------------------- everything else, on smaller images


def crop(scene: dict[str, Any]) -> None:
    scene["sensor"]["film"].update(crop_width=30, crop_height=20, crop_offset_x=10, crop_offset_y=30)


def overlapping(description: dict[str, Any], spp: int = 4, seed: int = 3) -> None:
    """At 64 x 64 a flipped path under the gaussian takes 25 pixels of 4096; allow a few."""
    image, reference = ours(description, spp, seed), theirs(description, spp, seed)
    assert image.shape == reference.shape
    assert agreement(image, reference, 1e-3).share >= 0.993
    assert image.mean() == pytest.approx(reference.mean(), rel=1e-3)


INTEGRATORS: dict[str, dict[str, Any]] = {
    "path, rr from the start": {"type": "path", "max_depth": 12, "rr_depth": 1},
    "path, unbounded": {"type": "path"},
    "path, 1": {"type": "path", "max_depth": 1},
    "path, 0": {"type": "path", "max_depth": 0},
    "path, hide_emitters": {**PATH, "hide_emitters": True},
    "prb": {"type": "prb", "max_depth": 6, "rr_depth": 2},
    "prb, defaults": {"type": "prb"},
    "direct": {"type": "direct"},
    "direct, 3 of each": {"type": "direct", "shading_samples": 3},
    "direct, 3 and 2": {"type": "direct", "emitter_samples": 3, "bsdf_samples": 2},
    "direct, lights only": {"type": "direct", "emitter_samples": 2, "bsdf_samples": 0},
    "direct, bsdf only": {"type": "direct", "emitter_samples": 0, "bsdf_samples": 3},
    "direct, hide_emitters": {"type": "direct", "hide_emitters": True},
    "depth": {"type": "depth"},
    "aov": {"type": "aov", "aovs": AOVS},
    "aov over path": {"type": "aov", "aovs": "d:depth", "image": PATH},
}


@pytest.mark.sparse(12)
@pytest.mark.parametrize("integrator", INTEGRATORS.values(), ids=INTEGRATORS)
def test_integrators(integrator: dict[str, Any]) -> None:
    overlapping(box(64, "box", integrator))


@pytest.mark.parametrize("name", ["aov", "direct, 3 and 2", "prb", "depth"])
@pytest.mark.sparse(2)
def test_integrators_on_curved_shapes(name: str) -> None:
    overlapping(box(64, "box", INTEGRATORS[name], spheres))


def test_nested_integrators_draw_the_same_numbers() -> None:
    overlapping(box(64, "box", {"type": "aov", "aovs": "n:sh_normal", "first": PATH, "second": {"type": "direct"}}))


def test_shape_index_tells_shapes_apart() -> None:
    """Mitsuba's numbers depend on the order in which threads finish loading: compare which pixels share one."""
    description = box(64, "box", {"type": "aov", "aovs": "s:shape_index"}, spheres)
    image, reference = (f(description, 1, 3).astype(int).ravel() for f in (ours, theirs))
    pairs = set(zip(image.tolist(), reference.tolist(), strict=True))
    assert (0, 0) in pairs
    assert len(pairs) == len({a for a, _ in pairs}) == len({b for _, b in pairs}) == 9


@pytest.mark.sparse(4)
@pytest.mark.parametrize("pixel_format", ["rgb", "rgba", "luminance"])
@pytest.mark.parametrize("integrator", [PATH, {**PATH, "hide_emitters": True}], ids=["path", "hidden"])
def test_pixel_formats(pixel_format: str, integrator: dict[str, Any]) -> None:
    overlapping(box(64, "gaussian", integrator, pixel_format=pixel_format))


@pytest.mark.sparse(9)
@pytest.mark.parametrize("sample_border", [False, True], ids=["", "border"])
@pytest.mark.parametrize("edit", [None, crop], ids=["whole", "crop"])
@pytest.mark.parametrize("rfilter", ["box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos"])
def test_films(rfilter: str, edit: Edit | None, sample_border: bool) -> None:
    description = box(64, rfilter, PATH, edit, sample_border=sample_border)
    image, reference = ours(description, seed=3), theirs(description, seed=3)
    assert image.shape == reference.shape
    # Filters with negative lobes can divide by sums of weights near 0.
    error = np.abs(image - reference).max(axis=2) / max(float(np.abs(reference).mean()), 1e-3)
    assert np.mean(error > 1e-2) < 0.02
    assert image.mean() == pytest.approx(reference.mean(), rel=1e-3)


@pytest.mark.parametrize(
    "rfilter",
    [{"type": "gaussian", "stddev": 0.7}, {"type": "gaussian", "stddev": 0.2}, {"type": "tent", "radius": 2.5},
     {"type": "mitchell", "B": 0.2, "C": 0.4}, {"type": "lanczos", "lobes": 2}],
    ids=str,
)  # fmt: skip
@pytest.mark.sparse(2)
def test_filter_parameters(rfilter: dict[str, Any]) -> None:
    image, reference = (f(box(32, rfilter, {"type": "depth"}), 4, 1) for f in (ours, theirs))
    assert agreement(image, reference, 1e-3).share >= 0.98


LIGHTS = [("point",), ("ball",), ("block",), ("sky",), ("point", "sky"), ("ball", "block"), ()]


LIT_BY = {
    "path": PATH,
    "prb": {"type": "prb", "max_depth": 4},
    "direct": {"type": "direct"},
    "hidden": {**PATH, "hide_emitters": True},
}
# Every choice of lights by `path`, the others with all of them: the choice and its numbers are the scene's.
LIT = [
    pytest.param(names, integrator, id=f"{'+'.join(names) or 'all'}-{kind}", marks=pytest.mark.slow if long else ())
    for names in LIGHTS
    for kind, integrator in LIT_BY.items()
    for long in (bool(names) and kind != "path",)
]


@pytest.mark.sparse(10)
@pytest.mark.parametrize(("names", "integrator"), LIT)
def test_lights(names: tuple[str, ...], integrator: dict[str, Any]) -> None:
    overlapping(box(64, "box", integrator, lights(*names)))


@pytest.mark.sparse(6)
@pytest.mark.parametrize("hide", [False, True], ids=["", "hidden"])
@pytest.mark.parametrize("name", ["path", "prb", "direct", "depth"])
def test_alpha_under_the_sky(name: str, hide: bool) -> None:
    """The sky counts as covered for `path` alone."""
    overlapping(box(64, "box", {"type": name, "hide_emitters": hide}, lights("sky"), pixel_format="rgba"))


@pytest.mark.parametrize("edit", [spheres, two_sided], ids=["spheres", "two-sided"])
def test_spheres_and_sides(edit: Edit) -> None:
    overlapping(box(64, "box", {"type": "path", "max_depth": 8}, edit))


def test_inside_a_shining_sphere() -> None:
    """All light from around, the lamp of the box gone; the camera inside."""

    def edit(scene: dict[str, Any]) -> None:
        del scene["light"]
        scene["dome"] = {"type": "sphere", "radius": 8.0, "flip_normals": True, "emitter": {"type": "area"}}

    overlapping(box(64, "box", PATH, edit))


def mirrored(*names: str, flip: bool) -> Edit:
    """Mirror some shapes, which turns their geometric normal but not the side that is shaded."""

    def edit(scene: dict[str, Any]) -> None:
        lights("block")(scene)
        for name in names:
            scene[name].update(to_world=scene[name]["to_world"] @ T().scale([-1, 1, 1]), flip_normals=flip)

    return edit


@pytest.mark.parametrize("flip", [False, True], ids=["", "flipped"])
@pytest.mark.parametrize("integrator", [PATH, {"type": "direct"}], ids=["path", "direct"])
@pytest.mark.sparse(2)
def test_mirrored_shapes(integrator: dict[str, Any], flip: bool) -> None:
    overlapping(box(64, "box", integrator, mirrored("small-box", "back", flip=flip)))


@pytest.mark.parametrize("integrator", [PATH, {"type": "direct"}], ids=["path", "direct"])
def test_mirrored_lamps(integrator: dict[str, Any]) -> None:
    overlapping(box(64, "box", integrator, mirrored("block", "light", flip=False)))


def many(scene: dict[str, Any]) -> None:
    """30 more spheres, 30 more materials, 20 of them lamps: too many for a chain of comparisons."""
    rng = np.random.default_rng(2)
    for i in range(30):
        color = {"type": "rgb", "value": rng.uniform(0.1, 0.9, 3).tolist()}
        ball = {"type": "sphere", "center": rng.uniform(-0.9, 0.9, 3).tolist(), "radius": 0.1}
        ball["bsdf"] = {"type": "diffuse", "reflectance": color}
        if i >= 10:
            ball["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": rng.uniform(0, 3, 3).tolist()}}
        scene[f"ball{i}"] = ball


@pytest.mark.parametrize(
    "integrator", [PATH, {"type": "direct"}, {"type": "aov", "aovs": AOVS}], ids=lambda i: i["type"]
)
@pytest.mark.sparse(4)
def test_many_shapes_materials_and_lights(integrator: dict[str, Any]) -> None:
    overlapping(box(64, "box", integrator, many))


def test_seed_of_the_sampler_is_added() -> None:
    description = box(16, "box", PATH)
    description["sensor"]["sampler"]["seed"] = 7
    overlapping(description, spp=16, seed=2)


def test_not_square_and_odd() -> None:
    overlapping(box((61, 37), "gaussian", PATH))


@pytest.mark.parametrize("schedule", ["flat", "wave"])
def test_schedules(schedule: str) -> None:
    description = box(64, "box", PATH)
    image = ours(description, 4, 5, schedule=schedule)
    assert agreement(image, theirs(description, 4, 5), 1e-3).share >= 0.998

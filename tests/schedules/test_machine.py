"""The machine schedule: the images and gradients of the other schedules, and of Mitsuba, sample for sample."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.records.flags import SurfaceDetail
from djpt.geometry.engines import ray_queries
from djpt.validation import agreement
from tests.kit.mesh_scenes import PATH, gallery, uv_texture
from tests.kit.renders import pixels, theirs
from tests.kit.threads import threads


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("meshes")


def images(scene: Any, spp: int, seed: int = 1, schedules: tuple[str, ...] = ("machine", "flat", "wave")) -> list[Any]:
    return [pixels(djpt.render(scene, spp=spp, seed=seed, schedule=s)) for s in schedules]


def close(image: np.ndarray, reference: np.ndarray, share: float = 0.995, tolerance: float = 1e-4) -> None:
    """Equal to rounding, but for the few pixels where rounding flips a decision."""
    assert image.shape == reference.shape
    assert np.isfinite(image).all()
    assert np.abs(reference).max() > 0
    found = agreement(image, reference, tolerance)
    assert found.share >= share, found
    assert abs(found.bias) < 5e-3, found


# ---------------------------------------------------------------- against the other schedules

KINDS: dict[str, dict[str, Any]] = {
    "box": {},
    "gaussian": {"rfilter": "gaussian"},
    "odd, gaussian": {"size": (37, 21), "rfilter": "gaussian"},
    "odd, box": {"size": (37, 21)},
    "crop": {"size": (50, 40), "crop_width": 21, "crop_height": 17, "crop_offset_x": 9, "crop_offset_y": 13},
    "crop, gaussian, border": {
        "size": (50, 40), "crop_width": 21, "crop_height": 17, "crop_offset_x": 9, "crop_offset_y": 13,
        "rfilter": "gaussian", "sample_border": True,
    },
    "rgba": {"pixel_format": "rgba", "lights": ("lamp", "point")},
    "hidden": {"integrator": {**PATH, "hide_emitters": True}, "pixel_format": "rgba"},
    "one bounce": {"integrator": {"type": "path", "max_depth": 2}},
    "lights only": {"integrator": {"type": "path", "max_depth": 1}},
    "prb": {"integrator": {"type": "prb"}},
    "lamp": {"lights": ("lamp",)},
    "point": {"lights": ("point",)},
    "sky": {"lights": ("sky",)},
}  # fmt: skip


SLOW = ("gaussian", "odd, box", "crop", "one bounce", "lamp", "point")


@pytest.mark.sparse(6)
@pytest.mark.parametrize("kind", [pytest.param(k, marks=pytest.mark.slow if k in SLOW else ()) for k in KINDS])
def test_schedules_agree(folder: Path, kind: str) -> None:
    scene = djpt.load_dict(gallery(folder, **KINDS[kind]))
    machine, flat, wave = images(scene, 8)
    # A flipped path spreads over 25 pixels under the gaussian.
    share = 0.97 if "gaussian" in kind else 0.995
    close(machine, flat, share)
    close(machine, wave, share)


@pytest.mark.sparse(12)
@pytest.mark.parametrize("size", [(1, 1), (3, 2), (1, 19), (37, 21)])
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_sizes_and_sample_counts(folder: Path, size: tuple[int, int], rfilter: str) -> None:
    """Tiles stick out, lists end early: every sample is computed once, and stored where it belongs."""
    scene = djpt.load_dict(gallery(folder, size, rfilter, {"type": "path", "max_depth": 2}))
    for spp in (1, 3, 33, 300):
        if size[0] * size[1] * spp > 50000:
            continue
        machine, flat = images(scene, spp, schedules=("machine", "flat"))
        close(machine, flat, 0.95)


def test_textures_by_uv(folder: Path) -> None:
    """A material that looks at uv needs all of a surface point."""
    scene = djpt.load_dict(uv_texture(gallery(folder), "smooth", "flat", "flipped", "mirrored", "ball", "block"))
    assert scene.surface_detail is SurfaceDetail.PARTIALS
    machine, flat, wave = images(scene, 8)
    close(machine, flat)
    close(machine, wave)
    plain = images(djpt.load_dict(gallery(folder)), 8, schedules=("machine",))[0]
    assert agreement(machine, plain, 1e-2).share < 0.6


def test_meshes_alone(folder: Path) -> None:
    """No analytic shape at all: all faces are records."""
    scene = gallery(folder, lights=("lamp", "sky"))
    for name in ("floor", "ball", "block"):
        del scene[name]
    machine, flat, wave = images(djpt.load_dict(scene), 8)
    close(machine, flat)
    close(machine, wave)


def test_nothing_in_sight(folder: Path) -> None:
    """All camera rays miss; so does every box of the tree."""
    scene = gallery(folder, lights=("sky",))
    scene["sensor"]["to_world"] = djpt.ScalarTransform4f().look_at([0, 0, 20], [0, 0, 40], [0, 1, 0])
    for image in images(djpt.load_dict(scene), 4):
        np.testing.assert_allclose(image, np.broadcast_to(np.float32([0.1, 0.15, 0.3]), image.shape), rtol=1e-6)


# ---------------------------------------------------------------- against Mitsuba


@pytest.mark.sparse(16)
@pytest.mark.parametrize("spp", [1, 3, 33])
@pytest.mark.parametrize("kind", ["box", "odd, gaussian", "crop, gaussian, border"])
def test_pixels_of_mitsuba(folder: Path, kind: str, spp: int) -> None:
    pytest.importorskip("mitsuba")
    description = gallery(folder, **KINDS[kind])
    image = pixels(djpt.render(djpt.load_dict(description, optimize=False), spp=spp, seed=2, schedule="machine"))
    close(image, theirs(description, spp, 2), 0.95 if "gaussian" in kind else 0.985, 1e-3)


@pytest.mark.sparse(6)
@pytest.mark.parametrize("kind", ["hidden", "rgba", "prb", "lamp", "sky", "one bounce"])
def test_more_pixels_of_mitsuba(folder: Path, kind: str) -> None:
    pytest.importorskip("mitsuba")
    description = gallery(folder, **KINDS[kind])
    image = pixels(djpt.render(djpt.load_dict(description, optimize=False), spp=4, seed=3, schedule="machine"))
    close(image, theirs(description, 4, 3), 0.985, 1e-3)


# ---------------------------------------------------------------- identical bits


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.sparse(2)
def test_passes_and_threads(folder: Path, rfilter: str) -> None:
    scene = djpt.load_dict(gallery(folder, (37, 21), rfilter))
    whole = pixels(djpt.render(scene, spp=20, seed=1, schedule="machine"))
    for pass_spp in (1, 3, 7, 16, 20, 25):
        with threads(1 + pass_spp % 2):
            split = pixels(djpt.render(scene, spp=20, seed=1, schedule="machine", pass_spp=pass_spp))
        np.testing.assert_array_equal(split, whole)
    again = djpt.load_dict(gallery(folder, (37, 21), rfilter))
    np.testing.assert_array_equal(pixels(djpt.render(again, spp=20, seed=1, schedule="machine")), whole)


def test_bands(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bands of rows that are no multiple of a tile."""
    from djpt.rendering.schedules import passes

    scene = djpt.load_dict(gallery(folder, (37, 21), "gaussian"))
    whole = pixels(djpt.render(scene, spp=6, schedule="machine"))
    monkeypatch.setattr(passes, "STORED_PIXELS", (5 * 37, 5 * 37))
    for pass_spp in (0, 4):
        split = pixels(djpt.render(scene, spp=6, schedule="machine", pass_spp=pass_spp))
        np.testing.assert_array_equal(split, whole)


@pytest.mark.parametrize("ways", ["steps", "auto"])
def test_auto_is_the_machine_where_lanes_take_steps(folder: Path, ways: str) -> None:
    with ray_queries(ways):
        scene = djpt.load_dict(gallery(folder))
    fastest = "machine" if scene.geometry.stepwise else "flat"
    auto, other = images(scene, 4, schedules=("auto", fastest))
    np.testing.assert_array_equal(auto, other)

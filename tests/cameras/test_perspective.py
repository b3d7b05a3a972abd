"""The pinhole camera: Mitsuba's rays, for every way to describe it; edits move them."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import ParameterError, SceneError
from djpt.jit.types import Point2f

POSITIONS = np.random.default_rng(1).random((2, 64)).astype(np.float32)
LOOK_AT: dict[str, Any] = {"origin": [1, 2, 3], "target": [-3, 0.5, 1], "up": [0, 1, 0.1]}
WIDE = {"width": 40, "height": 30}
TALL_CROP = {
    "width": 30, "height": 40, "crop_width": 7, "crop_height": 13, "crop_offset_x": 5, "crop_offset_y": 9,
}  # fmt: skip


def camera(film: dict[str, Any] | None = None, **entries: Any) -> Any:
    film = {"type": "hdrfilm", **(WIDE if film is None else film)}
    return djpt.load_dict({"type": "perspective", "film": film, **entries})


def rays(sensor: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    ray = sensor.ray_through(Point2f(POSITIONS), Point2f(0.5))
    return np.array(ray.o), np.array(ray.d), np.array(ray.maxt)


def assert_mitsubas_rays(mi: Any, ours: Any, theirs: Any) -> None:
    o, d, maxt = rays(ours)
    ray, _ = theirs.sample_ray(0, 0, mi.Point2f(POSITIONS), mi.Point2f(0))
    np.testing.assert_allclose(o, np.array(ray.o), atol=5e-7)
    np.testing.assert_allclose(d, np.array(ray.d), atol=5e-7)
    np.testing.assert_allclose(maxt, np.array(ray.maxt), rtol=1e-6)


AXES = [{"fov": fov, "fov_axis": axis} for fov in (20, 150) for axis in ("x", "y", "diagonal", "smaller", "larger")]
OTHERS: list[dict[str, Any]] = [
    {},
    {"fov": 39.3077},
    {"fov": 60, "fov_axis": "SMALLER"},
    {"focal_length": "35mm"},
    {"focal_length": "85.5"},
    {"fov": 50, "near_clip": 0.5, "far_clip": 20.0},
    {"fov": 50, "principal_point_offset_x": 0.2, "principal_point_offset_y": -0.1},
    {"fov": 50, "shutter_open": 1.0, "shutter_close": 2.0},
]


@pytest.mark.parametrize("film", [WIDE, TALL_CROP], ids=["wide", "tall crop"])
@pytest.mark.parametrize("entries", AXES + OTHERS, ids=str)
def test_rays_are_mitsubas(mi: Any, entries: dict[str, Any], film: dict[str, Any]) -> None:
    ours = camera(film, to_world=T().look_at(**LOOK_AT), **entries)
    description = {"type": "perspective", "film": {"type": "hdrfilm", **film}, **entries}
    theirs = mi.load_dict({**description, "to_world": mi.ScalarTransform4f().look_at(**LOOK_AT)})
    assert_mitsubas_rays(mi, ours, theirs)
    assert ours.x_fov[0] == pytest.approx(mi.traverse(theirs)["x_fov"][0], rel=1e-6)


def test_edits_move_the_rays_as_in_mitsuba(mi: Any) -> None:
    ours = camera(TALL_CROP, fov=50)
    theirs = mi.load_dict({"type": "perspective", "fov": 50, "film": {"type": "hdrfilm", **TALL_CROP}})
    edits = {
        "x_fov": 70.0,
        "near_clip": 0.25,
        "far_clip": 30.0,
        "principal_point_offset_x": 0.1,
        "to_world": T().translate([1, 2, 3]).rotate([0, 1, 0], 40),
        "film.crop_size": (9, 11),
        "film.crop_offset": (3, 2),
    }
    params = djpt.traverse(ours)
    params.update(edits)
    their_params = mi.traverse(theirs)
    for key, value in edits.items():
        their_params[key] = mi.Transform4f(value.matrix) if key == "to_world" else value
    their_params.update()
    assert_mitsubas_rays(mi, ours, theirs)


def test_looks_along_z_with_y_down_and_x_to_the_left() -> None:
    sensor = camera({"width": 8, "height": 8}, fov=90, near_clip=1.0, far_clip=5.0)
    ray = sensor.ray_through(Point2f([0.5, 0.75, 0.5], [0.5, 0.5, 0.75]), Point2f(0.5))
    np.testing.assert_allclose(np.array(ray.d)[:, 0], [0, 0, 1], atol=1e-7)
    np.testing.assert_allclose(np.array(ray.d)[:, 1], np.array([-0.5, 0, 1]) / np.hypot(0.5, 1), atol=1e-6)
    np.testing.assert_allclose(np.array(ray.d)[:, 2], np.array([0, -0.5, 1]) / np.hypot(0.5, 1), atol=1e-6)
    np.testing.assert_allclose(np.array(ray.o)[2], 1, atol=1e-6)
    np.testing.assert_allclose(np.array(ray(ray.maxt))[2], 5, atol=1e-5)


def test_edits_compile_nothing() -> None:
    sensor = camera(fov=50)
    params = djpt.traverse(sensor)
    position = Point2f(POSITIONS)

    def kernels() -> set[int]:
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            ray = sensor.ray_through(position, Point2f(0.5))
            dr.eval(ray)
        return {k["hash"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT}

    before = kernels()
    params.update({"x_fov": 30, "near_clip": 0.5, "to_world": T().translate([1, 2, 3])})
    assert before and kernels() == before


REFUSED = {
    "both": ({"fov": 30, "focal_length": "50mm"}, r"perspective: 'focal_length' can't be given together with 'fov'"),
    "fov 180": ({"fov": 180}, r"perspective: 'fov' must lie in \(0, 180\), found 180"),
    "fov 0": ({"fov": 0}, r"'fov' must lie in \(0, 180\), found 0"),
    "fov text": ({"fov": "abc"}, r"perspective: 'fov' must be a float, found str 'abc'"),
    "fov nan": ({"fov": float("nan")}, r"'fov' must be finite in single precision, found float nan"),
    "axis": ({"fov": 30, "fov_axis": "smallest"}, r"'fov_axis' can't be 'smallest'; did you mean 'smaller'\?"),
    "axis alone": ({"fov_axis": "x"}, r"'fov_axis' needs 'fov'"),
    "focal number": ({"focal_length": 50}, r"'focal_length' must be a string, found int 50"),
    "focal text": ({"focal_length": "fifty"}, r"'focal_length' must be a positive length .*found 'fifty'"),
    "focal 0": ({"focal_length": "0mm"}, r"'focal_length' must be a positive length"),
    "near 0": ({"near_clip": 0.0}, r"'near_clip' must be greater than 0, found 0"),
    "near beyond far": ({"near_clip": 5, "far_clip": 2}, r"'near_clip' must be less than 'far_clip' \(2\), found 5"),
    "shutter": ({"shutter_open": 1.0, "shutter_close": 0.5}, r"'shutter_close' must not be less than 'shutter_open'"),
    "scale": ({"to_world": T().scale(2)}, r"perspective: 'to_world' must not scale"),
    "unknown": ({"fow": 30}, r"perspective: unknown key 'fow' of sensor 'perspective'; did you mean 'fov'\?"),
    "film": ({"film": {"type": "box"}}, r"perspective: unknown key 'film' \(an rfilter\)"),
    "two films": (
        {"a": {"type": "hdrfilm"}, "b": {"type": "hdrfilm"}},
        r"'perspective' takes one film, found 2: 'a', 'b'",
    ),
}  # fmt: skip


def test_a_focal_length_refers_to_the_diagonal_whatever_the_axis() -> None:
    plain = djpt.load_dict({"type": "perspective", "focal_length": "25mm"})
    with pytest.warns(UserWarning, match="'fov_axis' has no effect on a focal length"):
        other = djpt.load_dict({"type": "perspective", "focal_length": "25mm", "fov_axis": "y"})
    assert other.x_fov[0] == plain.x_fov[0]


def test_the_focus_distance_of_cameras() -> None:
    assert djpt.load_dict({"type": "perspective", "far_clip": 50}).focus_distance() == 50
    assert djpt.load_dict({"type": "perspective", "focus_distance": 3}).focus_distance() == 3
    lens = djpt.load_dict({"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 3})
    params = djpt.traverse(lens)
    params.update({"focus_distance": 4.0})
    assert lens.focus_distance() == 4


@pytest.mark.parametrize(("entries", "message"), REFUSED.values(), ids=REFUSED.keys())
def test_refused(entries: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict({"type": "perspective", **entries})


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("x_fov", 180, r"x_fov: must lie in \(0, 180\), found 180"),
        ("near_clip", 0, r"near_clip: must be greater than 0"),
        ("near_clip", 1e5, r"near_clip: must be less than far_clip"),
        ("shutter_open_time", -1, r"shutter_open_time: must be at least 0"),
        ("to_world", T().scale(2), r"to_world: must not scale"),
        ("to_world", "abc", r"to_world: must be numbers, found str 'abc'"),
    ],
)
def test_refused_edits_change_nothing(key: str, value: Any, message: str) -> None:
    sensor = camera(fov=50)
    before = rays(sensor)
    params = djpt.traverse(sensor)
    with pytest.raises(ParameterError, match=message):
        params.update({key: value})
    params.update()
    for old, new in zip(before, rays(sensor), strict=True):
        assert np.array_equal(old, new)

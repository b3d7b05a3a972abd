"""Sensors, films and filters as scripts ask them: Mitsuba's answers."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import RenderError
from tests.kit.arrays import in_numpy, rows

CAMERAS: dict[str, dict[str, Any]] = {
    "perspective": {"fov": 50.0, "principal_point_offset_x": 0.1, "shutter_open": 1.0, "shutter_close": 3.0},
    "thinlens": {"fov": 50.0, "aperture_radius": 0.1, "focus_distance": 3.0},
    "orthographic": {},
    "radiancemeter": {},
}
COUNT = 7


def camera(module: Any, name: str, crop: bool = False) -> Any:
    film: dict[str, Any] = {"type": "hdrfilm", "width": 30, "height": 20}
    if crop:
        film |= {"crop_offset_x": 3, "crop_offset_y": 4, "crop_width": 20, "crop_height": 11, "sample_border": True}
    if name == "radiancemeter":
        film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    planes = {"near_clip": 0.5, "far_clip": 20.0} if name != "radiancemeter" else {}
    to_world = module.ScalarTransform4f().look_at(origin=[1, 2, 3], target=[0, 0, 0], up=[0, 1, 0])
    return module.load_dict({"type": name, **CAMERAS[name], **planes, "to_world": to_world, "film": film})


def random(components: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random((components, COUNT))


def require_close(mine: Any, his: Any, tolerance: float = 2e-6) -> None:
    a, b = (np.minimum(in_numpy(x), 1e30) for x in (mine, his))  # infinite or the largest float
    shape = np.broadcast_shapes(a.shape, b.shape)
    np.testing.assert_allclose(np.broadcast_to(a, shape), np.broadcast_to(b, shape), rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("crop", [False, True])
@pytest.mark.parametrize("name", CAMERAS)
def test_rays_are_mitsubas(mi: Any, name: str, crop: bool) -> None:
    drawn = []
    for module, Point2f in ((djpt, djpt.Point2f), (mi, mi.Point2f)):
        sensor = camera(module, name, crop)
        drawn.append(sensor.sample_ray(1.5, 0.3, Point2f(*rows(random(2, 1))), Point2f(*rows(random(2, 2)))))
    (mine, weight), (his, expected) = drawn
    for field in ("o", "d", "maxt"):
        require_close(getattr(mine, field), getattr(his, field))
    require_close(weight, expected)


@pytest.mark.parametrize("name", ["perspective", "thinlens"])
def test_directions_are_mitsubas(mi: Any, name: str) -> None:
    drawn = []
    for module in (djpt, mi):
        it = dr.zeros(mi.Interaction3f, COUNT)
        it.p = mi.Point3f(*rows(random(3, 3) - 0.5))
        ref = it if module is mi else djpt.Point3f(it.p)
        drawn.append(camera(module, name).sample_direction(ref, module.Point2f(*rows(random(2, 4)))))
    (mine, importance), (his, expected) = drawn
    for field in ("p", "n", "uv", "d", "dist", "pdf"):
        require_close(getattr(mine, field), getattr(his, field), 1e-5)
    require_close(importance, expected, 1e-5)
    assert in_numpy(expected).max() > 0


@pytest.mark.parametrize("crop", [False, True])
@pytest.mark.parametrize("name", CAMERAS)
def test_sensors_and_films_say_what_mitsubas_do(mi: Any, name: str, crop: bool) -> None:
    mine, his = (camera(module, name, crop) for module in (djpt, mi))
    for question in ("shutter_open", "shutter_open_time", "needs_aperture_sample"):
        assert getattr(mine, question)() == getattr(his, question)()
    if name != "radiancemeter":
        for question in ("near_clip", "far_clip"):
            assert getattr(mine, question)() == getattr(his, question)()
    np.testing.assert_allclose(
        mine.world_transform().matrix, np.array(his.world_transform().matrix).squeeze(), atol=1e-6
    )
    film, other = mine.film(), his.film()
    for question in ("size", "crop_size", "crop_offset"):
        assert list(getattr(film, question)()) == list(getattr(other, question)())
    for question in ("sample_border", "base_channels_count", "flags"):
        assert getattr(film, question)() == getattr(other, question)()
    assert film.prepare(["a", "b"]) == other.prepare(["a", "b"])
    assert mine.sampler().sample_count() == his.sampler().sample_count()
    assert in_numpy(mine.sample_wavelengths(None, 0.5)[1]).tolist() == [[1]] * 3


@pytest.mark.parametrize("crop", [False, True])
@pytest.mark.parametrize("name", ["perspective", "orthographic"])
def test_projections_are_mitsubas(mi: Any, name: str, crop: bool) -> None:
    mine, his = (camera(module, name, crop).projection_transform() for module in (djpt, mi))
    np.testing.assert_allclose(np.array(mine.matrix).squeeze(), np.array(his.matrix).squeeze(), rtol=1e-5, atol=1e-5)


def test_sensors_of_scripts_know_where_they_stand() -> None:
    sensor = camera(djpt, "perspective")
    assert sensor.m_to_world is sensor.world_transform() and sensor.m_film is sensor.film()
    sensor.m_to_world = djpt.ScalarTransform4f().translate([1, 2, 3])
    assert sensor.world_transform() == djpt.ScalarTransform4f().translate([1, 2, 3])
    np.testing.assert_array_equal(in_numpy(sensor.bbox().min).ravel(), [1, 2, 3])
    assert not camera(djpt, "radiancemeter").bbox().valid()


FILTERS = ("box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos")


@pytest.mark.parametrize("name", FILTERS)
def test_filters_are_mitsubas(mi: Any, name: str) -> None:
    mine, his = (module.load_dict({"type": name}) for module in (djpt, mi))
    for question in ("radius", "border_size", "is_box_filter"):
        assert getattr(mine, question)() == getattr(his, question)()
    x = np.linspace(-1, 1, 50) * mine.radius() * 0.999
    require_close(mine.eval(djpt.Float(*rows([x]))), his.eval(mi.Float(x)), 3e-5)


def test_a_film_without_samples() -> None:
    film = djpt.load_dict({"type": "hdrfilm"})
    for call in (film.develop, film.create_block):
        with pytest.raises(RenderError, match=r"film\.prepare\(\) first"):
            call()
    with pytest.raises(RenderError, match="the channel 'R' appears twice"):
        film.prepare(["R"])

"""How densely the rays of a sensor fill directions and space: `pdf_ray` against rays, and against the importance."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.frame import Frame3f
from djpt.core.records import Ray3f
from djpt.description import registry
from djpt.errors import RenderError
from djpt.jit.types import Float, Point2f, Point3f, Vector3f
from tests.cameras.test_sensors import CAMERAS, FILMS, LOOK, METER, METERS, MIXED, batch
from tests.cameras.wide_cameras import VIEW, WIDE
from tests.kit.chi_squared import PLANE, SIGNIFICANCE, SPHERE, p_value, uniform

pytestmark = pytest.mark.cuda

COUNT = 2**18
BROAD = {"type": "perspective", "fov": 100, "to_world": LOOK}
REACHABLE: dict[str, dict[str, Any]] = {
    "perspective": BROAD,
    "perspective off the axis": {**BROAD, "fov": 40, "principal_point_offset_x": 0.6, "near_clip": 1.5},
    **CAMERAS,
    **{name: WIDE[name] for name in ("equidistant", "stereographic", "panorama behind", "distorted in pixels")},
    **{name: VIEW[name] for name in ("tilt", "all of it")},
}
LENSES = [(0.5, 0.5), (0.1, 0.8)]
"""Samples of the aperture: its centre, and a point near its edge."""


def sensor_of(name: str, film: str) -> Any:
    return djpt.load_dict({**REACHABLE[name], "film": {"type": "hdrfilm", **FILMS[film]}})


def rays_of(sensor: Any, lens: tuple[float, float], count: int = COUNT) -> Any:
    return sensor.ray_through(Point2f(*uniform(count)), Point2f(*lens))


def test_all_reachable_sensors_are_tested() -> None:
    own = {name: factory for name, factory in registry.registered("sensor").items() if registry.is_own(factory)}
    reachable = {name for name, factory in own.items() if factory.can_be_reached}
    assert reachable == {description["type"] for description in REACHABLE.values()}


@pytest.mark.parametrize("lens", LENSES, ids=["centre", "edge"])
@pytest.mark.parametrize("film", FILMS)
@pytest.mark.parametrize("name", REACHABLE)
class TestDensity:
    @pytest.mark.sparse(65)
    def test_rays_follow_it(self, name: str, film: str, lens: tuple[float, float]) -> None:
        """By direction; where all rays are parallel, by the place where they start."""
        sensor = sensor_of(name, film)
        ray = rays_of(sensor, lens)
        parallel = np.isinf(np.array(sensor.pdf_ray(ray)[1])).any()
        axis = Frame3f.from_normal(dr.normalize(dr.detach(dr.mean(ray.d, axis=1))))

        def shown(p: Any) -> Any:
            return sensor.sample_wi(p, Point2f(*lens))[1] > 0

        if parallel:
            local = axis.to_local(ray.o)
            x, y, z = (np.array(v, np.float64) for v in (local.x, local.y, local.z))
            centre, half = np.array([x.mean(), y.mean()]), 1.1 * max(np.ptp(x), np.ptp(y)) / 2
            place = Point2f(*(((v - c) / half).astype(np.float32) for v, c in zip((x, y), centre, strict=True)))
            depth = float(z.mean()) + 0.5

            def density(at: Any) -> Any:
                p = axis.to_world(Point3f(at.x * half + centre[0], at.y * half + centre[1], depth))
                return dr.select(shown(p), sensor.pdf_ray(Ray3f(p, axis.n))[0] * half**2, 0)

            p, integral = p_value(PLANE, place, True, density, fine=96)
        else:
            towards = axis.to_local(ray.d)
            lowest = float(np.array(towards.z).min())
            domain = type(SPHERE)((1 - 1.1 * (1 - lowest), 0), SPHERE.high, SPHERE.point, SPHERE.coordinates)
            _, distance = sensor.pdf_ray(ray)
            start = Point3f(*np.array(ray.o - ray.d * distance, np.float64).mean(axis=1).tolist())

            def density(local: Any) -> Any:
                d = axis.to_world(local)
                _, near = sensor.pdf_ray(Ray3f(start, d))
                pdf, _ = sensor.pdf_ray(Ray3f(dr.fma(d, near, start), d))
                return dr.select(shown(dr.fma(d, near + 1, start)), pdf, 0)

            p, integral = p_value(domain, towards, True, density, fine=96)
        assert integral == pytest.approx(1, abs=1e-2)
        assert p > SIGNIFICANCE

    def test_it_is_the_importance(self, name: str, film: str, lens: tuple[float, float]) -> None:
        """At any distance from the ray's origin, that too."""
        sensor = sensor_of(name, film)
        ray = rays_of(sensor, lens, 4096)
        t = Float(uniform(4096, 1, seed=1)[0] * (0.9 * ray.maxt) + 1e-3)
        _, importance = sensor.sample_wi(ray(t), Point2f(*lens))
        pdf, distance = sensor.pdf_ray(ray)
        expected = dr.select(dr.isfinite(distance), pdf * dr.rcp(dr.square(t + distance)), pdf)
        expected, found = (np.broadcast_to(np.array(x, np.float64), (4096,)) for x in (expected, importance))
        # A point on the border of the film may fall off it.
        inside = found > 0
        assert inside.mean() > 0.99
        np.testing.assert_allclose(found[inside], expected[inside], rtol=1e-3)

    def test_rays_come_together_at_its_distance(self, name: str, film: str, lens: tuple[float, float]) -> None:
        sensor = sensor_of(name, film)
        ray = rays_of(sensor, lens, 4096)
        _, distance = sensor.pdf_ray(ray)
        if np.isinf(np.array(distance)).all():
            assert np.ptp(np.broadcast_to(np.array(ray.d), (3, 4096)), axis=1).max() == 0
            return
        centre = np.array(ray.o - ray.d * distance)
        np.testing.assert_allclose(centre, np.median(centre, axis=1, keepdims=True).repeat(4096, axis=1), atol=1e-5)


UNREACHABLE: dict[str, dict[str, Any]] = {
    **METERS,
    "irradiancemeter": {"type": "scene", "ball": {"type": "sphere", "sensor": METER}},
    "batch": batch(**MIXED),
}


@pytest.mark.parametrize("name", UNREACHABLE)
def test_others_say_that_light_cannot_reach_them(name: str) -> None:
    loaded = djpt.load_dict(UNREACHABLE[name])
    sensor = loaded.sensors()[0] if name == "irradiancemeter" else loaded
    message = "light can't be traced towards this sensor; possible: .*perspective.*"
    with pytest.raises(RenderError, match=message):
        sensor.pdf_ray(Ray3f(Point3f(0), Vector3f(0, 0, 1)))
    with pytest.raises(RenderError, match=message):
        sensor.sample_wi(Point3f(0), Point2f(0.5))

"""Rays that leave emitters: what `sample_emission` claims of them, and what `pdf_emission` says of the same rays.

All parameter sets of tests/kit/emitters.py are tested, and all shapes that can send rays, with an area light. That
the mean weight is the power is tested in tests/lights/test_sampling.py.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.frame import Frame3f
from djpt.core.records import DirectionSample3f, EmissionSample, EmitterFlags, has_flag
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.materials.pointer import BSDFPtr
from tests.kit.chi_squared import PLANE, SIGNIFICANCE, SPHERE, p_value, probability_of_counts, uniform
from tests.kit.emitters import NAMES, entry
from tests.kit.renders import box, lights, pixels
from tests.lights.test_sampling import BALL, room
from tests.sampling.test_claims import with_area

RAYS = 4096
COUNT = 2**18


def sources() -> list[Any]:
    """All sets of emitters, and all shapes that have an area, as entries of a scene."""
    shining = [
        pytest.param({**p.values[1], "emitter": {"type": "area", "radiance": 2.0}}, id=p.id) for p in with_area()
    ]
    compensated = pytest.param({**entry("envmap-sun"), "mis_compensation": True}, id="envmap-compensated")
    return [pytest.param(name, id=name) for name in NAMES] + shining + [compensated]


def scene_of(source: dict[str, Any] | str) -> Any:
    """One of `sources` in a large transparent ball."""
    return room(entry(source) if isinstance(source, str) else source)


def emitted(scene: Any, count: int = RAYS, seed: int = 0) -> EmissionSample:
    """Rays of the first emitter."""
    u = uniform(count, 4, seed)
    es: EmissionSample = scene.emitter_ptr(UInt32(0)).sample_emission(Point2f(u[0], u[1]), Point2f(u[2], u[3]))
    dr.eval(es)
    return es


def densities(scene: Any, es: EmissionSample) -> tuple[Any, Any]:
    found = scene.emitter_ptr(UInt32(0)).pdf_emission(es.ray.d, es.n, es.uv)
    dr.eval(found)
    return found


def wide(value: Any, count: int = RAYS) -> np.ndarray:
    """As (count,) or (channels, count) numbers in double precision."""
    found = np.array(value, np.float64)
    return np.broadcast_to(found if len(found) > 1 or found.ndim > 1 else found[0], (*found.shape[:-1], count))


def kind(scene: Any) -> int:
    return int(scene.emitters()[0].flags())


def in_one_direction(scene: Any) -> bool:
    return bool(has_flag(kind(scene), EmitterFlags.DeltaDirection))


def from_surface(scene: Any) -> bool:
    return bool(has_flag(kind(scene), EmitterFlags.Surface))


def from_point(scene: Any) -> bool:
    return bool(has_flag(kind(scene), EmitterFlags.DeltaPosition))


def strength(scene: Any, es: EmissionSample) -> np.ndarray:
    """What `EmissionSample` calls radiance cos, (3, RAYS), by the methods that don't sample rays; NaN: unknown."""
    emitter = scene.emitter_ptr(UInt32(0))
    if from_surface(scene) and in_one_direction(scene):
        return wide(scene.emitters()[0].radiance.eval(es))
    if from_surface(scene):
        # Back onto the point that the ray left.
        step = 1e-2
        ray = djpt.Ray3f(dr.fma(es.ray.d, step, es.ray.o), -es.ray.d, maxt=Float(2 * step))
        si = scene.ray_intersect(ray)
        radiance = si.emitter(scene).eval(si)
        near = si.valid & (dr.norm(si.p - es.ray.o) < step / 4)
        return np.where(wide(near) > 0, wide(radiance) * wide(es.cos), np.nan)
    if from_point(scene) or in_one_direction(scene):
        # Intensity / dist^2 at the distance 1, or the irradiance.
        return wide(emitter.sample_direction(djpt.Interaction3f(p=es.ray(Float(1))), Point2f(0.5))[1])
    # An environment, looked at against the ray and past the ball.
    si = scene.ray_intersect(djpt.Ray3f(Point3f(1e4), -es.ray.d, maxt=Float(1e-3)))
    assert not np.array(si.valid).any()
    return wide(si.emitter(scene).eval(si))


@pytest.mark.parametrize("source", sources())
class TestEmission:
    @pytest.mark.sparse(15)
    def test_weight_is_emitted_light_over_densities(self, source: dict[str, Any] | str) -> None:
        scene = scene_of(source)
        es = emitted(scene)
        product = wide(es.weight) * wide(es.pdf_position) * wide(es.pdf_direction)
        expected = strength(scene, es)
        assert expected[np.isfinite(expected)].max() > 0
        close = np.isclose(product, expected, rtol=2e-3, atol=2e-4 * np.nanmax(expected)).all(axis=0)
        # Rays back to an edge may miss it; where bright and dark meet, rounding decides.
        assert close.mean() > 0.98

    @pytest.mark.sparse(3)
    def test_densities_are_found_again(self, source: dict[str, Any] | str) -> None:
        scene = scene_of(source)
        es = emitted(scene, seed=1)
        for found, drawn in zip(densities(scene, es), (es.pdf_position, es.pdf_direction), strict=True):
            found, drawn = wide(found), wide(drawn)
            assert np.isfinite(drawn).all()
            assert drawn.min() >= 0
            # Directions are rounded at the edges of cones and pictures, and at grazing angles.
            assert np.isclose(found, drawn, rtol=2e-3, atol=1e-6 * drawn.max()).mean() > 0.995

    @pytest.mark.sparse(13)
    def test_record_is_consistent(self, source: dict[str, Any] | str) -> None:
        scene = scene_of(source)
        es, emitter = emitted(scene, seed=2), scene.emitters()[0]
        for unit in (es.ray.d, es.n):
            np.testing.assert_allclose(np.linalg.norm(wide(unit), axis=0), 1, atol=1e-5)
        np.testing.assert_allclose(wide(es.cos), (wide(es.ray.d) * wide(es.n)).sum(axis=0), atol=1e-5)
        assert (wide(es.finite) > 0).all() == (emitter.bounds() is not None)
        assert (wide(es.finite) > 0).any() == (emitter.bounds() is not None)
        delta = bool(has_flag(kind(scene), EmitterFlags.Delta))
        assert (wide(es.delta) > 0).all() == delta
        assert (wide(es.delta) > 0).any() == delta
        if from_point(scene):
            assert (wide(es.pdf_position) == 1).all()
        if in_one_direction(scene):
            assert (wide(es.pdf_direction) == 1).all()
        if not from_surface(scene):
            np.testing.assert_array_equal(wide(es.n), wide(es.ray.d))

    @pytest.mark.sparse(3)
    def test_a_hit_gives_the_arguments(self, source: dict[str, Any] | str) -> None:
        """Of a path that arrives from the other side: `DirectionSample3f.between`."""
        scene = scene_of(source)
        if kind(scene) & EmitterFlags.Delta:
            pytest.skip("no path meets it")
        es = emitted(scene, seed=3)
        # From beyond the ball for an environment, which the ball would hide.
        away = Float(1.0) if from_surface(scene) else Float(100.0)
        start = es.ray(away)
        ray = djpt.Ray3f(start, -es.ray.d, maxt=Float(1.05) if from_surface(scene) else Float(1e-3))
        si = scene.ray_intersect(ray)
        ds = DirectionSample3f.between(start, ray, si)
        position, direction = scene.emitter_ptr(UInt32(0)).pdf_emission(-ds.d, ds.n, ds.uv)
        dr.eval(si.p, si.valid, position, direction)
        # Some rays meet another part of the shape or the ball first.
        same = dr.norm(si.p - es.ray.o) < 1e-3 * (1 + dr.norm(es.ray.o)) if from_surface(scene) else ~si.valid
        same = wide(same) > 0
        assert same.mean() > 0.3
        for found, drawn in ((position, es.pdf_position), (direction, es.pdf_direction)):
            close = np.isclose(wide(found), wide(drawn), rtol=5e-3, atol=1e-3 * wide(drawn).max())
            assert close[same].mean() > 0.98

    @pytest.mark.sparse(64)
    def test_directions_follow_the_density(self, source: dict[str, Any] | str) -> None:
        scene = scene_of(source)
        emitter, es = scene.emitter_ptr(UInt32(0)), emitted(scene, COUNT, seed=4)
        if in_one_direction(scene):
            np.testing.assert_allclose((wide(es.ray.d, COUNT) * wide(es.n, COUNT)).sum(axis=0), 1, atol=1e-5)
            return
        if from_surface(scene):
            # About the normal; the density is the same for every normal.
            n, uv = dr.normalize(Vector3f(0.3, -0.5, 0.6)), Point2f(0.4, 0.3)
            towards, frame = Frame3f.from_normal(es.n).to_local(es.ray.d), Frame3f.from_normal(n)
        else:
            n, uv = Vector3f(0, 0, 1), Point2f(0)
            # Densities of cones are narrow: look there closely.
            frame = Frame3f.from_normal(dr.normalize(dr.detach(dr.mean(es.ray.d, axis=1))))
            towards = frame.to_local(es.ray.d)
        lowest = float(np.array(towards.z).min())
        domain = SPHERE if lowest < 0.7 else type(SPHERE)(
            (1 - 1.2 * (1 - lowest), 0), (1, 2 * np.pi), SPHERE.point, SPHERE.coordinates
        )  # fmt: skip

        def density(local: Any) -> Any:
            return emitter.pdf_emission(frame.to_world(local), n, uv)[1]

        p, integral = p_value(domain, towards, True, density, fine=24 if from_surface(scene) else 96)
        assert integral == pytest.approx(1, abs=5e-3)
        assert p > SIGNIFICANCE

    @pytest.mark.sparse(64)
    def test_positions_follow_the_density(self, source: dict[str, Any] | str) -> None:
        scene = scene_of(source)
        es = emitted(scene, COUNT, seed=5)
        if from_surface(scene):
            assert surface_p_value(scene, es) > SIGNIFICANCE
        elif from_point(scene):
            position = wide(scene.emitters()[0].position, COUNT)
            np.testing.assert_array_equal(wide(es.ray.o, COUNT), position)
        else:
            # Whatever the direction: on the disk across it that the scene fills.
            emitter = scene.emitters()[0]
            across = Frame3f.from_normal(es.ray.d).to_local(es.ray.o - emitter.center) * dr.rcp(emitter.radius)
            assert np.array(across.z).max() <= 1e-5
            share, _ = scene.emitter_ptr(UInt32(0)).pdf_emission(Vector3f(0, 0, 1), Vector3f(0, 0, 1), Point2f(0))
            share = share * dr.square(emitter.radius)
            d = wide(es.ray.d, COUNT)
            for chosen in (np.full(COUNT, True), d[0] > 0.3, d[1] < -0.5):
                if chosen.sum() < 1000:  # parallel light
                    continue
                place = djpt.Point2f(*(np.array(x)[chosen] for x in (across.x, across.y)))
                p, integral = p_value(
                    PLANE, place, True, lambda at: dr.select(dr.squared_norm(at) <= 1, share, 0), fine=32
                )
                assert integral == pytest.approx(1, abs=5e-3)
                assert p > SIGNIFICANCE


def surface_p_value(scene: Any, es: EmissionSample) -> float:
    """Pearson's test of the points that rays leave from, in boxes of space.

    What the boxes should hold comes from points of equal density, whose own test is in tests/sampling/test_claims.py,
    weighted by `pdf_emission`.
    """
    shape, side = scene.shapes()[0], 2048
    grid = (np.indices((side, side)).reshape(2, -1) + np.random.default_rng(6).random((2, side * side))) / side
    ps = shape.sample_position(0, Point2f(*(Float(x.astype(np.float32)) for x in grid)))
    density, _ = scene.emitter_ptr(UInt32(0)).pdf_emission(ps.n, ps.n, ps.uv)
    share = wide(density * shape.surface_area(), side * side)
    assert share.mean() == pytest.approx(1, abs=5e-3)
    points, reference = wide(es.ray.o, COUNT).T, wide(ps.p, side * side).T
    low, high = reference.min(axis=0) - 1e-3, reference.max(axis=0) + 1e-3
    box = [(np.clip((x - low) / (high - low), 0, 1 - 1e-9) * 6).astype(int) @ [36, 6, 1] for x in (points, reference)]
    observed = np.bincount(box[0], minlength=216)
    expected = np.bincount(box[1], share, minlength=216) / len(share)
    # Nearby points are counted on one side or the other of a box.
    return probability_of_counts(observed, expected, error=5e-3)


# ---------------------------------------------------------------- several at once, and none


def test_each_lane_asks_its_own_emitter() -> None:
    lights = {
        f"light{i}": entry(name)
        for i, name in enumerate(NAMES)
        if not name.startswith(("envmap", "constant", "sunsky"))
    }
    scene = djpt.load_dict({"type": "scene", **lights, "sky": entry("constant-colour"), "ball": BALL})
    emitters = scene.emitters()
    u = uniform(RAYS, 5, seed=7)
    index = UInt32(u[4] * len(emitters))
    samples = Point2f(u[0], u[1]), Point2f(u[2], u[3])
    es = scene.emitter_ptr(index).sample_emission(*samples)
    position, direction = scene.emitter_ptr(index).pdf_emission(es.ray.d, es.n, es.uv)
    dr.eval(es, position, direction)
    for i, emitter in enumerate(emitters):
        mine, alone = np.array(index) == i, emitter.sample_emission(*samples)
        asked = emitter.pdf_emission(es.ray.d, es.n, es.uv)
        dr.eval(alone, asked)
        assert mine.any()
        for field in ("weight", "n", "uv", "cos", "pdf_position", "pdf_direction", "finite", "delta"):
            a, b = (wide(getattr(x, field))[..., mine] for x in (es, alone))
            np.testing.assert_allclose(a, b, rtol=2e-5, atol=1e-6, err_msg=f"{emitter.id()}: {field}")
        for found, one in zip((position, direction), asked, strict=True):
            np.testing.assert_allclose(wide(found)[mine], wide(one)[mine], rtol=2e-5, atol=1e-6, err_msg=emitter.id())


def test_no_emitter_sends_nothing() -> None:
    scene = djpt.load_dict({"type": "scene", "light": entry("point-position"), "ball": BALL})
    nobody, half = scene.emitter_ptr(UInt32([0, 1])), Point2f(0.5)
    d = Vector3f(0, 0, 1)
    assert (wide(nobody.sample_emission(half, half).weight, 2)[:, 1] == 0).all()
    assert [float(x[1]) for x in nobody.pdf_emission(d, d, half)] == [0, 0]
    assert (np.array(nobody.sample_emission(half, half, Bool(False, True)).weight) == 0).all()
    assert [np.array(x).max() for x in nobody.pdf_emission(d, d, half, Bool(False, True))] == [0, 0]


@pytest.mark.parametrize("source", ["area-rectangle", "spot-turned", "projector-bitmap"])
def test_rays_that_are_never_drawn_have_no_density(source: str) -> None:
    """Behind the surface, beside the cone and beside the picture."""
    scene = scene_of(source)
    es = emitted(scene)
    forward = dr.normalize(dr.detach(dr.mean(es.ray.d, axis=1)))
    normal = es.n if from_surface(scene) else -forward
    for d in (-forward, dr.normalize(Frame3f.from_normal(forward).s - 0.1 * forward)):
        position, direction = scene.emitter_ptr(UInt32(0)).pdf_emission(d, normal, es.uv)
        assert np.array(position * direction).max() == 0


@pytest.mark.parametrize("emitter", ["area", "directionalarea"])
def test_shapes_without_area_are_refused(emitter: str) -> None:
    scene = djpt.load_dict({"type": "scene", "light": {"type": "plane", "emitter": {"type": emitter}}, "ball": BALL})
    light, half, d = scene.emitters()[0], Point2f(0.5), Vector3f(0, 0, 1)
    for method in (lambda: light.sample_emission(half, half), lambda: light.pdf_emission(d, d, half)):
        with pytest.raises(djpt.SceneError, match="light: no rays can be drawn from this shape"):
            method()


def test_direct_traces_no_bsdf_samples_that_can_meet_no_light(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("a BSDF was sampled")

    monkeypatch.setattr(BSDFPtr, "sample", refuse)
    description = box(4, "box", {"type": "direct", "shading_samples": 2}, lights("point"))
    # Dr.Jit wraps what is raised within a loop.
    with pytest.raises((AssertionError, RuntimeError), match=r"sampled|encountered an exception"):
        djpt.render(djpt.load_dict(description), spp=1)
    for key in [key for key, node in description.items() if isinstance(node, dict) and "emitter" in node]:
        del description[key]
    assert pixels(djpt.render(djpt.load_dict(description), spp=4)).mean() > 0

"""What scenes and BSDFs answer to estimators, and the contracts that estimators build on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.records import BSDFContext, Ray3f, SurfaceInteraction3f
from djpt.films.footprint import Splats
from djpt.integrators import PassIntegrator, PathState, SplattingIntegrator, UnidirectionalPath, Vertex
from djpt.integrators.paths.passes import LightPath, Walks
from djpt.jit.types import Bool, Color3f, Float, Point2f, Point3f, UInt32, Vector3f
from tests.kit.materials import bsdf, cases, in_kernel, interaction
from tests.kit.mesh_scenes import ball_file
from tests.kit.renders import box

SIGMA = 0.7


def rays(count: int, seed: int) -> Ray3f:
    """Rays from inside the Cornell box in all directions."""
    rng = np.random.default_rng(seed)
    o, d = rng.uniform(-0.7, 0.7, (3, count)), rng.normal(size=(3, count))
    return Ray3f(Point3f(o), Vector3f(d / np.linalg.norm(d, axis=0)))


def with_meshes(folder: Path) -> dict[str, Any]:
    """The box with a mesh and a sphere in it."""
    scene = box(8)
    scene["mesh"] = {"type": "ply", "filename": ball_file(folder), "to_world": djpt.ScalarTransform4f().scale(0.3)}
    scene["ball"] = {"type": "sphere", "center": [0.5, -0.5, 0.4], "radius": 0.3}
    return scene


@pytest.mark.parametrize("kind", ["path", "ptracer", "prbvolpath", "direct_projective", "sppm"])
def test_the_size_of_passes_of_older_scenes_changes_nothing(kind: str) -> None:
    integrator = djpt.load_dict({"type": kind, "samples_per_pass": 64, "block_size": 32})
    assert str(integrator) == str(djpt.load_dict({"type": kind}))
    with pytest.raises(djpt.SceneError, match="'samples_per_pass' must be an integer"):
        djpt.load_dict({"type": kind, "samples_per_pass": "all"})


# ---------------------------------------------------------------- scenes


@pytest.mark.parametrize("meshes", [False, True])
def test_a_stored_vertex_is_met_again(meshes: bool, tmp_path: Path) -> None:
    scene = djpt.load_dict(with_meshes(tmp_path) if meshes else box(8))
    ray = rays(2000, 0)
    si = scene.ray_intersect(ray)
    again = scene.revisit(si.p, ray.d, si.face)
    hit = np.array(si.is_valid())
    assert hit.sum() > 1000
    for name in ("p", "n", "wi"):
        first, second = (np.array(getattr(s, name))[:, hit] for s in (si, again))
        np.testing.assert_allclose(second, first, atol=2e-5)
    np.testing.assert_array_equal(np.array(again.bsdf().index)[hit], np.array(si.bsdf().index)[hit])
    np.testing.assert_array_equal(np.array(again.shape_index)[hit], np.array(si.shape_index)[hit])


def test_light_arrives_where_nothing_stands_between() -> None:
    scene = djpt.load_dict(box(8))
    si = scene.ray_intersect(rays(2000, 1))
    ds, _ = scene.sample_emitter_direction(si, Point2f(0.3, 0.6), test_visibility=False)
    ray = scene.shadow_ray(si, ds)
    arrived = np.array(scene.transmittance(ray))
    free = ~np.array(scene.ray_test(ray))
    valid = np.array(si.is_valid()) & (np.array(dr.dot(si.n, ds.d)) > 1e-3)
    assert 0 < free[valid].mean() < 1
    # The lamp itself and the wall behind it stand in the way of no ray to the lamp.
    np.testing.assert_array_equal(arrived[0][valid], free[valid].astype(np.float32))
    colored = np.array(scene.transmittance(ray, Color3f(1, 2, 3)))
    np.testing.assert_array_equal(colored, arrived * np.array([[1], [2], [3]], np.float32))


def test_light_fades_in_matter() -> None:
    """From the middle of a glass ball to its rim: exp(-sigma r), and nothing outside."""
    glass = {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.0, "absorption": SIGMA}
    scene = djpt.load_dict({"type": "scene", "ball": {"type": "sphere", "radius": 0.5, "bsdf": glass}})
    p = Point3f([0.0, 0.1, 3.0], 0.0, 0.0)
    ray = Ray3f(p, Vector3f(0, 0, 1), medium=scene.medium_at(p))
    expected = np.exp(-SIGMA * np.array([0.5, 0.25, 0.0]))
    np.testing.assert_allclose(
        np.array(scene.media.transmittance(ray, Float(0.5, 0.25, 7.0))).T[:, 0], expected, rtol=1e-6
    )
    si = scene.ray_intersect(Ray3f(p, Vector3f(0, 0, 1), medium=ray.medium))
    inward, outward = (np.array(si.medium_beyond(Vector3f(0, 0, sign))) for sign in (-1, 1))
    np.testing.assert_array_equal(inward[:2], np.array(ray.medium)[:2])
    assert (outward[:2] == np.array(ray.medium)[2]).all()


def test_vacuum_has_no_medium() -> None:
    scene = djpt.load_dict(box(8))
    si = scene.ray_intersect(rays(10, 2))
    assert si.medium is None and si.spawn_ray(si.n).medium is None and scene.camera_medium is None


# ---------------------------------------------------------------- BSDFs


@pytest.mark.sparse(3)
@pytest.mark.parametrize("name", cases())
def test_densities_of_both_ways(name: str) -> None:
    """The reverse density is that of the query with the directions exchanged, and the rest is `eval_pdf`."""
    rng = np.random.default_rng(3)
    wi, wo = (v / np.linalg.norm(v, axis=0) for v in rng.normal(size=(2, 3, 500)))
    material, si = in_kernel(bsdf(name)), interaction(Vector3f(wi), width=500)
    ctx = BSDFContext()
    value, pdf, back = material.eval_pdf_both(ctx, si, Vector3f(wo))
    plain = material.eval_pdf(ctx, si, Vector3f(wo))
    for found, expected in zip((value, pdf), plain, strict=True):
        np.testing.assert_array_equal(np.array(found), np.array(expected))
    turned = si.replaced(wi=Vector3f(wo))
    importance = BSDFContext(djpt.TransportMode.Importance)
    np.testing.assert_array_equal(np.array(back), np.array(material.pdf(importance, turned, Vector3f(wi))))


def test_one_visit_for_all_that_is_asked() -> None:
    scene = djpt.load_dict(box(8))
    si = scene.ray_intersect(rays(500, 4))
    wo = Vector3f(0.3, 0.2, 0.9)
    ctx, ptr = BSDFContext(), si.bsdf()
    value, albedo = ptr.visit(lambda b: (b.eval(ctx, si, wo), b.eval_diffuse_reflectance(si)))
    np.testing.assert_array_equal(np.array(value), np.array(ptr.eval(ctx, si, wo)))
    np.testing.assert_array_equal(np.array(albedo), np.array(ptr.eval_diffuse_reflectance(si)))
    both = ptr.eval_pdf_both(ctx, si, wo)
    np.testing.assert_array_equal(np.array(both[2]), np.array(ptr.pdf(ctx, si.replaced(wi=wo), si.wi)))


# ---------------------------------------------------------------- paths that carry more


@dataclass
class CountedState(PathState):
    met: UInt32 | None = None


class Counted(UnidirectionalPath):
    """The number of surfaces that a path has met, as its radiance; it ends after `max_depth` of them."""

    def start(self, scene: Any) -> CountedState:
        return CountedState(**vars(super().start(scene)), met=UInt32(0))

    def vertex(self, scene: Any, sampler: Any, state: Any, ray: Ray3f, si: SurfaceInteraction3f) -> Vertex:
        met = state.met + dr.select(si.is_valid(), UInt32(1), 0)
        numbers = sampler.next_1d(), sampler.next_2d()
        _, _, bs, weight = si.bsdf().eval_pdf_sample(BSDFContext(), si, si.wi, *numbers, si.is_valid())
        goes_on = si.is_valid() & (met < self.max_depth)
        # Without weights, so that the count is all that matters.
        onward = self.next_state(scene, state, si, bs, Color3f(1))
        return Vertex(
            emitted=dr.select(goes_on, 0, Color3f(Float(met))),
            reflected=Color3f(0),
            shadow_ray=si.spawn_ray(ray.d),
            weight=weight,
            ray=si.spawn_ray(si.to_world(bs.wo)),
            state=replace(onward, met=met),
            active=goes_on,
            valid=Bool(True),
        )


@pytest.mark.parametrize("schedule", ["flat", "machine", "wave"])
def test_a_path_carries_what_its_integrator_adds(schedule: str, tmp_path: Path) -> None:
    djpt.register_integrator("counted", Counted)
    scene = djpt.load_dict(with_meshes(tmp_path))
    integrator = djpt.load_dict({"type": "counted", "max_depth": 3})
    image = np.array(djpt.render(scene, spp=4, integrator=integrator, schedule=schedule))
    # The box is open to the camera: paths leave it, but none meets more than three surfaces.
    assert image.max() == 3 and 1 < image.mean() < 3


# ---------------------------------------------------------------- passes


class Emitted(PassIntegrator):
    """The power of the lights, as the mean of what leaves them: one splat per path, in the middle of the film."""

    passes: list[tuple[int, int]]

    def begin(self, walks: Walks) -> Splats:
        self.passes = []
        return Splats(walks.film, 1.0)

    def add_pass(self, walks: Walks, state: Splats, begin: int, end: int) -> Splats:
        self.passes.append((begin, end))

        def start(sampler: Any) -> LightPath:
            es = walks.scene.emitter_ptr(UInt32(0)).sample_emission(sampler.next_2d(), sampler.next_2d())
            return LightPath(es.ray, es.weight, Float(1), None, UInt32(1))

        def vertex(sampler: Any, path: LightPath, si: SurfaceInteraction3f) -> tuple[LightPath, Bool]:
            state.add(Point2f(0.6), path.flux, Bool(True))
            return path, Bool(False)

        walks.light(start, vertex, state.memory, begin, end)
        return state

    def color(self, walks: Walks, state: Splats) -> Color3f:
        return Color3f(*state.sums()) / walks.spp


def test_passes_carry_their_state(monkeypatch: pytest.MonkeyPatch) -> None:
    from djpt.rendering.schedules import progressive

    djpt.register_integrator("emitted", Emitted)
    scene, integrator = djpt.load_dict(box(8, "box")), djpt.load_dict({"type": "emitted"})
    whole = np.array(djpt.render(scene, spp=12, integrator=integrator))
    assert integrator.passes == [(0, 12)]
    monkeypatch.setattr(progressive, "PASS_PATHS", 5 * 64)
    split = np.array(djpt.render(scene, spp=12, integrator=integrator))
    assert integrator.passes == [(0, 5), (5, 10), (10, 12)]
    np.testing.assert_array_equal(split, whole)
    # All paths land on one pixel: their mean is the power, that of a lamp with constant radiance without any noise.
    assert (whole > 0).sum() == 3
    power = whole.sum(axis=(0, 1)).mean() / 64
    assert power == pytest.approx(scene.emitters()[0].power(), rel=1e-4)


def test_passes_have_no_derivatives() -> None:
    djpt.register_integrator("emitted", Emitted)
    scene = djpt.load_dict(box(8, "box"))
    params = djpt.traverse(scene)
    key = "white.reflectance.value"
    dr.enable_grad(params[key])
    params.update()
    with pytest.raises(djpt.RenderError, match="can't be differentiated"):
        djpt.render(scene, params, spp=2, integrator=djpt.load_dict({"type": "emitted"}))


def test_passes_refuse_other_schedules() -> None:
    djpt.register_integrator("emitted", Emitted)
    with pytest.raises(djpt.RenderError, match="vertex by vertex"):
        djpt.render(djpt.load_dict(box(8)), spp=2, integrator=djpt.load_dict({"type": "emitted"}), schedule="flat")


# ---------------------------------------------------------------- samples that light other pixels


class Scattered(SplattingIntegrator):
    """Half of the light of a white film in the pixels themselves, the other half at mirrored places; beyond it, all."""

    def layer_names(self) -> Sequence[str]:
        return ["left.R", "left.G", "left.B"]

    def splat_sample(
        self, scene: Any, camera: Any, sampler: Any, ray: Ray3f, position: Point2f, sink: Any
    ) -> tuple[Color3f, Bool, list[Float]]:
        inside = (position.x >= 0) & (position.x < 1) & (position.y >= 0) & (position.y < 1)
        sink.add(Point2f(1 - position.x, position.y), Color3f(0.5), inside & (position.x > 0))
        sink.add(position, Color3f(1), inside & (position.x < 0.5), UInt32(1))
        return dr.select(inside, Color3f(0.5), 1), Bool(True), []


@pytest.mark.parametrize("sample_border", [False, True])
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_samples_light_other_pixels(rfilter: str, sample_border: bool) -> None:
    djpt.register_integrator("scattered", Scattered)
    scene = box(8, rfilter)
    scene["sensor"]["film"]["sample_border"] = sample_border
    loaded, integrator = djpt.load_dict(scene), djpt.load_dict({"type": "scattered"})
    names = djpt.channel_names(loaded, integrator=integrator)
    assert names == ("R", "G", "B", "left.R", "left.G", "left.B")
    image = np.array(djpt.render(loaded, integrator=integrator, spp=4096))
    assert image.shape == (8, 8, 6)
    np.testing.assert_allclose(image[..., :3], 1, atol=0.03)
    np.testing.assert_allclose(image[:, :2, 3:], 1, atol=0.06)
    np.testing.assert_allclose(image[:, 6:, 3:], 0, atol=1e-3)

"""Guided paths: the means of `path`, the densities of their directions, and what they learn."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.records import BSDFContext, Ray3f
from djpt.core.warp import direction_at, place_of
from djpt.errors import RenderError, SceneError
from djpt.integrators.guiding.guide import HALVINGS, SIDES, SQUARES, Cells, Guide, Leaves
from djpt.jit.types import Normal3f, Point2f, Point3f, UInt32, Vector3f
from djpt.rendering.image import make_job
from djpt.rendering.schedules.learning import JobTrainingPaths
from djpt.rendering.settings import RenderSettings
from djpt.samplers import SampleIndex
from tests.kit.chi_squared import SPHERE, p_value, uniform
from tests.kit.convergence import assert_converges_to_path, assert_equal_means, images
from tests.kit.lit_floor import floor_scene
from tests.kit.renders import box
from tests.kit.threads import assert_same_for_any_threads

LIMIT = 1e-5
"""The smallest p-value that passes."""


def check(scene: dict[str, Any], spp: int = 64, **keys: Any) -> None:
    """Assert that `guided` and `path` converge to one image."""
    shared = {"max_depth": 5, **{key: keys[key] for key in keys if key != "share"}}
    ours = images(scene, {"type": "guided", **shared, **keys}, spp)
    assert_equal_means(ours, images(scene, {"type": "path", **shared}, 2 * spp, 100))


# ---------------------------------------------------------------- the parts of a guide


def some_guide(seed: int = 1) -> Guide:
    """Random distributions, with squares that are left out, for each of the six sides; nothing is known of the last."""
    cells = Cells(np.zeros(3), np.array([2.0, 1.0, 0.5]))
    sums = np.random.default_rng(seed).random((SIDES, SQUARES)) ** 4
    sums[:, ::3] = 0
    sums[-1] = 0
    return Guide(cells, Leaves.equal(cells, 0), sums, np.full(SIDES, 0.5))


NORMALS = [Normal3f(*(sign * (axis == i) for i in range(3))) for axis in range(3) for sign in (1.0, -1.0)]


def test_octahedron() -> None:
    """The map and its inverse, and the solid angle that it covers."""
    place = Point2f(*(2 * u - 1 for u in uniform(100000)))
    d = direction_at(place)
    back, spread = place_of(d)
    np.testing.assert_allclose(np.array(dr.norm(d)), 1, atol=1e-6)
    np.testing.assert_allclose(np.array(back), np.array(place), atol=1e-6)
    p, integral = p_value(SPHERE, d, True, lambda d: dr.rcp(4 * place_of(d)[1]))
    assert p > LIMIT and integral == pytest.approx(1, rel=1e-4)
    assert float(dr.mean(spread)[0]) * 4 == pytest.approx(4 * np.pi, rel=5e-3)


@pytest.mark.sparse(6)
@pytest.mark.parametrize("side", range(SIDES))
def test_density_of_a_guide(side: int) -> None:
    """It integrates to 1, and samples follow it; where nothing is known no guide is followed."""
    u, v, w = uniform(400000, 3)
    local = some_guide().at(dr.zeros(Point3f, dr.width(u)), NORMALS[side])
    d = local.sample(u, Point2f(v, w))

    def density(d: Any) -> Any:
        return some_guide().at(dr.zeros(Point3f, dr.width(d)), NORMALS[side]).heading(d).pdf

    if side == SIDES - 1:
        assert float(dr.max(local.share)[0]) == 0
    else:
        assert float(dr.min(local.share)[0]) == 0.5
        # Squares that end within a bin need many points to be integrated.
        p, integral = p_value(SPHERE, d, True, density, fine=96)
        assert p > LIMIT and integral == pytest.approx(1, rel=1e-3)


def test_cells_and_leaves() -> None:
    """Every cell has a leaf; those that are visited often are told apart, and all others lie together."""
    cells = Cells(np.zeros(3), np.array([2.0, 1.0, 0.5]))
    assert [cells.axes.count(axis) for axis in range(3)] == [7, 5, 4]
    assert sorted(cells.order) == list(range(cells.count))
    p, n = Point3f(0.3, 0.2, 0.1), Normal3f(0.1, -0.9, 0.2)
    visits = np.zeros(cells.count, np.uint32)
    visits[cells.at(p, n)[0]] = 1000
    leaves = Leaves.by_visits(cells, visits, 500)
    assert leaves.count == SIDES + HALVINGS
    assert set(leaves.of_cell) == set(range(leaves.count))
    own = leaves.of_cell[cells.at(p, n)[0]]
    assert (leaves.of_cell == own).sum() == 1
    outside = cells.at(Point3f(-1, 9, dr.inf), Normal3f(0, 0, -1))[0]
    assert outside == cells.at(Point3f(0, 1, 0.5), Normal3f(0, 0, -1))[0] < cells.count


@pytest.mark.slow
def test_the_mixture_of_guide_and_material() -> None:
    """The directions of a vertex follow the density that it states, which integrates to 1; weights are value / density.

    All lanes are at one point, with other random numbers.
    """
    plugin = djpt.load_dict({"type": "guided", "max_depth": 5, "practice": 16.0})
    loaded = djpt.load_dict(floor_scene(size=16))
    job = make_job(loaded, RenderSettings.of(loaded, integrator=plugin, seed=1, spp=256))
    guided, scene = plugin.trained(JobTrainingPaths(job)), job.scene
    ray = Ray3f(Point3f(1, 2.5, 5.5), dr.normalize(Vector3f(-1.9, -2.9, -5.5)))
    si = scene.surface_interaction(ray, scene.closest_hit(ray))
    number = dr.arange(UInt32, 400000)
    stream = job.sampler.stream(UInt32(7), SampleIndex(UInt32(0), number, UInt32(1), UInt32(1)))
    v = guided.vertex(scene, stream, guided.start(scene), ray, si)
    guide, context = guided.guide.at(si.p, si.n), BSDFContext()
    share = guide.share
    assert 0.2 < share[0] < 0.5

    def density(d: Any) -> Any:
        return share * guide.heading(d).pdf + (1 - share) * si.bsdf().pdf(context, si, si.to_local(d))

    p, integral = p_value(SPHERE, v.ray.d, True, density, fine=48)
    assert p > LIMIT and integral == pytest.approx(1, rel=2e-3)
    expected = si.bsdf().eval(context, si, si.to_local(v.ray.d)) / density(v.ray.d)
    np.testing.assert_allclose(np.array(v.weight), np.array(expected), rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(np.array(v.state.bsdf_pdf), np.array(density(v.ray.d)), rtol=1e-3)


# ---------------------------------------------------------------- images


MATERIALS: dict[str, dict[str, Any]] = {
    "diffuse": {"type": "diffuse"},
    "plastic": {"type": "plastic"},
    "rough glass": {"type": "roughdielectric", "alpha": 0.3},
    "glass": {"type": "dielectric"},
    "metal": {"type": "roughconductor", "material": "Au", "alpha": 0.1},
    "opening": {"type": "mask", "opacity": 0.5, "inner": {"type": "twosided", "inner": {"type": "diffuse"}}},
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "plastic" else pytest.mark.slow) for name in MATERIALS]
)
def test_materials(name: str) -> None:
    """Smooth lobes, mirrors, and those that have both; what is nearly a mirror; both sides of a surface."""
    scene = floor_scene(size=16)
    scene["ball"]["bsdf"] = MATERIALS[name]
    scene["small"]["bsdf"] = {"type": "roughplastic"}
    check(scene, 256, rr_depth=3)


@pytest.mark.parametrize("keys", [{"share": 0.9}, {"emitter_choice": "power", "hide_emitters": True}], ids=str)
@pytest.mark.sparse(2)
def test_parameters(keys: dict[str, Any]) -> None:
    """Two lamps, one of them a point."""
    lights = {"lamp": floor_scene()["lamp"], "point": {"type": "point", "position": [1, 3, 1]}}
    check(floor_scene(lights, size=16), 128, **keys)


def test_an_environment_and_a_filter() -> None:
    scene = floor_scene({"sky": {"type": "constant", "radiance": 0.5}}, size=16)
    scene["sensor"]["film"]["rfilter"] = {"type": "gaussian"}
    check(scene, 64)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted({*djpt.scenes.SCENES} - {"parabolic_mirror", "pool"}))
def test_built_in_scenes(name: str) -> None:
    assert_converges_to_path(name, {"type": "guided"}, 1024, 2048)


@pytest.mark.slow
def test_less_noise_by_way_of_a_ceiling() -> None:
    """Where all light comes from a bright spot, three samples of `path` have more noise than one that is guided."""
    scene = djpt.scenes.fixture()
    scene["sensor"]["film"].update(width=16, height=16, rfilter={"type": "box"})
    keys: list[dict[str, Any]] = [{"type": "guided", "practice": 4.0}, {"type": "path"}]
    guided, path = (np.var(images(scene, {**key, "max_depth": 5}, 256), axis=0) for key in keys)
    assert 3 * np.median(guided) < np.median(path)


# ---------------------------------------------------------------- contracts


def test_image_is_the_same_for_any_threads_and_passes() -> None:
    scene, plugin = djpt.load_dict(box(32, "gaussian")), djpt.load_dict({"type": "guided", "max_depth": 5})

    def render(**arguments: Any) -> np.ndarray:
        return np.array(djpt.render(scene, integrator=plugin, spp=32, **{"seed": 4, **arguments}))

    first = assert_same_for_any_threads(render)
    np.testing.assert_array_equal(render(pass_spp=5), first)
    assert (render(seed=5) != first).any()


def test_lights_that_are_seen() -> None:
    """Paths of one edge, which a guide can't change, are those of `path`."""
    scene = djpt.load_dict(box(16))

    def render(kind: str, depth: int) -> np.ndarray:
        return np.array(djpt.render(scene, integrator=djpt.load_dict({"type": kind, "max_depth": depth}), spp=16))

    assert render("guided", 0).max() == 0
    np.testing.assert_allclose(render("guided", 1), render("path", 1), rtol=1e-5)


def test_progress_and_cancelling() -> None:
    """Practice is no part of the samples that are counted, and ends where it is asked to."""
    scene, plugin = djpt.load_dict(box(16)), djpt.load_dict({"type": "guided"})
    told: list[tuple[int, int]] = []
    djpt.render(scene, integrator=plugin, spp=4, progress=lambda done, total: told.append((done, total)))
    assert told[0] == (0, 1024) and told[-1] == (1024, 1024) and told == sorted(told)
    with pytest.raises(RenderError, match="cancelled"):
        djpt.render(scene, integrator=plugin, spp=4, progress=lambda done, total: plugin.cancel())


def test_bounces_add_up() -> None:
    scene, plugin = djpt.load_dict(box(16)), djpt.load_dict({"type": "guided", "max_depth": 4, "bounces": True})
    image = np.array(djpt.render(scene, integrator=plugin, spp=16), np.float64)
    np.testing.assert_allclose(image[..., 3:].reshape(16, 16, 4, 3).sum(axis=2), image[..., :3], rtol=1e-4, atol=1e-6)


def test_what_is_refused() -> None:
    with pytest.raises(SceneError, match=r"share.*0\.95"):
        djpt.load_dict({"type": "guided", "share": 1.0})
    with pytest.raises(SceneError, match="learns about the scene can't be nested"):
        djpt.load_dict({"type": "aov", "aovs": "d:depth", "inner": {"type": "guided"}})
    scene = djpt.load_dict(box(4, integrator={"type": "guided"}))
    params = djpt.traverse(scene)
    dr.enable_grad(params["red.reflectance.value"])
    params.update()
    with pytest.raises(RenderError, match="can't be differentiated"):
        djpt.render(scene, params, spp=1)


def test_frozen_functions_are_refused() -> None:
    scene = djpt.load_dict(box(4, integrator={"type": "guided"}))

    @dr.freeze
    def frame(scene: Any, seed: Any) -> Any:
        return djpt.render(scene, spp=1, seed=seed)

    with pytest.raises(Exception, match="frozen") as caught:
        frame(scene, UInt32(1))
    chain = [caught.value, caught.value.__cause__]
    assert any(isinstance(error, RenderError) for error in chain)

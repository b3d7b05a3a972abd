"""Densities on the unit cube that guide samples."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import RenderError
from djpt.jit.types import Color3f, Float, Point3f, UInt32
from tests.kit.kernels import kernels
from tests.silhouettes.cases import FLOOR, LAMP, ball, sensor


def sampler(lanes: int, seed: int = 1) -> Any:
    found: Any = djpt.load_dict({"type": "independent"})
    found.seed(seed, lanes)
    return found


def function(p: Point3f, _: Any = None) -> tuple[Color3f, None, None]:
    """Two balls of radius 0.1; 0 elsewhere."""
    x = dr.select(p.x < 0.5, p.x - 0.25, p.x - 0.75)
    inside = dr.square(x) + dr.square(p.y - 0.4) + dr.square(p.z - 0.6) < 0.1**2
    return Color3f(dr.select(inside, 1 + p.y, 0)), None, None


INTEGRAL = 2 * 4 / 3 * np.pi * 0.1**3 * 1.4


def estimate(distribution: Any, lanes: int = 1 << 16) -> tuple[float, float]:
    """The mean of value / density, and its standard error."""
    p, inverse = distribution.sample(sampler(lanes, 7))
    values = np.array(function(Point3f(p))[0].x * inverse)
    return float(values.mean()), float(values.std() / np.sqrt(lanes))


def learnt_grid() -> Any:
    grid = djpt.ad.GridDistr([16, 8, 8], 1e-8)
    total = dr.zeros(Float, grid.num_cells)
    for seed in range(100):
        total += function(grid.random_cell_sample(sampler(grid.num_cells, seed)))[0].x
    grid.set_mass(total)
    return grid


def learnt_octree(lanes: int = 20000, **settings: Any) -> Any:
    arguments = {"max_depth": 5, "max_leaf_count": 1 << 16, "extra_spc": 16, "clamp_mass_thres": 1e-8}
    arguments |= {"clamp_input_mass_thres": 0.1, "prepartition_x_slices": 10, **settings}
    tree = djpt.ad.OcSpaceDistr(eval_indirect_integrand_handle=function, **arguments)
    source = sampler(lanes, 3)
    points = Point3f(source.next_1d(), source.next_1d(), source.next_1d())
    tree.set_points(points, function(points)[0].x)
    return tree


def test_uniform_samples() -> None:
    p, inverse = djpt.ad.UniformDistr().sample(sampler(1000))
    assert np.array(inverse) == 1 and np.array(p).shape == (3, 1000)
    with pytest.raises(NotImplementedError, match=r"BaseGuidingDistr needs a method sample\(sampler\)"):
        djpt.ad.BaseGuidingDistr().sample(sampler(1))


@pytest.mark.parametrize("learn", [learnt_grid, learnt_octree])
@pytest.mark.sparse(2)
@pytest.mark.slow
def test_guided_samples_are_unbiased_and_better(learn: Any) -> None:
    """Cells at the rim in which no sample fell are left out: a bias of less than 2 per cent here."""
    plain_mean, plain_error = estimate(djpt.ad.UniformDistr())
    mean, error = estimate(learn())
    assert abs(plain_mean - INTEGRAL) < 4 * plain_error
    assert abs(mean - INTEGRAL) < 4 * error + 0.02 * INTEGRAL
    assert error < 0.5 * plain_error


def test_cells_of_grids() -> None:
    grid = djpt.ad.GridDistr([4, 3, 2], 0.0)
    assert grid.num_cells == 24 and repr(grid) == "GridDistr[resolution=[4, 3, 2], num_cells=24]"
    number = dr.arange(UInt32, 24)
    cells = grid.get_cell_array(number)
    assert np.array(cells)[:, 7].tolist() == [1, 0, 1]
    middle = (djpt.Vector3f(cells) + 0.5) / djpt.Vector3f(4, 3, 2)
    assert np.array(grid.sample_to_cell_idx(Point3f(middle))).tolist() == list(range(24))
    assert np.array(grid.sample_to_cell_idx(Point3f(middle), False)).sum() == 0
    grid.set_mass(dr.select(number == 7, Float(1), 0))
    p, inverse = grid.sample(sampler(50))
    assert (np.array(grid.sample_to_cell_idx(Point3f(p))) == 7).all()
    np.testing.assert_allclose(np.array(inverse), 1 / 24, rtol=1e-6)


def test_cells_are_mitsubas() -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    ours, theirs = djpt.ad.GridDistr([4, 3, 2], 0.0), mi.ad.GridDistr([4, 3, 2], 0.0)
    index = np.arange(24, dtype=np.uint32)
    a, b = ours.get_cell_array(UInt32(index)), theirs.get_cell_array(mi.UInt32(index))
    assert np.array(a).tolist() == np.array(b).tolist()


@pytest.mark.slow
def test_leaves_tile_the_cube() -> None:
    tree = learnt_octree(clamp_mass_thres=0.0)
    size = np.array(tree.upper) - np.array(tree.lower)
    assert np.prod(size, axis=0).sum() == pytest.approx(1, rel=1e-4)
    assert size.min() == pytest.approx(1 / 320, rel=1e-3) and repr(tree).startswith("OcSpaceDistr[leaves=")


def test_octrees_that_cannot_be_built() -> None:
    with pytest.raises(RenderError, match="more than 500 leaves: raise max_leaf_count"):
        learnt_octree(max_leaf_count=500)
    tree = djpt.ad.guiding.OcSpaceDistr(5, 1000, 4, function, 0.1, 1e-8, 10)
    with pytest.raises(RenderError, match="no sample has mass above the threshold"):
        tree.set_points(Point3f(0.5), Float(0))


def test_trees_of_all_sizes_share_kernels() -> None:
    """Lengths of tables and numbers of points vary from one step of an optimisation to the next."""
    leaves: list[int] = []

    def learn(extra: int, lanes: int) -> set[str]:
        def learnt() -> None:
            tree = learnt_octree(lanes, extra_spc=extra, prepartition_x_slices=15, uniform_share=0.1)
            leaves.append(dr.width(tree.lower))
            dr.eval(tree.sample(sampler(1 << 10)))

        return kernels(learnt)

    known = learn(16, 5000)
    assert not learn(32, 40000) - known
    assert leaves[0] <= 8192 < leaves[1] <= 65536, "a power of two lies between"


def test_guides_do_not_depend_on_earlier_images(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each learns from the samples of its own seed, also the mass below which samples don't count."""
    monkeypatch.setattr("djpt.integrators.projective.detail.FEW_SAMPLES", 1)

    def under(*brightness: float) -> float:
        """The derivative under the last of some lamps, after images under the others."""
        nodes = {"sensor": sensor(), "floor": FLOOR, "moving": ball(center=[1, 1, 3], radius=0.4), "light": LAMP}
        how = {"type": "direct_projective", "sppc": 0, "sppp": 0}
        scene = djpt.load_dict({"type": "scene", "integrator": how, **nodes})
        params = djpt.traverse(scene)
        for radiance in brightness:
            theta = Float(0)
            dr.enable_grad(theta)
            params["moving.to_world"] = djpt.Transform4f().translate([1 + theta, 1, 3]).scale(0.4)
            params["light.emitter.radiance.value"] = radiance
            params.update()
            loss = dr.sum(djpt.render(scene, params, spp=16, seed=2), axis=None)
            dr.forward(theta)
            derivative = float(np.array(dr.grad(loss)).ravel()[0])
        return derivative

    assert under(60, 0.6) == under(0.6) != 0


@pytest.mark.parametrize(("fov", "spp", "learns"), [(40, 16, False), (0.5, 16, True), (40, 64, True)])
def test_a_guide_is_learnt_where_it_pays(fov: float, spp: int, learns: bool) -> None:
    """A narrow view shows few silhouettes; many samples pay for any guide."""
    camera = sensor((0, -3, 6), fov)
    scene = djpt.load_dict({"type": "scene", "ball": ball(radius=0.5), "floor": FLOOR, "lamp": LAMP, "sensor": camera})
    params = djpt.traverse(scene)
    theta = Float(0)
    dr.enable_grad(theta)
    params["ball.to_world"] = djpt.Transform4f().translate([1.5 + theta, 0, 1])
    params.update()
    integrator = djpt.load_dict({"type": "prb_projective", "max_depth": 4})
    integrator.render_forward(scene, None, spp=spp)
    assert isinstance(integrator.proj_detail.guiding_distr, djpt.ad.OcSpaceDistr) == learns

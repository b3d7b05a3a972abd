"""Derivatives of the ladder's images: reverse and forward mode against finite differences of the same paths."""

from __future__ import annotations

from typing import Any

import drjit as dr
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.integrators import Integrator
from tests.kit.derivatives import ALBEDO, RADIANCE, Experiment
from tests.kit.renders import box, spheres

# Paths end by chance with probabilities that don't depend on albedos, so that those of finite differences agree.
STEPS: list[dict[str, Any]] = [
    {"type": "path_naive", "hemisphere": "uniform", "rr_depth": 1000},
    {"type": "path_naive", "hemisphere": "cosine", "rr_depth": 1000},
    {"type": "path_nee"},
    {"type": "path_nee", "russian_roulette": 1.0},
    {"type": "prb_basic"},
]


COLOURS = [
    "small-sphere.bsdf.specular_transmittance.value",
    "large-sphere.bsdf.specular_reflectance.value",
    "back.bsdf.nested_bsdf.reflectance.value",
    "sky.radiance.value",
    RADIANCE,
]


class ThreeBounces(Integrator):
    """A user's path tracer: a loop in Python, nothing about derivatives."""

    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
        radiance, throughput, covered = djpt.Color3f(0), djpt.Color3f(1), None
        for bounce in range(4):
            si = scene.ray_intersect(ray, active)
            radiance += throughput * si.emitter(scene).eval(si, active)
            active &= si.is_valid()
            covered = active if bounce == 0 else covered
            bs, weight = si.bsdf().sample(djpt.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), active)
            throughput, ray = throughput * weight, si.spawn_ray(si.to_world(bs.wo))
        return radiance, covered, []


djpt.register_integrator("three_bounces", ThreeBounces)


@pytest.mark.sparse(12)
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.parametrize("integrator", STEPS, ids=str)
def test_albedo_and_radiance(integrator: dict[str, Any], rfilter: str) -> None:
    description = box(16, rfilter, {"max_depth": 4, **integrator})
    # Paths meet the lamp rarely.
    Experiment(description, [ALBEDO, "white.reflectance.value", RADIANCE], spp=64).check()


@pytest.mark.sparse(6)
@pytest.mark.parametrize("integrator", STEPS, ids=str)
def test_lobes(integrator: dict[str, Any]) -> None:
    """Glass, rough metal, and a surface of two lobes; their choice doesn't depend on the colours, as FD needs it."""
    colour = {"type": "rgb", "value": [0.3, 0.5, 0.2]}

    def edit(scene: dict[str, Any]) -> None:
        spheres(scene)
        scene["light"]["to_world"] = T().translate([0, 0.99, 0]).rotate([1, 0, 0], 90).scale(0.7)
        scene["small-sphere"]["bsdf"] = {"type": "dielectric", "specular_transmittance": colour}
        scene["large-sphere"]["bsdf"] = {"type": "roughconductor", "alpha": 0.5, "specular_reflectance": colour}
        scene["back"]["bsdf"] = {"type": "mask", "opacity": 0.6, "inner": {"type": "diffuse", "reflectance": colour}}
        scene["sky"] = {"type": "constant", "radiance": colour}

    Experiment(box(16, "box", {"max_depth": 4, **integrator}, edit), COLOURS, spp=64).check()


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.sparse(2)
def test_a_users_path_tracer(rfilter: str) -> None:
    """By plain automatic differentiation."""
    experiment = Experiment(box(16, rfilter, {"type": "three_bounces"}), [ALBEDO, RADIANCE], spp=64)
    experiment.check()


def test_a_users_path_tracer_agrees_with_path_replay() -> None:
    """Its draws are those of `prb_basic`: the same image, and the same derivative."""
    mine = Experiment(box(16, "box", {"type": "three_bounces"}), [ALBEDO, RADIANCE], spp=64)
    replayed = Experiment(box(16, "box", {"type": "prb_basic", "max_depth": 4}), [ALBEDO, RADIANCE], spp=64)
    ours, theirs = mine.gradients(), replayed.gradients()
    for name in (ALBEDO, RADIANCE):
        assert ours[name] == pytest.approx(theirs[name], rel=1e-3)


@pytest.mark.parametrize("integrator", ["whitted", "distributed", "path"])
def test_what_has_no_derivative_says_so(integrator: str) -> None:
    scene = djpt.load_dict(box(8))
    params = djpt.traverse(scene)
    dr.enable_grad(params[ALBEDO])
    params.update()
    bounces = {"bounces": True} if integrator == "path" else {}
    plugin = djpt.load_dict({"type": integrator, "max_depth": 3, **bounces})
    with pytest.raises(djpt.RenderError, match="can't be differentiated"):
        djpt.render(scene, integrator=plugin, spp=1)

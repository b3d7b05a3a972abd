"""Faults that renderers are known for, planted in djpt one at a time: each must be caught.

By a closed form with one integrator; or, where a fault leaves images right, by the gradient checker.
"""

from typing import NamedTuple

import pytest

import djpt
from djpt.rendering.gradients import single_walk
from djpt.scenes.overrides import override
from djpt.validation.closed_forms import CASES, validate
from djpt.validation.gradcheck import check_gradient
from tests.kit.faults import planted


class Fault(NamedTuple):
    """A fault: where it is planted, and the closed form and the integrator that catch it."""

    name: str
    target: str
    old: str
    new: str
    case: str
    integrator: str = "path"


DIFFUSE, PATH, PHASE = "djpt.materials.diffuse:Diffuse", "djpt.integrators.path:Path", "djpt.phase.hg:HGPhaseFunction"

FAULTS = (
    Fault("cosine dropped", f"{DIFFUSE}.eval_pdf", "active) * pdf", "active) * INV_PI", "point light"),
    Fault("1 / pi dropped", f"{DIFFUSE}.eval_pdf", "active) * pdf", "active) * wo.z", "sunlight"),
    Fault("pdf of eval off by two", f"{DIFFUSE}.eval_pdf", "* pdf, pdf", "* pdf, 2 * pdf", "rectangle overhead"),
    Fault("pdf of sample off by two", f"{DIFFUSE}.sample", "of(wo, pdf,", "of(wo, 2 * pdf,", "rectangle overhead"),
    Fault("sampling weight of 1", f"{DIFFUSE}.sample", "self.reflectance.eval(si, active), 0)", "1, 0)", "white sky"),
    Fault("black floors from behind", f"{DIFFUSE}.eval_pdf", "(si.wi.z > 0) &", "(si.wi.z < 0) &", "point light"),
    Fault(
        "MIS weights swapped",
        f"{PATH}.vertex",
        "mis_weight(state.bsdf_pdf, met.pdf)",
        "mis_weight(met.pdf, state.bsdf_pdf)",
        "disk overhead",
    ),
    Fault(
        "no MIS weight of light samples",
        f"{PATH}.vertex",
        "dr.rcp(1 + dr.square(pdf * ds.weight))",
        "1",
        "disk overhead",
    ),
    Fault(
        "delta lights weighted",
        f"{PATH}.vertex",
        "dr.select(ds.delta, 1, dr.rcp(1 + dr.square(pdf * ds.weight)))",
        "dr.rcp(1 + dr.square(pdf * ds.weight))",
        "point light",
    ),
    Fault(
        "roulette without a factor",
        "djpt.integrators.path:roulette",
        "throughput * dr.rcp(survival), throughput",
        "throughput, throughput",
        "shining sphere",
        "path, roulette",
    ),
    Fault(
        "one bounce too many",
        "djpt.integrators.paths.unidirectional:UnidirectionalPath.proceeds",
        "state.depth + 1 <",
        "state.depth <",
        "shining sphere",
    ),
    Fault(
        "shadows left out",
        "djpt.scene.queries:SceneQueries.transmittance",
        "self.geometry.blocked(ray, followed)",
        "Bool(False)",
        "half a sky",
    ),
    Fault(
        "distance not squared",
        "djpt.emitters.point:towards_point",
        "dr.square(inv_dist), 0",
        "inv_dist, 0",
        "two lights",
    ),
    Fault(
        "light picked with a wrong probability",
        "djpt.emitters.light_samplers.weighted:UniformLightSampler.choose",
        "Float(self.count)",
        "Float(self.count - 1)",
        "two lights",
    ),
    Fault(
        "probability of lights left out of the pdf",
        "djpt.emitters.light_samplers.sampling:LightSampling.sample",
        "ds.pdf * probability, ds.weight * inverse, weight * inverse",
        "ds.pdf * probability, ds.weight * inverse, weight",
        "two lights",
    ),
    Fault(
        "area lights shine backwards",
        "djpt.emitters.area:Area.sample_direction",
        "dr.dot(ds.d, ds.n) < 0",
        "dr.dot(ds.d, ds.n) > 0",
        "rectangle overhead",
    ),
    Fault(
        "density of lights per area",
        "djpt.emitters.area:Area.pdf_direction",
        "self.shape.direction_density(it.p, ds)",
        "dr.rcp(self.shape.surface_area())",
        "rectangle overhead",
    ),
    Fault(
        "eta squared missing",
        "djpt.materials.dielectric:Dielectric.lobes",
        "tint_t * dr.square(eta_ti)",
        "tint_t",
        "lamp under water",
    ),
    Fault(
        "one polarisation only",
        "djpt.materials.dielectric:fresnel",
        "dr.square((cos_i - s) * d_p) + dr.square((p - cos_t) * d_s)",
        "2 * dr.square((cos_i - s) * d_p)",
        "slab of glass",
    ),
    Fault(
        "metals without absorption",
        "djpt.materials.conductor:fresnel_conductor",
        "product = eta * k",
        "product = eta * 0 * k",
        "metal",
    ),
    Fault(
        "phase function backwards",
        f"{PHASE}.eval_pdf",
        "dr.fma(2 * self.g,",
        "dr.fma(-2 * self.g,",
        "slab in sunlight",
        "volpath",
    ),
    Fault(
        "albedo of media dropped",
        "djpt.media.homogeneous:Homogeneous.fly",
        "dr.select(scattered, albedo, 1)",
        "Color3f(1)",
        "slab in sunlight",
        "volpath",
    ),
    Fault(
        "free flights too long",
        "djpt.media.homogeneous:Homogeneous.drawn",
        "-dr.log(1 -",
        "-1.1 * dr.log(1 -",
        "absorbing ball",
        "volpath",
    ),
    Fault(
        "media cast no shadow",
        "djpt.media.homogeneous:Homogeneous.transmittance",
        "dr.exp(-minimum(length, FAR) * sigma_t)",
        "Color3f(1)",
        "slab in sunlight",
        "volpath",
    ),
    Fault(
        "texture flipped",
        "djpt.textures.bitmap:Bitmap._lookup",
        "dr.floor(y)",
        "(1 - dr.floor(y))",
        "painted floor",
    ),
)
"""Faults of images."""


def caught(fault: Fault) -> bool:
    """Whether a closed form fails with the fault."""
    name, _, roulette = fault.integrator.partition(", ")
    settings = {"rr_depth": 1} if roulette else None
    outcomes = list(validate([CASES[fault.case]], [name], spp=4096, settings=settings))
    assert len(outcomes) == 1
    return not outcomes[0].passed


@pytest.mark.sparse(5)
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_faults_of_images_are_caught(fault: Fault) -> None:
    with planted(fault.target, fault.old, fault.new):
        assert caught(fault)


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_nothing_is_caught_without_a_fault(fault: Fault) -> None:
    assert not caught(fault)


DERIVATIVES = (
    (
        "gradient sign",
        "djpt.rendering.gradients.modes:Reverse.differentiate",
        "dr.dot(outgoing, adjoint)",
        "-dr.dot(outgoing, adjoint)",
    ),
    (
        "gradient doubled",
        "djpt.rendering.gradients.modes:Reverse.differentiate",
        "dr.dot(outgoing, adjoint)",
        "2 * dr.dot(outgoing, adjoint)",
    ),
    (
        "light still to come not reduced",
        "djpt.rendering.gradients.modes:Mode.outgoing",
        "walk.radiance - passed",
        "walk.radiance",
    ),
    (
        "direct light not differentiated",
        "djpt.rendering.gradients.modes:Mode.outgoing",
        "here = v.emitted + arrived",
        "here = v.emitted + dr.detach(arrived)",
    ),
    (
        "in one walk, gradient sign",
        "djpt.rendering.gradients.single_walk:in_reverse",
        "dr.dot(here, attached)",
        "-dr.dot(here, attached)",
    ),
    (
        "in one walk, weights not differentiated",
        "djpt.rendering.gradients.single_walk:in_reverse",
        "slope * scale[channel]",
        "0 * slope",
    ),
)
"""Faults of derivatives: name, place, text and its replacement."""


def test_faults_are_in_the_code_of_today() -> None:
    """Few of them are rendered in `make test`."""
    for _, target, old, new, *_ in (*FAULTS, *DERIVATIVES):
        with planted(target, old, new):
            pass


@pytest.mark.sparse(3)
@pytest.mark.parametrize(("name", "target", "old", "new"), DERIVATIVES, ids=[row[0] for row in DERIVATIVES])
def test_faults_of_derivatives_are_caught(
    name: str, target: str, old: str, new: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "single_walk" not in target:
        monkeypatch.setattr(single_walk, "possible", lambda mode: False)
    scene = override(djpt.cornell_box(), width=8)
    options = {"spp": 64, "seeds": 6, "most_seeds": 6, "mitsuba": False}
    with planted(target, old, new):
        result = check_gradient(scene, "white.reflectance.value", **options)  # type: ignore[arg-type]
    assert not result.passed
    assert any("differences" in verdict.what for verdict in result.failures), result

"""What users write themselves: a BSDF, an emitter, a filter, an integrator, in Mitsuba's signatures."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, has_flag
from djpt.core.warp import square_to_cosine_hemisphere, square_to_uniform_sphere
from djpt.description.plugin import ParamFlags
from djpt.emitters import Emitter
from djpt.errors import SceneError
from djpt.integrators import Integrator
from djpt.jit.types import Bool, Color3f, Float, Point3f, UInt32, Vector3f
from djpt.materials import BSDF
from djpt.rfilters.base import ReconstructionFilter
from djpt.samplers import SampleIndex
from djpt.validation import agreement
from tests.kit.derivatives import by_both
from tests.kit.renders import box, lights, ours, pixels, spheres, theirs

PATH = {"type": "path", "max_depth": 5}


# ---------------------------------------------------------------- a BSDF


class Tinted(BSDF):
    """Lambertian, its colour the product of a value of its own and a nested texture."""

    values: ClassVar = {"tint": ParamFlags.Differentiable}
    children = ("base",)

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.tint: Any = Color3f(*props.vector("tint", (1, 1, 1)).tolist())
        self.base = props.texture("base", 0.5, low=0.0, high=1.0)

    def flags(self) -> int:
        return int(BSDFFlags.DiffuseReflection | BSDFFlags.FrontSide)

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        wo = square_to_cosine_hemisphere(sample2)
        pdf = wo.z / math.pi
        weight = dr.select((si.wi.z > 0) & (pdf > 0), self.tint * self.base.eval(si, active), 0)
        return BSDFSample3f.of(wo, pdf, BSDFFlags.DiffuseReflection), weight

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return self.tint * self.base.eval(si, active) * self.pdf(ctx, si, wo, active)

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return dr.select((si.wi.z > 0) & (wo.z > 0), wo.z / math.pi, 0)


class Mirror(BSDF):
    """A perfect mirror on both sides: a delta lobe."""

    def flags(self) -> int:
        return int(BSDFFlags.DeltaReflection | BSDFFlags.FrontSide | BSDFFlags.BackSide)

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        wo = Vector3f(-si.wi.x, -si.wi.y, si.wi.z)
        return BSDFSample3f.of(wo, 1, BSDFFlags.DeltaReflection), Color3f(1)

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return Color3f(0)

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return Float(0)


djpt.register_bsdf("tinted", Tinted)
djpt.register_bsdf("plain_mirror", Mirror)


def tinted(scene: dict[str, Any]) -> None:
    """The red wall and the boxes in a user's material that equals the built-in one."""
    red = scene["red"]["reflectance"]["value"]
    scene["red"] = {"type": "tinted", "tint": [2 * x for x in red], "base": 0.5}
    tint = {"type": "rgb", "value": [0.885809, 0.698859, 0.666422]}
    scene["small-box"]["bsdf"] = {"type": "tinted", "base": tint}


@pytest.mark.parametrize("schedule", ["flat", "wave"])
@pytest.mark.parametrize("integrator", [PATH, {"type": "direct"}], ids=["path", "direct"])
def test_bsdf_like_the_built_in_one(integrator: dict[str, Any], schedule: str) -> None:
    if integrator["type"] == "direct":
        schedule = "auto"
    image = ours(box(48, "box", integrator, tinted), 8, schedule=schedule)
    reference = ours(box(48, "box", integrator), 8, schedule=schedule)
    assert agreement(image, reference, 1e-4).share > 0.999


def test_bsdf_parameters_are_edited_and_differentiated() -> None:
    description = box(16, "box", {"type": "prb", "max_depth": 4, "rr_depth": 1000}, tinted)
    scene = djpt.load_dict(description)
    assert djpt.traverse(scene).flags("red.tint").differentiable
    found, expected = by_both(scene, "red.tint", 0.02, [1, 0, 0], seed=2, spp=16)
    assert found == pytest.approx(expected, rel=3e-3)


def test_delta_bsdf_against_mitsuba() -> None:
    """A mirror, Mitsuba's `conductor` without a material: seen lights get the MIS weight 1."""
    pytest.importorskip("mitsuba")

    def edit(name: str) -> Any:
        def apply(scene: dict[str, Any]) -> None:
            spheres(scene)
            scene["small-sphere"]["bsdf"] = {"type": name}
            if name == "conductor":
                scene["small-sphere"]["bsdf"] = {"type": "twosided", "inner": {"type": name, "material": "none"}}

        return apply

    image = ours(box(64, "box", PATH, edit("plain_mirror")), 8, 1)
    reference = theirs(box(64, "box", PATH, edit("conductor")), 8, 1)
    assert agreement(image, reference, 1e-3).share > 0.99
    assert image.mean() == pytest.approx(reference.mean(), rel=1e-3)


# ---------------------------------------------------------------- an emitter and a filter


class Sunlight(Emitter):
    """Parallel light from above: a delta direction."""

    values: ClassVar = {"irradiance": ParamFlags.Differentiable}

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.irradiance: Any = Float(props.float("irradiance", 1.0, low=0.0))

    def flags(self) -> int:
        from djpt.core.records import EmitterFlags

        return int(EmitterFlags.DeltaDirection)

    def eval(self, si: Any, active: Any = True) -> Any:
        return Color3f(0)

    def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
        d = Vector3f(0, 1, 0)
        far = it.p + d * 1e3
        ds = djpt.DirectionSample3f.of(
            far, -d, sample * 0, d, Float(1e3), Float(1), Float(1), Bool(True), UInt32(0)
        )  # fmt: skip
        return ds, Color3f(self.irradiance)

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        return Float(0)


class Triangle(ReconstructionFilter):
    """A tent of two pixels."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.reach = 2.0

    def eval(self, x: Any) -> Any:
        w = 1 - dr.abs(x) * 0.5
        return dr.select(w > 0, w, 0)


djpt.register_emitter("sunlight", Sunlight)
djpt.register_rfilter("triangle", Triangle)


def test_emitter_by_formula() -> None:
    """A floor under parallel light: L = albedo E / pi."""
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "sensor": box(8)["sensor"],
        "wall": {
            "type": "rectangle",
            "to_world": djpt.ScalarTransform4f().rotate([1, 0, 0], -60).scale(50.0),
            "bsdf": {"type": "diffuse", "reflectance": 0.4},
        },
        "sun": {"type": "sunlight", "irradiance": 3.0},
    }
    scene["sensor"]["film"].update(width=8, height=8)
    expected = 0.4 / math.pi * 3.0 * math.cos(math.radians(30))
    np.testing.assert_allclose(ours(scene, 4), expected, rtol=1e-5)


@pytest.mark.parametrize("edit", [None, lights()], ids=["box", "lights"])
def test_filter_like_the_built_in_one(edit: Any) -> None:
    image = ours(box(24, "triangle", PATH, edit), 4)
    np.testing.assert_allclose(image, ours(box(24, {"type": "tent", "radius": 2.0}, PATH, edit), 4), rtol=2e-5)


# ---------------------------------------------------------------- integrators


class AmbientOcclusion(Integrator):
    """Which share of the sky within a radius is free: no light, one shadow ray."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.radius = props.float("radius", 1.0, low=0.0)

    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
        si = scene.ray_intersect(ray, active)
        d = si.to_world(square_to_cosine_hemisphere(sampler.next_2d()))
        probe = si.spawn_ray(d)
        probe.maxt = Float(self.radius)
        free = ~scene.ray_test(probe, si.is_valid())
        return Color3f(dr.select(si.is_valid() & free, 1.0, 0.0)), si.is_valid(), []


def power(a: Any, b: Any) -> Any:
    """The power heuristic; squares of densities near an edge of a lamp overflow."""
    weight = a**2 / (a**2 + b**2)
    return dr.select(dr.isfinite(weight), weight, 0)


class Textbook(Integrator):
    """A path tracer as in a textbook: a symbolic loop, light sampling with MIS, no roulette."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.max_depth = props.integer("max_depth", 4, low=1)

    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
        lanes = dr.width(ray.d)
        ctx = BSDFContext()

        def body(ray: Any, sampler: Any, f: Any, result: Any, p: Any, pdf: Any, depth: Any, active: Any) -> Any:
            si = scene.ray_intersect(ray, active)
            ds = djpt.DirectionSample3f.between(p, ray, si)
            light_pdf = scene.pdf_emitter_direction(p, ds)
            mis = dr.select(depth == 0, 1, power(pdf, light_pdf))
            result = result + f * dr.select(active, si.emitter(scene).eval(si) * mis, 0)
            active = active & si.is_valid() & (depth + 1 < self.max_depth)

            bsdf = si.bsdf(ray)
            ds, weight = scene.sample_emitter_direction(si, sampler.next_2d(), True, active)
            value, bsdf_pdf = bsdf.eval_pdf(ctx, si, si.to_local(ds.d), active)
            mis = dr.select(ds.delta, 1, power(ds.pdf, bsdf_pdf))
            result = result + dr.select(active, f * value * weight * mis, 0)

            bs, weight = bsdf.sample(ctx, si, sampler.next_1d(), sampler.next_2d(), active)
            f = f * weight
            active = active & (dr.max(f) > 0)
            return si.spawn_ray(si.to_world(bs.wo)), sampler, f, result, Point3f(si.p), bs.pdf, depth + 1, active

        wide = dr.zeros(Float, lanes)
        start = djpt.Ray3f(ray.o + wide, ray.d + wide, maxt=ray.maxt + wide)
        state = (
            start,
            sampler,
            Color3f(1) + wide,
            Color3f(0) + wide,
            Point3f(0) + wide,
            Float(1) + wide,
            dr.zeros(UInt32, lanes),
            dr.full(Bool, True, lanes) & active,
        )
        state = dr.while_loop(state, lambda *s: s[-1], body)
        return state[3], start.d.x == start.d.x, []


djpt.register_integrator("corner_occlusion", AmbientOcclusion)
djpt.register_integrator("textbook", Textbook)


def test_ambient_occlusion_of_a_corner() -> None:
    """On the floor at the foot of an endless wall half of all directions are free, cosine-weighted."""
    floor = {"type": "rectangle", "to_world": djpt.ScalarTransform4f().scale(1000.0)}
    turned = djpt.ScalarTransform4f().translate([-1e-3, 0, 0]).rotate([0, 1, 0], 90).scale(1000.0)
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    view = djpt.ScalarTransform4f().look_at([1, 1, 1], [0.0, 0, 0], [0, 0, 1])
    sensor = {"type": "perspective", "fov": 1e-3, "to_world": view, "film": film}
    scene = {"type": "scene", "floor": floor, "wall": {"type": "rectangle", "to_world": turned}, "sensor": sensor}
    for radius, expected in ((100.0, 0.5), (1e-4, 1.0)):
        scene["integrator"] = {"type": "corner_occlusion", "radius": radius}
        assert ours(scene, 1024).mean() == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("edit", [None, lights(), spheres], ids=["box", "lights", "spheres"])
def test_textbook_path_tracer(edit: Any) -> None:
    """With roulette off, `path` draws one number more per vertex only when it plays: images agree."""
    image = ours(box(48, "box", {"type": "textbook", "max_depth": 4}, edit), 128)
    reference = ours(box(48, "box", {"type": "path", "max_depth": 4, "rr_depth": 1000}, edit), 128, seed=1)
    assert image.mean() == pytest.approx(reference.mean(), rel=0.01)
    blocks = [x.reshape(4, 12, 4, 12, 3).mean(axis=(1, 3)) for x in (image, reference)]
    np.testing.assert_allclose(*blocks, rtol=0.15, atol=0.02)


def test_textbook_path_tracer_is_refused_by_flat() -> None:
    with pytest.raises(djpt.RenderError, match="wave"):
        ours(box(8, "box", {"type": "textbook"}), 1, schedule="flat")


class WithVariables(Integrator):
    """Two AOVs beside the colour, one of them computed from it."""

    def aov_names(self) -> Any:
        return ("red.twice", "depth")

    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
        si = scene.ray_intersect(ray, active)
        color = si.bsdf().eval_diffuse_reflectance(si, si.is_valid())
        return color, si.is_valid(), [2 * color.x, dr.select(si.is_valid(), si.t, 0)]


djpt.register_integrator("with_variables", WithVariables)


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_own_aovs(rfilter: str) -> None:
    image = ours(box(24, rfilter, {"type": "with_variables"}), 4)
    depth = ours(box(24, rfilter, {"type": "depth"}), 4)
    assert image.shape == (24, 24, 5)
    np.testing.assert_allclose(image[..., 3], 2 * image[..., 0], rtol=1e-5)
    np.testing.assert_allclose(image[..., 4], depth[..., 0], rtol=1e-5)


class TestDifferentiatedAOVs:
    """A linear image, whose derivative is a coverage."""

    options: ClassVar = {"spp": 4, "seed": 1, "seed_grad": 1}

    def attach(self, rfilter: str) -> tuple[Any, Any]:
        scene = djpt.load_dict(box(12, rfilter, {"type": "with_variables"}))
        params = djpt.traverse(scene)
        dr.enable_grad(params["red.reflectance.value"])
        params.update()
        return params["red.reflectance.value"], djpt.render(scene, params, **self.options)

    @pytest.mark.parametrize("rfilter", ["box", "gaussian"])
    def test_forward(self, rfilter: str) -> None:
        red, image = self.attach(rfilter)
        dr.set_grad(red, Color3f(1, 0, 0))
        change = pixels(dr.forward_to(image))
        np.testing.assert_allclose(change[..., 3], 2 * change[..., 0], rtol=1e-4)
        assert 1 < change[..., 0].sum() < 100
        assert np.abs(change[..., [1, 2, 4]]).max() == 0

    @pytest.mark.parametrize("rfilter", ["box", "gaussian"])
    def test_reverse(self, rfilter: str) -> None:
        red, image = self.attach(rfilter)
        dr.backward(dr.sum(image.array))
        gradient = np.array(dr.grad(red)).ravel()
        assert 1 < gradient[2] < 100
        np.testing.assert_allclose(gradient / gradient[2], [3, 1, 1], rtol=1e-4)


# ---------------------------------------------------------------- asking a scene


def test_queries_from_a_script() -> None:
    """Rays by hand, as in Mitsuba's tutorials."""
    scene = djpt.load_dict(djpt.cornell_box())
    ray = djpt.Ray3f(Point3f(0, 0, 3.9), Vector3f([0.0, 0.1, 2], [0, 0, 0], [-1, -1, 1]), maxt=Float(dr.inf))
    si = scene.ray_intersect(ray)
    assert np.array(si.is_valid()).tolist() == [True, True, False]
    np.testing.assert_allclose(np.array(si.wi.z)[0], np.array(si.n.z)[0], atol=1e-6)
    assert isinstance(si.bsdf().flags(), UInt32)
    assert not np.array(has_flag(si.emitter(scene).flags(), 8)).any()
    lamp = scene.ray_intersect(djpt.Ray3f(Point3f(0, 0, 0), Vector3f(0, 1, 0), maxt=Float(dr.inf)))
    np.testing.assert_allclose(np.array(lamp.emitter(scene).eval(lamp)).ravel(), [18.387, 13.9873, 6.75357], rtol=1e-6)
    assert [shape.id() for shape in scene.shapes()][:2] == ["light", "floor"]
    assert len(scene.sensors()) == len(scene.emitters()) == 1
    low, high = scene.bbox()
    np.testing.assert_allclose([low, high], [[-1, -1.01, -1], [1, 1, 1]], atol=1e-6)


def test_sampler_and_warp_from_a_script() -> None:
    stream = djpt.load_dict({"type": "independent"}).stream(
        UInt32(0), SampleIndex(dr.arange(UInt32, 1000), UInt32(0), UInt32(1), UInt32(1))
    )
    d = square_to_uniform_sphere(stream.next_2d())
    np.testing.assert_allclose(np.linalg.norm(np.array(d), axis=0), 1, atol=1e-6)


def test_names_of_other_kinds_are_taken() -> None:
    with pytest.raises(SceneError, match="another kind"):
        djpt.register_bsdf("path", Tinted)

"""BSDFs of users' own: in djpt's style, and scripts written for Mitsuba, which declare nothing."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.jit.types import UInt32
from djpt.validation import agreement
from tests.kit.derivatives import by_both
from tests.kit.kernels import kernels
from tests.kit.renders import box, ours, pixels, theirs
from tests.kit.swatches import swatches

PATH = {"type": "path", "max_depth": 5}
PRB = {"type": "prb", "max_depth": 4, "rr_depth": 1000}

SCRIPT = '''
import drjit as dr


class Gloss(mi.BSDF):
    """A tinted sheet that mirrors by Fresnel's law and lets the rest through."""

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        self.eta = 1.33
        if "eta" in props:
            self.eta = props["eta"]
        self.tint = mi.Color3f(props["tint"])
        reflection = mi.BSDFFlags.DeltaReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        passage = mi.BSDFFlags.Null | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [reflection, passage]
        self.m_flags = reflection | passage

    def sample(self, ctx, si, sample1, sample2, active):
        cos_theta = mi.Frame3f.cos_theta(si.wi)
        r = mi.fresnel(dr.abs(cos_theta), self.eta)[0]
        mirrored = (sample1 <= r) & active
        bs = mi.BSDFSample3f()
        bs.pdf = dr.select(mirrored, r, 1 - r)
        bs.sampled_component = dr.select(mirrored, mi.UInt32(0), mi.UInt32(1))
        bs.sampled_type = dr.select(
            mirrored, mi.UInt32(+mi.BSDFFlags.DeltaReflection), mi.UInt32(+mi.BSDFFlags.Null)
        )
        bs.wo = dr.select(mirrored, mi.reflect(si.wi), -si.wi)
        bs.eta = 1.0
        value = dr.lerp(mi.Color3f(self.tint), mi.Color3f(1.0), dr.clip(dr.abs(cos_theta), 0.0, 1.0))
        return bs, dr.select(mirrored, value, mi.Color3f(1.0)) & active

    def eval(self, ctx, si, wo, active):
        return 0.0

    def pdf(self, ctx, si, wo, active):
        return 0.0

    def eval_pdf(self, ctx, si, wo, active):
        return 0.0, 0.0

    def traverse(self, callback):
        callback.put("tint", self.tint, mi.ParamFlags.Differentiable)

    def parameters_changed(self, keys):
        self.told = keys

    def to_string(self):
        return "Gloss[tint=%s]" % self.tint


class Velvet(mi.BSDF):
    """Brighter towards the rim: f = tint (1 - rim + rim (1 - cos_i cos_o)) / pi."""

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        self._tint = mi.Color3f(props["tint"])
        self.rim = mi.Float(props.get("rim", 0.8))
        self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
        self.m_components = [self.m_flags]

    def _shine(self, si, wo):
        return self._tint * (1 - self.rim + self.rim * (1 - si.wi.z * wo.z))

    def sample(self, ctx, si, sample1, sample2, active):
        wo = mi.warp.square_to_cosine_hemisphere(sample2)
        active &= (si.wi.z > 0) & (wo.z > 0)
        bs = mi.BSDFSample3f(wo)
        bs.pdf = mi.warp.square_to_cosine_hemisphere_pdf(wo)
        bs.eta = 1.0
        bs.sampled_type = mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
        bs.sampled_component = 0
        return bs, self._shine(si, wo) & active

    def eval(self, ctx, si, wo, active):
        active &= (si.wi.z > 0) & (wo.z > 0)
        return (self._shine(si, wo) * dr.inv_pi * wo.z) & active

    def pdf(self, ctx, si, wo, active):
        return dr.select((si.wi.z > 0) & (wo.z > 0), mi.warp.square_to_cosine_hemisphere_pdf(wo), 0.0)

    def eval_pdf(self, ctx, si, wo, active):
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    def traverse(self, callback):
        callback.put("tint", self._tint, mi.ParamFlags.Differentiable)
        callback.put("rim", self.rim, mi.ParamFlags.Differentiable)


mi.register_bsdf("gloss", Gloss)
mi.register_bsdf("velvet", Velvet)
'''


def run(mi: Any) -> dict[str, Any]:
    """The script with `mi` for Mitsuba: nothing else is different."""
    names = {"mi": mi, "__name__": "script"}
    exec(compile(SCRIPT, "script.py", "exec"), names)
    return names


CLASSES = run(djpt)


def velvet(r: float, g: float, b: float, **values: Any) -> dict[str, Any]:
    return {"type": "velvet", "tint": {"type": "rgb", "value": [r, g, b]}, **values}


def scripted(scene: dict[str, Any]) -> None:
    """Walls of velvet and a glossy sheet before the boxes."""
    scene["white"] = velvet(0.8, 0.7, 0.6)
    scene["red"] = velvet(0.7, 0.1, 0.1, rim=0.3)
    scene["small-box"]["bsdf"] = velvet(0.2, 0.4, 0.9, rim=0.5)
    scene["sheet"] = {
        "type": "rectangle",
        "to_world": djpt.ScalarTransform4f().translate([0.1, -0.2, 0.75]).rotate([0, 1, 0], 50).scale(0.4),
        "bsdf": {"type": "gloss", "tint": [0.2, 0.9, 0.3], "eta": 2.5},
    }


@pytest.mark.parametrize("integrator", [PATH, {"type": "direct"}], ids=["path", "direct"])
def test_a_script_gives_mitsubas_pixels(integrator: dict[str, Any]) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    run(mi)
    image = ours(box(48, "box", integrator, scripted), 8, 3)
    reference = theirs(box(48, "box", integrator, scripted), 8, 3)
    assert agreement(image, reference, 1e-3).share > 0.97
    assert image.mean() == pytest.approx(reference.mean(), rel=2e-3)


def test_instances_are_traced_as_one_and_keep_their_values() -> None:
    scene = djpt.load_dict(box(16, "box", PATH, scripted))
    groups = {type(group.plugins[0]).__name__: len(group.plugins) for group in scene.bsdfs.ensemble.groups}
    assert groups == {"Velvet": 3, "Gloss": 1, "Diffuse": 1}
    params = djpt.traverse(scene)
    assert float(np.array(params["red.rim"]).item()) == pytest.approx(0.3)
    assert {"red.tint", "red.rim", "sheet.bsdf.tint"} <= set(params)

    # A class that is traced once for each instance is the reference.
    class Alone(CLASSES["Velvet"]):  # type: ignore[misc]
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.number = object()

    djpt.register_bsdf("velvet", Alone)
    try:
        apart = djpt.load_dict(box(16, "box", PATH, scripted))
        assert len(apart.bsdfs.ensemble.groups) == 5
        np.testing.assert_allclose(pixels(djpt.render(scene, spp=4)), pixels(djpt.render(apart, spp=4)), rtol=1e-5)
    finally:
        djpt.register_bsdf("velvet", CLASSES["Velvet"])


def test_edits_take_effect_and_compile_nothing() -> None:
    scene = djpt.load_dict(box(16, "box", PATH, scripted))
    params = djpt.traverse(scene)
    before = kernels(lambda: djpt.render(scene, spp=4))
    params["red.tint"] = [0.1, 0.6, 0.1]
    params["small-box.bsdf.rim"] = 0.1
    params["sheet.bsdf.tint"] = [1.0, 0.0, 0.0]
    params.update()
    assert scene.bsdfs.plugins  # the scene itself is the same
    assert kernels(lambda: djpt.render(scene, spp=4)) <= before

    def edited(description: dict[str, Any]) -> None:
        scripted(description)
        description["red"]["tint"]["value"] = [0.1, 0.6, 0.1]
        description["small-box"]["bsdf"]["rim"] = 0.1
        description["sheet"]["bsdf"]["tint"] = [1.0, 0.0, 0.0]

    np.testing.assert_allclose(pixels(djpt.render(scene, spp=4)), ours(box(16, "box", PATH, edited), 4), rtol=1e-5)


@pytest.mark.sparse(3)
@pytest.mark.parametrize("name", ["red.tint", "red.rim", "white.tint", "small-box.bsdf.rim", "sheet.bsdf.tint"])
def test_gradients_against_differences(name: str) -> None:
    scene = djpt.load_dict(box(16, "box", PRB, scripted))
    found, expected = by_both(scene, name, 0.01, seed=5, spp=16)
    assert abs(expected) > 0.05
    assert found == pytest.approx(expected, rel=3e-3)


def test_as_fast_as_a_built_in_one() -> None:
    """The kernel of a script's Lambertian walls has as many instructions as that of `diffuse`."""

    class Lambert(djpt.BSDF):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.tint = props["reflectance"]

        def flags(self) -> Any:
            return djpt.BSDFFlags.DiffuseReflection | djpt.BSDFFlags.FrontSide

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            wo = djpt.warp.square_to_cosine_hemisphere(sample2)
            pdf = wo.z * dr.inv_pi
            weight = dr.select((si.wi.z > 0) & (pdf > 0), self.tint, 0)
            return djpt.BSDFSample3f(wo, pdf, sampled_type=UInt32(2)), weight

        # `eval` and `pdf` follow from this one.
        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            pdf = dr.select((si.wi.z > 0) & (wo.z > 0), wo.z * dr.inv_pi, 0)
            return self.tint * pdf, pdf

    djpt.register_bsdf("script_lambert", Lambert)

    def instructions(name: str) -> int:
        def edit(scene: dict[str, Any]) -> None:
            for key in ("white", "red", "green"):
                scene[key]["type"] = name
            scene["light"]["bsdf"] = {"type": "ref", "id": "white"}

        scene = djpt.load_dict(box(16, "box", PATH, edit))
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            djpt.render(scene, spp=4)
            return max(k["operation_count"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT)

    assert instructions("script_lambert") <= instructions("diffuse") + 5


@pytest.mark.parametrize(
    "description",
    [
        {"type": "twosided", "inner": velvet(0.5, 0.3, 0.2)},
        {"type": "mask", "opacity": 0.6, "inner": velvet(0.5, 0.3, 0.2)},
        {"type": "mask", "opacity": 0.6, "inner": {"type": "gloss", "tint": [0.1, 0.5, 0.5]}},
        {"type": "blendbsdf", "weight": 0.5, "a": velvet(0.5, 0.3, 0.2), "b": {"type": "gloss", "tint": [1, 1, 1]}},
    ],
    ids=["twosided", "mask", "mask of deltas", "blend"],
)
def test_scripts_can_be_nested(description: dict[str, Any]) -> None:
    image = pixels(djpt.render(swatches(a=description), spp=64, integrator=djpt.load_dict(PATH)))
    assert np.isfinite(image).all()
    assert 0.1 < image.mean() <= 1.05


def test_printing_and_telling() -> None:
    bsdf = djpt.load_dict({"type": "gloss", "tint": [0.1, 0.2, 0.3]})
    assert repr(bsdf).startswith("Gloss[tint=")
    params = djpt.traverse(bsdf)
    params["tint"] = [1, 1, 1]
    params.update()
    assert bsdf.told == ["tint"]
    assert bsdf.flags() & int(djpt.BSDFFlags.Null)


def test_flags_and_records_are_mitsubas() -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    assert {flag.name: int(flag) for flag in mi.BSDFFlags if flag.name in djpt.BSDFFlags.__members__} == {
        name: int(flag) for name, flag in djpt.BSDFFlags.__members__.items()
    }
    for record in (djpt.BSDFSample3f(), djpt.BSDFSample3f(djpt.Vector3f(0, 0, 1))):
        assert (record.pdf[0], record.eta[0], record.sampled_type[0]) == (0, 1, 0)
    for context in (djpt.BSDFContext(), djpt.BSDFContext(djpt.TransportMode.Importance, 0x1FF, 0xFFFFFFFF)):
        assert context.is_enabled(djpt.BSDFFlags.Null, 3)
    assert djpt.BSDFContext().mode == djpt.TransportMode.Radiance


def test_wrong_keys() -> None:
    with pytest.raises(djpt.SceneError, match="'gloss' needs the key 'tint'"):
        djpt.load_dict({"type": "gloss"})
    with pytest.raises(djpt.SceneError, match=r"unknown key 'tnit' of .*'gloss'"):
        djpt.load_dict({"type": "gloss", "tint": [1, 1, 1], "tnit": 3})

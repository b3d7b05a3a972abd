"""What scripts ask BSDFs: flags, lobes, attributes, and one lobe at a time, as Mitsuba answers."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt import BSDFContext, BSDFFlags, TransportMode
from djpt.errors import DjptError
from djpt.jit.types import Color3f, Vector3f
from tests.kit.arrays import floats, in_numpy, rows
from tests.kit.materials import interaction

CHECKS = {"type": "checkerboard", "color0": 0.3, "color1": 0.9}
DIFFUSE, ROUGH = {"type": "diffuse"}, {"type": "roughconductor", "alpha": 0.3}
CASES: dict[str, dict[str, Any]] = {
    "diffuse": DIFFUSE,
    "conductor": {"type": "conductor", "material": "Au"},
    "roughconductor": ROUGH,
    "anisotropic metal": {"type": "roughconductor", "alpha_u": 0.1, "alpha_v": 0.3},
    "dielectric": {"type": "dielectric"},
    "thindielectric": {"type": "thindielectric"},
    "roughdielectric": {"type": "roughdielectric", "alpha": 0.4},
    "anisotropic glass": {"type": "roughdielectric", "alpha_u": 0.1, "alpha_v": 0.3},
    "plastic": {"type": "plastic", "diffuse_reflectance": CHECKS},
    "roughplastic": {"type": "roughplastic", "alpha": 0.4},
    "principled": {"type": "principled"},
    "coat and glass": {"type": "principled", "clearcoat": 0.5, "spec_trans": 0.4, "anisotropic": 0.3},
    "principledthin": {"type": "principledthin", "spec_trans": 0.3, "diff_trans": 0.6},
    "mask": {"type": "mask", "opacity": 0.7, "b": ROUGH},
    "twosided": {"type": "twosided", "b": DIFFUSE},
    "two sides": {"type": "twosided", "a": DIFFUSE, "b": {"type": "roughplastic", "alpha": 0.4}},
    "blend": {"type": "blendbsdf", "weight": 0.3, "a": DIFFUSE, "b": {"type": "roughplastic", "alpha": 0.4}},
    "null": {"type": "null"},
    "bumps": {"type": "bumpmap", "t": CHECKS, "b": {"type": "roughplastic", "alpha": 0.4}},
}
SINGLE = {"principled", "coat and glass", "principledthin"}
"""BSDFs that give all lobes to all contexts, as in Mitsuba."""
COUNT = 64


@pytest.mark.parametrize("name", CASES)
@pytest.mark.sparse(4)
def test_flags_and_counts_are_mitsubas(mi: Any, name: str) -> None:
    mine, his = (module.load_dict(CASES[name]) for module in (djpt, mi))
    assert mine.component_count() == his.component_count()
    assert mine.flags() == int(his.flags())
    for i in range(mine.component_count()):
        assert mine.flags(i) == int(his.flags(i))
    assert mine.needs_differentials() == his.needs_differentials()


def asked(module: Any, bsdf: Any, ctx: Any) -> list[np.ndarray]:
    """The answers of a BSDF to random questions."""
    u = np.random.default_rng(5).random((9, COUNT), dtype=np.float32)
    turned = 2 * np.pi * u[:2]
    z = 2 * u[2:4] - 1
    wi, wo = (
        np.stack([np.sqrt(1 - c * c) * np.cos(a), np.sqrt(1 - c * c) * np.sin(a), c])
        for a, c in zip(turned, z, strict=True)
    )
    Vector = module.Vector3f
    if module is djpt:
        si = interaction(Vector(*rows(wi)), (0.31, 0.62), COUNT)
    else:
        si = dr.zeros(module.SurfaceInteraction3f, COUNT)
        si.t, si.n, si.sh_frame = 1, module.Normal3f(0, 0, 1), module.Frame3f(module.Normal3f(0, 0, 1))
        si.wi, si.uv = Vector(*rows(wi)), module.Point2f(0.31, 0.62)
        si.dp_du, si.dp_dv = Vector(1, 0, 0), Vector(0, 1, 0)
    value, pdf = bsdf.eval_pdf(ctx, si, Vector(*rows(wo)))
    bs, weight = bsdf.sample(ctx, si, floats(u[4]), module.Point2f(*rows(u[5:7])))
    again = bsdf.eval_pdf_sample(ctx, si, Vector(*rows(wo)), floats(u[4]), module.Point2f(*rows(u[5:7])))
    # Where nothing is scattered, densities are anything in Mitsuba, negative ones included.
    found, seen = dr.max(weight) > 1e-6, dr.max(value) > 0
    densities = [dr.select(seen, pdf, 0), dr.select(seen, again[1], 0), dr.select(found, bs.pdf, 0)]
    answers = [value, weight, again[0], again[3], *densities]
    dr.eval(answers)
    return [np.broadcast_to(in_numpy(x), (*in_numpy(x).shape[:-1], COUNT)) for x in answers]


def contexts(module: Any, count: int) -> list[Any]:
    make, flags, mode = module.BSDFContext, module.BSDFFlags, module.TransportMode.Radiance
    masks = (flags.Reflection, flags.Transmission, flags.Diffuse, flags.Delta)
    return [make(mode, int(mask), None) for mask in masks] + [make(mode, int(flags.All), i) for i in range(count)]


@pytest.mark.sparse(6)
@pytest.mark.parametrize("name", sorted(set(CASES) - SINGLE - {"mask", "bumps", "twosided", "two sides"}))
def test_single_lobes_are_mitsubas(mi: Any, name: str) -> None:
    """Left out is what Mitsuba 3.9.1 answers otherwise.

    Masks sample both ways if one is asked for, bumps have another tangent, and what is asked of one side of a two-sided
    BSDF is answered by the other side, too.
    """
    mine, his = (module.load_dict(CASES[name]) for module in (djpt, mi))
    count = mine.component_count()
    for own, theirs in zip(contexts(djpt, count), contexts(mi, count), strict=True):
        for a, b in zip(asked(djpt, mine, own), asked(mi, his, theirs), strict=True):
            np.testing.assert_allclose(a, b, rtol=2e-3, atol=2e-4, err_msg=f"{own}")


@pytest.mark.sparse(6)
@pytest.mark.parametrize("name", sorted(set(CASES) - SINGLE))
def test_lobes_add_up(name: str) -> None:
    bsdf = djpt.load_dict(CASES[name])
    whole = asked(djpt, bsdf, BSDFContext())[0]
    parts = [
        asked(djpt, bsdf, BSDFContext(TransportMode.Radiance, int(BSDFFlags.All), i))[0]
        for i in range(bsdf.component_count())
    ]
    np.testing.assert_allclose(sum(parts), whole, rtol=1e-4, atol=1e-6)


def test_contexts_are_mitsubas(mi: Any) -> None:
    for module in (djpt, mi):
        ctx = module.BSDFContext()
        assert (int(ctx.type_mask), ctx.component) == (0x1FF, 0xFFFFFFFF)
        ctx.reverse()
        assert ctx.mode == module.TransportMode.Importance
        ctx = module.BSDFContext(module.TransportMode.Radiance, int(module.BSDFFlags.Glossy), 1)
        flags = module.BSDFFlags
        assert [ctx.is_enabled(f, i) for f in (flags.GlossyReflection, flags.Diffuse) for i in (0, 1)] == [
            False,
            True,
            False,
            False,
        ]


@pytest.mark.parametrize(("name", "attribute"), [("plastic", "diffuse_reflectance"), ("diffuse", "reflectance")])
def test_attributes_are_mitsubas(mi: Any, name: str, attribute: str) -> None:
    mine, his = (module.load_dict(CASES[name]) for module in (djpt, mi))
    si, other = interaction(Vector3f(0, 0, 1)), dr.zeros(mi.SurfaceInteraction3f)
    other.uv = mi.Point2f(0.31, 0.62)
    assert mine.has_attribute(attribute) and not mine.has_attribute("nothing")
    for question in ("eval_attribute", "eval_attribute_1"):
        a, b = getattr(mine, question)(attribute, si), getattr(his, question)(attribute, other)
        np.testing.assert_allclose(in_numpy(a), in_numpy(b), rtol=1e-6)
    with pytest.raises(DjptError, match="there is no attribute 'reflectence'"):
        mine.eval_attribute("reflectence", si)


def test_two_sides_have_attributes_of_their_own() -> None:
    bsdf = djpt.load_dict({"type": "twosided", "a": {"type": "diffuse", "reflectance": 0.25}, "b": ROUGH})
    si = dr.zeros(djpt.SurfaceInteraction3f, 2)
    si.wi = Vector3f(0, 0, [1, -1])
    assert bsdf.has_attribute("alpha_u") is False and bsdf.has_attribute("alpha") and bsdf.has_attribute("reflectance")
    np.testing.assert_allclose(np.array(bsdf.eval_attribute_1("alpha", si)), [0, 0.3], rtol=1e-6)
    np.testing.assert_allclose(np.array(bsdf.eval_attribute("reflectance", si).x), [0.25, 0], rtol=1e-6)
    with pytest.raises(DjptError, match="there is no attribute 'x'"):
        bsdf.eval_attribute("x", si)


def test_pointers_answer_per_lane() -> None:
    scene = djpt.load_dict(djpt.cornell_box())
    ray = djpt.Ray3f(djpt.Point3f(0, 0, 3.5), djpt.Vector3f([0, -0.25], [0, 0.0], [-1, -1]))
    bsdf = scene.ray_intersect(ray).bsdf()
    assert bsdf.component_count()[0] == 1 and bsdf.flags(0)[0] == int(BSDFFlags.DiffuseReflection | BSDFFlags.FrontSide)
    assert bsdf.flags(1)[0] == 0 and bsdf.has_attribute("reflectance")[0] and not bsdf.has_attribute("alpha")[0]
    color = in_numpy(bsdf.eval_attribute("reflectance", scene.ray_intersect(ray)))
    assert (color > 0).all()


class Tinted(djpt.BSDF):
    """A script's BSDF, written as in Mitsuba's tutorials."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.tint = props.get("tint", Color3f(1))
        flags = BSDFFlags.DiffuseReflection | BSDFFlags.FrontSide
        self.m_components = [flags]
        self.m_flags = flags

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        wo = djpt.warp.square_to_cosine_hemisphere(sample2)
        bs = djpt.BSDFSample3f()
        bs.wo, bs.eta, bs.sampled_component = wo, 1.0, 0
        bs.pdf = djpt.warp.square_to_cosine_hemisphere_pdf(wo)
        bs.sampled_type = int(BSDFFlags.DiffuseReflection)
        return bs, self.tint

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return self.tint * djpt.warp.square_to_cosine_hemisphere_pdf(wo)

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return djpt.warp.square_to_cosine_hemisphere_pdf(wo)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    def traverse(self, callback: Any) -> None:
        callback.put("tint", self.tint, djpt.ParamFlags.Differentiable)

    def to_string(self) -> str:
        return f"Tinted[tint={self.tint}]"


def test_scripts_can_write_bsdfs() -> None:
    djpt.register_bsdf("tinted_by_script", lambda props: Tinted(props))
    bsdf = djpt.load_dict({"type": "tinted_by_script", "tint": [0.1, 0.5, 0.9]})
    assert (bsdf.component_count(), bsdf.flags(0)) == (1, int(BSDFFlags.DiffuseReflection | BSDFFlags.FrontSide))
    assert "Tinted[tint=" in str(bsdf)
    params = djpt.traverse(bsdf)
    params["tint"] = Color3f(0.25)
    params.update()
    value = bsdf.eval(BSDFContext(), interaction(Vector3f(0, 0, 1)), Vector3f(0, 0, 1))
    np.testing.assert_allclose(in_numpy(value).ravel(), [0.25 / np.pi] * 3, rtol=1e-6)


def test_both_sides_have_attributes() -> None:
    sides = {
        name: {"type": "roughconductor", "material": "Al", "alpha": alpha} for name, alpha in (("a", 0.2), ("b", 0.1))
    }
    bsdf = djpt.load_dict({"type": "twosided", **sides})
    assert bsdf.has_attribute("alpha") and not bsdf.has_attribute("alpah")
    si = interaction(djpt.Vector3f([0, 0], [0, 0.6], [1, -0.8]), width=2)
    np.testing.assert_allclose(in_numpy(bsdf.eval_attribute_1("alpha", si)), [0.2, 0.1], rtol=1e-6)
    np.testing.assert_allclose(in_numpy(bsdf.eval_attribute("alpha", si)), [[0.2, 0.1]] * 3, rtol=1e-6)
    single = djpt.load_dict({"type": "twosided", "a": sides["a"]})
    np.testing.assert_allclose(in_numpy(single.eval_attribute_1("alpha", si)), 0.2, rtol=1e-6)

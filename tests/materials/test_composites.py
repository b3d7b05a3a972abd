"""Masks, blends and two-sided materials, nested in each other: Mitsuba's draws, and what Mitsuba gets wrong."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.frame import Frame3f
from djpt.core.records import BSDFContext, BSDFFlags, SurfaceInteraction3f, has_flag
from djpt.core.warp import square_to_uniform_sphere
from djpt.jit.types import Float, Normal3f, Point2f, Point3f, Vector3f
from djpt.validation import agreement
from djpt.validation.bridge import to_mitsuba
from tests.kit.arrays import floats, in_numpy, rows
from tests.kit.derivatives import by_both
from tests.kit.renders import box, ours

COUNT = 4096


def diffuse(r: float, g: float, b: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": [r, g, b]}}


RED, BLUE = diffuse(0.8, 0.2, 0.1), diffuse(0.1, 0.3, 0.9)
MIRROR = {"type": "conductor"}
GLASS = {"type": "dielectric"}
TURNED = djpt.ScalarTransform4f().scale([4, 3, 1])
CHECKS = {"type": "checkerboard", "color0": 0.3, "color1": 0.8, "to_uv": TURNED}


def mask(nested: dict[str, Any], opacity: Any = 0.4) -> dict[str, Any]:
    return {"type": "mask", "opacity": opacity, "nested": nested}


def blend(first: dict[str, Any], second: dict[str, Any], weight: Any = 0.3) -> dict[str, Any]:
    return {"type": "blendbsdf", "weight": weight, "first": first, "second": second}


def two_sided(*nested: dict[str, Any]) -> dict[str, Any]:
    return {"type": "twosided", **{f"side{i}": node for i, node in enumerate(nested)}}


NESTED: dict[str, dict[str, Any]] = {
    "mask of diffuse": mask(RED),
    "mask of a mirror": mask(MIRROR, 0.7),
    "mask of glass": mask(GLASS),
    "mask with a texture": mask(RED, CHECKS),
    "solid mask": mask(RED, 1.0),
    "empty mask": mask(RED, 0.0),
    "beyond opaque": mask(RED, 1.7),
    "mask of a mask": mask(mask(two_sided(RED), 0.6)),
    "blend of diffuse": blend(RED, BLUE),
    "blend of deltas": blend(MIRROR, GLASS),
    "blend, first only": blend(RED, MIRROR, 0.0),
    "blend, second only": blend(MIRROR, RED, 1.0),
    "blend with a texture": blend(RED, two_sided(BLUE), CHECKS),
    "blend of blends": blend(blend(RED, BLUE, 0.8), two_sided(blend(BLUE, RED, 0.1)), 0.6),
    "two-sided blend": two_sided(blend(RED, BLUE)),
    "two sides": two_sided(RED, blend(BLUE, RED, 0.9)),
    "two-sided mirror": two_sided(MIRROR),
    "mirror and diffuse": two_sided(MIRROR, RED),
    "mask of two-sided blend": mask(two_sided(blend(RED, BLUE), MIRROR)),
    "blend of masks": blend(mask(RED, 0.2), mask(two_sided(BLUE), 0.9)),
}


def directions(seed: int) -> Any:
    """Unit vectors over the whole sphere, (3, COUNT) float32."""
    u = np.random.default_rng(seed).random((2, COUNT), dtype=np.float32)
    return np.array(square_to_uniform_sphere(Point2f(u)))


def interaction(wi: Any, uv: Any) -> SurfaceInteraction3f:
    """A surface point in its own frame, one per lane."""
    z = Normal3f(0, 0, 1)
    return SurfaceInteraction3f(
        t=dr.full(Float, 1, COUNT),
        p=Point3f(0),
        n=z,
        sh_frame=Frame3f(Vector3f(1, 0, 0), Vector3f(0, 1, 0), z),
        uv=Point2f(*rows(uv)),
        dp_du=Vector3f(1, 0, 0),
        dp_dv=Vector3f(0, 1, 0),
        wi=Vector3f(*rows(wi)),
    )


class Query:
    """Random arguments for all methods of a BSDF, and what djpt answers."""

    def __init__(self, description: dict[str, Any]) -> None:
        u = np.random.default_rng(4).random((5, COUNT), dtype=np.float32)
        self.s1, self.s2, self.uv = u[0], u[1:3], u[3:]
        self.wi, self.wo = directions(1), directions(2)
        self.bsdf = djpt.load_dict(description)
        self.si = interaction(self.wi, self.uv)
        self.args = BSDFContext(), self.si
        value, pdf, bs, weight = self.bsdf.eval_pdf_sample(
            *self.args, Vector3f(*rows(self.wo)), floats(self.s1), Point2f(*rows(self.s2))
        )
        delta = has_flag(bs.sampled_type, BSDFFlags.Delta)
        dr.eval(value, pdf, bs, weight, delta)
        self.value, self.pdf, self.weight = wide(value), wide(pdf), wide(weight)
        self.sampled = {name: wide(getattr(bs, name)) for name in ("wo", "pdf", "eta", "sampled_type")}
        self.delta = np.broadcast_to(np.array(delta), (COUNT,))


def wide(x: Any) -> np.ndarray:
    array = in_numpy(x)
    return np.broadcast_to(array, (len(array), COUNT) if dr.depth_v(x) > 1 else (COUNT,))


def load_theirs(description: dict[str, Any], mi: Any) -> Any:
    return mi.load_dict(to_mitsuba({"b": description})["b"], optimize=False)


class TheirQuery(Query):
    """The same in Mitsuba."""

    def __init__(self, description: dict[str, Any], mi: Any) -> None:
        super().__init__(description)
        self.bsdf = load_theirs(description, mi)
        si = dr.zeros(mi.SurfaceInteraction3f, COUNT)
        si.t, si.n, si.sh_frame = mi.Float(1), mi.Normal3f(0, 0, 1), mi.Frame3f(mi.Normal3f(0, 0, 1))
        si.wi, si.uv = mi.Vector3f(*rows(self.wi)), mi.Point2f(*rows(self.uv))
        ctx = mi.BSDFContext()
        value, pdf = self.bsdf.eval_pdf(ctx, si, mi.Vector3f(*rows(self.wo)))
        bs, weight = self.bsdf.sample(ctx, si, floats(self.s1), mi.Point2f(*rows(self.s2)))
        albedo = self.bsdf.eval_diffuse_reflectance(si)
        dr.eval(value, pdf, bs, weight, albedo)
        self.value, self.pdf, self.weight = wide(value), wide(pdf), wide(weight)
        self.sampled = {name: wide(getattr(bs, name)) for name in ("wo", "pdf", "eta", "sampled_type")}
        self.si, self.albedo = si, wide(albedo)


@pytest.mark.sparse(2)
@pytest.mark.narrow
@pytest.mark.parametrize("description", NESTED.values(), ids=NESTED)
def test_answers_are_mitsubas(description: dict[str, Any], mi: Any) -> None:
    mine, theirs = Query(description), TheirQuery(description, mi)
    np.testing.assert_allclose(mine.value, theirs.value, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(mine.pdf, theirs.pdf, rtol=1e-4, atol=1e-6)
    lost = (mine.weight == 0).all(axis=0) & (theirs.weight == 0).all(axis=0)
    assert lost.mean() < 0.8
    np.testing.assert_allclose(mine.weight, theirs.weight, rtol=1e-4, atol=1e-5)
    for name, values in mine.sampled.items():
        np.testing.assert_allclose(values[..., ~lost], theirs.sampled[name][..., ~lost], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("description", NESTED.values(), ids=NESTED)
def test_combined_calls_agree(description: dict[str, Any]) -> None:
    query = Query(description)
    args, wo = query.args, Vector3f(*rows(query.wo))
    bs, weight = query.bsdf.sample(*args, floats(query.s1), Point2f(*rows(query.s2)))
    value, pdf = query.bsdf.eval(*args, wo), query.bsdf.pdf(*args, wo)
    dr.eval(bs, weight, value, pdf)
    np.testing.assert_allclose(wide(value), query.value, rtol=1e-6)
    np.testing.assert_allclose(wide(pdf), query.pdf, rtol=1e-6)
    np.testing.assert_allclose(wide(weight), query.weight, rtol=1e-5)
    for name, values in query.sampled.items():
        np.testing.assert_allclose(wide(getattr(bs, name)), values, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    "description",
    [*NESTED.values(), blend(RED, MIRROR), blend(GLASS, mask(BLUE, 0.8), 0.6), mask(two_sided(blend(MIRROR, RED)))],
    ids=[*NESTED, "diffuse and mirror", "glass and a mask", "mask of two-sided diffuse and mirror"],
)
def test_samples_add_up(description: dict[str, Any]) -> None:
    """Smooth samples integrate to the integral of eval, delta ones to the weighted sum of the delta lobes."""
    query = Query(description)
    n = 64
    wi = np.array([0.6, -0.3, 0.8]) / np.linalg.norm([0.6, -0.3, 0.8])
    query.si.wi = Vector3f(*(float(x) for x in wi))
    grid = (np.stack(np.meshgrid(np.arange(n), np.arange(n))).reshape(2, -1) + 0.5).astype(np.float32) / n
    # One lobe number per point, stratified over the whole range.
    s1 = ((np.random.default_rng(3).permutation(COUNT) + 0.5) / COUNT).astype(np.float32)
    points = Point2f(*rows(grid))
    bs, weight = query.bsdf.sample(*query.args, floats(s1), points)
    value, lobe = (
        query.bsdf.eval(*query.args, square_to_uniform_sphere(points)),
        has_flag(bs.sampled_type, BSDFFlags.Delta),
    )
    dr.eval(bs, weight, value, lobe)
    delta = np.broadcast_to(np.array(lobe), (COUNT,))
    smooth_part = np.where(delta, 0, wide(weight)).mean(axis=1)
    integral = wide(value).mean(axis=1) * 4 * np.pi
    np.testing.assert_allclose(smooth_part, integral, rtol=0.05, atol=5e-3)
    np.testing.assert_array_less(wide(weight).mean(axis=1), 1.001)
    assert (wide(bs.pdf) >= 0).all()


def test_a_delta_lobe_in_a_blend_keeps_its_weight() -> None:
    """Mitsuba 3.9 mixes its probability with the other's density, and so loses energy."""
    query = Query(blend(RED, MIRROR, 0.3))
    front = query.wi[2] > 0
    assert query.delta[front].mean() == pytest.approx(0.3, abs=0.02)
    np.testing.assert_allclose(query.weight[:, query.delta & front], 1, rtol=1e-5)
    np.testing.assert_allclose(query.sampled["pdf"][query.delta & front], 0.3, rtol=1e-5)


def test_what_passes_through() -> None:
    si = interaction(directions(1), np.full((2, COUNT), 0.3))
    for description, expected in [
        (mask(RED, 0.4), 0.6),
        (mask(mask(RED, 0.5), 0.4), 1 - 0.4 * 0.5),
        (blend(RED, mask(RED, 0.4), 0.25), 0.25 * 0.6),
        (two_sided(RED), 0.0),
    ]:
        passed = djpt.load_dict(description).eval_null_transmission(si)
        np.testing.assert_allclose(np.array(passed)[:, 0], expected, rtol=1e-6)


@pytest.mark.parametrize("name", ["mask of two-sided blend", "blend of masks", "blend with a texture", "two sides"])
def test_names_and_lobes_are_mitsubas(name: str, mi: Any) -> None:
    theirs = load_theirs(NESTED[name], mi)
    bsdf = djpt.load_dict(NESTED[name])
    ignored = ("to_uv",)
    names = {key for key in dict(mi.traverse(theirs)) if not key.endswith(ignored)}
    assert names == {key for key in djpt.traverse(bsdf) if not key.endswith(ignored)}
    assert bsdf.flags() & int(BSDFFlags.All) == theirs.flags() & int(mi.BSDFFlags.All)


# ---------------------------------------------------------------- gradients


def sheet(bsdf: dict[str, Any]) -> Any:
    """A sheet before a wall, under a lamp and a grey sky."""
    view = djpt.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    wall = djpt.ScalarTransform4f().translate([0, 0, -2]).scale(4)
    return djpt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "prb", "max_depth": 4, "rr_depth": 100},
            "sensor": {"type": "perspective", "fov": 30, "to_world": view, "film": film},
            "sheet": {"type": "rectangle", "bsdf": bsdf},
            "wall": {"type": "rectangle", "to_world": wall, "bsdf": two_sided(diffuse(0.7, 0.6, 0.5))},
            "sky": {"type": "constant", "radiance": 0.5},
            "lamp": {"type": "point", "position": [1, 1, 3], "intensity": 4.0},
        }
    )


def slopes(bsdf: dict[str, Any], name: str, h: float, spp: int) -> tuple[float, float]:
    """The derivative of the sum of a picture of `sheet`, by path replay and by central differences."""
    return by_both(sheet(bsdf), f"sheet.bsdf.{name}", h, seed=1, spp=spp)


DULL = {"type": "conductor", "specular_reflectance": 0.6}


@pytest.mark.sparse(8)
@pytest.mark.parametrize(
    ("description", "name"),
    [
        (mask(two_sided(RED)), "opacity.value"),
        (mask(two_sided(MIRROR)), "opacity.value"),
        (mask(mask(two_sided(RED), 0.6)), "nested_bsdf.opacity.value"),
        (blend(two_sided(RED), two_sided(BLUE)), "weight.value"),
        (blend(two_sided(RED), two_sided(MIRROR)), "weight.value"),
        (blend(two_sided(MIRROR), mask(RED, 0.3)), "weight.value"),
        (blend(two_sided(MIRROR), mask(RED, 0.3)), "bsdf_1.opacity.value"),
    ],
)
def test_gradients_by_shares(description: dict[str, Any], name: str) -> None:
    """Other shares, other decisions: differences of images with one seed are noisy."""
    gradient, slope = slopes(description, name, 0.1, spp=16384)
    assert abs(slope) > 1
    assert gradient == pytest.approx(slope, rel=0.02, abs=0.1)


@pytest.mark.sparse(3)
@pytest.mark.parametrize(
    ("description", "name"),
    [
        (mask(two_sided(RED)), "nested_bsdf.brdf_0.reflectance.value"),
        (mask(two_sided(DULL)), "nested_bsdf.brdf_0.specular_reflectance.value"),
        (blend(RED, DULL), "bsdf_1.specular_reflectance.value"),
        (two_sided(blend(RED, DULL, 0.6)), "brdf_0.bsdf_0.reflectance.value"),
        (two_sided(BLUE, RED), "brdf_0.reflectance.value"),
    ],
)
def test_gradients_of_what_is_nested(description: dict[str, Any], name: str) -> None:
    gradient, slope = slopes(description, name, 0.05, spp=64)
    assert abs(slope) > 1
    assert gradient == pytest.approx(slope, rel=2e-3)


# ---------------------------------------------------------------- errors and edits


@pytest.mark.parametrize(
    ("description", "message"),
    [
        ({"type": "mask"}, "'mask' takes one nested BSDF, found 0"),
        ({**mask(RED), "more": BLUE}, "'mask' takes one nested BSDF, found 2"),
        ({"type": "blendbsdf", "a": RED}, "'blendbsdf' takes two nested BSDFs, found 1"),
        ({**blend(RED, BLUE), "third": RED}, "'blendbsdf' takes two nested BSDFs, found 3"),
        ({"type": "blendbsdf", "a": RED, "b": BLUE, "wieght": 0.5}, "unknown key 'wieght'.*weight"),
        ({**mask(RED), "opacity": "half"}, "'opacity' must be a number or a texture"),
        (two_sided(mask(RED)), "a transmitting BSDF can't be made two-sided"),
        (two_sided(blend(RED, GLASS)), "a transmitting BSDF can't be made two-sided"),
    ],
)
def test_errors(description: dict[str, Any], message: str) -> None:
    with pytest.raises(djpt.SceneError, match=message):
        djpt.load_dict(description)


def test_sheets_of_one_structure_are_one_group_and_edits_compile_nothing() -> None:
    scene = djpt.load_dict(
        {
            **djpt.cornell_box(),
            "a": {"type": "rectangle", "bsdf": mask(two_sided(RED), 0.2)},
            "b": {"type": "rectangle", "bsdf": mask(two_sided(BLUE), 0.7)},
        }
    )
    assert sorted(len(group.plugins) for group in scene.bsdfs.ensemble.groups) == [2, 3]
    params = djpt.traverse(scene)

    def render() -> tuple[set[Any], Any]:
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            image = np.array(djpt.render(scene, spp=2, sensor=0))
            return {k["hash"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT}, image

    before, image = render()
    params["a.bsdf.opacity.value"] = 0.9
    params["b.bsdf.nested_bsdf.brdf_0.reflectance.value"] = [0.9, 0.9, 0.1]
    params.update()
    after, edited = render()
    assert after <= before
    assert np.abs(image - edited).max() > 0.01


# ---------------------------------------------------------------- images


def furnished(scene: dict[str, Any]) -> None:
    """Composites all over the Cornell box.

    The masked box hovers above the floor: where both lie in one plane, rounding decides which of them a ray from
    within the box meets.
    """
    above = djpt.ScalarTransform4f().translate([0, 0.01, 0])
    scene["white"] = blend(diffuse(0.8, 0.8, 0.7), BLUE, 0.2)
    scene["small-box"].update(to_world=above @ scene["small-box"]["to_world"], bsdf=mask(RED, 0.6))
    scene["large-box"]["bsdf"] = two_sided(blend(BLUE, RED, CHECKS), RED)
    scene["pane"] = {
        "type": "rectangle",
        "to_world": djpt.ScalarTransform4f().translate([0.1, -0.2, 0.75]).rotate([0, 1, 0], 50).scale(0.4),
        "bsdf": blend(mask(GLASS, 0.9), MIRROR, 0.3),
    }


@pytest.mark.narrow
@pytest.mark.parametrize("integrator", ["path", "prb"])
@pytest.mark.sparse(2)
def test_pixels_are_mitsubas(integrator: str, mi: Any) -> None:
    description = box(48, "box", {"type": integrator, "max_depth": 6}, furnished)
    image = ours(description, 8, 2)
    reference = np.array(mi.render(load_theirs(description, mi), spp=8, seed=2))
    assert agreement(image, reference, 1e-3).share > 0.99
    assert image.mean() == pytest.approx(reference.mean(), rel=1e-3)


@pytest.mark.parametrize("description", NESTED.values(), ids=NESTED)
def test_albedos_are_mitsubas(description: dict[str, Any], mi: Any) -> None:
    theirs = TheirQuery(description, mi)
    albedo = djpt.load_dict(description).eval_diffuse_reflectance(interaction(theirs.wi, theirs.uv))
    np.testing.assert_allclose(wide(albedo), theirs.albedo, rtol=1e-4, atol=1e-6)

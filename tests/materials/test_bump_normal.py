"""Normal maps and bump maps: Mitsuba's frames, samples and pictures; their own densities, gradients and errors."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.frame import Frame3f
from djpt.core.records import BSDFContext, SurfaceInteraction3f
from djpt.core.transforms import ScalarTransform4f as T
from djpt.core.warp import square_to_uniform_sphere
from djpt.dispatch.ensemble import Detached, Ensemble
from djpt.errors import SceneError
from djpt.jit.types import Float, Point2f, TensorXf, UInt32, Vector3f
from djpt.materials.bumpmap import sees_tangent
from tests.kit.arrays import floats
from tests.kit.axes import unit
from tests.kit.renders import ours, theirs

COUNT = 4000
NESTED: dict[str, Any] = {
    "diffuse": {"type": "diffuse"},
    "two-sided": {"type": "twosided", "inner": {"type": "diffuse", "reflectance": 0.8}},
    "mirror": {"type": "twosided", "inner": {"type": "conductor"}},
    "rough": {"type": "roughconductor", "alpha": 0.3},
    "glass": {"type": "dielectric"},
}


def texels(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.1, 0.9, shape).astype(np.float32)


def bitmap(data: np.ndarray, **keys: Any) -> dict[str, Any]:
    return {"type": "bitmap", "data": TensorXf(data), "raw": True, **keys}


def normals(*size: int, tilt: float = 0.5, seed: int = 1) -> np.ndarray:
    """A normal map that tilts normals at random."""
    n = np.random.default_rng(seed).uniform(-tilt, tilt, (*size, 3))
    n[..., 2] = 1
    return ((n / np.linalg.norm(n, axis=2, keepdims=True) + 1) / 2).astype(np.float32)


def maps() -> dict[str, dict[str, Any]]:
    """Made anew for each use: Mitsuba empties the tensors that it is given."""
    return {
        "normals": {"type": "normalmap", "normalmap": bitmap(normals(6, 7))},
        "wild normals": {"type": "normalmap", "normalmap": bitmap(texels(5, 7, 3))},
        "heights": {"type": "bumpmap", "texture": bitmap(texels(5, 7, 1)), "scale": 0.3},
        "coloured heights": {"type": "bumpmap", "texture": bitmap(texels(4, 4, 3), to_uv=T().scale([2, 3, 1]))},
    }


MAPS = tuple(maps())


def array(v: np.ndarray) -> Vector3f:
    return Vector3f(*(floats(x) for x in v.T))


class Surfaces:
    """Random points of random surfaces, seen from everywhere."""

    def __init__(self, count: int = COUNT) -> None:
        random = np.random.default_rng(2)

        def unit() -> np.ndarray:
            v = random.normal(size=(count, 3))
            return v / np.linalg.norm(v, axis=1, keepdims=True)

        self.n, self.wi, self.wo = unit(), unit(), unit()
        tilted = self.n + 0.2 * unit()  # smooth shading
        self.shading = tilted / np.linalg.norm(tilted, axis=1, keepdims=True)
        along = unit()
        along -= self.shading * np.sum(along * self.shading, axis=1, keepdims=True)
        self.s = along / np.linalg.norm(along, axis=1, keepdims=True)
        self.t = np.cross(self.shading, self.s)
        self.dp_du = random.uniform(0.5, 2, (count, 1)) * self.s
        self.dp_dv = random.uniform(0.5, 2, (count, 1)) * self.t + random.uniform(-0.5, 0.5, (count, 1)) * self.s
        self.uv = random.random((2, count)).astype(np.float32)
        self.sample1, self.sample2 = (
            random.random(count).astype(np.float32),
            random.random((2, count)).astype(np.float32),
        )

    def ours(self) -> SurfaceInteraction3f:
        frame = Frame3f(array(self.s), array(self.t), array(self.shading))
        uv = Point2f(floats(self.uv[0]), floats(self.uv[1]))
        n, du, dv, wi = (array(v) for v in (self.n, self.dp_du, self.dp_dv, self.wi))
        return SurfaceInteraction3f(t=1, n=n, sh_frame=frame, uv=uv, dp_du=du, dp_dv=dv, wi=wi)

    def theirs(self, mi: Any) -> Any:
        si = dr.zeros(mi.SurfaceInteraction3f, len(self.n))
        si.uv = mi.Point2f(*(floats(x) for x in self.uv))
        si.n, si.wi = mi.Normal3f(array(self.n)), mi.Vector3f(array(self.wi))
        si.sh_frame = mi.Frame3f(*(mi.Vector3f(array(v)) for v in (self.s, self.t, self.shading)))
        si.dp_du, si.dp_dv = mi.Vector3f(array(self.dp_du)), mi.Vector3f(array(self.dp_dv))
        return si


def call(bsdf: Any, method: Any) -> Any:
    """What a method returns on a representative, as in kernels."""
    ensemble, lookup = Ensemble([bsdf]), Detached()
    lookup.prepare(ensemble.leaves())
    return ensemble.call(UInt32(0), lookup, method, None)


def described(map_: str, nested: str, **keys: Any) -> dict[str, Any]:
    return {**maps()[map_], "nested": NESTED[nested], **keys}


def misspelt_scale() -> dict[str, Any]:
    description = {**described("heights", "diffuse"), "scael": 1.0}
    description.pop("scale", None)
    return description


# ---------------------------------------------------------------- against Mitsuba


@pytest.mark.sparse(10)
@pytest.mark.parametrize("shadowed", [True, False], ids=["shadowed", "plain"])
@pytest.mark.parametrize("flipped", [True, False], ids=["flipped", "unflipped"])
@pytest.mark.parametrize("nested", ["diffuse", "two-sided", "rough"])
@pytest.mark.parametrize("map_", MAPS)
def test_values_and_samples_are_mitsubas(map_: str, nested: str, flipped: bool, shadowed: bool, mi: Any) -> None:
    description = described(map_, nested, flip_invalid_normals=flipped, use_shadowing_function=shadowed)
    surfaces = Surfaces()
    bsdf, reference = djpt.load_dict(description), mi.load_dict(djpt.validation.to_mitsuba(description))
    si, wo, sample = surfaces.ours(), array(surfaces.wo), Point2f(*(floats(x) for x in surfaces.sample2))
    first = floats(surfaces.sample1)
    value, pdf, bs, weight = call(bsdf, lambda b: b.eval_pdf_sample(BSDFContext(), si, wo, first, sample))
    their_si, context = surfaces.theirs(mi), mi.BSDFContext()
    their_value, their_pdf = reference.eval_pdf(context, their_si, mi.Vector3f(wo))
    their_bs, their_weight = reference.sample(context, their_si, mi.Float(first), mi.Point2f(sample))
    dr.eval(value, pdf, bs, weight)
    dr.eval(their_value, their_pdf, their_bs, their_weight)
    assert bsdf.flags() == int(reference.flags())

    def same(found: Any, expected: Any, where: Any = True) -> None:
        a, b = (np.where(where, np.array(x), 0) for x in (found, expected))
        # Normals that are nearly perpendicular to a direction may fall on either side of it.
        assert np.mean(np.abs(a - b) > 2e-4 * np.maximum(1, np.abs(b))) < 1e-3

    same(value, their_value)
    same(pdf, their_pdf)
    same(weight, their_weight)
    sampled = np.array(their_weight).max(axis=0) > 0
    assert sampled.mean() > 0.1
    same(bs.wo, their_bs.wo, sampled)
    same(bs.pdf, their_bs.pdf, sampled)


def scene(map_: str, nested: str) -> dict[str, Any]:
    """A tilted board and a ball under a lamp and a dim sky."""
    camera = T().look_at(origin=[0, -3, 3], target=[0, 0, 0], up=[0, 0, 1])
    film = {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}}
    bsdf = described(map_, nested)
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4},
        "sensor": {"type": "perspective", "fov": 40, "to_world": camera, "film": film},
        "floor": {"type": "rectangle", "to_world": T().rotate(unit(1, 2, 0.5), 25), "bsdf": bsdf},
        "ball": {"type": "sphere", "radius": 0.5, "center": [0, 0, 0.9], "bsdf": described(map_, nested)},
        "lamp": {
            "type": "rectangle", "to_world": T().translate([0, 0, 4]).rotate([1, 0, 0], 180),
            "emitter": {"type": "area", "radiance": 4.0},
        },
        "sky": {"type": "constant", "radiance": 0.2},
    }  # fmt: skip


@pytest.mark.sparse(12)
@pytest.mark.parametrize("nested", NESTED)
@pytest.mark.parametrize("map_", ["normals", "heights"])
def test_pictures_are_mitsubas(map_: str, nested: str) -> None:
    pytest.importorskip("mitsuba")
    image, reference = ours(scene(map_, nested), 8), theirs(scene(map_, nested), 8)
    close = np.abs(image - reference).max(axis=2) <= 1e-3 * np.maximum(1, reference.max(axis=2))
    assert close.mean() > 0.95


# ---------------------------------------------------------------- by themselves


@pytest.mark.parametrize("nested", ["diffuse", "two-sided"])
@pytest.mark.parametrize("map_", MAPS)
def test_densities_count_what_is_sampled(map_: str, nested: str) -> None:
    # The integral of the density is the share of samples that aren't lost, and that of eval their mean weight.
    bsdf, one = djpt.load_dict(described(map_, nested)), Surfaces(6)
    count = 1 << 14
    random = np.random.default_rng(0).random((5, count)).astype(np.float32)
    u = [floats(x) for x in random]
    for i in range(6):
        point = one.ours()
        pick = [dr.gather(type(v), v, UInt32(i)) for v in (point.n, point.uv, point.dp_du, point.dp_dv, point.wi)]
        frame = dr.gather(Frame3f, point.sh_frame, UInt32(i))
        si = SurfaceInteraction3f(
            t=1, n=pick[0], sh_frame=frame, **dict(zip(("uv", "dp_du", "dp_dv", "wi"), pick[1:], strict=True))
        )
        wo = square_to_uniform_sphere(Point2f(u[0], u[1]))
        value, pdf, bs, weight = bsdf.eval_pdf_sample(BSDFContext(), si, wo, u[2], Point2f(u[3], u[4]))
        again, density = bsdf.eval_pdf(BSDFContext(), si, bs.wo)
        dr.eval(value, pdf, bs, weight, again, density)
        kept = np.array(bs.pdf) > 0
        assert np.mean(np.array(pdf)) * 4 * np.pi == pytest.approx(kept.mean(), abs=0.04)
        assert np.mean(np.array(value)) * 4 * np.pi == pytest.approx(np.mean(np.array(weight)), abs=0.04)
        ratio = np.array(again)[0][kept] / np.array(density)[kept]
        np.testing.assert_allclose(ratio, np.array(weight)[0][kept], rtol=2e-3, atol=1e-4)


@pytest.mark.parametrize("nested", ["two-sided", "rough", "glass"])
@pytest.mark.parametrize(
    "flat",
    [
        {"type": "normalmap", "normalmap": {"type": "rgb", "value": [0.5, 0.5, 1.0]}},
        {"type": "bumpmap", "texture": bitmap(np.full((3, 3, 1), 0.4, np.float32))},
        {"type": "bumpmap", "texture": bitmap(texels(3, 3, 1), filter_type="nearest")},
        {"type": "bumpmap", "texture": bitmap(texels(3, 3, 1)), "scale": 0.0},
        {"type": "bumpmap", "texture": {"type": "checkerboard"}},
    ],
    ids=["blue", "level", "nearest", "unscaled", "fields"],
)
def test_flat_maps_change_nothing(flat: dict[str, Any], nested: str) -> None:
    mapped, plain = djpt.load_dict({**flat, "nested": NESTED[nested]}), djpt.load_dict(NESTED[nested])
    surfaces = Surfaces(500)
    si, wo = surfaces.ours(), array(surfaces.wo)
    found, expected = (bsdf.eval_pdf(BSDFContext(), si, wo) for bsdf in (mapped, plain))
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(np.array(a), np.array(b) + 0 * np.array(a), rtol=2e-3, atol=2e-4)
    assert mapped.flags() == plain.flags()


def test_degenerate_maps_give_numbers() -> None:
    surfaces = Surfaces(200)
    si, wo = surfaces.ours(), array(surfaces.wo)
    si.dp_du, si.dp_dv = Vector3f(0), Vector3f(0)
    for description in (
        {"type": "normalmap", "normalmap": {"type": "rgb", "value": 0.5}},  # no normal
        {"type": "normalmap", "normalmap": {"type": "rgb", "value": [1.0, 0.5, 0.5]}},  # along the tangent
        {"type": "bumpmap", "texture": bitmap(texels(5, 7, 1)), "scale": 1e4},
    ):
        bsdf = djpt.load_dict({**description, "nested": NESTED["two-sided"]})
        for result in bsdf.eval_pdf_sample(BSDFContext(), si, wo, Float(0.5), Point2f(0.3, 0.6)):
            fields = vars(result).values() if hasattr(result, "wo") else [result]
            assert all(np.isfinite(np.array(field)).all() for field in fields)


def test_bumps_face_their_slope() -> None:
    # Heights that grow with u tilt the normal towards smaller u.
    ramp = np.linspace(0, 1, 8, dtype=np.float32)[None, :, None].repeat(2, axis=0)
    bump = djpt.load_dict({"type": "bumpmap", "texture": bitmap(ramp), "nested": NESTED["diffuse"]})
    z, axes = Vector3f(0, 0, 1), (Vector3f(1, 0, 0), Vector3f(0, 1, 0))
    si = SurfaceInteraction3f(
        t=1, n=z, sh_frame=Frame3f(*axes, z), uv=Point2f(0.4, 0.5), dp_du=axes[0], dp_dv=axes[1], wi=z
    )
    slope = 8 / 7  # the texels' centres are 1 / 8 apart, their heights 1 / 7
    expected = np.array([-slope, 0, 1]) / np.hypot(slope, 1)
    n = np.array(bump.tilted(si, True)[0].n).ravel()
    np.testing.assert_allclose(n, expected, atol=1e-5)


def test_anisotropic_materials_keep_their_grain() -> None:
    """Where the direction of the tangent shows, it follows dp/du, wherever the surface is turned."""

    class Grain(type(djpt.load_dict({"type": "diffuse"}))):  # type: ignore[misc]
        def flags(self) -> int:
            return super().flags() | int(djpt.BSDFFlags.Anisotropic)

    djpt.register_bsdf("grain_for_test", Grain)
    heights = maps()["heights"]
    bump = djpt.load_dict({**heights, "nested": {"type": "twosided", "inner": {"type": "grain_for_test"}}})
    assert sees_tangent(bump.nested_bsdf)
    assert sees_tangent(djpt.load_dict(described("normals", "diffuse")))
    assert not sees_tangent(djpt.load_dict(NESTED["two-sided"]))
    np.testing.assert_array_equal(np.array(bump.tangent(Surfaces(3).ours())).ravel(), [1, 0, 0])


# ---------------------------------------------------------------- parameters


def test_parameters_have_mitsubas_names(mi: Any) -> None:
    for map_ in ("normals", "heights"):
        description = described(map_, "two-sided")
        found = set(djpt.traverse(djpt.load_dict(description)))
        assert found == set(dict(mi.traverse(mi.load_dict(djpt.validation.to_mitsuba(description)))))


@pytest.mark.parametrize(
    ("map_", "name", "index"),
    [("normals", "normalmap.data", (2, 3, 0)), ("heights", "nested_texture.data", (2, 3, 0)), ("heights", "scale", ())],
)
@pytest.mark.sparse(2)
def test_gradients_by_maps(map_: str, name: str, index: tuple[int, ...]) -> None:
    description = scene(map_, "two-sided")
    # A point light alone: sampled directions, which move with the normals, then count for nothing.
    del description["ball"], description["sky"], description["lamp"]
    description["bulb"] = {"type": "point", "position": [0.5, -1.0, 3.0], "intensity": 20.0}
    description["floor"]["bsdf"]["flip_invalid_normals"] = False
    loaded = djpt.load_dict(description)
    params = djpt.traverse(loaded)
    name = f"floor.bsdf.{name}"
    start = np.array(params[name], np.float32)
    start = start if index else start.reshape(())

    def loss() -> Any:
        return dr.mean(djpt.render(loaded, params, spp=16, seed=2, seed_grad=2), axis=None)

    dr.enable_grad(params[name])
    params.update()
    dr.backward(loss())
    gradient = np.array(dr.grad(params[name])).reshape(start.shape)[index]
    ends = []
    for sign in (1, -1):
        moved = start.copy()
        moved[index] += sign * 0.02
        params.update({name: moved if index else float(moved)})
        ends.append(float(loss().array[0]))
    assert gradient == pytest.approx((ends[0] - ends[1]) / 0.04, rel=0.01, abs=1e-5)


@pytest.mark.parametrize(
    ("description", "message"),
    [
        ({"type": "normalmap", "normalmap": 0.5}, "'normalmap' takes one nested BSDF, found 0"),
        ({"type": "normalmap", "nested": NESTED["diffuse"]}, "'normalmap' needs the key 'normalmap'"),
        ({"type": "bumpmap", "nested": NESTED["diffuse"]}, "'bumpmap' takes one nested texture, found 0"),
        (
            {
                "type": "bumpmap",
                "a": maps()["heights"]["texture"],
                "b": maps()["heights"]["texture"],
                "nested": NESTED["diffuse"],
            },
            "'bumpmap' takes one nested texture, found 2",
        ),
        (described("heights", "diffuse", second=NESTED["diffuse"]), "'bumpmap' takes one nested BSDF, found 2"),
        (described("heights", "diffuse", scale="big"), "'scale' must be a float"),
        (misspelt_scale(), "unknown key 'scael' of bsdf 'bumpmap'; did you mean 'scale'"),
    ],
)
def test_wrong_descriptions(description: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict(description)

"""Scattering of light that comes from lamps: the adjoint of what paths from the camera see."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.frame import Frame3f
from djpt.core.records import BSDFContext, BSDFFlags, SurfaceInteraction3f, TransportMode, has_flag
from djpt.jit.types import Float, Normal3f, Point2f, Vector3f
from djpt.materials.base import eval_pdf_light, sample_light
from tests.kit.chi_squared import uniform
from tests.kit.materials import bsdf, first_of_each, in_kernel, interaction

COUNT = 2000
CAMERA, LIGHT = BSDFContext(), BSDFContext(TransportMode.Importance)


def directions(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return tuple(v / np.linalg.norm(v, axis=0) for v in rng.normal(size=(2, 3, COUNT)))


def tilted(si: SurfaceInteraction3f) -> SurfaceInteraction3f:
    """The point with a shading normal that isn't the geometric one."""
    return si.replaced(sh_frame=Frame3f.from_normal(dr.normalize(Normal3f(0.3, -0.2, 1))), n=Normal3f(0, 0, 1))


@pytest.mark.parametrize("name", first_of_each())
class TestAdjoint:
    def test_symmetry_is_as_declared(self, name: str) -> None:
        """A symmetric BSDF's value for light is that of a path the other way, with the other cosine."""
        if not djpt.load_dict(bsdf(name)).is_symmetric:
            pytest.skip("not symmetric")
        wi, wo = directions(3)
        material, si = in_kernel(bsdf(name)), interaction(Vector3f(wi), width=COUNT)
        light = np.array(material.eval(LIGHT, si, Vector3f(wo)), np.float64)
        back = np.array(material.eval(CAMERA, si.replaced(wi=Vector3f(wo)), Vector3f(wi)), np.float64)
        back = back * np.abs(wo[2] / wi[2])
        np.testing.assert_allclose(np.broadcast_to(light, back.shape), back, rtol=1e-2, atol=1e-5 * (1 + back.max()))

    @pytest.mark.sparse(3)
    def test_value_is_that_of_the_path_the_other_way(self, name: str) -> None:
        """With the cosines by the geometric normal, on the sides where both normals agree."""
        wi, wo = directions(4)
        material, si = in_kernel(bsdf(name)), tilted(interaction(Vector3f(wi), width=COUNT))
        value, pdf, back = eval_pdf_light(material, si, Vector3f(wo))
        turned = si.replaced(wi=Vector3f(wo))
        n = np.array(si.sh_frame.to_local(si.n)).reshape(3, -1)
        wi_cos, wo_cos = (n * wi).sum(axis=0), (n * wo).sum(axis=0)
        agree = (wi_cos * wi[2] > 0) & (wo_cos * wo[2] > 0)
        expected = np.array(material.eval(CAMERA, turned, Vector3f(wi))) * np.abs(wo_cos / wi_cos) * agree
        np.testing.assert_allclose(np.array(value), expected, rtol=2e-3, atol=1e-5 * (1 + expected.max()))
        np.testing.assert_array_equal(np.array(pdf), np.array(material.pdf(LIGHT, si, Vector3f(wo))))
        np.testing.assert_array_equal(np.array(back), np.array(material.pdf(CAMERA, turned, Vector3f(wi))))

    @pytest.mark.sparse(6)
    def test_weight_is_value_over_density(self, name: str) -> None:
        material, si = in_kernel(bsdf(name)), tilted(interaction(Vector3f(directions(5)[0]), width=COUNT))
        u = uniform(COUNT, 3)
        bs, weight = sample_light(material, si, Float(u[0]), Point2f(u[1], u[2]))
        value, pdf, _ = eval_pdf_light(material, si, bs.wo)
        smooth = np.array(~has_flag(bs.sampled_type, BSDFFlags.Delta) & (bs.pdf > 1e-3) & (pdf > 1e-3))
        smooth = np.broadcast_to(smooth, (COUNT,))
        found, expected = (np.broadcast_to(np.array(v), (3, COUNT)) for v in (weight, value * dr.rcp(bs.pdf)))
        np.testing.assert_allclose(found[:, smooth], expected[:, smooth], rtol=2e-2, atol=1e-3)


def test_those_that_say_nothing_may_be_anything() -> None:
    class Own(djpt.BSDF):
        pass

    own: Any = Own(djpt.Properties("own"))
    assert not own.is_symmetric and djpt.load_dict({"type": "diffuse"}).is_symmetric
    nested = {"type": "mask", "inner": {"type": "hair"}}
    assert not djpt.load_dict(nested).is_symmetric

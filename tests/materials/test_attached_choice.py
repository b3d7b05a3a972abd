"""The derivative of a sample's weight by the surface's normal: the share of light of the lobe that was drawn."""

from __future__ import annotations

from typing import Any

import drjit as dr
import pytest

import djpt
from djpt.core.records import BSDFContext
from djpt.jit.types import Float, Point2f, Vector3f

ANGLE = 0.6


def sampled(angle: Float, material: dict[str, Any], sample1: float) -> tuple[Float, Float]:
    """The weight of a sample seen at an angle to the normal, and the probability of its lobe."""
    si = dr.zeros(djpt.SurfaceInteraction3f)
    si.wi = Vector3f(dr.sin(angle), 0, dr.cos(angle))
    bs, weight = djpt.load_dict(material).sample(BSDFContext(), si, Float(sample1), Point2f(0.3, 0.6))
    return weight.x, bs.pdf


@pytest.mark.parametrize("sample1", [0.0, 0.99])
def test_smooth_glass_is_attached_to_what_its_lobe_reflects(sample1):
    angle = Float(ANGLE)
    dr.enable_grad(angle)
    weight, probability = sampled(angle, {"type": "dielectric"}, sample1)
    parts = (weight / dr.detach(weight), probability / dr.detach(probability))
    dr.forward(angle)
    slopes = [dr.grad(part)[0] for part in parts]
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-4)
    assert abs(slopes[1]) > 1e-3


@pytest.mark.parametrize("sample1", [0.0, 0.99])
def test_rough_glass_is_attached_as_if_the_choice_were_none(sample1):
    material = {"type": "roughdielectric", "alpha": 0.3}
    context = BSDFContext()
    context.component = 0 if sample1 == 0 else 1

    def alone(angle: Float) -> Float:
        si = dr.zeros(djpt.SurfaceInteraction3f)
        si.wi = Vector3f(dr.sin(angle), 0, dr.cos(angle))
        return djpt.load_dict(material).sample(context, si, Float(0), Point2f(0.3, 0.6))[1].x

    slopes = []
    for weigh in (lambda angle: sampled(angle, material, sample1)[0], alone):
        angle = Float(ANGLE)
        dr.enable_grad(angle)
        weight = weigh(angle)
        ratio = weight / dr.detach(weight)
        dr.forward(angle)
        slopes.append(dr.grad(ratio)[0])
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-4)
    assert abs(slopes[0]) > 1e-3

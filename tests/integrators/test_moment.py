"""Moments: Mitsuba's channels, and the variance that images of many seeds have."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import RenderError
from djpt.validation import agreement
from tests.kit.renders import box, ours, pixels, theirs

DIRECT = {"type": "direct"}


def moment(**nested: Any) -> dict[str, Any]:
    return {"type": "moment", **nested}


@pytest.mark.parametrize(
    "integrator",
    [
        moment(img=DIRECT),
        moment(img={"type": "path", "max_depth": 3}),
        moment(img=DIRECT, d={"type": "depth"}),
    ],
    ids=["direct", "path", "two"],
)
@pytest.mark.sparse(2)
def test_the_same_channels_and_pixels_as_in_mitsuba(integrator: dict[str, Any]) -> None:
    mi = pytest.importorskip("mitsuba")
    description = box(48, "box", integrator)
    names = djpt.channel_names(djpt.load_dict(description))
    image, reference = ours(description, 4, 3), theirs(description, 4, 3)
    assert image.shape == reference.shape
    assert agreement(image, reference, 1e-3).share >= 0.99
    mi.set_variant("llvm_ad_rgb")
    assert list(names[3:]) == mi.load_dict(integrator).aov_names()


@pytest.mark.parametrize("schedule", ["flat", "wave"])
@pytest.mark.parametrize("filter_name", ["box", "tent"])
@pytest.mark.sparse(4)
def test_the_schedules_of_a_path_tracer_make_its_moments(schedule: str, filter_name: str) -> None:
    alone = box(24, filter_name, {"type": "path", "max_depth": 3, "hide_emitters": True})
    scene, nested = djpt.load_dict(alone), djpt.load_dict({**alone, "integrator": moment(img=alone["integrator"])})
    color = pixels(djpt.render(scene, spp=16, seed=5, schedule=schedule))
    image = pixels(djpt.render(nested, spp=16, seed=5, schedule=schedule))
    if (schedule, filter_name) == ("wave", "tent"):  # more channels than lanes can add up: another order of additions
        np.testing.assert_allclose(image[..., :3], color, rtol=1e-6)
    else:
        np.testing.assert_array_equal(image[..., :3], color)
    # The luminance of the mean, and the second moments of the samples by themselves.
    np.testing.assert_allclose(image[..., 4], color @ [0.212671, 0.715160, 0.072169], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(
        image, pixels(djpt.render(nested, spp=16, seed=5, schedule="wave")), rtol=2e-5, atol=1e-6
    )


def test_several_integrators_have_moments_in_the_wave_schedule_only() -> None:
    scene = djpt.load_dict(box(8, "box", moment(a={"type": "path"}, b=DIRECT)))
    with pytest.raises(djpt.RenderError, match="doesn't advance vertex by vertex"):
        djpt.render(scene, spp=1, schedule="flat")


def test_moments_of_paths_in_media_are_those_of_single_samples() -> None:
    description = box(12, "box", moment(img={"type": "volpath", "max_depth": 4}))
    description["smoke"] = {
        "type": "cube",
        "bsdf": {"type": "null"},
        "interior": {"type": "homogeneous", "albedo": 0.8, "sigma_t": 0.5},
    }
    scene = djpt.load_dict(description)
    image, reference = (pixels(djpt.render(scene, spp=8, seed=2, schedule=s)) for s in ("auto", "wave"))
    np.testing.assert_allclose(image, reference, rtol=2e-5, atol=1e-6)


def test_aovs_of_nested_integrators_have_moments_too() -> None:
    description = box(16, "box", moment(a={"type": "aov", "aovs": "d:depth", "x": DIRECT}))
    names = djpt.channel_names(djpt.load_dict(description))
    assert names == ("R", "G", "B", "a.d.T", "a.X", "a.Y", "a.Z", "m2_a.d.T", "m2_a.X", "m2_a.Y", "m2_a.Z")
    image = ours(description, 1)
    np.testing.assert_allclose(image[..., 7:], image[..., 3:7] ** 2, rtol=1e-6)
    assert djpt.variance(image, names, 2).shape == (16, 16, 4)


def test_the_variance_is_that_of_many_images() -> None:
    scene = djpt.load_dict(box(12, "box", moment(img=DIRECT)))
    names, spp, seeds = djpt.channel_names(scene), 16, 64
    images = np.stack([pixels(djpt.render(scene, spp=spp, seed=seed)) for seed in range(seeds)]).astype(np.float64)
    estimated = np.mean([pixels(djpt.variance(image, names, spp)) for image in images], axis=0)
    empirical = images[..., 3:6].var(axis=0, ddof=1)
    # The sum over all pixels is known to a few per cent; a pixel's empirical variance to sqrt(2 / 63).
    assert estimated.sum() == pytest.approx(empirical.sum(), rel=0.05)
    bright = empirical > np.median(empirical)
    assert np.median(estimated[bright] / empirical[bright]) == pytest.approx(1, abs=0.08)


def test_a_constant_has_no_variance() -> None:
    names = ["a", "m2_a"]
    image = np.float32([[[3.0, 9.0], [2.0, 4.5]]])
    np.testing.assert_allclose(pixels(djpt.variance(djpt.TensorXf(image), names, 3)), [[[0.0], [0.25]]])


def test_errors() -> None:
    with pytest.raises(djpt.SceneError, match="needs a nested integrator"):
        djpt.load_dict({"type": "moment"})
    with pytest.raises(djpt.SceneError, match="from lights can't be nested"):
        djpt.load_dict(moment(a={"type": "ptracer"}))
    with pytest.raises(djpt.RenderError, match="render with a 'moment' integrator"):
        djpt.variance(np.zeros((2, 2, 3)), "RGB", 4)
    with pytest.raises(djpt.RenderError, match="at least 2 samples"):
        djpt.variance(np.zeros((2, 2, 3)), "RGB", 1)
    with pytest.raises(djpt.RenderError, match="an image of 3 channels"):
        djpt.variance(np.zeros((2, 2, 4)), "RGB", 4)


@pytest.mark.parametrize("kind", ["prb_projective", "direct_projective", "prb_basic"])
@pytest.mark.parametrize("outer", [{"type": "moment"}, {"type": "aov", "aovs": "far:depth"}], ids=["moment", "aov"])
def test_integrators_that_render_by_themselves_can_be_nested(kind: str, outer: dict[str, Any]) -> None:
    """With the random numbers, and so the image, that they have alone.

    They have no derivatives then, but for the one whose paths are advanced vertex by vertex, beside properties.
    """
    scene = djpt.load_dict(box(8))
    nested = djpt.load_dict({**outer, "nested": {"type": kind}})
    image = np.array(djpt.render(scene, spp=4, seed=3, integrator=nested))[..., :3]
    alone = np.array(djpt.render(scene, spp=4, seed=3, integrator=djpt.load_dict({"type": kind})))
    np.testing.assert_allclose(image, alone, atol=2e-6)
    params = djpt.traverse(scene)
    dr.enable_grad(params["red.reflectance.value"])
    params.update()
    if (kind, outer["type"]) == ("prb_basic", "aov"):
        changed = djpt.render(scene, params, spp=4, integrator=nested)
        dr.forward(params["red.reflectance.value"])
        assert np.array(dr.grad(changed))[..., :3].max() > 0
        return
    with pytest.raises(RenderError, match="can't be differentiated"):
        djpt.render(scene, params, spp=4, integrator=nested)

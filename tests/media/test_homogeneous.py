"""Homogeneous media: what scripts ask them, as in Mitsuba, and mistakes in descriptions."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import DjptError
from tests.kit.media_scenes import colour, fog

MEDIA: dict[str, dict[str, Any]] = {
    "default": {"type": "homogeneous"},
    "grey": fog(2.0, 0.5, scale=1.5),
    "coloured": fog(colour(0.1, 0.4, 0.9), colour(0.9, 0.5, 0.2), scale=3.0),
    "not spectral": fog(0.7, has_spectral_extinction=False, sample_emitters=False),
}


def interface(m: Any, description: dict[str, Any]) -> dict[str, np.ndarray]:
    """The answers of a medium and of a pointer to it."""
    medium = m.load_dict(description)
    ray = m.Ray3f([[0.0, 1.0], [0.0, 2.0], [0.0, 3.0]], [0.0, 0.6, 0.8])
    ray.maxt = m.Float([10.0, 0.1])
    found: dict[str, Any] = {}
    for name, asked in (("medium", medium), ("pointer", m.MediumPtr(medium))):
        u, channel = m.Float([0.3, 0.8]), m.UInt32([0, 2])
        mei = asked.sample_interaction(ray, u, channel, m.Bool(True))
        si = dr.zeros(m.SurfaceInteraction3f, 2)
        si.t = m.Float([0.2, 5.0])
        found |= {
            f"{name}.t": mei.t,
            f"{name}.p": mei.p,
            f"{name}.wi": mei.wi,
            f"{name}.combined": mei.combined_extinction,
            f"{name}.majorant": asked.get_majorant(mei),
            f"{name}.coefficients": asked.get_scattering_coefficients(mei),
            f"{name}.box": asked.intersect_aabb(ray),
            f"{name}.transmittance": asked.transmittance_eval_pdf(mei, si, m.Bool(True)),
            f"{name}.flags": [asked.is_homogeneous(), asked.use_emitter_sampling(), asked.has_spectral_extinction()],
        }
    return {
        name: np.array([np.broadcast_to(np.array(part), (3, 2)) for part in listed(x)]) for name, x in found.items()
    }


def listed(x: Any) -> list[Any]:
    return list(x) if isinstance(x, (tuple, list)) else [x]


@pytest.mark.parametrize("name", ["default", "coloured", "not spectral"])
@pytest.mark.sparse(2)
def test_interface(name: str) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    ours, theirs = interface(djpt, MEDIA[name]), interface(mi, MEDIA[name])
    if name == "default":  # a grey has no channels to choose among: see the documentation
        ours["medium.flags"][2] = ours["pointer.flags"][2] = 1
    for key, value in theirs.items():
        if key.endswith(".p"):  # of no collision
            value, ours[key] = value[..., :1], ours[key][..., :1]
        np.testing.assert_allclose(ours[key], value, rtol=1e-5, atol=1e-6, err_msg=key)


def test_parameters() -> None:
    medium = djpt.load_dict(fog(colour(0.1, 0.4, 0.9), 0.5))
    names = list(djpt.traverse(medium).keys())
    assert names == ["scale", "albedo.value.value", "sigma_t.value.value"]
    params = djpt.traverse(djpt.load_dict({"type": "scene", "ball": {"type": "sphere", "interior": fog(1.0)}}))
    assert "ball.interior_medium.albedo.value.value" in params
    params["ball.interior_medium.scale"] = 3.0
    params.update()
    assert params["ball.interior_medium.scale"] == 3.0
    with pytest.raises(DjptError, match="must be at least 0"):
        params["ball.interior_medium.scale"] = -1.0


def test_media_of_shapes_and_sensors() -> None:
    scene = djpt.load_dict(
        {
            "type": "scene",
            "mist": fog(0.1),
            "ball": {"type": "sphere", "interior": fog(1.0), "exterior": {"type": "ref", "id": "mist"}},
            "floor": {"type": "rectangle"},
            "camera": {"type": "perspective", "medium": {"type": "ref", "id": "mist"}},
        }
    )
    ball, floor = scene.shapes()
    assert ball.is_medium_transition() and not floor.is_medium_transition()
    assert ball.exterior_medium() is scene.sensors()[0].get_medium() is not None
    assert ball.interior_medium() is not ball.exterior_medium() and floor.interior_medium() is None
    si = scene.ray_intersect(djpt.Ray3f([0, 0, 5], [0, 0, -1]))
    assert si.is_medium_transition()[0]
    assert (si.target_medium(djpt.Vector3f(0, 0, -1)) == ball.interior_medium())[0]
    assert (si.target_medium(djpt.Float(1.0)) == ball.exterior_medium())[0]
    assert (si.target_medium(cos_theta=1.0) == ball.exterior_medium())[0]
    with pytest.raises(djpt.DjptError, match=r"target_medium\(\): give a direction"):
        si.target_medium()


@pytest.mark.parametrize(
    ("description", "words"),
    [
        (fog(-1.0), "'sigma_t' must be at least 0, found -1"),
        (fog(1.0, 1.5), "'albedo'.* found 1.5"),
        (fog(scale=-2.0), "'scale' must be at least 0"),
        (fog(sgima=2.0), "unknown key 'sgima'"),
        ({"type": "sphere", "interior": {"type": "diffuse"}}, "'interior' must be a medium, found the bsdf"),
    ],
)
def test_errors(description: dict[str, Any], words: str) -> None:
    with pytest.raises(DjptError, match=words):
        djpt.load_dict(description)


def test_two_media_in_one_body() -> None:
    """A BSDF that absorbs, and an interior medium."""
    ball = {"type": "sphere", "bsdf": {"type": "dielectric", "absorption": 1.0}, "interior": fog()}
    with pytest.raises(DjptError, match=r"the BSDF '.*' absorbs, and the shape has an 'interior'"):
        djpt.load_dict({"type": "scene", "ball": ball})

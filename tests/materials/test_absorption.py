"""Coloured glass: light that runs through an absorbing body fades with the distance."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import Float
from tests.kit.derivatives import by_both
from tests.kit.renders import ours, pixels
from tests.kit.smooth_materials import wide

SIGMA = [0.2, 0.5, 0.9]


def scene(
    origin: Any, integrator: str = "path", target: Any = (0, 0, 0), fov: float = 30, **nodes: Any
) -> dict[str, Any]:
    """A camera, and whatever `nodes` has."""
    return {
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": 16},
        "sensor": {
            "type": "perspective",
            "fov": fov,
            "to_world": T().look_at(origin=list(origin), target=list(target), up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}},
        },
        **nodes,
    }


def glass(ior: float = 1.5, **more: Any) -> dict[str, Any]:
    return {"type": "glass", "int_ior": ior, "ext_ior": 1.0, "absorption": {"type": "rgb", "value": SIGMA}, **more}


SKY = {"type": "constant", "radiance": 1.0}


def test_camera_inside() -> None:
    """exp(-sigma r) at the centre of a ball that doesn't refract; the ray begins at the near plane."""
    image = ours(
        scene([0, 0, 0], target=[0, 0, 1], sky=SKY, ball={"type": "sphere", "radius": 2.0, "bsdf": glass(1.0)})
    )
    y, x = np.mgrid[:24, :24]
    slope = np.tan(np.radians(15)) * (np.stack([x, y]) - 11.5) / 12
    near = 0.01 * np.sqrt(1 + (slope**2).sum(axis=0))
    np.testing.assert_allclose(image, np.exp(-np.array(SIGMA) * (2 - near)[..., None]), rtol=1e-3)


def test_chords_of_a_ball() -> None:
    """A camera with a narrow view: the chord through the centre has length 2."""
    image = ours(scene([0, 0, 5], fov=0.1, sky=SKY, ball={"type": "sphere", "bsdf": glass(1.0)}))
    np.testing.assert_allclose(image.mean(axis=(0, 1)), np.exp(-2 * np.array(SIGMA)), rtol=1e-3)


def test_mesh_bodies() -> None:
    """A cube as triangles: the machine schedule."""
    cube = {"type": "cube", "bsdf": glass(1.0)}
    wall = {"type": "rectangle", "to_world": T().translate([0, 0, -3]).scale(9), "emitter": {"type": "area"}}
    description = scene([0, 0, 5], fov=0.1, cube=cube, wall=wall)
    mesh = djpt.Mesh("cube", vertex_positions=corners(), faces=faces(), props={"bsdf": djpt.load_dict(glass(1.0))})
    for flat in (description, {**description, "cube": mesh}):
        image = ours(flat)
        np.testing.assert_allclose(image.mean(axis=(0, 1)), np.exp(-2 * np.array(SIGMA)), rtol=1e-3)


def corners() -> Any:
    return np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], float)


def faces() -> Any:
    return np.array([[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7],
                     [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]])  # fmt: skip


INSIDE: dict[str, Any] = {
    "lamp": {"type": "sphere", "center": [0.8, 0.5, 0], "radius": 0.2, "emitter": {"type": "area", "radiance": 5.0}},
    "stone": {"type": "sphere", "center": [-0.4, -0.3, 0], "radius": 0.5, "bsdf": {"type": "diffuse"}},
}
"""A lamp and a stone, both within the ball: light sampling fades, too."""


@pytest.mark.parametrize("origin", [(0, 0, 6), (0, 0, 1.5)], ids=["outside", "inside"])
@pytest.mark.parametrize("inside", [{}, INSIDE], ids=["clear", "filled"])
@pytest.mark.sparse(4)
def test_as_an_absorbing_medium(inside: dict[str, Any], origin: Any) -> None:
    """Mitsuba's volumetric path tracer with a medium that doesn't scatter."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    air = {"int_ior": 1.5, "ext_ior": 1.0}
    mine = {"type": "dielectric", **air, "absorption": {"type": "rgb", "value": SIGMA}}
    ball = {"type": "sphere", "radius": 2.0}
    image = ours(scene(origin, sky=SKY, ball={**ball, "bsdf": mine}, **inside), spp=1024)

    medium = {"type": "homogeneous", "albedo": 0.0, "sigma_t": {"type": "rgb", "value": SIGMA}}
    theirs = scene(origin, "volpath", sky=SKY, **inside)
    theirs["ball"] = {**ball, "bsdf": {"type": "dielectric", **air}, "interior": medium}
    if origin[2] < 2:
        theirs["sensor"]["medium"] = medium
    theirs["sensor"]["to_world"] = mi.ScalarTransform4f(theirs["sensor"]["to_world"].matrix)
    reference = np.array(mi.render(mi.load_dict(theirs, optimize=False), spp=2048))
    np.testing.assert_allclose(image.mean(axis=(0, 1)), reference.mean(axis=(0, 1)), rtol=0.02)


@pytest.mark.parametrize("inside", [{}, INSIDE], ids=["clear", "filled"])
@pytest.mark.sparse(2)
def test_gradient(inside: dict[str, Any]) -> None:
    """Absorption moves no sample, so equal seeds make differences exact."""
    loaded = djpt.load_dict(
        scene([0, 0, 6], sky=SKY, ball={"type": "sphere", "radius": 2.0, "bsdf": glass()}, **inside)
    )
    key = next(k for k in djpt.traverse(loaded) if "absorption" in k)
    for along in np.eye(3):
        found, expected = by_both(loaded, key, 1e-2, along, spp=64)
        assert found == pytest.approx(expected, rel=0.02)


def test_clear_glass_costs_nothing() -> None:
    """Without `absorption`, rays carry no medium."""
    clear = djpt.load_dict(scene([0, 0, 6], sky=SKY, ball={"type": "sphere", "bsdf": {"type": "dielectric"}}))
    assert clear.camera_medium is None
    assert np.isfinite(pixels(djpt.render(clear, spp=4))).all()


# ---------------------------------------------------------------- asked without a scene


@pytest.mark.parametrize("name", ["dielectric", "glass"])
def test_absorption_is_exponential(name: str) -> None:
    rgb = [0.0, 0.5, 2.0]
    bsdf = djpt.load_dict({"type": name, "absorption": {"type": "rgb", "value": rgb}})
    assert bsdf.absorbs
    distances = np.array([0.0, 0.3, 4.0, 1e4])
    found = wide(bsdf.transmittance(Float(distances)), 4)
    np.testing.assert_allclose(found, np.exp(-np.outer(rgb, distances)), rtol=1e-5)
    params = djpt.traverse(bsdf)
    assert params.flags("absorption.value").differentiable
    params["absorption.value"] = [1, 1, 1]
    params.update()
    np.testing.assert_allclose(wide(bsdf.transmittance(Float(1.0)), 1), np.exp(-1), rtol=1e-6)


def test_clear_glass_absorbs_nothing() -> None:
    bsdf = djpt.load_dict({"type": "glass"})
    assert not bsdf.absorbs
    np.testing.assert_array_equal(wide(bsdf.transmittance(Float(5.0)), 1), 1)
    assert list(djpt.traverse(bsdf)) == ["eta"]


def test_derivative_of_absorption() -> None:
    bsdf = djpt.load_dict({"type": "dielectric", "absorption": 0.7})
    params = djpt.traverse(bsdf)
    dr.enable_grad(params["absorption.value"])
    params.update()
    dr.backward(bsdf.transmittance(Float(2.0)))
    np.testing.assert_allclose(wide(dr.grad(params["absorption.value"]), 1).ravel(), -2 * np.exp(-1.4), rtol=1e-5)

"""Derivatives by the numbers and the motion of cameras that see wide angles, and by what they see: differences."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.integrators.projective.viewpoints import sampled_from_many
from djpt.jit.types import Bool, Float, Point3f, UInt32
from tests.silhouettes.camera_cases import GROUND
from tests.silhouettes.cases import SPOTS, Case, Move, ball, edit, sensor, shift, slide, turn_head
from tests.silhouettes.test_projective import octahedron

LAMP = {"type": "area", "radiance": SPOTS}
PLACED = T().rotate([0.6, 0.64, 0.48], 75)
SEEN: dict[str, Any] = {
    "a globe": lambda: {"moving": ball(radius=0.9, emitter=LAMP)},
    "a cylinder": lambda: {
        "moving": {"type": "cylinder", "radius": 0.5, "to_world": PLACED, "emitter": {"type": "area", "radiance": 1.0}}
    },
    "a cube": lambda: {
        "moving": {"type": "cube", "to_world": PLACED.scale(0.6), "emitter": {"type": "area", "radiance": 1.0}}
    },
    "a mesh": lambda: {"moving": octahedron((0.2, 0.1, 0), 0.9, {"type": "area", "radiance": 1.0})},
    "the light of a point": lambda: {
        "moving": ball({"type": "diffuse", "reflectance": SPOTS}, center=[0.5, 0.2, 1], radius=0.8),
        "floor": GROUND,
        "light": {"type": "point", "position": [1, 2, 6], "intensity": 40.0},
    },
    "a large globe": lambda: {"moving": ball(center=[0.35, 0.2, 0], radius=1.7, emitter=LAMP)},
}


def eye(which: str) -> dict[str, Any]:
    """An eye of a giant: 0.5 aside from the middle, at the distance 6 of what it sees."""
    camera = sensor(type="panorama", eye=which, eye_distance=1.0, azimuth_from=-22.0, azimuth_to=22.0)
    del camera["fov"]
    return {**camera, "elevation_from": -18.0, "elevation_to": 18.0}


def of(camera: dict[str, Any], seen: str, move: Move, **more: Any) -> Case:
    """A case of a camera and what it sees."""
    shaded = seen == "the light of a point"
    settings = {} if shaded else {"sppi": 0}
    kinds = ("prb_projective",) if shaded else ("direct_projective",)
    return Case(lambda: {**SEEN[seen](), "sensor": camera}, move, kinds, spp=512, settings=settings, **more)


CASES: dict[str, Case] = {}
for where in ("a globe", "a cylinder", "a cube", "the light of a point"):
    for motion, move in {
        "distance": edit("sensor.eye_distance", 1),
        "turn": turn_head,
        "step aside": shift("sensor.to_world"),
        "azimuth": edit("sensor.azimuth_to", 10),
        "what is seen": slide if where == "a cube" else shift("moving.to_world"),
    }.items():
        # Sharp edges pass by whole pixels: differences over long ways are those of other edges.
        finer: dict[str, Any] = {"step": 0.02, "spp_difference": 16384} if motion == "turn" else {}
        CASES[f"an eye, {motion}: {where}"] = of(eye("left" if motion == "distance" else "right"), where, move, **finer)
CASES["an eye, what is seen: a mesh"] = of(eye("left"), "a mesh", slide)

CIRCLE = sensor(type="fisheye", image_circle=16.0, principal_point_offset_x=0.1)
POLYNOMIAL = {**sensor(type="fisheye"), "fx": 14.0, "k1": -2.5, "k2": 0.3}
del POLYNOMIAL["fov"]
BARREL = sensor(fov=60, k1=-0.9, k2=-0.3, p1=0.03)
for where in ("a large globe", "the light of a point"):
    for name, camera, move in (
        ("an image circle, its angle", CIRCLE, edit("sensor.image_circle", 10)),
        ("an image circle, focal length", CIRCLE, edit("sensor.x_focal", 0.5)),
        ("an image circle, principal point", CIRCLE, edit("sensor.principal_point_offset_y", 0.3)),
        ("a polynomial that turns, k1", POLYNOMIAL, edit("sensor.k1", 3)),
        ("a picture that folds, k1", BARREL, edit("sensor.k1", 1)),
        ("a picture that folds, p1", BARREL, edit("sensor.p1", 0.2)),
        ("a thinner medium, its index", sensor(fov=150, ior=0.5), edit("sensor.eta", 0.3)),
        ("water, its index", sensor(ior="water"), edit("sensor.eta", 0.5)),
    ):
        CASES[f"{name}: {where}"] = of(camera, where, move, step=0.01, spp_difference=8192)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_derivatives_are_those_of_differences(name: str) -> None:
    (kind,) = CASES[name].kinds
    CASES[name].check(kind, name)


def slope_of_mean(camera: dict[str, Any], key: str, **nodes: Any) -> float:
    """The derivative of the mean of an image, in forward mode."""
    scene = djpt.load_dict({"type": "scene", "sensor": camera, **nodes})
    params = djpt.traverse(scene)
    value = Float(params[f"sensor.{key}"])
    dr.enable_grad(value)
    params[f"sensor.{key}"] = value
    params.update()
    image = djpt.render(scene, params, spp=1024, integrator=djpt.load_dict({"type": "direct_projective", "sppi": 0}))
    dr.set_grad(value, 1)
    return float(np.array(dr.forward_to(image)).mean())


def test_eyes_further_apart_see_a_plate_under_other_angles() -> None:
    """A point at the distance d from the axis and the azimuth psi is seen at psi + asin(r / d), r half of the distance
    of the eyes."""
    film = {"type": "hdrfilm", "width": 32, "height": 4, "rfilter": {"type": "box"}}
    camera = {"type": "panorama", "eye": "left", "eye_distance": 1.0, "elevation_from": -30.0, "elevation_to": 30.0}
    camera |= {"azimuth_from": 0.0, "azimuth_to": 90.0}  # the left edge isn't seen
    plate = {"type": "rectangle", "to_world": T().translate([0.5, 0, 2]).rotate([0, 1, 0], 180).scale([1.5, 2, 1])}
    found = slope_of_mean({**camera, "film": film}, "eye_distance", plate={**plate, "emitter": {"type": "area"}})
    assert found == pytest.approx(0.5 / np.sqrt(1 + 2**2 - 0.5**2) / (np.pi / 2), rel=0.015)


def test_a_wider_image_circle_shows_more_of_a_white_sky() -> None:
    """Its area is pi rho^2, with rho the focal length times half of the angle."""
    camera = {**sensor(type="fisheye", image_circle=30.0), "to_world": T()}
    found = slope_of_mean(camera, "image_circle", sky={"type": "constant"}, small=ball(center=[0, 0, 9], radius=0.1))
    focal, radian = 0.5 / np.radians(20), np.pi / 180
    assert found == pytest.approx(2 * np.pi * focal**2 * (15 * radian) * radian / 2, rel=0.01)


@pytest.mark.parametrize("kind", ["sphere", "cylinder", "paraboloid"])
@pytest.mark.sparse(2)
def test_an_eye_sees_outlines_from_many_places(kind: str) -> None:
    """Each line of sight from the place that sees the point is a tangent, and densities are those of the curve."""
    place = T().translate([0.5, 0.4, 2.5]).rotate([1, 0, 0], 60).scale(0.5)
    one = djpt.load_dict({"type": "scene", "one": {"type": kind, "to_world": place}}).shapes()[0]
    camera = djpt.load_dict({"type": "panorama", "eye": "left", "eye_distance": 0.6})
    count = 2048
    u = Float(((np.arange(count) + 0.5) / count).astype(np.float32))
    (*_, part) = np.array(one.precompute_silhouette(Point3f(0))[0])
    ss = sampled_from_many(one, Point3f(0), camera.sight, UInt32(int(part)), u, Bool(True))
    p, n, d = (np.array(v, np.float64) for v in (ss.p, ss.n, ss.d))
    way = p - np.array(camera.sight(ss.p)[0], np.float64)
    assert np.abs((way * n).sum(0)).max() < 1e-5 and np.array(ss.is_valid()).all()
    across = np.cross(n.T, d.T).T
    speed = (np.gradient(p, 1 / count, axis=1) * across).sum(0) / (np.array(ss.silhouette_d) * across).sum(0)
    ratio = np.abs(speed) * np.array(ss.pdf)
    # A cylinder has two lines, from one to the other of which the curve jumps.
    assert np.mean(np.abs(ratio - 1) < 2e-3) > 0.99

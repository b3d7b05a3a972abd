"""Cameras within a medium: refraction at their window, absorption, and what is around them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt import ScalarTransform4f as T
from djpt.materials.ior import IOR
from djpt.scene.surroundings import index_around, surroundings

ETA = IOR["water"] / IOR["air"]
SIZE, FOV = 512, 60.0
FILM = {"type": "hdrfilm", "width": SIZE, "height": 8, "rfilter": {"type": "box"}}


def camera(**more: Any) -> dict[str, Any]:
    return {"type": "perspective", "fov": FOV, "fov_axis": "x", "film": FILM, **more}


def facing(half: float, distance: float) -> dict[str, Any]:
    """A ruler that shines."""
    place = T().translate([0, 0, distance]).rotate([0, 1, 0], 180).scale([half, 0.4, 1])
    return {"type": "rectangle", "to_world": place, "emitter": {"type": "area", "radiance": 1.0}}


def shown_width(scene: dict[str, Any], **integrator: Any) -> float:
    """The width of what shines, in pixels."""
    image = np.array(djpt.render(djpt.load_dict({"type": "scene", **scene}), spp=256, **integrator))
    return float(image[2:6].mean(axis=(0, 2)).sum() / image.max())


@pytest.mark.parametrize("half", [0.1, 0.4, 0.7])
def test_a_ruler_in_water_has_the_length_of_snells_law(half: float) -> None:
    distance = 2.0
    scene = {"ruler": facing(half, distance), "sensor": camera(ior="water"), "integrator": {"type": "direct"}}
    outside = np.arctan(half / distance)
    inside = np.arcsin(ETA * np.sin(outside))
    expected = SIZE * np.tan(inside) / np.tan(np.radians(FOV / 2))
    assert shown_width(scene) == pytest.approx(expected, rel=0.005)
    # In air it is smaller by about the index.
    dry = shown_width({**scene, "sensor": camera()})
    assert dry == pytest.approx(SIZE * np.tan(outside) / np.tan(np.radians(FOV / 2)), rel=0.005)


def test_water_around_the_camera_absorbs() -> None:
    sigma, distance = 0.4, 2.0
    water = {"type": "dielectric", "int_ior": "water", "absorption": sigma}
    sea = {"type": "sphere", "radius": 9.0, "bsdf": water}
    scene = {"sea": sea, "ruler": facing(0.3, distance), "sensor": camera(ior="water"), "integrator": {"type": "path"}}
    image = np.array(djpt.render(djpt.load_dict({"type": "scene", **scene}), spp=16))
    middle = float(image[3:5, SIZE // 2 - 1 : SIZE // 2 + 1].mean())
    assert middle == pytest.approx(np.exp(-sigma * distance), rel=0.005)


def test_light_paths_reach_the_camera_where_it_sees_them() -> None:
    film = {**FILM, "width": 24, "height": 24}
    view = {"to_world": T().look_at([0, 0, 2.5], [0, 0, 0], [0, 1, 0])}
    scene = {
        "sensor": camera(ior="water", **view) | {"film": film},
        "floor": {"type": "rectangle"},
        "lamp": {"type": "point", "position": [0.3, 0.2, 1.5], "intensity": 3.0},
    }
    loaded = djpt.load_dict({"type": "scene", **scene})
    images = [
        np.array(djpt.render(loaded, spp=spp, integrator=djpt.load_dict({"type": name, "max_depth": 2})))
        for name, spp in (("path", 256), ("ptracer", 4096))
    ]
    assert images[0].mean() > 0.05
    # The magnification, and with it the density of light paths, grows from the middle to the rim.
    inner = np.zeros((24, 24), np.bool_)
    inner[6:18, 6:18] = True
    for part in (inner, ~inner):
        assert images[1][part].mean() == pytest.approx(images[0][part].mean(), rel=0.01)


def test_a_camera_in_air_is_one_without_a_medium() -> None:
    scene = {"ruler": facing(0.4, 2.0), "integrator": {"type": "direct"}}
    dry, air = (shown_width({**scene, "sensor": camera(**more)}) for more in ({}, {"ior": "air"}))
    assert air == pytest.approx(dry, rel=1e-4)
    assert type(djpt.load_dict(camera())).__name__ == "Perspective"


def test_the_index_is_a_parameter_and_goes_with_no_distortion() -> None:
    sensor = djpt.load_dict(camera(ior=1.5))
    assert float(djpt.traverse(sensor)["eta"][0]) == pytest.approx(1.5 / IOR["air"])
    with pytest.raises(djpt.DjptError, match="ior"):
        djpt.load_dict(camera(ior=1.5, k1=0.1))


def glass_of_water() -> djpt.Scene:
    """Water that reaches into the wall of a glass ball, in the sea."""
    bodies = {
        "sea": {"type": "sphere", "radius": 8.0, "bsdf": {"type": "dielectric", "int_ior": 1.4, "ext_ior": 1.0}},
        "glass": {"type": "sphere", "radius": 2.0, "bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}},
        "drink": {"type": "cube", "bsdf": {"type": "dielectric", "int_ior": 1.3, "ext_ior": 1.0}},
    }
    return djpt.load_dict({"type": "scene", **bodies, "wall": {"type": "rectangle", "to_world": T().scale(20)}})


def test_bodies_around_a_point_are_found_by_vote_and_priority() -> None:
    scene = glass_of_water()
    found = surroundings(scene, [0.3, 0.2, 0.1])
    assert [body.shape.id() for body in found] == ["drink", "glass", "sea"]
    assert all(body.votes == 1 for body in found)
    assert index_around(scene, [0.3, 0.2, 0.1]) == pytest.approx(1.3)
    assert index_around(scene, [0.3, 0.2, 0.1], {"glass": 1}) == pytest.approx(1.5)
    assert index_around(scene, [1.5, 0.2, 0.1]) == pytest.approx(1.5)
    assert index_around(scene, [5.0, 0.2, 0.1]) == pytest.approx(1.4)
    assert index_around(scene, [15.0, 0.2, 0.1]) == 1


@pytest.mark.parametrize("bsdf", ["plastic", "thindielectric", "diffuse", "conductor"])
def test_bodies_that_light_doesnt_enter_or_that_are_hollow_have_no_index(bsdf: str) -> None:
    scene = djpt.load_dict({"type": "scene", "body": {"type": "sphere", "bsdf": {"type": bsdf}}})
    (body,) = surroundings(scene, [0.1, 0.2, 0.3])
    assert body.eta is None
    assert index_around(scene, [0.1, 0.2, 0.3]) == 1


def test_an_ambiguous_place_is_said_to_be_one() -> None:
    """A point on a face of the cube: half of the rays begin outside."""
    cube = {"type": "cube", "bsdf": {"type": "dielectric"}}
    scene = djpt.load_dict({"type": "scene", "box": cube})
    with pytest.raises(djpt.DjptError, match=r"box: whether the point .* is ambiguous"):
        index_around(scene, [0.3, 0.2, 1.0])

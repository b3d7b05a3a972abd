"""Every sensor: Mitsuba's rays and parameter names, refused descriptions, edits."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import ParameterError, RenderError, SceneError
from djpt.jit.types import Point2f

POSITIONS, APERTURES = np.random.default_rng(1).random((2, 2, 64)).astype(np.float32)
FILMS: dict[str, dict[str, Any]] = {
    "wide": {"width": 40, "height": 30},
    "tall crop": {
        "width": 30, "height": 40, "crop_width": 7, "crop_height": 13, "crop_offset_x": 5, "crop_offset_y": 9,
    },
}  # fmt: skip
LOOK = T().look_at(origin=[1, 2, 3], target=[-3, 0.5, 1], up=[0, 1, 0.1])
CAMERAS: dict[str, dict[str, Any]] = {
    "thinlens": {"type": "thinlens", "aperture_radius": 0.2, "to_world": LOOK},
    "thinlens focus": {
        "type": "thinlens", "aperture_radius": 0.7, "focus_distance": 3.5, "fov": 60, "fov_axis": "y", "to_world": LOOK,
    },
    "thinlens clip": {
        "type": "thinlens", "aperture_radius": 0.05, "focus_distance": 2.0, "focal_length": "85mm",
        "near_clip": 0.5, "far_clip": 30.0,
    },
    "orthographic": {"type": "orthographic"},
    "orthographic placed": {"type": "orthographic", "to_world": LOOK},
    "orthographic scaled": {"type": "orthographic", "to_world": LOOK @ T().scale([2, 3, 0.5]), "near_clip": 0.5},
    "orthographic mirrored": {"type": "orthographic", "to_world": LOOK @ T().scale([-2, 2, 2]), "far_clip": 12.0},
}  # fmt: skip
METERS: dict[str, dict[str, Any]] = {
    "radiancemeter": {"type": "radiancemeter"},
    "radiancemeter placed": {"type": "radiancemeter", "to_world": LOOK},
    "radiancemeter direction": {"type": "radiancemeter", "origin": [1, 2, 3], "direction": [-1, 0.5, 4]},
    "radiancemeter both": {"type": "radiancemeter", "origin": [1, 2, 3], "direction": [1, 0, 0], "to_world": LOOK},
    "distant": {"type": "distant"},
    "distant placed": {"type": "distant", "to_world": LOOK},
    "distant down": {"type": "distant", "direction": [0, 0, -2]},
    "distant direction": {"type": "distant", "direction": [1, 2, -3]},
    "distant point": {"type": "distant", "direction": [1, 2, -3], "target": [3, 2, 1]},
    "distant rectangle": {
        "type": "distant", "direction": [1, -2, -3],
        "target": {"type": "rectangle", "to_world": T().translate([1, 2, 3]).scale(2)},
    },
    "distant sphere": {"type": "distant", "target": {"type": "sphere", "center": [3, 4, 5], "radius": 0.5}},
    "distant cube": {"type": "distant", "target": {"type": "cube", "to_world": LOOK}},
}  # fmt: skip
CARRIERS: dict[str, dict[str, Any]] = {
    "sphere": {"type": "sphere", "center": [1, 0, 0], "radius": 2},
    "rectangle": {"type": "rectangle", "to_world": LOOK @ T().scale([1, 2, 1])},
    "flipped rectangle": {"type": "rectangle", "flip_normals": True},
    "disk": {"type": "disk", "to_world": LOOK},
    "cylinder": {"type": "cylinder", "radius": 0.5, "to_world": LOOK},
    "cube": {"type": "cube"},
}
PIXEL = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
BOX = {"type": "box"}


def as_mitsuba(mi: Any, node: Any) -> Any:
    """A description with Mitsuba's transforms."""
    if isinstance(node, dict):
        return {key: as_mitsuba(mi, value) for key, value in node.items()}
    return mi.ScalarTransform4f(node.matrix) if isinstance(node, T) else node


def rays(sensor: Any) -> Any:
    return sensor.ray_through(Point2f(POSITIONS), Point2f(APERTURES))


def assert_mitsubas_rays(mi: Any, ours: Any, theirs: Any, atol: float = 1e-6) -> None:
    ray = rays(ours)
    expected, weight = theirs.sample_ray_differential(0, 0, mi.Point2f(POSITIONS), mi.Point2f(APERTURES))
    np.testing.assert_allclose(*np.broadcast_arrays(np.array(ray.o), np.array(expected.o)), atol=atol)
    np.testing.assert_allclose(*np.broadcast_arrays(np.array(ray.d), np.array(expected.d)), atol=atol)
    np.testing.assert_allclose(np.array(weight), ours.weight, rtol=1e-6)
    maxt = np.array(expected.maxt)
    np.testing.assert_allclose(np.array(ray.maxt), np.where(maxt > 1e38, np.inf, maxt), rtol=2e-6)


@pytest.mark.parametrize("film", FILMS)
@pytest.mark.parametrize("name", CAMERAS)
def test_cameras_have_mitsubas_rays(mi: Any, name: str, film: str) -> None:
    description = {**CAMERAS[name], "film": {"type": "hdrfilm", **FILMS[film]}}
    ours, theirs = djpt.load_dict(description), mi.load_dict(as_mitsuba(mi, description))
    assert_mitsubas_rays(mi, ours, theirs)
    assert list(djpt.traverse(ours)) == list(mi.traverse(theirs).keys())
    assert ours.needs_aperture_sample() == theirs.needs_aperture_sample()


@pytest.mark.parametrize("name", METERS)
def test_meters_have_mitsubas_rays(mi: Any, name: str) -> None:
    ball = {"type": "sphere", "center": [1, 0, 0], "radius": 2}
    description = {"type": "scene", "ball": ball, "meter": {**METERS[name], "film": PIXEL}}
    (ours,), (theirs,) = djpt.load_dict(description).sensors(), mi.load_dict(as_mitsuba(mi, description)).sensors()
    assert_mitsubas_rays(mi, ours, theirs, atol=3e-6)
    # Mitsuba's can't be moved.
    assert [key for key in djpt.traverse(ours) if key != "to_world"] == list(mi.traverse(theirs).keys())
    assert ours.needs_aperture_sample() == theirs.needs_aperture_sample()


@pytest.mark.parametrize("name", CARRIERS)
def test_irradiance_meters_have_mitsubas_rays(mi: Any, name: str) -> None:
    description = {"type": "scene", "carrier": {**CARRIERS[name], "sensor": {"type": "irradiancemeter", "film": PIXEL}}}
    ours, theirs = djpt.load_dict(description), mi.load_dict(as_mitsuba(mi, description), optimize=False)
    assert_mitsubas_rays(mi, ours.sensors()[0], theirs.sensors()[0], atol=3e-6)
    assert {key for key, _ in mi.traverse(theirs).items() if ".sensor." in key} <= set(djpt.traverse(ours))


def test_an_irradiance_meter_stands_on_a_mesh(mi: Any) -> None:
    vertices, faces = np.random.default_rng(2).random((5, 3)), [[0, 1, 2], [1, 2, 3], [2, 3, 4]]
    meter = {"type": "irradiancemeter", "film": PIXEL}
    ours = djpt.Mesh("mesh", vertices, faces, props={"sensor": meter})
    scene = djpt.load_dict({"type": "scene", "mesh": ours})
    props = mi.Properties()
    props["sensor"] = mi.load_dict(meter)
    theirs = mi.Mesh("mesh", 5, 3, props=props)
    params = mi.traverse(theirs)
    params["vertex_positions"], params["faces"] = vertices.ravel(), np.ravel(faces)
    params.update()
    assert_mitsubas_rays(mi, scene.sensors()[0], theirs.sensor(), atol=3e-6)
    target = djpt.load_dict({"type": "distant", "target": ours})
    np.testing.assert_allclose(
        np.array(rays(target).o)[:2], np.array(theirs.sample_position(0, mi.Point2f(APERTURES)).p)[:2], atol=1e-6
    )


def batch(**entries: Any) -> dict[str, Any]:
    film = {"type": "hdrfilm", "width": 42, "height": 10, "rfilter": BOX}
    return {"type": "batch", "film": film, **entries}


MIXED = {
    "first": {"type": "perspective", "fov": 40, "to_world": LOOK},
    "second": CAMERAS["thinlens focus"],
    "third": {"type": "perspective", "fov": 50, "fov_axis": "y", "to_world": T().translate([1, 2, 3])},
}


def test_batches_have_mitsubas_rays(mi: Any) -> None:
    description = batch(**MIXED)
    ours, theirs = djpt.load_dict(description), mi.load_dict(as_mitsuba(mi, description))
    assert_mitsubas_rays(mi, ours, theirs, atol=2e-6)
    assert list(djpt.traverse(ours)) == list(mi.traverse(theirs).keys())
    crop = {"type": "hdrfilm", "width": 42, "height": 10, "crop_width": 20, "crop_offset_x": 3}
    description = batch(**{**MIXED, "film": crop})
    assert_mitsubas_rays(mi, djpt.load_dict(description), mi.load_dict(as_mitsuba(mi, description)), atol=2e-6)


def test_batches_of_irradiance_meters_have_mitsubas_rays(mi: Any) -> None:
    meter = {"type": "irradiancemeter", "film": PIXEL}
    shapes = {name: {**CARRIERS[name], "meter": meter} for name in ("sphere", "rectangle", "cube")}

    def theirs() -> Any:
        return mi.load_dict(as_mitsuba(mi, batch(**shapes)), optimize=False)  # which merges the meters

    assert_mitsubas_rays(mi, djpt.load_dict(batch(**shapes)), theirs(), atol=3e-6)
    # Shapes of the scene, which move.
    references = {f"part-{name}": {"type": "ref", "id": name} for name in shapes}
    scene = djpt.load_dict({"type": "scene", **shapes, "batch": batch(**references)}, optimize=False)
    params = djpt.traverse(scene)
    params.update({"sphere.to_world": T().translate([5, 0, 0])})
    shapes["sphere"] = {"type": "sphere", "center": [5, 0, 0], "meter": meter}
    assert_mitsubas_rays(mi, scene.sensors()[-1], theirs(), atol=3e-6)


EDITS: dict[str, dict[str, Any]] = {
    "thinlens": {"aperture_radius": 0.4, "focus_distance": 2.5, "x_fov": 70.0, "to_world": T().translate([1, 2, 3])},
    "orthographic": {"near_clip": 0.25, "far_clip": 30.0, "to_world": LOOK @ T().scale([3, 3, 1])},
}


@pytest.mark.parametrize("name", EDITS)
def test_edits_move_the_rays_as_in_mitsuba(mi: Any, name: str) -> None:
    description = {**CAMERAS[name], "film": {"type": "hdrfilm", **FILMS["tall crop"]}}
    ours, theirs = djpt.load_dict(description), mi.load_dict(as_mitsuba(mi, description))
    edits = {**EDITS[name], "film.crop_size": (9, 11), "film.crop_offset": (3, 2)}
    djpt.traverse(ours).update(edits)
    params = mi.traverse(theirs)
    for key, value in edits.items():
        params[key] = mi.Transform4f(value.matrix) if key == "to_world" else value
    params.update()
    assert_mitsubas_rays(mi, ours, theirs)


def test_moving_a_distant_sensors_target_moves_its_rays() -> None:
    disk = {"type": "disk", "to_world": T().scale(0.1)}
    meter = {"type": "distant", "target": {"type": "ref", "id": "disk"}}
    scene = djpt.load_dict({"type": "scene", "disk": disk, "meter": meter})
    djpt.traverse(scene).update({"disk.to_world": T().translate([7, 8, 9]).scale(0.1)})
    np.testing.assert_allclose(np.array(rays(scene.sensors()[0]).o)[:2].mean(axis=1), [7, 8], atol=0.1)


# ---------------------------------------------------------------- refused

THIN = {"type": "thinlens", "aperture_radius": 0.1}
SHEAR = T([[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
VIEW = {"type": "perspective", "fov": 40}
METER = {"type": "irradiancemeter", "film": PIXEL}
REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "no aperture": ({"type": "thinlens"}, "'thinlens' needs the key 'aperture_radius'"),
    "aperture 0": ({**THIN, "aperture_radius": 0.0}, "'aperture_radius' must be greater than 0, found 0"),
    "focus 0": ({**THIN, "focus_distance": 0.0}, "'focus_distance' must be greater than 0, found 0"),
    "fov": ({**THIN, "fov": 180}, r"'fov' must lie in \(0, 180\), found 180"),
    "near": ({**THIN, "near_clip": 2.0, "far_clip": 1.0}, r"'near_clip' must be less than 'far_clip' \(1\), found 2"),
    "near orthographic": (
        {"type": "orthographic", "near_clip": 2.0, "far_clip": 2.0},
        r"'near_clip' must be less than 'far_clip' \(2\), found 2",
    ),
    "scale": ({**THIN, "to_world": T().scale(2)}, "'to_world' must not scale: a camera has no size"),
    "shear": ({"type": "orthographic", "to_world": SHEAR}, "'to_world' may scale along its own axes .* found a shear"),
    "fov of orthographic": ({"type": "orthographic", "fov": 40}, "unknown key 'fov'"),
    "radiance film": (
        {"type": "radiancemeter", "film": {"type": "hdrfilm", "width": 2, "height": 1}},
        "'film' must have 1 x 1 pixels, found 2 x 1: a 'radiancemeter' measures one number",
    ),
    "distant film": ({"type": "distant", "film": {"type": "hdrfilm"}}, "must have 1 x 1 pixels, found 768 x 576"),
    "origin alone": ({"type": "radiancemeter", "origin": [0, 0, 1]}, "'origin' needs 'direction' as well"),
    "no direction": (
        {"type": "radiancemeter", "origin": [0, 0, 1], "direction": [0, 0, 0]},
        "'direction' must not be the zero vector",
    ),
    "two directions": (
        {"type": "distant", "direction": [0, 0, 1], "to_world": T()},
        "'direction' can't be given together with 'to_world'",
    ),
    "target number": ({"type": "distant", "target": 3.0}, "'target' must be three numbers"),
    "target plugin": ({"type": "distant", "target": {"type": "diffuse"}}, "'target' must be a shape, found"),
    "target without area": ({"type": "distant", "target": {"type": "plane"}}, "the area of 'plane' is unknown"),
    "irradiance to_world": (
        {"type": "irradiancemeter", "film": PIXEL, "to_world": T()},
        "'to_world' can't be given: move the shape",
    ),
    "irradiance without area": (
        {"type": "scene", "plane": {"type": "plane", "sensor": METER}},
        "'irradiancemeter' samples points by area, but the area of 'plane' is unknown",
    ),
    "camera in a shape": (
        {"type": "scene", "ball": {"type": "sphere", "sensor": VIEW}},
        "can't be nested in a shape; possible: irradiancemeter",
    ),
    "empty batch": (batch(), "a batch needs at least one nested sensor"),
    "indivisible batch": (
        batch(**{f"part{i}": VIEW for i in range(4)}),
        "batch: the film's width, 42, must be a multiple of the number of sensors, 4",
    ),
    "batch to_world": (batch(a=VIEW, to_world=T()), "'to_world' can't be given: place the sensors of the batch"),
    "batch of a shape": (batch(a=VIEW, b={"type": "sphere"}), "'b' is a shape without a sensor"),
    "batch of a meter": (batch(a=METER), "'a' must be nested in a shape; nest the shape in the batch"),
    "units": (
        batch(a=VIEW, b={"type": "sphere", "sensor": METER}),
        r"'a' and 'sensor' measure in different units \(radiance and irradiance\)",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name: str) -> None:
    description, message = REFUSED[name]
    with pytest.raises(SceneError, match=message):
        djpt.load_dict(description)


@pytest.mark.parametrize(
    ("description", "key", "value", "message"),
    [
        (THIN, "aperture_radius", 0.0, "aperture_radius: must be greater than 0, found 0"),
        (THIN, "focus_distance", -1.0, "focus_distance: must be greater than 0, found -1"),
        (THIN, "x_fov", 180.0, r"x_fov: must lie in \(0, 180\), found 180"),
        ({"type": "orthographic"}, "far_clip", 0.005, "near_clip: must be less than far_clip"),
        ({"type": "orthographic"}, "to_world", SHEAR, "to_world: may scale along its own axes"),
        (batch(a=VIEW, b=VIEW), "film.size", (7, 4), "the film's width, 7, must be a multiple"),
    ],
)
def test_refused_edits_change_nothing(description: dict[str, Any], key: str, value: Any, message: str) -> None:
    sensor = djpt.load_dict(description)
    before, params = np.array(rays(sensor).o), djpt.traverse(sensor)
    with pytest.raises(ParameterError, match=message):
        params.update({key: value})
    np.testing.assert_array_equal(np.array(rays(sensor).o), before)


def test_an_irradiance_meter_without_a_shape_cant_be_rendered() -> None:
    scene = djpt.load_dict({"type": "scene", "light": {"type": "constant"}})
    with pytest.raises(RenderError, match="must be nested in a shape of the scene"):
        djpt.render(scene, sensor=djpt.load_dict(METER), spp=1)


def test_an_irradiance_meter_warns_of_a_wide_filter() -> None:
    with pytest.warns(UserWarning, match="needs a film with a box filter"):
        djpt.load_dict({"type": "irradiancemeter"})


def test_a_batch_divides_its_film() -> None:
    shared = djpt.load_dict({"type": "hdrfilm", "width": 640, "height": 480})
    sensor = djpt.load_dict(batch(a={**VIEW, "film": shared}, b={**VIEW, "film": shared}))
    assert [tuple(s.film().size()) for s in sensor.sensors] == [(21, 10)] * 2
    assert tuple(shared.size()) == (640, 480)
    djpt.traverse(sensor).update({"film.size": (64, 20)})
    assert [tuple(s.film().crop_size()) for s in sensor.sensors] == [(32, 20)] * 2


@pytest.mark.parametrize("name", [*CAMERAS, *METERS])
def test_rays_have_unit_length(name: str) -> None:
    description = CAMERAS.get(name) or METERS[name]
    d = np.array(rays(djpt.load_dict(description)).d)
    np.testing.assert_allclose(np.linalg.norm(d, axis=0), 1, atol=1e-6)


def test_edits_compile_nothing() -> None:
    sensor = djpt.load_dict(batch(**MIXED))
    params = djpt.traverse(sensor)

    def kernels() -> set[int]:
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.eval(rays(sensor))
        return {k["hash"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT}

    before = kernels()
    old = np.array(rays(sensor).o)
    params.update({"first.to_world": T().translate([9, 9, 9]), "second.aperture_radius": 0.5, "film.size": (21, 9)})
    assert before and kernels() == before
    assert np.abs(np.array(rays(sensor).o) - old).max() > 1

"""Surface properties as images: distances, unfiltered channels, nested integrators."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from tests.kit.renders import box, ours, pixels, spheres, theirs

PATH = {"type": "path", "max_depth": 3}


def aov(aovs: str, **others: Any) -> dict[str, Any]:
    return {"type": "aov", "aovs": aovs, **others}


ORIGIN = np.array([0.2, -0.1, 3.5])
PLACE = T().look_at(list(ORIGIN), [0, 0, 0], [0, 1, 0])


@pytest.mark.parametrize("near", [0.01, 1.5])
@pytest.mark.parametrize("camera", ["perspective", "thinlens", "orthographic", "batch"])
def test_distance_is_measured_from_the_camera(camera: str, near: float) -> None:
    description = box(24, "box", aov("d:distance,t:depth,p:position", unfiltered=True))
    film = description["sensor"]["film"]
    clip = {"near_clip": near, "far_clip": 100.0}
    one = {"type": "perspective", "to_world": PLACE, **clip}
    description["sensor"] = {
        "perspective": {**one, "film": film},
        "thinlens": {**one, "type": "thinlens", "aperture_radius": 0.2, "focus_distance": 3.0, "film": film},
        "orthographic": {"type": "orthographic", "to_world": PLACE, **clip, "film": film},
        "batch": {"type": "batch", "film": film, "a": one, "b": {**one, "fov": 20}},
    }[camera]
    image = ours(description, 1)
    distance, depth, p = image[..., 0], image[..., 1], image[..., 2:5]
    hit = distance > 0
    assert hit.mean() > 0.5
    assert np.all(distance[hit] > depth[hit] + 0.99 * near)
    offset = p[hit] - ORIGIN
    forward = PLACE.matrix[:3, 2]
    expected = offset @ forward if camera == "orthographic" else np.linalg.norm(offset, axis=1)
    np.testing.assert_allclose(distance[hit], expected, rtol=2e-5)


def test_sensors_without_a_near_plane_start_at_themselves() -> None:
    description = box(1, "box", aov("d:distance,t:depth"))
    description["sensor"] = {"type": "radiancemeter", "origin": [0, 0, 3.5], "direction": [0, 0, -1]}
    distance, depth = ours(description, 1).ravel()
    assert distance == depth > 0


def test_a_batch_of_different_near_planes_has_no_distance() -> None:
    description = box((8, 4), "box", aov("d:distance"))
    cameras = {f"c{near}": {"type": "perspective", "near_clip": near} for near in (1, 2)}
    description["sensor"] = {"type": "batch", "film": description["sensor"]["film"], **cameras}
    with pytest.raises(djpt.RenderError, match="the same 'near_clip' and 'far_clip'"):
        ours(description, 1)


def test_unfiltered_channels_ignore_filter_samples_and_seed() -> None:
    shape = "s:shape_index,i:prim_index,t:depth"
    images = [
        ours(box(24, rfilter, aov(shape, unfiltered=True, image=PATH), spheres), spp, seed)
        for rfilter, spp, seed in (("box", 1, 0), ("gaussian", 3, 5))
    ]
    np.testing.assert_array_equal(images[0][..., 3:], images[1][..., 3:])
    np.testing.assert_array_equal(images[0][..., 3:5], np.round(images[0][..., 3:5]))
    assert len(np.unique(images[0][..., 3])) > 5
    # The colours are filtered and sampled as without AOVs.
    np.testing.assert_array_equal(images[1][..., :3], ours(box(24, "gaussian", PATH, spheres), 3, 5))


def test_unfiltered_channels_come_from_the_centres() -> None:
    """A fine grid of pixels, filtered, tends to the centres of coarse ones."""
    crop = {"crop_width": 6, "crop_height": 4, "crop_offset_x": 9, "crop_offset_y": 5}
    coarse = ours(box(16, "box", aov("p:position", unfiltered=True), **crop), 1)
    fine = ours(box(16 * 33, "box", aov("p:position")), 1)[16::33, 16::33][5:9, 9:15]
    # One position in a pixel of a 33rd: off by half of that, except at edges.
    assert np.median(np.abs(coarse - fine)) < 0.01


def test_names_of_unfiltered_channels() -> None:
    scene = djpt.load_dict(box(4, "box", aov("n:sh_normal", unfiltered=True, a=PATH, b={"type": "depth"})))
    assert djpt.channel_names(scene) == ("R", "G", "B", "b.R", "b.G", "b.B", "n.X", "n.Y", "n.Z")
    assert pixels(djpt.render(scene, spp=2)).shape == (4, 4, 9)


def test_colours_beside_unfiltered_channels_are_differentiable() -> None:
    import drjit as dr

    scene = djpt.load_dict(box(8, "box", aov("d:depth", unfiltered=True, image={"type": "direct"})))
    params = djpt.traverse(scene)
    key = "white.reflectance.value"
    dr.enable_grad(params[key])
    params.update()
    image = djpt.render(scene, spp=2)
    dr.backward(dr.sum(image.array))
    assert np.all(np.array(dr.grad(params[key])) > 0)


@pytest.mark.parametrize("unfiltered", [False, True], ids=["filtered", "unfiltered"])
def test_the_image_of_a_nested_path_tracer_has_the_derivatives_that_it_has_alone(unfiltered: bool) -> None:
    import drjit as dr

    scene = djpt.load_dict(box(16))
    params, key = djpt.traverse(scene), "red.reflectance.value"
    dr.enable_grad(params[key])
    params.update()
    both = djpt.load_dict(aov("a:albedo,d:depth", unfiltered=unfiltered, image=PATH))
    changes = []
    for integrator in (djpt.load_dict(PATH), both):
        image = djpt.render(scene, params, spp=8, integrator=integrator)
        dr.forward(params[key])
        changes.append(pixels(dr.grad(image)))
    np.testing.assert_array_equal(changes[1][..., :3], changes[0])
    assert changes[0].max() > 0.1
    # Reverse: each channel of the albedo counts the wall's share of the picture, distances stay.
    gradients = []
    for integrator, channels in ((djpt.load_dict(PATH), 3), (both, 3), (both, None)):
        image = djpt.render(scene, params, spp=8, integrator=integrator)
        dr.set_grad(params[key], 0)
        dr.backward(dr.sum(image[:, :, :channels], axis=None))
        gradients.append(np.array(dr.grad(params[key])).ravel())
    np.testing.assert_array_equal(gradients[1], gradients[0])
    wall = np.zeros(3)
    if not unfiltered:
        np.testing.assert_array_equal(changes[1][..., 6], 0)
        wall = changes[1][..., 3:6].sum(axis=(0, 1))
        # The parameter's change is 1 in each channel, and the wall is seen in about a sixth of the pixels.
        assert np.all((wall > 20) & (wall < 60))
    np.testing.assert_allclose(gradients[2] - gradients[0], wall, rtol=1e-4)


def test_several_nested_path_tracers_have_no_derivatives() -> None:
    import drjit as dr

    scene = djpt.load_dict(box(4, "box", aov("d:depth", first=PATH, second=PATH)))
    params = djpt.traverse(scene)
    dr.enable_grad(params["red.reflectance.value"])
    params.update()
    with pytest.raises(djpt.RenderError, match=r"'AOV' can't be differentiated .* or an 'aov' with one"):
        djpt.render(scene, params, spp=1)


@pytest.mark.parametrize("nested", [{"type": "path", "max_depth": 2}, {"type": "direct"}], ids=lambda i: i["type"])
@pytest.mark.sparse(2)
def test_nested_integrators_choose_emitters_as_they_do_alone(nested: dict[str, Any]) -> None:
    from tests.kit.renders import lights

    chosen = {**nested, "emitter_choice": "power"}
    alone = ours(box(16, "box", chosen, lights("point", "ball")), 4)
    other = ours(box(16, "box", nested, lights("point", "ball")), 4)
    both = ours(box(16, "box", aov("d:depth", first=chosen, second=nested), lights("point", "ball")), 4)
    np.testing.assert_allclose(both[..., :3], alone, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(both[..., 3:6], other, rtol=1e-5, atol=1e-6)
    assert np.abs(alone - other).max() > 1e-3


def test_variables_with_a_lens_as_in_mitsuba() -> None:
    pytest.importorskip("mitsuba")
    description = box(32, "box", aov("t:depth,p:position,n:geo_normal"), spheres)
    description["sensor"].update(type="thinlens", aperture_radius=0.1, focus_distance=3.0)
    image, reference = ours(description, 4, 3), theirs(description, 4, 3)
    assert np.mean(np.abs(image - reference).max(axis=2) < 1e-3) > 0.99


def test_ray_differentials_are_refused() -> None:
    with pytest.raises(djpt.SceneError, match=r"'duv_dx' in 'aovs' needs ray differentials.*possible: albedo, depth"):
        djpt.load_dict(aov("u:duv_dx"))
    with pytest.raises(djpt.SceneError, match="from lights can't be nested"):
        djpt.load_dict(aov("d:depth", image={"type": "ptracer"}))


def test_the_shading_normal_is_the_one_that_a_normal_map_asks_for() -> None:
    n = np.array([0.0, 0.6, 0.8], np.float32)
    texels = djpt.TensorXf(np.broadcast_to((n + 1) / 2, (2, 2, 3)))
    description = box(8, "box", aov("n:sh_normal,g:geo_normal", unfiltered=True))
    sensor = {
        "type": "orthographic",
        "to_world": T().look_at([0, 0, 2], [0, 0, 0], [0, 1, 0]),
        "film": description["sensor"]["film"],
    }
    mapped = {
        "type": "normalmap",
        "normalmap": {"type": "bitmap", "data": texels, "raw": True},
        "b": {"type": "diffuse"},
    }
    plain = {"type": "rectangle", "to_world": T().translate([1, 0, 0])}
    image = ours(
        {
            "type": "scene",
            "integrator": description["integrator"],
            "sensor": sensor,
            "mapped": {"type": "rectangle", "to_world": T().translate([-1, 0, 0]), "bsdf": mapped},
            "plain": plain,
        },
        1,
    )
    normals = {tuple(np.round(row, 3)) for row in image[..., :3].reshape(-1, 3).tolist()}
    assert normals == {(0.0, 0.6, 0.8), (0.0, 0.0, 1.0)}
    assert np.allclose(image[..., 3:6], [0, 0, 1], atol=1e-6)


@pytest.mark.parametrize("filter_name", ["box", "gaussian"])
@pytest.mark.parametrize("unfiltered", [False, True])
@pytest.mark.sparse(2)
def test_aovs_run_in_the_schedule_of_a_nested_path_tracer(filter_name: str, unfiltered: bool) -> None:
    description = box(20, filter_name, aov("d:distance,n:sh_normal,i:shape_index", p=PATH, unfiltered=unfiltered))
    scene, alone = djpt.load_dict(description), djpt.load_dict({**description, "integrator": PATH})
    image, reference = (pixels(djpt.render(scene, spp=16, seed=4, schedule=s)) for s in ("flat", "wave"))
    np.testing.assert_allclose(image, reference, rtol=2e-5, atol=2e-5)
    if filter_name == "box" or unfiltered:
        # With more channels than sums of the filter are held for, samples are stored.
        np.testing.assert_array_equal(image[..., :3], pixels(djpt.render(alone, spp=16, seed=4, schedule="flat")))
    with pytest.raises(djpt.RenderError, match=r"'machine'|vertex by vertex"):
        djpt.render(scene, spp=1, schedule="machine")

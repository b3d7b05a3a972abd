"""Derivatives of records, and of images by parameters that they don't use."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from tests.kit.axes import unit
from tests.scripting.kit import numbers, same

TURNED = T().translate([0.1, 0.2, 0.3]).rotate(unit(1, 1, 0), 30)

SHAPES: dict[str, dict[str, Any]] = {
    "sphere": {"type": "sphere", "to_world": TURNED},
    "rectangle": {"type": "rectangle", "to_world": TURNED},
    "disk": {"type": "disk", "to_world": TURNED.scale(2)},
    "cylinder": {"type": "cylinder", "to_world": TURNED.rotate([1, 0, 0], 90), "p0": [0, 0, -1]},
    "cube": {"type": "cube", "to_world": TURNED},
}

FIELDS = ("t", "p", "uv", "n", "wi", "dp_du")


def scene(m: Any, name: str) -> Any:
    description = {"type": "scene", "shape": SHAPES[name]}
    return djpt.load_dict(description) if m is djpt else m.load_dict(djpt.validation.to_mitsuba(description))


@pytest.mark.sparse(12)
@pytest.mark.parametrize("preliminary", [False, True])
@pytest.mark.parametrize("name", SHAPES)
def test_a_hit_moves_with_its_ray(name: str, preliminary: bool, mi: Any) -> None:
    """Forward derivatives of all fields, by a motion of origin and direction: as in Mitsuba."""
    found = []
    for m in (djpt, mi):
        place, step = scene(m, name), m.Float(0)
        dr.enable_grad(step)
        o = m.Point3f(0.2, 0.1, -5) + step * m.Vector3f(1, 0.5, 0.25)
        ray = m.Ray3f(o, m.Vector3f(0.01, 0.02, 1) + step * m.Vector3f(0.1, -0.1, 0))
        if preliminary:
            si = place.ray_intersect_preliminary(ray).compute_surface_interaction(ray)
        else:
            si = place.ray_intersect(ray)
        values = [getattr(si, field) for field in FIELDS]
        dr.set_grad(step, 1)
        dr.enqueue(dr.ADMode.Forward, step)
        dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearNone)
        found.append([np.array(dr.grad(value), np.float64).ravel() for value in values])
        dr.eval(values)
    for field, mine, other in zip(FIELDS, *found, strict=True):
        np.testing.assert_allclose(mine, other, atol=2e-3 * max(1, np.abs(other).max()), err_msg=field)
    assert np.abs(found[0][1]).max() > 0.1


def test_a_hit_on_a_mesh_moves_with_its_ray() -> None:
    """Against differences, with a smooth normal."""
    corners, normals = [[-1, -1, 0], [1, -1, 0.3], [0, 1, 0.2]], [[-0.3, 0, 1], [0.3, 0, 1], [0, 0.4, 1]]
    place = djpt.load_dict({"type": "scene", "mesh": djpt.Mesh("mesh", corners, [[0, 1, 2]], vertex_normals=normals)})
    fields = ("t", "p", "uv", "wi")

    def hit(step: Any) -> list[Any]:
        o = djpt.Point3f(0.1, -0.3, -5) + step * djpt.Vector3f(1, 0.5, 0.25)
        si = place.ray_intersect(djpt.Ray3f(o, djpt.Vector3f(0.01, 0.02, 1)))
        return [getattr(si, field) for field in fields] + [si.sh_frame.n]

    step = djpt.Float(0)
    dr.enable_grad(step)
    values = hit(step)
    dr.set_grad(step, 1)
    dr.enqueue(dr.ADMode.Forward, step)
    dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearNone)
    for value, high, low in zip(values, hit(djpt.Float(1e-2)), hit(djpt.Float(-1e-2)), strict=True):
        difference = (np.array(high, np.float64) - np.array(low, np.float64)) / 2e-2
        np.testing.assert_allclose(np.array(dr.grad(value), np.float64), difference, atol=1e-3)


def test_backward() -> None:
    o = djpt.Point3f(0.3, 0.2, -5)
    dr.enable_grad(o)
    si = djpt.load_dict({"type": "scene", "wall": {"type": "rectangle"}}).ray_intersect(djpt.Ray3f(o, [0, 0, 1]))
    dr.backward(si.p.x + 2 * si.p.y + 3 * si.t)
    assert numbers(dr.grad(o)) == [1, 2, -3]


@pytest.mark.parametrize("name", SHAPES)
def test_a_point_that_follows_the_shape_stays(name: str, mi: Any) -> None:
    found = []
    for m in (djpt, mi):
        place, o = scene(m, name), m.Point3f(0.2, 0.1, -5)
        dr.enable_grad(o)
        si = place.ray_intersect(m.Ray3f(o, m.Vector3f(0.01, 0.02, 1)), m.RayFlags.All | m.RayFlags.FollowShape, False)
        assert not dr.grad_enabled(si.p) or m is mi
        dr.backward(si.t)
        found.append(dr.grad(o))
    same(*found, 1e-3)


def test_values_are_those_of_rays_without_gradients() -> None:
    place, o = scene(djpt, "sphere"), djpt.Point3f([0.2, 0.1, 3], 0.1, -5)
    plain = place.ray_intersect(djpt.Ray3f(o, [0, 0, 1]))
    attached = djpt.Point3f(o)
    dr.enable_grad(attached)
    other = place.ray_intersect(djpt.Ray3f(attached, [0, 0, 1]))
    assert numbers(plain.is_valid()) == numbers(other.is_valid()) == [True, True, False]
    for field in ("t", "p", "uv", "n", "wi"):
        a, b = (np.array(dr.detach(getattr(si, field))).reshape(-1, 3)[:, :2] for si in (plain, other))
        np.testing.assert_allclose(a, b, atol=2e-6)


def small_box() -> Any:
    box = djpt.cornell_box()
    box["sensor"]["film"].update(width=4, height=4)
    return djpt.load_dict(box | {"spare": {"type": "diffuse"}})


@pytest.mark.parametrize("used", [False, True])
def test_an_image_is_attached_to_parameters_that_it_does_not_use(used: bool) -> None:
    scene = small_box()
    params = djpt.traverse(scene)
    names = ["spare.reflectance.value"] + ["white.reflectance.value"] * used
    for name in names:
        dr.enable_grad(params[name])
    params.update()
    image = djpt.render(scene, params, spp=2)
    assert dr.grad_enabled(image)
    dr.backward(dr.mean(image))
    assert numbers(dr.grad(params[names[0]])) == [0, 0, 0]
    assert not used or min(numbers(dr.grad(params[names[1]]))) > 0


def test_the_forward_derivative_by_an_unused_parameter_is_zero() -> None:
    scene = small_box()
    params = djpt.traverse(scene)
    name = "spare.reflectance.value"
    dr.enable_grad(params[name])
    params.update()
    image = djpt.render(scene, params, spp=2)
    dr.set_grad(params[name], 1)
    change = dr.forward_to(image)
    assert change.shape == (4, 4, 3) and not np.array(change).any()


@pytest.mark.parametrize("flag", ["dNGdUV", "dNSdUV"])
@pytest.mark.parametrize("name", ["sphere", "rectangle", "cylinder"])
def test_derivatives_of_normals_by_texture_coordinates(name: str, flag: str, mi: Any) -> None:
    """Zero unless asked for; Mitsuba's rectangle is a mesh without geometric ones."""
    found = []
    for m in (djpt, mi):
        place, ray = scene(m, name), m.Ray3f([0.2, 0.1, -5], [0.01, 0.02, 1])
        si = place.ray_intersect(ray, m.RayFlags.All | getattr(m.RayFlags, flag), False)
        found.append([si.dn_du, si.dn_dv, place.ray_intersect(ray).dn_du])
        dr.eval(found[-1])
    for mine, other in zip(*found, strict=True):
        same(mine, other, 1e-3)


def test_the_derivative_of_a_point_outlasts_a_traversal() -> None:
    """uv follow from the point; still `dr.forward` leaves a derivative of each."""
    o = djpt.Point3f(0.3, 0.2, -5)
    dr.enable_grad(o)
    si = djpt.load_dict({"type": "scene", "wall": {"type": "rectangle"}}).ray_intersect(djpt.Ray3f(o, [0, 0, 1]))
    dr.forward(o.x)
    assert numbers(dr.grad(si.p)) == [1, 0, 0] and numbers(dr.grad(si.uv)) == [0.5, 0]


def own_estimate(m: Any) -> list[float]:
    """The derivatives of light that a script computes by itself: reflected from a wall, and from a lamp."""
    box = m.load_dict(m.cornell_box())
    params = m.traverse(box)
    white, light = "white.reflectance.value", "light.emitter.radiance.value"
    dr.enable_grad(params[white])
    dr.enable_grad(params[light])
    params.update()
    si = box.ray_intersect(m.Ray3f([0, 0, 0], [0.1, -1, 0.2]))
    ds, lit = box.sample_emitter_direction(si, m.Point2f(0.3, 0.4))
    value = si.bsdf().eval(m.BSDFContext(), si, si.to_local(ds.d))
    lamp = box.ray_intersect(m.Ray3f([0, 0, 0], [0, 1, 0]))
    dr.backward(dr.sum(value * lit + lamp.emitter(box).eval(lamp)))
    found = [dr.grad(params[key]) for key in (white, light)]
    dr.eval(found)
    return [float(g[c][0]) for g in found for c in range(3)]


def test_scripts_differentiate_what_they_compute_themselves(mi: Any) -> None:
    np.testing.assert_allclose(own_estimate(djpt), own_estimate(mi), rtol=1e-4)


def lit_floor() -> tuple[Any, Any, Any, Any]:
    """A floor whose reflectance has gradients: scene, parameters, and two rays with the value that they find."""
    floor = djpt.load_dict({"type": "scene", "floor": {"type": "rectangle"}, "light": {"type": "constant"}})
    params, ray = djpt.traverse(floor), djpt.Ray3f(djpt.Point3f(0, [0, 0.1], 1), djpt.Vector3f(0, 0, -1))
    dr.enable_grad(params["floor.bsdf.reflectance.value"])
    params.update()
    return (
        floor,
        lambda: dr.grad(params["floor.bsdf.reflectance.value"]).x[0],
        ray,
        lambda si: si.bsdf().eval(djpt.BSDFContext(), si, djpt.Vector3f(0, 0, 1)).x,
    )


def test_each_evaluation_has_a_gradient() -> None:
    """A traversal cuts the way from one evaluation to the parameter, not from the next."""
    floor, gradient, ray, value = lit_floor()
    for times in (1, 2, 3):
        dr.backward(dr.sum(value(floor.ray_intersect(ray))))
        assert gradient() == pytest.approx(times * 2 / np.pi)
    with dr.suspend_grad():
        assert not dr.grad_enabled(value(floor.ray_intersect(ray)))


@pytest.mark.parametrize("preliminary", [True, False])
def test_gradients_in_a_loop_of_a_script(preliminary: bool) -> None:
    """Tables can't be made in a loop that Dr.Jit records: those made for a ray before it serve."""
    floor, gradient, ray, value = lit_floor()
    for times in (1, 2):
        with dr.suspend_grad():
            pi = floor.ray_intersect_preliminary(ray) if preliminary else floor.ray_intersect(ray)

            def body(i: djpt.UInt32, found: Any = pi) -> tuple[djpt.UInt32]:
                si = found.compute_surface_interaction(ray) if preliminary else found
                with dr.resume_grad():
                    dr.backward_from(value(si))
                return (i + 1,)

            dr.eval(dr.while_loop((djpt.UInt32(0, 0),), lambda i: i < 3, body))
        assert gradient() == pytest.approx(times * 3 * 2 / np.pi)


def test_a_loop_before_any_ray_reads_values() -> None:
    """Without gradients, as there are no tables yet."""
    floor, _, ray, value = lit_floor()
    _, total = dr.while_loop(
        (djpt.UInt32(0, 0), djpt.Float(0, 0)),
        lambda i, total: i < 3,
        lambda i, total: (i + 1, total + value(floor.ray_intersect(ray))),
    )
    np.testing.assert_allclose(np.array(dr.detach(total)), 3 * 0.5 / np.pi, rtol=1e-6)


def lit_floors(count: int, reflectance: Any) -> Any:
    """Floors side by side, each with a reflectance of its own, under a lamp."""
    description: dict[str, Any] = {
        "type": "scene",
        "lamp": {"type": "point", "position": [0, 0, 5], "intensity": {"type": "rgb", "value": [3, 2, 1]}},
    }
    for i in range(count):
        own = reflectance if i == 1 else {"type": "rgb", "value": [0.1 + i / 50] * 3}
        to_world = T().translate([i, 0, 0]).scale(0.5)
        description[f"floor_{i}"] = {
            "type": "rectangle",
            "to_world": to_world,
            "bsdf": {"type": "diffuse", "reflectance": own},
        }
    return djpt.load_dict(description)


def shade(scene: Any, count: int) -> Any:
    """What a script may compute: the light of the lamp that the middles of all floors send upwards."""
    o = djpt.Point3f(dr.arange(djpt.Float, count) + 0.1, 0.1, 3)
    si = scene.ray_intersect(djpt.Ray3f(o, djpt.Vector3f(0, 0, -1)))
    ds, weight = scene.sample_emitter_direction(si, djpt.Point2f(0.5, 0.5))
    return si.bsdf().eval(djpt.BSDFContext(), si, si.to_local(ds.d)) * weight


BITMAP = {"type": "bitmap", "data": np.full((4, 4, 3), 0.5, np.float32), "raw": True}


@pytest.mark.sparse(4)
@pytest.mark.parametrize("count", [1, 3, 20])
@pytest.mark.parametrize("name", ["reflectance.value", "reflectance.data", "lamp"])
def test_what_scripts_compute_is_attached_to_the_scene(name: str, count: int) -> None:
    """Light is linear in reflectances and intensities: a derivative times the parameter is the light."""
    count = max(count, 2)
    scene = lit_floors(count, BITMAP if name.endswith("data") else {"type": "rgb", "value": [0.5, 0.25, 0.75]})
    params = djpt.traverse(scene)
    key = "lamp.intensity.value" if name == "lamp" else f"floor_1.bsdf.{name}"
    plain = np.array(shade(scene, count))
    dr.enable_grad(params[key])
    params.update()
    light = shade(scene, count)
    np.testing.assert_allclose(np.array(dr.detach(light)), plain, rtol=1e-6)
    dr.backward(dr.sum(dr.sum(light)))
    gradient, value = (
        np.array(x).reshape(-1, 3) if name.endswith("data") else np.array(x).ravel()
        for x in (dr.grad(params[key]), dr.detach(params[key]))
    )
    expected = plain.sum() if name == "lamp" else plain[:, 1].sum()
    np.testing.assert_allclose((gradient * value).sum(), expected, rtol=1e-4)
    with dr.suspend_grad():
        assert not dr.grad_enabled(shade(scene, count))


def test_sampled_weights_are_attached() -> None:
    """Their derivative is that of the value over the density, which is kept."""
    scene = lit_floors(2, {"type": "rgb", "value": [0.5, 0.25, 0.75]})
    params = djpt.traverse(scene)
    dr.enable_grad(params["floor_1.bsdf.reflectance.value"])
    params.update()
    si = scene.ray_intersect(djpt.Ray3f([1.1, 0.1, 3], [0, 0, -1]))
    bs, weight = si.bsdf().sample(djpt.BSDFContext(), si, djpt.Float(0.3), djpt.Point2f(0.2, 0.6))
    assert not dr.grad_enabled(bs.wo)
    dr.backward(weight.y)
    gradient = dr.grad(params["floor_1.bsdf.reflectance.value"])
    np.testing.assert_allclose(np.array(gradient).ravel(), [0, 1, 0], atol=1e-6)


def test_what_is_asked_together_has_the_derivatives_of_what_is_asked_alone() -> None:
    """`eval_pdf_sample`, whose dispatch is by branches, of surface points that move, on materials of many kinds."""
    kinds = ("diffuse", "roughconductor", "roughplastic", "dielectric", "principled")
    balls = {
        kind: {"type": "sphere", "center": [3 * number, 0, 0], "bsdf": {"type": kind}}
        for number, kind in enumerate(kinds)
    }
    place = djpt.load_dict({"type": "scene", **balls})
    ctx, found = djpt.BSDFContext(), []
    for together in (False, True):
        step = djpt.Float(0)
        dr.enable_grad(step)
        x = 3 * dr.arange(djpt.Float, len(kinds)) + 0.3 + step
        si = place.ray_intersect(djpt.Ray3f(djpt.Point3f(x, 0.2, 5), djpt.Vector3f(0, 0, -1)))
        wo, bsdf = si.to_local(dr.normalize(djpt.Vector3f(0.3, 0.2, 1))), si.bsdf()
        if together:
            value = bsdf.eval_pdf_sample(ctx, si, wo, djpt.Float(0.5), djpt.Point2f(0.5, 0.4))[0]
        else:
            value = bsdf.eval(ctx, si, wo)
        dr.forward(step)
        found.append(numbers(dr.grad(value)))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-5)
    assert np.count_nonzero(found[0]) == 3 * (len(kinds) - 1)

"""Records as scripts make and use them: the same call has the same result as in Mitsuba."""

from __future__ import annotations

import threading
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import RenderError
from tests.scripting.kit import numbers, same

RAYS = [
    "m.Ray3f()",
    "m.Ray3f([1, 2, 3], [0, 0, 1])",
    "m.Ray3f([1, 2, 3], [0, 0, 1], 5)",
    "m.Ray3f([1, 2, 3], [0, 0, 1], 5, [])",
    "m.Ray3f([1, 2, 3], [0, 0, 1], 7, 5, [])",
    "m.Ray3f(o=[1, 2, 3], d=[0, 0, 1], time=2, wavelengths=[])",
    "m.Ray3f(m.Ray3f([1, 2, 3], [0, 0, 1], 7, 5, []))",
    "m.Ray3f(m.Ray3f([1, 2, 3], [0, 0, 1], 7, 5, []), 2)",
    "m.Ray3f([[1, 2], 2, 3], m.Vector3f(0, 0, 1), m.Float(1, 2))",
    "m.Ray2f([1, 2], [0, 1], 5)",
    "m.RayDifferential3f([1, 2, 3], [0, 0, 1], 5, [])",
    "m.RayDifferential3f(m.Ray3f([1, 2, 3], [0, 0, 1], 7, 5, []))",
]


@pytest.mark.parametrize("call", RAYS)
def test_rays_are_made_as_in_mitsuba(call: str, mi: Any) -> None:
    mine, other = eval(call, {"m": djpt}), eval(call, {"m": mi})
    for name in ("o", "d", "time") if "()" not in call else ("time",):
        same(getattr(mine, name), getattr(other, name))
    # Where Mitsuba has the largest float, djpt has infinity.
    same(dr.minimum(mine.maxt, 3.4028234e38), other.maxt)
    assert len(mine.wavelengths) == len(other.wavelengths) == 0


def test_a_ray_is_a_copy_of_what_it_was_made_of() -> None:
    o = djpt.Point3f(1, 2, 3)
    ray = djpt.Ray3f(o, [0, 0, 1])
    ray.o += 1
    assert numbers(o) == [1, 2, 3] and numbers(ray.o) == [2, 3, 4] and numbers(ray(2)) == [2, 3, 6]


def test_wavelengths_are_refused() -> None:
    with pytest.raises(RenderError, match=r"light is RGB, so records have no wavelengths: pass \[\], found \[500\]"):
        djpt.Ray3f([0, 0, 0], [0, 0, 1], 0, [500])


FIELDS = {
    "Ray3f": {"o": [1, 2, 3], "d": [4, 5, 6], "maxt": 7, "time": 8},
    "Interaction3f": {"t": 1, "time": 2, "p": [1, 2, 3], "n": [4, 5, 6]},
    "SurfaceInteraction3f": {
        "t": 1, "time": 2, "p": [1, 2, 3], "n": [4, 5, 6], "uv": [7, 8], "dp_du": [1, 0, 0], "dp_dv": [0, 1, 0],
        "dn_du": [2, 0, 0], "dn_dv": [0, 2, 0], "duv_dx": [1, 2], "duv_dy": [3, 4], "wi": [0, 0, 1], "prim_index": 5,
    },
    "MediumInteraction3f": {"t": 1, "p": [1, 2, 3], "wi": [0, 0, 1], "sigma_t": [1, 2, 3], "mint": 0.5},
    "PreliminaryIntersection3f": {"t": 1, "prim_uv": [1, 2], "prim_index": 3, "shape_index": 4},
    "PositionSample3f": {"p": [1, 2, 3], "n": [4, 5, 6], "uv": [7, 8], "time": 1, "pdf": 2, "delta": True},
    "DirectionSample3f": {"p": [1, 2, 3], "uv": [7, 8], "pdf": 2, "d": [0, 0, 1], "dist": 4},
    "BSDFSample3f": {"wo": [0, 0, 1], "pdf": 2, "eta": 1.5, "sampled_type": 3, "sampled_component": 1},
}  # fmt: skip


def filled(m: Any, name: str) -> Any:
    # Not of `name()`, whose fields Mitsuba leaves without memory.
    record = dr.zeros(getattr(m, name))
    for field, value in FIELDS[name].items():
        setattr(record, field, value)
    return record


@pytest.mark.parametrize("name", FIELDS)
def test_fields_take_lists_and_numbers(name: str, mi: Any) -> None:
    mine, other = filled(djpt, name), filled(mi, name)
    for field in FIELDS[name]:
        same(getattr(mine, field), getattr(other, field))


@pytest.mark.parametrize("name", FIELDS)
def test_zeros_gather_select_scatter_copy(name: str, mi: Any) -> None:
    """Each of Dr.Jit's operations on records, in both."""
    results = []
    for m in (djpt, mi):
        kind, one = getattr(m, name), filled(m, name)
        if name == "Ray3f":
            one.time = 0  # a ray with a time doesn't mix with rays without one
        if name == "DirectionSample3f":
            one.time, one.delta = 0, False
        zeros = dr.zeros(kind, 3)
        mixed = dr.select(m.Bool(True, False, True), one, zeros)
        taken = dr.gather(kind, mixed, m.UInt32(2, 1))
        dr.scatter(zeros, one, m.UInt32(1))
        # Mitsuba takes a direction sample for a mere position sample here, and forgets the direction.
        copy = mixed if m is mi and name == "DirectionSample3f" else kind(mixed)
        third = kind()
        third.assign(mixed)
        masked = dr.zeros(kind, 3)
        masked[m.Bool(False, True, True)] = one
        results.append((dr.zeros(kind, 3), mixed, taken, zeros, copy, third, masked))
    assert [dr.width(mine) for mine in results[0]] == [3, 3, 2, 3, 3, 3, 3]
    for mine, other in zip(*results, strict=True):
        for field in FIELDS[name]:
            same(getattr(mine, field), getattr(other, field))


@pytest.mark.parametrize("name", ["Interaction3f", "SurfaceInteraction3f", "PreliminaryIntersection3f"])
def test_new_interactions_are_not_valid(name: str) -> None:
    kind = getattr(djpt, name)
    record = kind()
    assert numbers(record.is_valid()) == [False] and numbers(dr.zeros(kind, 2).is_valid()) == [False, False]
    record.t = 1
    assert numbers(record.is_valid()) == [True]


@pytest.mark.parametrize("name", FIELDS)
def test_records_are_shown_like_mitsubas(name: str, mi: Any) -> None:
    """Frames apart, which have a form of their own."""
    mine, other = repr(filled(djpt, name)), repr(filled(mi, name))
    assert mine.split("[")[0] == other.split("[")[0]
    shown = {line.split("=")[0] for line in mine.splitlines() if line.startswith("  ") and line[2] != " "}
    listed = {line.split("=")[0] for line in other.splitlines() if line.startswith("  ") and line[2] != " "}
    assert shown - listed <= {"  sh_frame"} and listed - shown <= {
        "  sh_frame", "  shape", "  instance", "  wavelengths", "  medium", "  valid",
    }  # fmt: skip


def test_flags_have_mitsubas_values(mi: Any) -> None:
    for flag in mi.RayFlags:
        assert int(getattr(djpt.RayFlags, flag.name)) == int(flag)
    # As newer versions name them.
    assert djpt.RayFlags.Default == djpt.RayFlags.Shading == djpt.RayFlags.All
    assert djpt.RayFlags.NormalPartials == djpt.RayFlags.dNSdUV
    for mode in ("Radiance", "Importance"):
        assert int(getattr(djpt.TransportMode, mode)) == getattr(mi.TransportMode, mode).value
    for kind in mi.ShapeType:
        assert int(getattr(djpt.ShapeType, kind.name)) == int(kind)


@pytest.mark.parametrize("differentials", [True, False])
def test_derivatives_of_uv_from_pixel_to_pixel(differentials: bool, mi: Any) -> None:
    found = []
    for m in (djpt, mi):
        ray = m.RayDifferential3f([0.4, 0.2, 0.7], [0.3, 0.7, 0.7])
        ray.o_x, ray.o_y = ray.o + m.Vector3f(0.1, 0, 0), ray.o + m.Vector3f(0, 0.1, 0)
        ray.d_x, ray.d_y, ray.has_differentials = m.Vector3f(0.31, 0.7, 0.7), ray.d, differentials
        ray.scale_differential(0.5)
        si = dr.zeros(m.SurfaceInteraction3f)
        si.p, si.dp_du, si.dp_dv = ray(10), [0.55, 0.85, 0.42], [0.15, 0.55, 0.39]
        si.n = dr.normalize(dr.cross(si.dp_du, si.dp_dv))
        si.t = 0
        si.compute_uv_partials(ray)
        found.append([si.duv_dx, si.duv_dy])
    for mine, other in zip(*found, strict=True):
        same(mine, other, 1e-4)


def test_the_shading_frame_is_made_orthonormal(mi: Any) -> None:
    found = []
    for m in (djpt, mi):
        si = dr.zeros(m.SurfaceInteraction3f, 2)
        frame = si.sh_frame
        frame.n = dr.normalize(m.Vector3f(0.1, 0.2, 1))
        si.sh_frame, si.dp_du = frame, m.Vector3f([1, 0], [0.5, 0], [0.2, 0])
        si.initialize_sh_frame()
        found.append([si.sh_frame.s, si.sh_frame.t, si.to_local([1, 2, 3]), si.to_world(si.to_local([1, 2, 3]))])
    for mine, other in zip(*found, strict=True):
        same(mine, other, 1e-5)


def test_interactions_are_loop_state() -> None:
    """A loop that starts without a hit, as scripts write it, keeps the scene that its hits belong to."""
    scene = djpt.load_dict({"type": "scene", "ball": {"type": "sphere"}})
    ray = djpt.Ray3f([[0, 0.2, 5], 0, -3], [0, 0, 1])

    def body(i: Any, si: Any) -> Any:
        return i + 1, scene.ray_intersect(ray)

    _, si = dr.while_loop((djpt.UInt32(0, 0, 0), dr.zeros(djpt.SurfaceInteraction3f, 3)), lambda i, si: i < 2, body)
    assert numbers(si.is_valid()) == [True, True, False]
    assert numbers(si.shape == scene.shapes()[0]) == [True, True, False]
    assert np.allclose(numbers(si.bsdf().eval_diffuse_reflectance(si))[:2], 0.5)


def test_threads_begin_loops_with_scenes_of_their_own() -> None:
    """A record that `dr.zeros` makes belongs to the scene of its thread, whatever other threads load meanwhile."""
    scene = djpt.load_dict({"type": "scene", "ball": {"type": "sphere"}})
    ray = djpt.Ray3f([0, 0, -3], [0, 0, 1])
    other = threading.Thread(target=djpt.load_dict, args=({"type": "scene"},))
    other.start()
    other.join()
    state = djpt.UInt32(0), dr.zeros(djpt.SurfaceInteraction3f)
    _, found = dr.while_loop(state, lambda i, si: i < 1, lambda i, si: (i + 1, scene.ray_intersect(ray)))
    assert numbers(found.shape == scene.shapes()[0]) == [True]


def test_an_interaction_without_a_scene_says_so() -> None:
    with pytest.raises(RenderError, match="this SurfaceInteraction3f belongs to no scene: it wasn't found by a ray"):
        djpt.SurfaceInteraction3f().bsdf()


def test_records_take_the_names_of_mitsubas_arguments() -> None:
    si = djpt.SurfaceInteraction3f(p=[1, 2, 3], n=[0, 0, 1])
    assert numbers(djpt.PositionSample3f(si=si).p) == [1, 2, 3]
    assert numbers(djpt.SurfaceInteraction3f(ps=djpt.PositionSample3f(si=si), wavelengths=[]).p) == [1, 2, 3]
    sample = djpt.BSDFSample3f(wo=[0, 0, 1])
    assert numbers(djpt.BSDFSample3f(bs=sample).wo) == [0, 0, 1]
    zeros = {"uv": [0, 0], "time": 0, "pdf": 2, "delta": False, "d": [0, 0, 1], "dist": 4, "emitter": None}
    assert numbers(djpt.DirectionSample3f(p=[1, 2, 3], n=[0, 0, 1], **zeros).dist) == [4]
    assert numbers(djpt.Interaction3f(p=[0, 0, 0], n=[0, 0, 1], t=1).spawn_ray_to(t=djpt.Point3f(0, 0, 2)).d)[2] > 1.9


def bounces(ray: Any, scene: Any, symbolic: bool) -> Any:
    """Points and times of paths of mirrors, in a loop that carries each point into its next turn."""
    before = dr.zeros(djpt.SurfaceInteraction3f)
    si = scene.ray_intersect(ray)

    def turn(ray: Any, si: Any, before: Any, i: Any) -> Any:
        ray = si.spawn_ray(si.to_world(djpt.reflect(si.wi)))
        return ray, scene.ray_intersect(ray), si, i + 1

    state = (ray, si, before, djpt.UInt32(0))
    if symbolic:
        state = dr.while_loop(state, lambda ray, si, before, i: i < 3, turn)
    else:
        for _ in range(3):
            state = turn(*state)
    return state[:3]


@pytest.mark.parametrize("time", [0, 0.5])
def test_loops_carry_points_that_rays_leave(time: float) -> None:
    """With a time and without, beside a point of `dr.zeros`, which has the time 0."""
    scene = djpt.load_dict({"type": "scene", "ball": {"type": "sphere"}})
    d = dr.normalize(djpt.Vector3f([0.1, -0.3, 0.9, 1], [0.2, 0.8, -0.1, -0.3], [1, 0.4, 0.5, 0.2]))
    results = [bounces(djpt.Ray3f([0.3, 0.1, 0], d, time), scene, symbolic) for symbolic in (True, False)]
    for looped, unrolled in zip(*results, strict=True):
        assert dr.all(looped.time == time) and dr.all(unrolled.time == time)
    for name in ("p", "n", "t"):
        same(getattr(results[0][1], name), getattr(results[1][1], name))
    assert dr.all(results[0][1].is_valid() & results[0][2].is_valid())


def test_points_of_any_time_are_mixed() -> None:
    """Rays that leave a point with a time that was assigned have it, whatever the point was made of."""
    si = dr.zeros(djpt.SurfaceInteraction3f, 2)
    si.time = djpt.Float(0.25, 0.5)
    mixed = dr.select(djpt.Bool(True, False), si, dr.zeros(djpt.SurfaceInteraction3f, 2))
    same(mixed.spawn_ray(djpt.Vector3f(0, 0, 1)).time, [0.25, 0])
    hit = djpt.load_dict(djpt.cornell_box()).ray_intersect(djpt.Ray3f([0, 0, 0], [0, 0, -1]))
    assert hit.spawn_ray(hit.n).times == ()
    hit.time = djpt.Float(0.75)
    same(hit.spawn_ray(hit.n).time, 0.75)

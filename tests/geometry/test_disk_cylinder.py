"""Disks and cylinders: Mitsuba's surfaces, samples and images; closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import ParameterError, SceneError
from djpt.jit.types import Float, Point2f, Point3f, Vector3f
from djpt.validation import agreement
from tests.kit.chi_squared import uniform
from tests.kit.renders import Edit, box, ours, theirs

PATH = {"type": "path", "max_depth": 4}
TURNED = T().translate([0.2, 0.1, 0]).rotate([0.6, 0, 0.8], 70).scale(0.8)
MIRRORED = T().translate([0.2, 0.1, 0]).rotate([0.6, 0.8, 0], 40).scale([-0.7, 0.7, 0.7])
ELLIPSE = T().translate([0.1, 0, 0.3]).rotate([0, 0.6, 0.8], 30).scale([1.3, 0.6, 1])
LEANING = {"p0": [0.1, 0, -0.2], "p1": [0.4, 0.5, 0.9], "radius": 0.6}

CASES: dict[str, dict[str, Any]] = {
    "disk": {"type": "disk"},
    "disk, turned": {"type": "disk", "to_world": TURNED},
    "disk, mirrored": {"type": "disk", "to_world": MIRRORED, "flip_normals": True},
    "disk, turned over": {"type": "disk", "to_world": T().scale([1, 1, -1])},
    "ellipse": {"type": "disk", "to_world": ELLIPSE},
    "ellipse, flipped": {"type": "disk", "to_world": ELLIPSE, "flip_normals": True},
    "cylinder": {"type": "cylinder"},
    "cylinder, flipped": {"type": "cylinder", "radius": 0.5, "p1": [0, 0, -2], "flip_normals": True},
    "cylinder, along x": {"type": "cylinder", "radius": 0.5, "p0": [-1, 0, 0], "p1": [1, 0, 0]},
    "cylinder, leaning": {"type": "cylinder", **LEANING},
    "cylinder, turned": {"type": "cylinder", "to_world": TURNED, **LEANING},
    "cylinder, mirrored": {"type": "cylinder", "to_world": MIRRORED, **LEANING},
}


def mitsuba(description: dict[str, Any]) -> tuple[Any, Any]:
    """Mitsuba, and the scene of one shape there (kept: what it returns refers to it)."""
    mi = pytest.importorskip("mitsuba")
    described = djpt.validation.to_mitsuba({"type": "scene", "shape": description})
    mi.set_variant("llvm_ad_rgb")
    return mi, mi.load_dict(described)


def load(description: dict[str, Any]) -> Any:
    return djpt.load_dict({"type": "scene", "shape": description, "light": {"type": "point"}})


def rays(count: int = 20000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    o = rng.normal(size=(3, count))
    o *= rng.uniform(0.2, 5, count) / np.linalg.norm(o, axis=0)
    d = rng.uniform(-0.9, 0.9, (3, count)) - o
    return o.astype(np.float32), (d / np.linalg.norm(d, axis=0)).astype(np.float32)


def wide(x: Any, count: int) -> np.ndarray:
    values = np.array(x, float)
    return np.broadcast_to(values, (*values.shape[:-1], count))


@pytest.mark.sparse(12)
@pytest.mark.parametrize("description", CASES.values(), ids=CASES)
def test_surface_is_mitsubas(description: dict[str, Any]) -> None:
    mi, scene = mitsuba(description)
    o, d = rays()
    mine = load(description).ray_intersect(djpt.Ray3f(Point3f(o), Vector3f(d), maxt=Float(np.inf)))
    other = scene.ray_intersect(mi.Ray3f(mi.Point3f(o), mi.Vector3f(d)))
    valid, expected = np.array(mine.is_valid()), np.array(other.is_valid())
    assert np.mean(valid != expected) < 1e-3
    both = valid & expected
    assert both.mean() > 0.1
    count = o.shape[1]
    for field in ("t", "p", "n", "uv", "dp_du", "dp_dv", "wi"):
        error = np.abs(wide(getattr(mine, field), count)[..., both] - wide(getattr(other, field), count)[..., both])
        if field == "uv":
            error = np.minimum(error, 1 - error)  # a seam
        assert np.quantile(error, 0.999) < 5e-4, field
    for axis in "stn":
        a, b = (wide(getattr(si.sh_frame, axis), count)[:, both] for si in (mine, other))
        assert np.quantile(np.abs(a - b), 0.999) < 1e-3, f"sh_frame.{axis}"


@pytest.mark.parametrize("description", CASES.values(), ids=CASES)
def test_positions_are_mitsubas(description: dict[str, Any]) -> None:
    mi, scene = mitsuba(description)
    mine, other = load(description).shapes()[0], scene.shapes()[0]
    sample = uniform(4096, seed=2)
    a = mine.sample_position(0, Point2f(*sample))
    b = other.sample_position(0, mi.Point2f(*(mi.Float(s) for s in sample)))
    mirrored = description["type"] == "cylinder" and description.get("to_world") is MIRRORED
    for field in ("p", "n", "uv", "pdf"):
        if field == "n" and mirrored:
            continue  # Mitsuba's point to the other side than those of its hits
        x, y = (wide(getattr(ps, field), 4096) for ps in (a, b))
        np.testing.assert_allclose(x, y, atol=3e-5, rtol=1e-5, err_msg=field)


@pytest.mark.parametrize("name", ["disk", "cylinder"])
def test_parameters_have_mitsubas_names(name: str) -> None:
    mi, scene = mitsuba({"type": name})
    mine = [key.split(".")[-1] for key, _ in djpt.traverse(load({"type": name})).items() if "shape." in key]
    expected = [key for key, _ in mi.traverse(scene.shapes()[0]).items() if "bsdf" not in key]
    assert [key for key in mine if key != "value"] == expected


# ---------------------------------------------------------------- images


def furnished(scene: dict[str, Any]) -> None:
    """A disk as the ceiling light, a shining cylinder, and both standing about."""
    del scene["small-box"], scene["large-box"], scene["light"]
    red, white = {"type": "ref", "id": "red"}, {"type": "ref", "id": "white"}
    light = T().translate([0.1, 0.95, 0]).rotate([1, 0, 0], 90).scale(0.3)
    scene["lamp"] = {"type": "disk", "to_world": light, "emitter": {"type": "area", "radiance": 8.0}}
    scene["tube"] = {
        "type": "cylinder",
        "p0": [-0.8, -0.9, -0.5],
        "p1": [-0.6, 0.2, -0.5],
        "radius": 0.06,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [4, 1, 0]}},
    }
    both = {"type": "twosided", "inner": white}
    scene["pipe"] = {"type": "cylinder", "p0": [0.3, -0.7, -0.3], "p1": [0.7, -0.5, 0.6], "radius": 0.25, "bsdf": both}
    scene["post"] = {"type": "cylinder", "p0": [0, -1, 0.2], "p1": [0, -0.2, 0.2], "radius": 0.2, "bsdf": red}
    scene["lid"] = {
        "type": "disk",
        "to_world": T().translate([0, -0.2, 0.2]).rotate([1, 0, 0], -90).scale([0.2, 0.3, 1]),
        "bsdf": both,
    }


@pytest.mark.parametrize("integrator", ["path", "prb", "direct"])
@pytest.mark.sparse(2)
def test_equal_seeds_give_equal_pixels(integrator: str) -> None:
    pytest.importorskip("mitsuba")
    edit: Edit = furnished
    description = box(64, "box", {"type": integrator, **({} if integrator == "direct" else {"max_depth": 4})}, edit)
    image, reference = ours(description, 4, 3), theirs(description, 4, 3)
    assert agreement(image, reference, 1e-3).share >= 0.99
    assert image.mean() == pytest.approx(reference.mean(), rel=1e-3)


# ---------------------------------------------------------------- closed forms


@pytest.mark.parametrize("height", [0.3, 2.0])
def test_light_below_a_disk(height: float) -> None:
    """Irradiance below the centre of a disk of radius R at height h: pi L R^2 / (R^2 + h^2)."""
    radius, radiance = 0.8, 3.0
    lamp = T().translate([0, 0, height]).rotate([1, 0, 0], 180).scale(radius)
    scene = djpt.load_dict(
        {
            "type": "scene",
            "lamp": {"type": "disk", "to_world": lamp, "emitter": {"type": "area", "radiance": radiance}},
            "floor": {"type": "rectangle"},
        }
    )
    si = scene.ray_intersect(djpt.Ray3f(Point3f(0, 0, 1e-2), Vector3f(0, 0, -1), maxt=Float(np.inf)))
    ds, weight = scene.sample_emitter_direction(si, Point2f(*uniform(2**16)), True)
    values = np.array(weight.x * ds.d.z, np.float64)
    expected = np.pi * radiance * radius**2 / (radius**2 + height**2)
    assert values.mean() == pytest.approx(expected, abs=5 * values.std() / 2**8 + 2e-4 * expected)


def test_light_around_a_tube() -> None:
    """Irradiance at distance R from the axis of an infinite cylinder of radius r, facing it: pi L r / R."""
    radius, distance = 0.2, 0.7
    tube = {"type": "cylinder", "p0": [0, -500, 0], "p1": [0, 500, 0], "radius": radius}
    scene = djpt.load_dict({"type": "scene", "tube": {**tube, "emitter": {"type": "area", "radiance": 2.0}},
                            "wall": {"type": "rectangle", "to_world": T().translate([0, 0, distance])}})  # fmt: skip
    si = scene.ray_intersect(djpt.Ray3f(Point3f(0, 0, 5), Vector3f(0, 0, -1), maxt=Float(np.inf)))
    si.n, si.sh_frame = -si.n, djpt.Frame3f.from_normal(-si.n)
    # A light that long is sampled badly by area: integrate over directions instead.
    from djpt.core.warp import square_to_cosine_hemisphere

    d = si.to_world(square_to_cosine_hemisphere(Point2f(*uniform(2**16))))
    hit = scene.ray_intersect(si.spawn_ray(d))
    radiance = np.array(hit.emitter(scene).eval(hit).x, np.float64)
    expected = np.pi * 2 * radius / distance
    assert np.pi * radiance.mean() == pytest.approx(expected, abs=5 * np.pi * radiance.std() / 2**8)


# ---------------------------------------------------------------- special rays, edits, errors


@pytest.mark.parametrize(
    ("description", "o", "d", "t"),
    [
        ({"type": "disk"}, (-5, 0, 0), (1, 0, 0), np.inf),  # in the plane
        ({"type": "disk"}, (0.6, 0.6, 3), (0, 0, -2), 1.5),
        ({"type": "disk"}, (0.8, 0.8, 3), (0, 0, -2), np.inf),  # past the rim
        ({"type": "cylinder"}, (0, 0, -3), (0, 0, 1), np.inf),  # along the axis: no caps
        ({"type": "cylinder"}, (1, 0, -3), (0, 0, 1), np.inf),  # within the surface
        ({"type": "cylinder"}, (0, 0, 0.5), (0, 2, 0), 0.5),  # from inside
        ({"type": "cylinder"}, (0, -3, 0.5), (0, 1, 0), 2),
        ({"type": "cylinder"}, (0, -3, 1.5), (0, 1, -0.2), 4),  # over the rim, onto the far side
        ({"type": "cylinder"}, (0, -3, 1.5), (0, 1, 0), np.inf),
    ],
)
def test_special_rays(description: dict[str, Any], o: Any, d: Any, t: float) -> None:
    pi = load(description).ray_intersect_preliminary(djpt.Ray3f(Point3f(*o), Vector3f(*d), maxt=Float(np.inf)))
    assert float(np.array(pi.t).ravel()[0]) == pytest.approx(t, rel=1e-6)


@pytest.mark.parametrize("name", ["disk", "cylinder"])
def test_an_edit_moves_the_shape(name: str) -> None:
    """From its pose at the start to any other, round or not: as if it had been loaded there."""
    scene = load({"type": name})
    params = djpt.traverse(scene)
    o, d = rays(2000)
    for pose in (TURNED, T(), MIRRORED, *((ELLIPSE, TURNED) if name == "disk" else ())):
        params["shape.to_world"] = pose
        params.update()
        edited, fresh = (
            s.ray_intersect(djpt.Ray3f(Point3f(o), Vector3f(d), maxt=Float(np.inf)))
            for s in (scene, load({"type": name, "to_world": pose}))
        )
        valid = np.array(fresh.is_valid())
        assert np.mean(np.array(edited.is_valid()) != valid) < 2e-3
        valid &= np.array(edited.is_valid())
        for field in ("t", "n", "dp_du"):
            a, b = (wide(getattr(si, field), 2000)[..., valid] for si in (edited, fresh))
            assert np.quantile(np.abs(a - b), 0.995) < 1e-4, field
        assert scene.shapes()[0].surface_area()[0] == pytest.approx(float(fresh_area(name, pose)), rel=1e-5)


def fresh_area(name: str, pose: T) -> float:
    return load({"type": name, "to_world": pose}).shapes()[0].surface_area()[0]


@pytest.mark.parametrize("bad", [T().scale([1, 2, 1]), T([[1, 0, 0.5, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])])
def test_a_stretched_cylinder_is_refused(bad: T) -> None:
    with pytest.raises(SceneError, match="scale uniformly"):
        load({"type": "cylinder", "to_world": bad})
    params = djpt.traverse(load({"type": "cylinder"}))
    with pytest.raises(ParameterError, match="scale uniformly"):
        params["shape.to_world"] = bad


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"radius": 0}, "'radius' must be greater than 0"),
        ({"p0": [1, 2, 3], "p1": [1, 2, 3]}, "'p0' and 'p1' are the same point"),
        ({"p2": [1, 2, 3]}, "unknown key 'p2'"),
    ],
)
def test_cylinder_errors(parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        load({"type": "cylinder", **parameters})

"""Derivatives of images by the place of shapes: those of finite differences."""

from __future__ import annotations

import functools
import inspect
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import DjptError, RenderError
from djpt.jit.types import Bool, Float, Point2f, Point3f, TensorXf, UInt32

SIZE = 16
STEP = 0.1
INTEGRATORS = ("direct_projective", "prb_projective")
COLUMN = np.linspace(-1, 1, SIZE, dtype=np.float32)
WEIGHTS = np.broadcast_to(np.sin(2 * COLUMN[None, :, None] + 1) + 0.5 * COLUMN[:, None, None], (SIZE, SIZE, 3)).copy()
"""The derivative of a loss by the pixels."""


def octahedron(center: tuple[float, float, float], radius: float, emitter: Any = None) -> Any:
    """A mesh of eight triangles."""
    axes = radius * np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)
    faces = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)]
    props = {} if emitter is None else {"emitter": djpt.load_dict(emitter)}
    return djpt.Mesh("moving", axes + np.array(center, np.float32), np.array(faces), props=props)


def globe(rows: int = 16, columns: int = 32) -> Any:
    """A smooth sphere of triangles, with normals that follow from their corners."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, rows + 1), np.arange(columns) * 2 * np.pi / columns, indexing="ij")
    points = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], axis=-1)
    row, column = (x.ravel() for x in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
    a, b = row * columns + column, row * columns + (column + 1) % columns
    faces = np.concatenate(
        [np.stack([a, b, a + columns], -1)[columns:], np.stack([b, b + columns, a + columns], -1)[:-columns]]
    )
    found = djpt.Mesh("moving", points.reshape(-1, 3).astype(np.float32), faces)
    found.recompute_vertex_normals()
    return found


LAMP = {"type": "area", "radiance": 1.0}
SKY = {
    "sky": {"type": "constant", "radiance": 0.3},
    "lamp": {"type": "point", "position": [3, 3, 5], "intensity": 40.0},
}
FLOOR = {
    "floor": {"type": "rectangle", "to_world": T().scale(3)},
    "lamp": {"type": "sphere", "center": [3, 3, 6], "radius": 0.5, "emitter": {"type": "area", "radiance": 60.0}},
}
SCENES: dict[str, Any] = {
    "a bright sphere": lambda: {"moving": {"type": "sphere", "emitter": LAMP}},
    "a bright mesh": lambda: {"moving": octahedron((0, 0, 0), 1.4, LAMP)},
    "a bright rectangle": lambda: {
        "moving": {"type": "rectangle", "emitter": LAMP, "to_world": T().rotate([1, 0, 0], 40)}
    },
    "a bright disk": lambda: {"moving": {"type": "disk", "emitter": LAMP, "to_world": T().rotate([1, 0, 0], 40)}},
    "a lit sphere": lambda: {"moving": {"type": "sphere"}, **SKY},
    "a lit cylinder": lambda: {
        "moving": {"type": "cylinder", "p0": [-1, -1, 0], "p1": [1, 1, 0], "radius": 0.6},
        **SKY,
    },
    "a lit mesh": lambda: {"moving": globe(), **SKY},
    # Its shadow is in the picture; the sphere itself isn't.
    "the shadow of a sphere": lambda: {"moving": {"type": "sphere", "center": [2, 2, 4], "radius": 0.5}, **FLOOR},
    "the shadow of a mesh": lambda: {"moving": octahedron((2, 2, 4), 0.6), **FLOOR},
}


def scene(name: str, theta: Float) -> Any:
    """The scene, with its shape moved by `theta` to the right and a little upwards."""
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    place = T().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0])
    fov = 25 if "shadow" in name else 40
    sensor = {"type": "perspective", "fov": fov, "to_world": place, "film": film}
    found = djpt.load_dict({"type": "scene", "sensor": sensor, **SCENES[name]()})
    params = djpt.traverse(found)
    if "mesh" in name:
        positions = Float(params["moving.vertex_positions"])
        x, y = (dr.arange(UInt32, dr.width(positions)) % 3 == axis for axis in (0, 1))
        params["moving.vertex_positions"] = positions + dr.select(x, theta, dr.select(y, 0.3 * theta, 0))
    else:
        motion = djpt.Transform4f().translate([theta, 0.3 * theta, 0])
        params["moving.to_world"] = motion @ djpt.Transform4f(params["moving.to_world"])
    params.update()
    return found


@functools.cache
def difference(name: str) -> float:
    """The change of the loss with `theta`."""
    path = djpt.load_dict({"type": "path", "max_depth": 2})
    images = [np.array(djpt.render(scene(name, Float(x)), integrator=path, spp=1024)) for x in (STEP, -STEP)]
    return float((WEIGHTS * (images[0] - images[1])).sum() / (2 * STEP))


def integrator(kind: str, **settings: Any) -> Any:
    """One with less effort than usual for its guide."""
    found = djpt.load_dict({"type": kind, "max_depth": 2, **settings})
    found.proj_seed_spp, found.octree_extra_leaf_sample, found.octree_max_depth = 256, 64, 9
    return found


def attached(name: str) -> tuple[Float, Any]:
    theta = Float(0)
    dr.enable_grad(theta)
    return theta, scene(name, theta)


QUICK = (("a bright sphere", "direct_projective"), ("a bright mesh", "prb_projective"))
CASES = [
    pytest.param(name, kind, marks=() if (name, kind) in QUICK else pytest.mark.slow)
    for name in SCENES
    for kind in INTEGRATORS
]


@pytest.mark.parametrize(("name", "kind"), CASES)
@pytest.mark.sparse(2)
def test_derivatives_by_the_place_of_a_shape(name: str, kind: str) -> None:
    """Forward mode agrees with differences within noise, and 3 per cent, since a guide leaves out what it hasn't found.

    Reverse mode agrees with forward mode.
    """
    indirect = {} if "shadow" in name else {"sppi": 0}
    # Along both sides of the cylinder points that fixed rays see move fast: few samples make most of the noise.
    spp = 256 if name == "a lit cylinder" else 64
    found, sizes = [], []
    for seed in (1, 2, 3, 4):
        theta, room = attached(name)
        dr.forward(theta, dr.ADFlag.ClearEdges)
        change = np.array(integrator(kind, **indirect).render_forward(room, None, spp=spp, seed=seed))
        found.append(float((WEIGHTS * change).sum()))
        sizes.append(float(np.abs(WEIGHTS * change).sum()))
    error, scale = np.std(found, ddof=1) / 2, np.mean(sizes)
    assert error < 0.05 * scale
    assert abs(np.mean(found) - difference(name)) < 4 * error + 0.03 * scale, (found, difference(name), scale)

    theta, room = attached(name)
    integrator(kind, **indirect).render_backward(room, None, TensorXf(WEIGHTS), spp=spp, seed=4)
    assert dr.grad(theta)[0] == pytest.approx(found[3], rel=2e-3, abs=1e-3 * scale)


def test_images_are_attached_to_shapes() -> None:
    """`djpt.render` takes images and derivatives; the image is that of a path tracer."""
    name = "a bright sphere"
    theta, room = attached(name)
    image = djpt.render(room, integrator=integrator("prb_projective", sppi=0), spp=64, seed=3)
    path = djpt.render(scene(name, Float(0)), integrator=djpt.load_dict({"type": "path", "max_depth": 2}), spp=64)
    assert np.array(image).mean() == pytest.approx(np.array(path).mean(), rel=0.02)
    dr.backward(dr.sum(image * TensorXf(WEIGHTS), axis=None))
    assert dr.grad(theta)[0] == pytest.approx(difference(name), rel=0.08)


@pytest.mark.parametrize(
    "guiding",
    [{"guiding": "none"}, {"guiding": "grid"}, {"guiding": "grid", "guiding_proj": False, "guiding_rounds": 64}],
)
@pytest.mark.sparse(3)
def test_ways_of_guiding(guiding: dict[str, Any]) -> None:
    name = "the shadow of a sphere"
    theta, room = attached(name)
    estimator = integrator("direct_projective", sppp=0, sppc=0, **guiding)
    estimator.guiding_grid_reso = [32, 16, 16]
    estimator.render_backward(room, None, TensorXf(WEIGHTS), spp=512, seed=2)
    assert dr.grad(theta)[0] == pytest.approx(difference(name), rel=0.12)


@pytest.mark.parametrize("algorithm", ["walk", "jump"])
@pytest.mark.sparse(2)
def test_ways_to_project_onto_meshes(algorithm: str) -> None:
    _, room = attached("the shadow of a mesh")
    estimator = integrator("direct_projective")
    estimator.proj_mesh_algo = algorithm
    with dr.suspend_grad():
        sampler, _ = estimator.prepare(room.sensors()[0], 1, 16)
        points, active = estimator.proj_detail.get_projected_points(room, room.sensors()[0], sampler)
        chosen = djpt.ad.guiding.places_of(active)
        inside = dr.gather(Point3f, points, chosen)
    assert dr.width(chosen) > 50
    values = np.array(inside)
    assert (values >= 0).all() and (values <= 1).all()


def test_samples_per_pixel() -> None:
    estimator = integrator("prb_projective", sppc=0, sppp=3)
    assert (estimator.sppc, estimator.sppp, estimator.sppi) == (0, 3, None)
    assert estimator.override_spp(0, 5, 7) == 0 and estimator.override_spp(3, 5, 7) == 5
    assert estimator.override_spp(3, 0, 7) == 3 and estimator.override_spp(None, 0, 7) == 7


def test_weights_and_jacobians() -> None:
    common = djpt.ad.integrators.common
    assert np.array(common.mis_weight(3.0, 4.0)) == pytest.approx(9 / 25)
    assert np.array(common.mis_weight(Float(0), Float(0))) == 0
    jacobian = common.solid_angle_to_area_jacobian(Point3f(0), Point3f(0, 0, 2), djpt.Normal3f(0, 0.6, 0.8))
    assert np.array(jacobian) == pytest.approx(0.2)
    assert np.array(common.solid_angle_to_area_jacobian([0, 0, 0], [0, 0, 2], [0, 0, 1], Bool(False))) == 1


def test_what_integrators_of_scripts_must_have() -> None:
    class Mine(djpt.ad.common.PSIntegrator):
        pass

    mine = Mine(djpt.Properties("mine", "mine", {}))
    for call in (mine.sample, mine.sample_radiance_difference, mine.sample_importance):
        with pytest.raises(NotImplementedError, match=f"Mine needs a method {call.__name__}"):
            call(*[None] * len(inspect.signature(call).parameters))


def test_errors() -> None:
    with pytest.raises(RenderError, match="mesh_proj_algo must be one of hybrid, walk, jump, found 'fly'"):
        djpt.ad.ProjectiveDetail.ProjectOperation("fly", 1, 1)
    with pytest.raises(DjptError, match="project_seed"):
        djpt.load_dict({"type": "direct_projective", "project_seed": "sky"})
    _, room = attached("a bright sphere")
    sensor = djpt.load_dict(
        {
            "type": "distant",
            "film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}},
            "to_world": T().translate([0, 0, -3]),
        }
    )
    with pytest.raises(
        RenderError, match="silhouettes are supported for cameras whose rays meet in one point or are parallel only"
    ):
        integrator("direct_projective").render_backward(
            room, None, TensorXf(np.ones((1, 1, 3), np.float32)), sensor, spp=1
        )


def test_places_on_the_film() -> None:
    """The Jacobian of a point in front of the camera: the area of a unit square on the film."""
    _, room = attached("a bright sphere")
    sensor = room.sensors()[0]
    ss = djpt.SilhouetteSample3f(
        p=Point3f(0.3, 0.2, 0), d=djpt.Vector3f(0, 0, -1), silhouette_d=djpt.Vector3f(1, 0, 0), n=djpt.Normal3f(0, 1, 0)
    )
    jacobian = djpt.ad.projective.ProjectiveDetail(None).sensor_jacobian(sensor, ss)
    width = 2 * 6 * np.tan(np.radians(20))
    assert np.array(jacobian) == pytest.approx(1 / width**2, rel=1e-4)
    place = sensor.sample_direction(ss, Point2f(0))[0].uv
    assert np.array(place).ravel() == pytest.approx(
        [SIZE * (0.5 - 0.3 / width * -1), SIZE * (0.5 - 0.2 / width)], rel=0.2
    )


@pytest.mark.parametrize("kind", INTEGRATORS)
def test_rays_end_at_the_far_plane(kind: str) -> None:
    """What is behind isn't seen, and throws shadows and light all the same."""
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    place = T().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0])
    camera = {"type": "perspective", "fov": 40, "to_world": place, "film": film, "far_clip": 6.0}
    floor = {"type": "rectangle", "to_world": T().translate([0, 0, -1.5]).scale(4)}
    nodes = {"ball": {"type": "sphere"}, "floor": floor}
    made = djpt.load_dict({"type": "scene", "sensor": camera, **nodes, "sky": {"type": "constant", "radiance": 0.5}})
    integrators = (djpt.load_dict({"type": name, "max_depth": 2}) for name in (kind, "path"))
    found, expected = (np.array(djpt.render(made, integrator=chosen, spp=256)) for chosen in integrators)
    np.testing.assert_allclose(found, expected, atol=0.05)
    assert expected[0] == pytest.approx(0.5)

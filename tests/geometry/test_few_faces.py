"""Scenes of few flat faces: the faces, the hits of the search by a tree, edges, lights, edits."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest
from numpy.typing import NDArray

import djpt
from djpt.core.records import Ray3f
from djpt.geometry.bvh.calls import searches
from djpt.geometry.bvh.calls.faces import FEW, Faces
from djpt.geometry.bvh.calls.ray import Features
from djpt.geometry.bvh.calls.trees import CompiledTree
from djpt.geometry.engines import chosen, ray_queries
from djpt.geometry.query import NONE
from djpt.jit.types import Bool, Float, Point3f, Vector3f

Floats = NDArray[np.float64]

with ray_queries("auto"):
    FASTEST = chosen()

pytestmark = [
    pytest.mark.narrow,
    pytest.mark.skipif(FASTEST == "steps", reason="calls don't work on this machine"),
]

RNG = np.random.default_rng(3)

BOX = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
SIDES = QUADS[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
"""A box whose normals point outwards."""

GOLDEN = (1 + 5**0.5) / 2
BALL = np.array([[a, b * GOLDEN, 0] for a in (-1, 1) for b in (-1, 1)])
BALL = np.concatenate([np.roll(BALL, k, axis=1) for k in range(3)])
HULL = np.array(
    [
        face
        for face in np.stack(np.meshgrid(*3 * [np.arange(12)], indexing="ij"), -1).reshape(-1, 3)
        if all(abs(np.linalg.norm(BALL[face[k]] - BALL[face[k - 1]]) - 2) < 1e-6 for k in range(3))
        and np.linalg.det(BALL[face]) > 0
        and face[0] == min(face)
    ]
)
"""An icosahedron."""


def turned(points: Floats, angle: float = 0.6) -> Floats:
    """Points turned about two axes."""
    c, s = np.cos(angle), np.sin(angle)
    x: Floats = points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    return x


def mesh(points: Floats, faces: NDArray[Any], **props: Any) -> djpt.Mesh:
    return djpt.Mesh("m", points.astype(np.float32), faces, props=props)


def room(**props: Any) -> dict[str, Any]:
    """A box that stands in another one, and a lamp."""
    return {
        "room": mesh(BOX * 4, SIDES[:, ::-1]),
        "body": mesh(turned(BOX) + np.array([1.2, 1.5, 1]), SIDES),
        "lamp": mesh(BOX[[0, 2, 6, 4]] * [1, 1, 0] + [2, 1, 3.9], np.array([[0, 1, 2], [0, 2, 3]]), **props),
    }


def shining() -> dict[str, Any]:
    return {"emitter": djpt.load_dict({"type": "area", "radiance": 3.0})}


def scene(ways: str, **nodes: Any) -> djpt.Scene:
    with ray_queries(ways):
        return djpt.load_dict({"type": "scene", **nodes})


def tree_of(loaded: djpt.Scene) -> CompiledTree:
    assert loaded.geometry.triangles is not None
    tree = loaded.geometry.triangles.tree
    assert isinstance(tree, CompiledTree)
    return tree


def rays(origins: Floats, targets: Floats) -> Ray3f:
    return Ray3f(Point3f(*origins.T), Vector3f(*(targets - origins).T))


def random_rays(count: int = 1 << 14) -> Ray3f:
    return rays(*(RNG.uniform(0.01, 3.85, (2, count, 3))))


def is_swept(loaded: djpt.Scene) -> bool:
    tree = tree_of(loaded)
    return any(tree.functions.any is searches.functions(f, "sweep").any for f in features())


def features() -> list[Features]:
    return [Features(lights=a, one_sided=b) for a in (False, True) for b in (False, True)]


@pytest.mark.parametrize(("points", "indices", "count"), [(BOX, SIDES, 6), (turned(BOX), SIDES, 6), (BALL, HULL, 20)])
def test_faces_are_triangles_or_joined_of_two(points: Floats, indices: NDArray[Any], count: int) -> None:
    corners = points[indices].astype(np.float32)
    faces = Faces.of(corners, np.zeros(len(corners), np.uint32), 3.0)
    assert faces is not None
    assert len(faces.faces) == count and len(faces.corners) == len(points)


def test_faces_of_other_meshes_and_bent_or_folded_ones_arent_joined() -> None:
    quad = BOX[QUADS[0]]

    def count(points: Floats, labels: list[int]) -> int:
        corners = points[[[0, 1, 2], [0, 2, 3]]].astype(np.float32)
        faces = Faces.of(corners, np.array(labels, np.uint32), 1.0)
        assert faces is not None
        return len(faces.faces)

    assert count(quad, [1, 1]) == 1
    assert count(quad, [1, 2]) == 2
    bent, folded = quad.copy(), quad.copy()
    bent[3, 0] += 0.01
    folded[3] = 0.9 * quad[1] + 0.1 * quad[0]
    assert count(bent, [1, 1]) == 2
    assert count(folded, [1, 1]) == 2


def assert_same_hits(swept: djpt.Scene, searched: djpt.Scene, ray: Ray3f, least: float) -> None:
    """For at least that share of rays the same triangle is hit, with the same words; others are on a common edge."""
    found, expected = (tree_of(s).search(ray, False) for s in (swept, searched))
    same = np.array(found.record == expected.record)
    assert same.mean() >= least
    assert found.b is not None and expected.b is not None
    for number, other in zip([found.t, *found.b], [expected.t, *expected.b], strict=True):
        assert np.array_equal(np.array(number)[same], np.array(other)[same])
    assert dr.allclose(found.t, expected.t, rtol=1e-5)
    segment = Ray3f(ray.o, ray.d, maxt=Float(1))
    blocked, also = (tree_of(s).search(segment, True).record != NONE for s in (swept, searched))
    assert dr.all(blocked == also)


def test_hits_are_those_of_the_tree() -> None:
    swept, searched, ray = scene("auto", **room()), scene(FASTEST, **room()), random_rays()
    assert is_swept(swept) and not is_swept(searched)
    assert_same_hits(swept, searched, ray, least=0.9999)


@pytest.mark.parametrize(
    ("points", "indices"),
    [(BOX, SIDES), (turned(BOX * [1, 0.03, 1]) + np.array([50, 20, 3]), SIDES), (turned(BALL), HULL)],
    ids=["box", "thin, off centre", "icosahedron"],
)
@pytest.mark.sparse(2)
def test_no_ray_slips_through_an_edge(points: Floats, indices: NDArray[Any]) -> None:
    """Rays from inside, at points on edges and within rounding errors of them."""
    count = 1 << 17
    loaded, middle = scene("auto", m=mesh(points, indices)), points.mean(axis=0)
    assert is_swept(loaded)
    edges = np.concatenate([indices[:, [0, 1]], indices[:, [1, 2]], indices[:, [2, 0]]])
    a, b = points[edges[RNG.integers(len(edges), size=count)].T]
    share = RNG.random((count, 1))
    origins = middle + 0.999 * (RNG.dirichlet(np.full(len(points), 0.3), count) @ points - middle)
    near = RNG.normal(size=(count, 3)) * 10 ** RNG.uniform(-9, -4, (count, 1))
    ray = rays(origins, a * share + b * (1 - share) + near)
    ray.d *= 2
    assert dr.all(tree_of(loaded).search(ray, True).record != NONE)
    assert_same_hits(loaded, scene(FASTEST, m=mesh(points, indices)), ray, least=0.3)


def test_rays_pass_through_lights_where_asked() -> None:
    swept, ray = scene("auto", **room(**shining())), rays(np.full((8, 3), 2.5), np.array([[2.5, 1.5, 4]] * 8))
    assert is_swept(swept)
    through = dr.arange(djpt.UInt32, 8) % 2 == 0
    t = np.array(tree_of(swept).search(ray, False, through_lights=Bool(through)).t)
    assert np.allclose(t, np.where(np.arange(8) % 2 == 0, 1, 1.4 / 1.5), atol=1e-5)


def test_rays_pass_one_sided_faces_from_behind() -> None:
    class OneSided(djpt.Mesh):
        one_sided = True

    loaded = scene("auto", m=OneSided("m", BOX.astype(np.float32), SIDES))
    assert is_swept(loaded)
    outside, inside = rays(np.full((8, 3), -1.0), np.full((8, 3), 0.5)), rays(np.full((8, 3), 0.5), np.ones((8, 3)))
    assert dr.all(tree_of(loaded).search(outside, False).record != NONE)
    assert dr.all(tree_of(loaded).search(inside, False).record == NONE)


def test_edits_are_followed() -> None:
    loaded = scene("auto", m=mesh(BOX, SIDES))
    parameters = djpt.traverse(loaded)
    key = next(key for key in parameters if key.endswith(("positions", "vertex_positions")))
    ray = rays(np.array([[0.5, 0.5, 5.0]]), np.array([[0.5, 0.5, 0.0]]))
    for height in (1, 2, 1e-4, 1):
        parameters[key] = (BOX * [1, 1, height]).astype(np.float32).ravel()
        parameters.update()
        t = loaded.ray_intersect(ray).t
        assert dr.allclose(t, (5 - height) / 5, atol=1e-5)
    assert is_swept(loaded)


def test_more_faces_are_searched_in_a_tree() -> None:
    boxes = {f"b{k}": mesh(BOX + 2 * k, SIDES) for k in range(FEW // 6 + 1)}
    assert not is_swept(scene("auto", **boxes))
    boxes.popitem()
    assert is_swept(scene("auto", **boxes))


def test_images_are_those_of_the_tree() -> None:
    view = djpt.ScalarTransform4f().look_at(origin=[2.2, 0.1, 2], target=[1.8, 4, 1.5], up=[0, 0, 1])
    film = {"type": "hdrfilm", "width": 24, "height": 24}
    nodes = {"sensor": {"type": "perspective", "fov": 70, "to_world": view, "film": film}}
    images = [
        np.array(djpt.render(scene(ways, integrator={"type": "path"}, **nodes, **room(**shining())), spp=16, seed=1))
        for ways in ("auto", FASTEST)
    ]
    assert images[0].mean() > 0.02
    # A path that hits an edge may go on with the other face.
    assert (images[0] == images[1]).all(axis=2).mean() > 0.99

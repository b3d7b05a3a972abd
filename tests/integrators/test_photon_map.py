"""The photon map: sums over photons near a point, against sums over all of them."""

from __future__ import annotations

import itertools
import math

import drjit as dr
import numpy as np
import pytest

from djpt.core import memory
from djpt.errors import RenderError
from djpt.integrators.photons import NOWHERE, Photon, PhotonMap, PhotonStore, photon
from djpt.integrators.photons.map import (
    ALONG_Y,
    ALONG_Z,
    FACING,
    FEWEST,
    FLATNESS,
    LENGTH,
    MOST_ACROSS,
    MOST_ALONG,
    WIDTH,
)
from djpt.integrators.photons.photon import FOUND, WEIGHTS, WORDS, bytes_of
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point3f, UInt32, Vector3f

RADIUS, PATHS, UNIT = 0.05, 1000, 0.5


def photons(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places about the origin, powers, and numbers of edges."""
    rng = np.random.default_rng(3)
    edges = rng.integers(1, 6, count)
    return rng.uniform(-0.3, 0.3, (count, 3)).astype(np.float32), rng.random((count, 3)).astype(np.float32), edges


def normals(count: int) -> Normal3f:
    """Along x, y and z in turn."""
    return Normal3f(np.eye(3, dtype=np.float32)[np.arange(count) % 3].T)


def filled(
    p: np.ndarray, flux: np.ndarray, edges: np.ndarray, radius: float = RADIUS, weighted: bool = True
) -> PhotonMap:
    """The map of some photons, of which every second one travels along x, the others along z."""
    store, count = PhotonStore("photons", PATHS, weighted), len(p)
    store.clear()
    if count:
        along_x = dr.arange(UInt32, count) % 2 == 0
        d = Vector3f(dr.select(along_x, 1, 0), 0, dr.select(along_x, 0, 1))
        store.add(
            Photon(Point3f(p.T), normals(count), Float(edges), d, Color3f(flux.T), Float(edges) * 2, Float(edges) * 3),
            dr.full(Bool, True, count),
        )
        dr.eval(store.sinks)
    found = store.count()
    assert found == count
    result = PhotonMap(radius, PATHS, UNIT)
    result.fill(store, found)
    return result


@pytest.mark.parametrize("count", [0, 1, 500, 5000])
def test_sums_are_those_over_all_photons(count: int) -> None:
    """Within the radius, near the surface, of paths that are short enough; whatever fields are asked for."""
    p, flux, edges = photons(count)
    map_of = filled(p, flux, edges)
    points = np.random.default_rng(4).uniform(-0.3, 0.3, (64, 3)).astype(np.float32)
    most = np.arange(64) % 7
    active = np.arange(64) % 5 != 0

    def worth(photon: Photon) -> Color3f:
        return photon.flux * (photon.d.x + photon.vcm * photon.vc)

    n = np.random.default_rng(5).normal(size=(64, 3)).astype(np.float32)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    found = map_of.density(Point3f(points.T), Normal3f(n.T), UInt32(most), Bool(active), worth)
    to = (p[None] - points[:, None]).astype(np.float64) if count else np.zeros((64, 0, 3))
    flat = np.abs((to * n[:, None]).sum(axis=2)) <= FLATNESS * RADIUS
    faces = np.eye(3)[np.arange(count) % 3] @ n.T.astype(np.float64) >= FACING
    counts = flat & faces.T & (np.linalg.norm(to, axis=2) <= RADIUS) & (edges[None] <= most[:, None]) & active[:, None]
    value = flux * ((np.arange(count) % 2 == 0) + 6.0 * edges**2)[:, None]
    expected = (counts @ value if count else np.zeros((64, 3))) / (math.pi * RADIUS**2 * PATHS)
    np.testing.assert_allclose(np.array(found).T, expected, rtol=1e-5, atol=1e-6)
    assert count < 5000 or expected.max() > 0


def filled_media(p: np.ndarray, flux: np.ndarray, edges: np.ndarray) -> tuple[PhotonMap, np.ndarray]:
    """The map of photons on surfaces and in the media 0 and 1, in turn, and the numbers of their media."""
    store, count = PhotonStore("photons", PATHS, False, in_media=True), len(p)
    store.clear()
    media = np.array([NOWHERE, 0, 1])[np.arange(count) % 3]
    if count:
        d = Vector3f(0, 0, 1)
        photons_of = Photon(Point3f(p.T), normals(count), Float(edges), d, Color3f(flux.T), medium=UInt32(media))
        store.add(photons_of, dr.full(Bool, True, count))
        dr.eval(store.sinks)
    result = PhotonMap(RADIUS, PATHS, UNIT)
    result.fill(store, store.count() or 0)
    return result, media


@pytest.mark.parametrize("count", [0, 5000])
def test_sums_in_media(count: int) -> None:
    """Over the photons of a ball in one medium; those on surfaces are told apart."""
    p, flux, edges = photons(count)
    map_of, media = filled_media(p, flux, edges)
    rng = np.random.default_rng(4)
    o = rng.uniform(-0.3, 0.3, (64, 3)).astype(np.float32)
    number, active, most = np.arange(64) % 2, np.arange(64) % 5 != 0, 3
    to = (p[None] - o[:, None]).astype(np.float64)
    belongs = (media[None] == number[:, None]) & (edges[None] <= most) & active[:, None]

    near = belongs & (np.linalg.norm(to, axis=2) <= RADIUS)
    lanes = UInt32(most), Bool(active)
    ball = map_of.density_in_medium(Point3f(o.T), UInt32(number), *lanes, lambda photon: photon.flux)
    expected = near @ flux.astype(np.float64) / (4 / 3 * math.pi * RADIUS**3 * PATHS)
    np.testing.assert_allclose(np.array(ball).T, expected, rtol=1e-5, atol=1e-5)

    assert not count or near.any()

    up = Normal3f(0, 0, 1)
    flat = map_of.density(Point3f(o.T), up, *lanes, lambda photon: photon.flux)
    on_surface = (media == NOWHERE) & (np.arange(count) % 3 == 2) & (edges <= most)
    disk = on_surface[None] & active[:, None] & (np.linalg.norm(to, axis=2) <= RADIUS)
    disk &= np.abs(to[..., 2]) <= FLATNESS * RADIUS
    expected = disk @ flux.astype(np.float64) / (math.pi * RADIUS**2 * PATHS)
    np.testing.assert_allclose(np.array(flat).T, expected, rtol=1e-5, atol=1e-6)


def test_a_crowd_in_one_place() -> None:
    """All photons have one hash value."""
    p, flux, edges = photons(2000)
    map_of = filled(p * 0 + 0.01, flux, edges)
    flux = flux[1::3]  # those that face along y
    point, n, active = Point3f(0.02, 0.01, 0), Normal3f(0, 1, 0), dr.full(Bool, True, 1)
    one = map_of.density(point, n, UInt32(9), active, lambda photon: photon.flux)
    np.testing.assert_allclose(np.array(one).ravel(), flux.sum(axis=0) / (math.pi * RADIUS**2 * PATHS), rtol=1e-5)


def test_sums_do_not_depend_on_the_order() -> None:
    p, flux, edges = photons(5000)
    points = Point3f(p[:64].T)
    sums = []
    for order in (slice(None), slice(None, None, -1)):
        map_of = filled(p[order], flux[order], edges[order])
        found = map_of.density(points, Normal3f(0, 0, 1), UInt32(9), dr.full(Bool, True, 64), lambda ph: ph.flux)
        sums.append(np.array(found))
    np.testing.assert_array_equal(*sums)


def test_neighbours_have_hashes_of_their_own() -> None:
    """No photon is found twice, and the run of a row has no photons of another row of the same ball."""
    along, across = range(1 - MOST_ALONG, MOST_ALONG), range(1 - MOST_ACROSS, MOST_ACROSS)
    for x, y, z in itertools.product(along, across, across):
        assert (x, y, z) == (0, 0, 0) or (x + y * ALONG_Y + z * ALONG_Z) % FEWEST
    assert 2 / LENGTH + 1 < MOST_ALONG
    assert 2 / WIDTH + 1 < MOST_ACROSS


@pytest.mark.parametrize("place", [1.0, 1e3, 1e30])
def test_radii_that_rounding_swallows(place: float) -> None:
    """A search ends, and no photon counts twice, where cells are smaller than what numbers can tell apart."""
    count = 100
    p = np.full((count, 3), place, np.float32)
    map_of = filled(p, np.ones((count, 3), np.float32), np.ones(count), radius=1e-6, weighted=False)
    at, n, active = Point3f(p[:2].T), Normal3f(0, 0.6, 0.8), dr.full(Bool, True, 2)
    found = map_of.density(at, n, UInt32(9), active, lambda photon: photon.flux * (photon.vcm + 1))
    assert (np.array(found) <= (1 + 1e-5) * count / (math.pi * 1e-12 * PATHS)).all()


def test_normals_and_edges_share_a_word() -> None:
    d = np.random.default_rng(7).normal(size=(1000, 3)).astype(np.float32)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    edges = np.arange(1000) * 100
    one = Photon(Point3f(0), Normal3f(d.T), Float(edges), Vector3f(0, 0, 1), Color3f(1))
    found = photon.unpacked(photon.packed(one), None)
    assert np.linalg.norm(np.array(found.n).T - d, axis=1).max() < 0.02
    np.testing.assert_array_equal(np.array(found.edges), np.minimum(edges, photon.MOST_EDGES))


def test_directions_in_a_word() -> None:
    d = np.random.default_rng(6).normal(size=(100_000, 3)).astype(np.float32)
    d[:6] = np.concatenate([np.eye(3), -np.eye(3)])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    found = np.array(photon.direction_in(photon.word_of(Vector3f(d.T)))).T
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-6)
    assert np.linalg.norm(found - d, axis=1).max() < 6.5e-5
    np.testing.assert_allclose(found[:6], d[:6], atol=1e-7)
    assert abs((found - d).mean(axis=0)).max() < 1e-6


def test_a_store_grows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(photon, "PER_PATH", 1)
    store = PhotonStore("photons", 10, False)
    p, flux, edges = photons(100)

    def walk() -> int | None:
        store.clear()
        one = Photon(Point3f(p.T), normals(100), Float(edges), Vector3f(0, 0, 1), Color3f(flux.T), Float(0), Float(0))
        store.add(one, dr.full(Bool, True, 100))
        dr.eval(store.sinks)
        return store.count()

    assert walk() is None
    assert walk() == 100


@pytest.mark.parametrize("weighted", [False, True])
def test_memory_is_what_the_estimate_says(weighted: bool) -> None:
    """What photons are kept in takes no more than the estimate, and more than a half of it."""
    p, flux, edges = photons(5000)
    map_of = filled(p, flux, edges, weighted=weighted)
    words = WORDS + WEIGHTS * weighted
    stored = 4 * (1 if weighted else 2) * words * len(p)
    if not weighted:
        assert 4 * dr.width(map_of._photons) == stored // 2
    hashes = 3 * 4 * dr.width(map_of._begin)
    assert hashes + (3 if weighted else 2) * 4 * len(p) <= 4 * FOUND * len(p)
    assert stored + hashes <= bytes_of(len(p), weighted) / photon.PER_PATH <= 2 * (stored + hashes)


@pytest.mark.parametrize("weighted", [False, True])
def test_what_memory_does_not_hold_is_refused(weighted: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = r"caustics: the map of .* light paths {} .*lower 'photon_count'"
    with pytest.raises(RenderError, match=problem.format("(takes about|has more than)")):
        PhotonStore("caustics", 2**28, weighted)
    paths = 2**20
    needed = bytes_of(paths, weighted) + memory.RESERVE
    monkeypatch.setattr(memory, "free_memory", lambda: needed - 1)
    with pytest.raises(RenderError, match=problem.format("takes about")):
        PhotonStore("caustics", paths, weighted)
    monkeypatch.setattr(memory, "free_memory", lambda: needed)
    PhotonStore("caustics", paths, weighted)

"""Sums of a film that kernels add to by calls, against those in registers."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.geometry.engines import chosen, ray_queries
from djpt.jit.llvm.lanes import lane_count
from djpt.jit.types import Bool, Float, Point2f, UInt32
from djpt.rendering.schedules import flat
from djpt.rendering.schedules.called_sums import (
    CHANNELS,
    CalledSums,
    Taps,
    pieces,
    proved,
    reader,
    tap_function,
    usable,
)
from djpt.rendering.schedules.job import Job

by_calls = pytest.mark.skipif(chosen() == "steps", reason="kernels can't call functions here")

FILTERS = [
    {"type": "gaussian"},
    {"type": "gaussian", "stddev": 0.3},
    {"type": "mitchell", "B": 0.2, "C": 0.6},
    {"type": "catmullrom"},
    {"type": "tent", "radius": 1.3},
]


def scene(rfilter: dict, pixel_format: str = "rgb", width: int = 37) -> djpt.Scene:
    """A Cornell box on a film whose pixels don't fill whole packets."""
    description = djpt.cornell_box()
    film = {"type": "hdrfilm", "width": width, "height": 29, "pixel_format": pixel_format, "rfilter": rfilter}
    description["sensor"]["film"] = film
    return djpt.load_dict(description)


def image(rfilter: dict, name: str, **film: object) -> np.ndarray:
    with ray_queries(name):
        return np.array(djpt.render(scene(rfilter, **film), spp=7, seed=3))


@pytest.mark.sparse(4)
@by_calls
@pytest.mark.parametrize("rfilter", FILTERS, ids=lambda f: "-".join(str(v) for v in f.values()))
def test_same_bits_as_registers(rfilter):
    np.testing.assert_array_equal(image(rfilter, "auto"), image(rfilter, "steps"))


@by_calls
@pytest.mark.parametrize("pixel_format", ["luminance", "rgba"])
@pytest.mark.sparse(2)
def test_same_bits_for_all_channels(pixel_format):
    a, b = (image(FILTERS[0], name, pixel_format=pixel_format) for name in ("auto", "steps"))
    np.testing.assert_array_equal(a, b)


@by_calls
def test_passes_and_lanes_per_pixel_do_not_matter():
    """A small film shares its pixels' samples among lanes, and passes carry the sums on."""
    small = scene(FILTERS[0], width=5)
    with ray_queries("steps"):
        registers = djpt.render(small, spp=64, seed=1)
    whole = djpt.render(small, spp=64, seed=1)
    parts = djpt.render(small, spp=64, seed=1, progress=lambda done, total: None)
    for picture in (whole, parts):
        np.testing.assert_array_equal(np.array(picture), np.array(registers))


@by_calls
def test_same_bits_with_one_vertex_per_turn(monkeypatch):
    """In a scene with meshes samples are added after each vertex, in registers after every second one."""
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0.5], [-1, 1, 0]], np.float32)
    description = djpt.cornell_box()
    description["sheet"] = djpt.Mesh("sheet", vertices, np.array([[0, 1, 2], [0, 2, 3]]))
    description["sensor"]["film"] = {"type": "hdrfilm", "width": 37, "height": 29}
    mesh = djpt.load_dict(description)
    assert mesh.geometry.triangles is not None
    called = np.array(djpt.render(mesh, spp=9, seed=2))
    monkeypatch.setattr(flat, "usable", lambda taps, rfilter: False)
    np.testing.assert_array_equal(np.array(djpt.render(mesh, spp=9, seed=2)), called)


@by_calls
def test_calls_are_used(monkeypatch):
    used, original = [], flat.called_film_sums

    def noted(job: Job, *rest):
        used.append(job)
        return original(job, *rest)

    monkeypatch.setattr(flat, "called_film_sums", noted)
    djpt.render(scene(FILTERS[0]), spp=2)
    assert len(used) == 1


def test_what_cannot_be_called():
    gaussian, lanczos = (djpt.load_dict({"type": name}) for name in ("gaussian", "lanczos"))
    assert not usable(Taps(7, 3), lanczos)
    assert not usable(Taps(5, len(CHANNELS) + 1), gaussian)
    with ray_queries("steps"):
        assert not usable(Taps(5, 3), gaussian)


@by_calls
def test_proof():
    assert proved()


@by_calls
def test_inactive_lanes_and_the_rest_of_a_packet_add_nothing():
    taps, lanes = Taps(5, 3), lane_count() + 3
    sums = CalledSums(taps, djpt.load_dict({"type": "gaussian"}), lanes)
    lane = dr.arange(UInt32, lanes)
    taken = sums.add(Point2f(Float(lane), 0), Point2f(0.5), [Float(1), Float(2), Float(3)], lane % 2 == 0)
    assert np.array(taken).tolist() == [k % 2 == 0 for k in range(lanes)]
    table = np.array(sums.memory).reshape(lanes, 25, 4)
    assert not table[1::2].any()
    np.testing.assert_array_equal(table[::2], np.broadcast_to(table[0], table[::2].shape))
    middle = reader(sums.memory, taps, 2)(lane, 2, Bool(True))
    np.testing.assert_allclose([np.array(x)[0] for x in middle], np.array([1, 2, 3, 1]) * table[0, 12, 3])


@pytest.mark.parametrize("count", range(1, 30))
def test_pieces(count):
    parts = pieces(list(range(count)))
    assert [k for part in parts for k in part] == list(range(count))
    assert all(len(part) in (1, 2, 4, 8) for part in parts)


def test_the_function_depends_on_the_filter():
    taps = Taps(5, 3)
    texts = {tap_function(taps, djpt.load_dict(rfilter), 8) for rfilter in FILTERS}
    assert len(texts) == len(FILTERS)

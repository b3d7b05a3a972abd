"""Samplers: Mitsuba's numbers, strata, independence where it is promised, images, gradients."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest
from scipy import stats

import djpt
from djpt.description import registry
from djpt.jit.types import PCG32, UInt32, UInt64
from djpt.samplers import SampleIndex
from djpt.samplers.independent import MULTIPLIER, IndependentStream
from tests.kit.arrays import in_numpy
from tests.kit.derivatives import by_both
from tests.kit.lit_floor import floor_scene
from tests.kit.renders import box, ours, pixels, theirs

MITSUBAS: list[dict[str, Any]] = [
    {"type": "independent"},
    {"type": "stratified"},
    {"type": "stratified", "jitter": False},
    {"type": "multijitter"},
    {"type": "multijitter", "jitter": False},
    {"type": "orthogonal"},
    {"type": "orthogonal", "jitter": False},
    {"type": "orthogonal", "strength": 3},
    {"type": "ldsampler"},
]
SOBOL = {"type": "sobol"}
BLUE = {"type": "sobol", "blue_noise": True}
ALL = [*MITSUBAS, SOBOL, BLUE]


def test_no_sampler_is_forgotten() -> None:
    own = {name for name, factory in registry.registered("sampler").items() if registry.is_own(factory)}
    assert {d["type"] for d in ALL} == own


def name_of(description: dict[str, Any]) -> str:
    return "-".join(str(v) for v in description.values())


def every(*descriptions: Any) -> Any:
    return pytest.mark.parametrize("description", descriptions or ALL, ids=name_of)


def streams(description: dict[str, Any], count: int, grid: int = 1, seed: int = 5, spp: int = 0, first: int = 0) -> Any:
    """The streams of the samples first .. first + count of all pixels of a grid; pixel by pixel."""
    i = dr.arange(UInt32, grid * grid * count)
    counts, start = dr.opaque(UInt32, count), dr.opaque(UInt32, first)  # one kernel for all
    pixel = i // counts
    sampler = djpt.load_dict(description)
    index = SampleIndex(pixel, i - pixel * counts + start, dr.opaque(UInt32, spp or count), dr.opaque(UInt32, grid))
    return sampler.stream(dr.opaque(UInt32, seed + sampler.base_seed), index)


def pairs(description: dict[str, Any], count: int, grid: int = 1, draws: int = 6, **options: Any) -> np.ndarray:
    """Pairs of numbers: (draw, pixel, sample, 2)."""
    stream = streams(description, count, grid, **options)
    points = [stream.next_2d() for _ in range(draws)]
    dr.eval(points)
    table = np.array([in_numpy(point) for point in points])
    return table.reshape(draws, 2, grid * grid, count).transpose(0, 2, 3, 1)


def singles(description: dict[str, Any], count: int, grid: int = 1, draws: int = 6, **options: Any) -> np.ndarray:
    """Numbers: (draw, pixel, sample)."""
    stream = streams(description, count, grid, **options)
    numbers = [stream.next_1d() for _ in range(draws)]
    dr.eval(numbers)
    return np.array([in_numpy(number) for number in numbers]).reshape(draws, grid * grid, count)


# ---------------------------------------------------------------- Mitsuba


@pytest.mark.sparse(30)
@pytest.mark.parametrize("spp", [1, 3, 10, 17, 100])
@every(*MITSUBAS)
def test_numbers_are_mitsubas(description: dict[str, Any], spp: int) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    for base, seed in [(0, 0), (3, 12345)]:
        described = {**description, "seed": base, "sample_count": spp}
        other, grid = mi.load_dict(described), 3
        count = other.sample_count()
        assert djpt.load_dict(described).round_count(spp) == count
        other.set_samples_per_wavefront(count)
        other.seed(seed, grid * grid * count)
        stream = streams(described, count, grid, seed)
        mine, his = ([s.next_2d() if draw % 3 == 0 else s.next_1d() for draw in range(9)] for s in (stream, other))
        dr.eval(mine)
        dr.eval(his)
        for a, b in ((in_numpy(a), in_numpy(b)) for a, b in zip(mine, his, strict=True)):
            np.testing.assert_allclose(a, np.broadcast_to(b, a.shape), rtol=0, atol=2e-7)


@pytest.mark.parametrize("name", ["stratified", "multijitter", "orthogonal", "ldsampler"])
def test_counts_are_mitsubas(name: str) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    sampler = djpt.load_dict({"type": name})
    for spp in [*range(1, 70), 99, 100, 120, 121, 122, 1000, 4095, 4096, 4097]:
        assert sampler.round_count(spp) == mi.load_dict({"type": name, "sample_count": spp}).sample_count()
        assert sampler.round_count(sampler.round_count(spp)) == sampler.round_count(spp)


@pytest.mark.sparse(6)
@pytest.mark.parametrize("schedule", ["flat", "wave"])
@pytest.mark.parametrize("name", ["stratified", "multijitter", "orthogonal", "ldsampler"])
def test_pixels_are_mitsubas(name: str, schedule: str) -> None:
    pytest.importorskip("mitsuba")
    scene = box(32, edit=lambda s: s["sensor"].__setitem__("sampler", {"type": name, "seed": 2}))
    mine, his = ours(scene, spp=8, seed=7, schedule=schedule), theirs(scene, spp=8, seed=7)
    assert (np.abs(mine - his).max(axis=2) < 1e-3).mean() >= 0.95


def test_render_takes_the_rounded_count() -> None:
    """Images at 10 and at 16 samples are the same, and progress counts the latter."""
    scene = djpt.load_dict(floor_scene(size=8, sampler="stratified"))
    done: list[tuple[int, int]] = []
    image = djpt.render(scene, spp=10, progress=lambda *counts: done.append(counts))
    assert done[-1] == (8 * 8 * 16, 8 * 8 * 16)
    np.testing.assert_array_equal(pixels(image), pixels(djpt.render(scene, spp=16)))


# ---------------------------------------------------------------- each stream by itself


@pytest.mark.sparse(2)
@every()
def test_numbers_are_uniform(description: dict[str, Any]) -> None:
    """Over many pixels and dimensions: range, mean, variance, and a chi-squared test of the first sample."""
    if description.get("jitter") is False or description["type"] == "ldsampler":
        pytest.skip("multiples of one over the count")
    count = djpt.load_dict(description).round_count(16)
    for table in (singles(description, count, 32), pairs(description, count, 32, draws=3).reshape(3, 1024, -1)):
        assert table.min() >= 0
        assert table.max() < 1
        assert abs(table.mean() - 0.5) < 5 / np.sqrt(12 * table.size)
        assert abs(table.var() - 1 / 12) < 5 * np.sqrt(1 / 180 / table.size)
        if description == BLUE:
            continue  # its pixels complete each other: more even than chance
        first = table[:, :, 0].ravel()
        assert stats.chisquare(np.histogram(first, 16, (0, 1))[0]).pvalue > 1e-4


@pytest.mark.sparse(4)
@every(*[d for d in ALL if d != BLUE])
def test_pixels_and_seeds_are_uncorrelated(description: dict[str, Any]) -> None:
    if description.get("strength"):
        pytest.skip("Mitsuba's numbers aren't uniform")
    count = djpt.load_dict(description).round_count(4)
    table = pairs(description, count, 64, draws=4).transpose(0, 3, 2, 1).reshape(8 * count, 64, 64)
    other = pairs(description, count, 64, draws=4, seed=6).transpose(0, 3, 2, 1).reshape(8 * count, 64, 64)
    for shifted in (np.roll(table, 1, 1), np.roll(table, 1, 2), np.roll(table, (1, 1), (1, 2)), other):
        for a, b in zip(table, shifted, strict=True):
            assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 6 / 64


@every(SOBOL, BLUE)
def test_dimensions_are_uncorrelated(description: dict[str, Any]) -> None:
    stream = streams(description, 16, 32)
    table = np.array([x for _ in range(4) for x in (*np.array(stream.next_2d()), np.array(stream.next_1d()))])
    assert np.abs(np.corrcoef(table) - np.eye(12)).max() < 6 / np.sqrt(table.shape[1])


@pytest.mark.sparse(2)
@every()
def test_a_clone_continues_on_its_own(description: dict[str, Any]) -> None:
    stream = streams(description, 16, 2)
    stream.next_2d()
    clone = stream.clone()
    first = [np.array(stream.next_1d()), *np.array(stream.next_2d())]
    second = [np.array(clone.next_1d()), *np.array(clone.next_2d())]
    np.testing.assert_array_equal(first, second)


@every()
def test_samples_beyond_the_count_are_new(description: dict[str, Any]) -> None:
    """They lie in [0, 1) and differ from those before; nothing hangs."""
    count = djpt.load_dict(description).round_count(16)
    before = pairs(description, count, 2, draws=2)
    beyond = pairs(description, 3 * count + 1, 2, draws=2, spp=count, first=count)
    assert beyond.min() >= 0
    assert beyond.max() < 1
    assert not np.array_equal(before, beyond[:, :, :count])


def test_independent_streams_are_independent() -> None:
    """Correlations within a stream and between neighbouring ones."""
    stream = streams({"type": "independent"}, 1, 256)
    table = np.array([np.array(stream.next_1d()) for _ in range(6)], np.float64)
    between = np.corrcoef(np.concatenate([table, np.roll(table, 1, axis=1)]))
    assert np.abs(between - np.eye(12)).max() < 6 / 256


def test_independent_streams_are_those_of_dr_jit() -> None:
    """The same numbers as from the generator with 64-bit words, also where halves overflow."""
    random = np.random.default_rng(3)
    start, sequence = (UInt32(random.integers(0, 2**32, 4096, dtype=np.uint32)) for _ in range(2))
    start[0], sequence[0] = 0xFFFFFFFF, 0xFFFFFFFF
    start[1], sequence[1] = 0, 0
    stream, theirs = IndependentStream.seeded(start, sequence), PCG32()
    theirs.inc = (UInt64(sequence) << 1) | 1
    theirs.state = (theirs.inc + UInt64(start)) * MULTIPLIER + theirs.inc
    for _ in range(5):
        np.testing.assert_array_equal(np.array(stream.next_1d()), np.array(theirs.next_float32()))


def test_inactive_lanes_draw_nothing() -> None:
    sampler = djpt.load_dict({"type": "independent"})
    number = dr.arange(UInt32, 8)
    index = SampleIndex(number, UInt32(0), UInt32(1), UInt32(1))
    masked, plain = sampler.stream(UInt32(0), index), sampler.stream(UInt32(0), index)
    even = (number & 1) == 0
    masked.next_1d(even)
    first, second = plain.next_1d(), plain.next_1d()
    np.testing.assert_array_equal(np.array(masked.next_1d()), np.array(dr.select(even, second, first)))


# ---------------------------------------------------------------- strata


def cells(points: np.ndarray, nx: int, ny: int) -> np.ndarray:
    """How many points of each set (.., sample, 2) are in each of nx x ny cells."""
    cell = (points * [nx, ny]).astype(int)
    flat = (cell[..., 1] * nx + cell[..., 0]).reshape(-1, points.shape[-2])
    return np.array([np.bincount(row, minlength=nx * ny) for row in flat])


@pytest.mark.parametrize("m", [0, 1, 2, 5, 8])
@every(SOBOL, BLUE)
def test_sobol_points_are_nets(description: dict[str, Any], m: int) -> None:
    """Every box of 2^-a x 2^-b, a + b = m, holds one of 2^m points, in all draws and pixels; so do intervals."""
    points = pairs(description, 2**m, 4)
    for a in range(m + 1):
        assert (cells(points, 2**a, 2 ** (m - a)) == 1).all()
    assert (np.sort((singles(description, 2**m, 4) * 2**m).astype(int)) == np.arange(2**m)).all()


def test_sobol_continues_its_sequence() -> None:
    """Any aligned power of two of consecutive samples is a net, whatever the count is."""
    points = pairs(SOBOL, 64, 2, spp=100, first=64)
    assert (cells(points[:, :, :32], 4, 8) == 1).all()
    assert (cells(points, 8, 8) == 1).all()


def test_blue_noise_pixels_complete_each_other() -> None:
    """The samples of an aligned block of 4 x 4 pixels are one net, and so are the blocks of 8 x 8."""
    grid, count = 16, 4
    points = pairs(BLUE, count, grid).reshape(-1, grid, grid, count, 2)
    for size in (2, 4, 8):
        blocks = points.reshape(-1, grid // size, size, grid // size, size, count, 2).transpose(0, 1, 3, 2, 4, 5, 6)
        side = 2 * size
        assert (cells(blocks.reshape(-1, side * side, 2), side, side) == 1).all()


@pytest.mark.parametrize(
    ("name", "count", "grids"),
    [
        ("stratified", 49, [(7, 7)]),
        ("multijitter", 49, [(7, 7), (49, 1), (1, 49)]),
        ("multijitter", 42, [(7, 6), (42, 1), (1, 42)]),
        ("orthogonal", 49, [(7, 7), (49, 1), (1, 49)]),
        ("ldsampler", 64, [(8, 8), (64, 1), (1, 64), (4, 16)]),
    ],
)
@pytest.mark.sparse(2)
def test_mitsubas_sets_are_stratified(name: str, count: int, grids: list[tuple[int, int]]) -> None:
    description = {"type": name}
    points = pairs(description, count, 4, draws=3)
    for nx, ny in grids:
        assert (cells(points, nx, ny) == 1).all()
    assert (np.sort((singles(description, count, 4) * count + 1e-4).astype(int)) == np.arange(count)).all()


def test_orthogonal_arrays_stratify_all_pairs() -> None:
    numbers = singles({"type": "orthogonal"}, 49, 4, draws=6)
    for i in range(6):
        for j in range(i):
            assert (cells(np.stack([numbers[i], numbers[j]], axis=-1), 7, 7) == 1).all()


# ---------------------------------------------------------------- images


@pytest.mark.sparse(4)
@every()
def test_new_seeds_and_counts_compile_nothing(description: dict[str, Any]) -> None:
    scene = djpt.load_dict(floor_scene(size=8, sampler=description))
    pixels(djpt.render(scene, spp=4, seed=1))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        for spp, seed in [(9, 1), (9, 2), (25, 3)]:
            pixels(djpt.render(scene, spp=spp, seed=seed))
        assert all(k["cache_hit"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT)


@pytest.mark.sparse(9)
@pytest.mark.parametrize("schedule", ["flat", "wave"])
@every()
def test_passes_do_not_change_a_bit(description: dict[str, Any], schedule: str) -> None:
    scene = djpt.load_dict(floor_scene(size=8, sampler=description))
    whole, parts = (djpt.render(scene, spp=16, schedule=schedule, pass_spp=n) for n in (0, 5))
    np.testing.assert_array_equal(pixels(whole), pixels(parts))


@pytest.mark.sparse(15)
@every(*[d if len(d) == 1 or d == BLUE else pytest.param(d, marks=pytest.mark.slow) for d in ALL])
def test_schedules_agree(description: dict[str, Any]) -> None:
    """Flat and wave; and with a mesh machine and wave. A filter and a border as well."""
    scene = box(8, rfilter="gaussian", sample_border=True)
    scene["sensor"]["sampler"] = description
    np.testing.assert_allclose(ours(scene, 9, schedule="flat"), ours(scene, 9, schedule="wave"), rtol=1e-3, atol=1e-4)
    scene = floor_scene(size=8, sampler=description)
    vertices = np.array([[-1, 0, 0], [1, 0, 0], [0, 1, 0.5]], np.float32)
    mesh = djpt.Mesh("sail", vertex_positions=vertices, faces=np.array([[0, 1, 2]]))
    scene["sail"] = mesh
    a, b = (ours(scene, 9, schedule=name) for name in ("machine", "wave"))
    np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4)


@pytest.mark.sparse(4)
@every()
def test_gradients_are_those_of_the_image(description: dict[str, Any]) -> None:
    scene = djpt.load_dict(floor_scene(size=8, sampler=description))
    found, expected = by_both(scene, "floor.bsdf.reflectance.value", 0.02, [1, 0, 0], seed=2, spp=8)
    assert found == pytest.approx(expected, rel=5e-3)


def noise(scene: dict[str, Any], spp: int, reference: np.ndarray, seeds: int = 4) -> np.ndarray:
    """Errors of images of several seeds."""
    loaded = djpt.load_dict(scene)
    return np.array([pixels(djpt.render(loaded, spp=spp, seed=seed)) - reference for seed in range(seeds)])


def sky(size: int, sampler: dict[str, Any]) -> dict[str, Any]:
    return floor_scene({"sky": {"type": "constant", "radiance": 1.0}}, size=size, sampler=sampler)


@pytest.mark.slow
@pytest.mark.parametrize("lit", ["box", "sky"])
def test_sobol_noise_is_smaller(lit: str) -> None:
    """At 64 spp, by far less than the 0.75 that is claimed; and the mean is right."""

    def scene(sampler: dict[str, Any]) -> dict[str, Any]:
        return sky(48, sampler) if lit == "sky" else box(48, edit=lambda s: s["sensor"].update(sampler=sampler))

    reference = pixels(djpt.render(djpt.load_dict(scene({"type": "independent"})), spp=8192, seed=99))
    spread = np.sqrt(np.square(noise(scene({"type": "independent"}), 64, reference)).mean())
    for description in (SOBOL, BLUE):
        errors = noise(scene(description), 64, reference)
        assert np.sqrt(np.square(errors).mean()) < 0.6 * spread
        assert abs(errors.mean()) < 5e-4


@pytest.mark.slow
@pytest.mark.parametrize("spp", [1, 4])
def test_blue_noise_has_little_low_frequency(spp: int) -> None:
    """Below a quarter of the highest frequency its energy is well below that of white noise of the same variance."""
    size = 64

    def low_share(sampler: dict[str, Any]) -> float:
        scene = sky(size, sampler)
        reference = pixels(djpt.render(djpt.load_dict(scene), spp=4096, seed=99))
        errors = noise(scene, spp, reference, seeds=8)[:, 24:, :, 0]
        power = (np.abs(np.fft.fft2(errors)) ** 2).mean(axis=0)
        frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(errors.shape[1])))
        return power[(frequency > 0) & (frequency < 0.125)].mean() / power[frequency > 0].mean()

    assert low_share(BLUE) < 0.7 * low_share(SOBOL)


# ---------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("description", "words"),
    [
        ({"type": "sobol", "sample_count": 0}, "'sample_count' must be at least 1"),
        ({"type": "stratified", "sample_count": 0}, "'sample_count' must be at least 1"),
        ({"type": "multijitter", "jitter": 1}, "'jitter' must be True or False"),
        ({"type": "orthogonal", "strength": 1}, r"'strength' must lie in \[2, 6\]"),
        ({"type": "sobol", "bluenoise": True}, "unknown key 'bluenoise'.*did you mean 'blue_noise'"),
    ],
)
def test_errors(description: dict[str, Any], words: str) -> None:
    with pytest.raises(djpt.SceneError, match=words):
        djpt.load_dict(description)

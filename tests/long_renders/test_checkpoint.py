"""Files of accumulations: what is read is what was written, and damaged files are refused."""

from __future__ import annotations

import json
import random
import zlib
from pathlib import Path

import numpy as np
import pytest

import djpt
from djpt.errors import DjptError, FileError
from djpt.rendering.progressive.accumulation import Accumulation
from tests.long_renders.test_passes import box, last


@pytest.fixture(scope="module")
def found() -> Accumulation:
    """Two rounds with weights, and with channels that aren't filtered."""
    aov = djpt.load_dict({"type": "aov", "aovs": "d:depth", "image": {"type": "path"}})
    return last(box(rfilter="gaussian", size=5), spp=8, round_spp=4, integrator=aov)


@pytest.fixture(scope="module")
def plain() -> Accumulation:
    """Three rounds without a filter, of which the last is smaller."""
    return last(box(size=5), spp=9, round_spp=4)


@pytest.fixture(scope="module")
def tiled() -> Accumulation:
    """Six rounds over tiles, of which the last is smaller."""
    return last(box(size=20), spp=22, round_spp=4, adaptive=True)


def rewritten(path: Path, **entries: object) -> None:
    """Change the header of a file, with the right checksum."""
    kind, _, data = path.read_bytes().split(b"\n", 2)
    line, memory = data.split(b"\n", 1)
    data = json.dumps({**json.loads(line), **entries}).encode() + b"\n" + memory
    path.write_bytes(kind + b"\n%08x\n" % zlib.crc32(data) + data)


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_what_is_read_is_what_was_written(tmp_path: Path, rfilter: str) -> None:
    written = last(box(rfilter=rfilter), spp=8, round_spp=4)
    written.save(tmp_path / "a.djpt")
    read = Accumulation.load(tmp_path / "a.djpt")
    require_equal(read, written)
    assert [path.name for path in tmp_path.iterdir()] == ["a.djpt"]


def require_equal(read: Accumulation, written: Accumulation) -> None:
    for name in ("software", "fingerprint", "channels", "round_spp", "schedule", "seeds", "counts", "size", "layout"):
        assert getattr(read, name) == getattr(written, name)
    for name in type(written).stored:
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))


@pytest.mark.parametrize("name", ["plain", "tiled"])
def test_the_rounds_before_a_smaller_one_are_kept(tmp_path: Path, name: str, request: pytest.FixtureRequest) -> None:
    written: Accumulation = request.getfixturevalue(name)
    written.save(tmp_path / "a.djpt")
    read = Accumulation.load(tmp_path / "a.djpt")
    require_equal(read, written)
    assert read.whole.counts == written.counts[:-1] != written.counts
    require_equal(read.whole, written.whole)
    assert read.whole.whole is read.whole


def test_damaged_files_are_refused(tmp_path: Path, found: Accumulation) -> None:
    path, chance = tmp_path / "a.djpt", random.Random(1)
    found.save(path)
    whole = path.read_bytes()
    cut = [whole[:n] for n in (0, 5, 20, 30, 100, len(whole) - 1)] + [whole + b"x"]
    for _ in range(50):
        place = chance.randrange(len(whole))
        cut.append(whole[:place] + bytes([whole[place] ^ 1 << chance.randrange(8)]) + whole[place + 1 :])
    for data in cut:
        path.write_bytes(data)
        with pytest.raises(FileError, match=r"a\.djpt"):
            Accumulation.load(path)


@pytest.mark.parametrize(
    ("entry", "value"),
    [
        ("size", [2**31, 2**31]),
        ("size", [5, -5]),
        ("size", 5),
        ("seeds", [1, 1]),
        ("seeds", [1.5]),
        ("seeds", None),
        ("seeds", []),
        ("seeds", [1]),
        ("seeds", [1, 2, 3]),
        ("counts", [4]),
        ("counts", [4, 0]),
        ("counts", [4, 5]),
        ("counts", [4, 4.0]),
        ("counts", None),
        ("software", 1),
        ("software", None),
        ("schedule", ["auto"]),
        ("sets", []),
        ("sets", {}),
        ("sets", [{"weighted": 1}]),
        ("sets", [{"weighted": True}, {"weighted": True}]),
        ("channels", [1, 2]),
        ("channels", []),
        ("fingerprint", ["a"]),
        ("round_spp", 0),
        ("constant", 99),
        ("constant", True),
    ],
)
def test_headers_that_lie_are_refused(tmp_path: Path, found: Accumulation, entry: str, value: object) -> None:
    """With the right checksum."""
    path = tmp_path / "a.djpt"
    found.save(path)
    rewritten(path, **{entry: value})
    with pytest.raises(FileError, match="its header is wrong"):
        Accumulation.load(path)


@pytest.mark.parametrize(
    ("name", "entries"),
    [
        ("found", {"seeds": [], "counts": []}),
        ("plain", {"seeds": [], "counts": []}),
        ("plain", {"seeds": [0, 1], "counts": [4, 1]}),
        ("plain", {"counts": [4, 4, 2]}),
        ("plain", {"counts": [4, 4, 4]}),
        ("plain", {"counts": [4, 3, 1]}),
        ("tiled", {"seeds": [], "counts": []}),
        ("tiled", {"seeds": [0, 1], "counts": [4, 2]}),
        ("tiled", {"seeds": list(range(9)), "counts": [*[4] * 8, 1]}),
    ],
)
def test_rounds_that_the_arrays_contradict_are_refused(
    tmp_path: Path, name: str, entries: dict[str, object], request: pytest.FixtureRequest
) -> None:
    path = tmp_path / "a.djpt"
    request.getfixturevalue(name).save(path)
    rewritten(path, **entries)
    with pytest.raises(FileError, match="its header is wrong"):
        Accumulation.load(path)


def test_other_files_are_refused(tmp_path: Path, found: Accumulation) -> None:
    path = tmp_path / "a.djpt"
    with pytest.raises(FileError, match="no such file"):
        Accumulation.load(path)
    path.write_text("hello")
    with pytest.raises(FileError, match="isn't an accumulation"):
        Accumulation.load(path)
    found.save(path)
    path.write_bytes(path.read_bytes().replace(b"accumulation 2\n", b"accumulation 1\n", 1))
    with pytest.raises(FileError, match="version 1; this djpt reads version 2"):
        Accumulation.load(path)
    with pytest.raises(DjptError):
        found.save(tmp_path)

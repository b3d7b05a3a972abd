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
from djpt.long_renders.accumulation import Accumulation
from djpt.long_renders.even import EvenAccumulation
from tests.long_renders.test_passes import box, last


@pytest.fixture(scope="module")
def found() -> Accumulation:
    """Two rounds with weights, and with channels that aren't filtered."""
    aov = djpt.load_dict({"type": "aov", "aovs": "d:depth", "image": {"type": "path"}})
    return last(box(rfilter="gaussian", size=5), spp=8, round_spp=4, integrator=aov)


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_what_is_read_is_what_was_written(tmp_path: Path, rfilter: str) -> None:
    written = last(box(rfilter=rfilter), spp=8, round_spp=4)
    written.save(tmp_path / "a.djpt")
    read = Accumulation.load(tmp_path / "a.djpt")
    for name in ("fingerprint", "channels", "round_spp", "seeds", "spp", "size"):
        assert getattr(read, name) == getattr(written, name)
    for name in EvenAccumulation.stored:
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
    assert [path.name for path in tmp_path.iterdir()] == ["a.djpt"]


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
    kind, _, data = path.read_bytes().split(b"\n", 2)
    line, memory = data.split(b"\n", 1)
    data = json.dumps({**json.loads(line), entry: value}).encode() + b"\n" + memory
    path.write_bytes(kind + b"\n%08x\n" % zlib.crc32(data) + data)
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
    path.write_bytes(path.read_bytes().replace(b"accumulation 1\n", b"accumulation 2\n", 1))
    with pytest.raises(FileError, match="version 2; this djpt reads version 1"):
        Accumulation.load(path)
    with pytest.raises(DjptError):
        found.save(tmp_path)

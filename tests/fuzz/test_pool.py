"""What the process that runs cases is blamed for: not for a busy machine, nor for large files of a case."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from tests.fuzz.cases import Case
from tests.fuzz.mutations import MOST_BYTES, line
from tests.fuzz.pool import Pool
from tests.fuzz.worker import MOST_WRITTEN

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the limits are those of Unix")


@pytest.fixture(scope="module")
def pool() -> Iterator[Pool]:
    with Pool(seconds=1, wall=60) as made:
        yield made


def test_waiting_takes_no_processor_time(pool: Pool) -> None:
    assert pool.run(Case("import time\ntime.sleep(3)")).outcome == "fine"


def test_time_is_that_of_one_case(pool: Pool) -> None:
    """A process has used more than the time of a case after some."""
    busy = "import time\nend = time.process_time() + 0.4\nwhile time.process_time() < end: pass"
    assert [pool.run(Case(busy)).outcome for _ in range(4)] == ["fine"] * 4


@pytest.mark.slow
def test_loops_without_end_hang(pool: Pool) -> None:
    verdict = pool.run(Case("while True: pass"))
    assert (verdict.outcome, verdict.error) == ("hung", "")
    assert pool.run(Case("1 + 1")).outcome == "fine"


@pytest.mark.slow
def test_waiting_forever_hangs() -> None:
    with Pool(wall=20) as impatient:
        verdict = impatient.run(Case("import threading\nthreading.Event().wait()"))
    assert (verdict.outcome, verdict.error) == ("hung", "by the clock")


@pytest.mark.slow
def test_programs_write_no_large_files(pool: Pool) -> None:
    write = "import os\nos.truncate(os.open('large', os.O_CREAT | os.O_RDWR), {size})"
    assert pool.run(Case(write.format(size=MOST_WRITTEN))).outcome == "fine"
    refused = pool.run(Case(write.format(size=MOST_WRITTEN + 1)))
    assert (refused.outcome, refused.error) == ("foreign", "OSError")


@pytest.mark.slow
def test_files_of_cases_may_be_large(pool: Pool) -> None:
    assert pool.run(Case("", {"large": bytes(MOST_WRITTEN + 1)})).outcome == "fine"


@pytest.mark.slow
def test_repeated_lines_have_bounds() -> None:
    data = bytes(1000)
    for _ in range(4):
        data = line(data, 0, 2)
    assert len(data) <= MOST_BYTES

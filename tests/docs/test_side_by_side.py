"""`make test` ends whatever dies: how files are given to processes, played with processes that only take notes."""

from __future__ import annotations

import pytest

pytest.importorskip("xdist")

from tests.kit.scheduling import FileScheduling

TESTS = [f"{file}.py::test_{k}" for file, count in (("a", 3), ("b", 3), ("c", 1), ("d", 2)) for k in range(count)]


class Process:
    """What the scheduler knows of a process of tests, and what it was given to do."""

    def __init__(self) -> None:
        self.given: list[str] = []
        self.shutting_down = False
        self.gateway, self.id = self, "process"

    def send_runtest_some(self, numbers: list[int]) -> None:
        self.given += [TESTS[number] for number in numbers]

    def shutdown(self) -> None:
        self.shutting_down = True

    @property
    def waits(self) -> bool:
        """A process begins a test when it knows the next one, or that there is none."""
        return len(self.given) < 2 and not self.shutting_down


@pytest.fixture
def scheduling(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> FileScheduling:
    monkeypatch.setattr(request.config.option, "tx", ["popen", "popen"], raising=False)
    monkeypatch.setattr(request.config.option, "loadscopereorder", False, raising=False)
    return FileScheduling(request.config)


def joined(scheduling: FileScheduling) -> Process:
    process = Process()
    scheduling.add_node(process)
    scheduling.add_node_collection(process, TESTS)
    return process


def run(scheduling: FileScheduling, process: Process, count: int) -> list[str]:
    """Let a process do some of what it was given."""
    done, process.given[:count] = process.given[:count], []
    for test in done:
        scheduling.mark_test_complete(process, TESTS.index(test))
    return done


def everything(scheduling: FileScheduling, process: Process) -> list[str]:
    """Let a process do all that it is given; it must never wait for more while there is something to do."""
    done: list[str] = []
    while process.given:
        assert not process.waits or scheduling.tests_finished
        done += run(scheduling, process, 1)
    return done


@pytest.mark.parametrize("survived", range(3))
def test_a_test_that_ends_its_process_fails_once(scheduling: FileScheduling, survived: int) -> None:
    """The next process goes on with the test after it, though the other one has finished and takes no more."""
    first, second = joined(scheduling), joined(scheduling)
    scheduling.schedule()
    assert first.given[:3] == TESTS[:3]
    done = run(scheduling, first, survived)
    done += everything(scheduling, second)
    assert second.shutting_down
    assert scheduling.remove_node(first) == TESTS[survived]
    third = joined(scheduling)
    scheduling.schedule()
    done += everything(scheduling, third)
    assert sorted(done) == sorted({*TESTS} - {TESTS[survived]})
    assert scheduling.tests_finished


def test_a_process_that_still_collects_is_given_nothing(scheduling: FileScheduling) -> None:
    first, second = joined(scheduling), joined(scheduling)
    scheduling.schedule()
    scheduling.remove_node(first)
    third = Process()
    scheduling.add_node(third)
    scheduling.remove_node(second)
    assert third.given == []

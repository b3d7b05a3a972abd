"""The log of scripts."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import djpt
from djpt.errors import DjptError

Level = djpt.LogLevel


class Collector(djpt.Appender):
    def __init__(self) -> None:
        self.lines: list[str] = []

    def append(self, level: djpt.LogLevel, text: str) -> None:
        self.lines.append(text)


class Plain(djpt.Formatter):
    def format(self, level: djpt.LogLevel, cname: str | None, fname: str, line: int, msg: str) -> str:
        return f"{int(level)} {msg}"


@pytest.fixture
def collector() -> Iterator[Collector]:
    before, made = djpt.logger(), Collector()
    djpt.set_logger(djpt.Logger(Level.Info))
    djpt.logger().set_formatter(Plain())
    djpt.logger().add_appender(made)
    yield made
    djpt.set_logger(before)


def test_messages_below_the_level_are_dropped(collector: Collector) -> None:
    djpt.Log(Level.Debug, "dropped")
    djpt.Log(Level.Info, "shown")
    djpt.set_log_level(Level.Warn)
    djpt.Log(Level.Info, "dropped")
    assert collector.lines == ["200 test_messages_below_the_level_are_dropped(): shown"]
    assert djpt.log_level() == djpt.Thread.thread().logger().log_level() == Level.Warn


def test_errors_are_raised(collector: Collector) -> None:
    with pytest.raises(DjptError, match=r"\[test_log.py:\d+\] test_errors_are_raised\(\): it broke"):
        djpt.Log(Level.Error, "it broke")
    djpt.logger().set_error_level(Level.Warn)
    with pytest.raises(RuntimeError):
        djpt.Log(Level.Warn, "it broke")
    assert collector.lines == []


def test_lines_go_to_a_file(tmp_path: object, collector: Collector) -> None:
    logger = djpt.logger()
    logger.set_formatter(djpt.DefaultFormatter())
    logger.remove_appender(collector)
    logger.add_appender(djpt.StreamAppender(f"{tmp_path}/log.txt"))
    djpt.Log(Level.Warn, "look here")
    assert logger.read_log().endswith("test_lines_go_to_a_file(): look here\n")
    assert "WARN" in logger.read_log() and "[test_log.py:" in logger.read_log()
    logger.clear_appenders()
    assert logger.appender_count() == 0


def test_the_levels_are_mitsubas() -> None:
    mi = pytest.importorskip("mitsuba")
    assert {m.name: m.value for m in Level} == {name: m.value for name, m in mi.LogLevel.__members__.items()}

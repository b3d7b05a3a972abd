"""The log that scripts write to: levels, what is shown and where, as in Mitsuba.

djpt itself reports through Python's `warnings`, which this log doesn't filter.
"""

from __future__ import annotations

import enum
import inspect
import sys
import time
from pathlib import Path

from djpt.core.forms import accessors
from djpt.description.files import file_resolver, set_file_resolver
from djpt.errors import DjptError

__all__ = [
    "Appender",
    "DefaultFormatter",
    "Formatter",
    "Log",
    "LogLevel",
    "Logger",
    "StreamAppender",
    "Thread",
    "log_level",
    "logger",
    "set_log_level",
    "set_logger",
]


class LogLevel(enum.IntEnum):
    """The severity of a message; the numbers are Mitsuba's."""

    Trace = 0
    Debug = 100
    Info = 200
    Warn = 300
    Error = 400


class Formatter:
    """The base class of formatters, which turn messages into lines; scripts override `format`."""

    def format(self, level: LogLevel, cname: str | None, fname: str, line: int, msg: str) -> str:
        """The text of a message.

        Args:
            level: its severity.
            cname: the class that issued it, if any.
            fname: the file that issued it.
            line: the line in that file.
            msg: its text.
        """
        raise NotImplementedError(f"{type(self).__name__}.format")


class DefaultFormatter(Formatter):
    """The time, the level, the place and the message."""

    def __init__(self) -> None:
        self._date = self._thread = self._log_level = self._class = True

    has_date, set_has_date = accessors("_date", "Whether a line begins with date and time.")
    has_thread, set_has_thread = accessors("_thread", "Accepted from scripts, no effect.")
    has_log_level, set_has_log_level = accessors("_log_level", "Whether lines name the level.")
    has_class, set_has_class = accessors("_class", "Whether lines name the class, or the file without one.")

    def format(self, level: LogLevel, cname: str | None, fname: str, line: int, msg: str) -> str:
        date = time.strftime("%Y-%m-%d %H:%M:%S") if self.has_date() else ""
        name = f"{LogLevel(level).name.upper():5}" if self.has_log_level() else ""
        place = f"[{cname or f'{Path(fname).name}:{line}'}]" if self.has_class() else ""
        return " ".join(part for part in (date, name, place, msg) if part)


class Appender:
    """The base class of destinations of messages; scripts override `append`."""

    def append(self, level: LogLevel, text: str) -> None:
        """Receive a message."""
        raise NotImplementedError(f"{type(self).__name__}.append")

    def log_progress(self, progress: float, name: str, formatted: str, eta: str, ptr: object = None) -> None:
        """Receive the progress of `name`, from 0 to 1; does nothing unless overridden."""


class StreamAppender(Appender):
    """A destination in a file, or in stderr if no name is given.

    Raises:
        OSError: the file can't be written.
    """

    def __init__(self, filename: str = "", /) -> None:
        self._file = Path(filename) if filename else None
        if self._file is not None:
            self._file.write_text("")

    def logs_to_file(self) -> bool:
        """Whether the destination is a file."""
        return self._file is not None

    def read_log(self) -> str:
        """The contents of the file.

        Raises:
            DjptError: the destination is stderr.
        """
        if self._file is None:
            raise DjptError("StreamAppender.read_log: these messages aren't kept: they go to stderr")
        return self._file.read_text()

    def append(self, level: LogLevel, text: str) -> None:
        if self._file is None:
            if sys.stderr is not None:  # a process may have none
                print(text, file=sys.stderr)
        else:
            with self._file.open("a") as file:
                file.write(text + "\n")


class Logger:
    """Passes messages from its level on to its appenders; those from its error level on become errors."""

    def __init__(self, level: LogLevel = LogLevel.Warn, /) -> None:
        self._level, self._error_level = level, LogLevel.Error
        self._formatter: Formatter = DefaultFormatter()
        self._appenders: list[Appender] = []

    log_level, set_log_level = accessors("_level", "The lowest level that is shown.", LogLevel)
    error_level, set_error_level = accessors("_error_level", "The level from which messages are errors.", LogLevel)
    formatter, set_formatter = accessors("_formatter", "The formatter of the lines.", lambda formatter: formatter)

    def add_appender(self, appender: Appender, /) -> None:
        """Add a destination."""
        self._appenders.append(appender)

    def remove_appender(self, appender: Appender, /) -> None:
        """Remove a destination."""
        self._appenders.remove(appender)

    def clear_appenders(self) -> None:
        """Remove all destinations."""
        self._appenders.clear()

    def appender_count(self) -> int:
        """The number of destinations."""
        return len(self._appenders)

    def appender(self, index: int, /) -> Appender:
        """One of the destinations, by its number."""
        return self._appenders[index]

    def log_progress(self, progress: float, name: str, formatted: str, eta: str, ptr: object = None) -> None:
        """Report the progress of `name` to all appenders."""
        for appender in self._appenders:
            appender.log_progress(progress, name, formatted, eta, ptr)

    def read_log(self) -> str:
        """The log of the first appender that writes to a file.

        Raises:
            DjptError: there is none.
        """
        for appender in self._appenders:
            if isinstance(appender, StreamAppender) and appender.logs_to_file():
                return appender.read_log()
        raise DjptError("Logger.read_log: no appender writes to a file")

    def log(self, level: LogLevel, msg: str, cname: str | None = None, fname: str = "", line: int = 0) -> None:
        """Log a message: see `Log`."""
        if level >= self._error_level:
            raise DjptError(f"[{Path(fname).name}:{line}] {msg}")
        if level >= self._level:
            text = self._formatter.format(level, cname, fname, line, msg)
            for appender in list(self._appenders):
                appender.append(level, text)


# Mitsuba's logger of the process, which scripts may replace.
_logger = Logger()
_logger.add_appender(StreamAppender())


def logger() -> Logger:
    """The logger of this process."""
    return _logger


def set_logger(logger: Logger) -> None:
    """Replace the logger of this process."""
    global _logger
    _logger = logger


def log_level() -> LogLevel:
    """The lowest level that is shown."""
    return _logger.log_level()


def set_log_level(level: LogLevel, /) -> None:
    """Set the lowest level that is shown."""
    _logger.set_log_level(level)


def Log(level: LogLevel, msg: str) -> None:
    """Log a message, with the name of the calling function.

    Raises:
        DjptError: the level is `LogLevel.Error`.
    """
    caller = inspect.stack()[1]
    name = caller.function if caller.function.startswith("<") else f"{caller.function}()"
    _logger.log(level, f"{name}: {msg}", None, caller.filename, caller.lineno)


class Thread:
    """The process, as scripts for older versions of Mitsuba address it: ``Thread.thread().file_resolver()``."""

    file_resolver = staticmethod(file_resolver)
    set_file_resolver = staticmethod(set_file_resolver)
    logger = staticmethod(logger)
    set_logger = staticmethod(set_logger)

    @staticmethod
    def thread() -> Thread:
        """The calling thread: all share one resolver and one logger."""
        return Thread()

    @staticmethod
    def wait_for_tasks() -> None:
        """Return at once: files are complete when the call that writes them returns."""

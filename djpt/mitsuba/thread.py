"""Mitsuba's former places of the file resolver and the logger."""

from __future__ import annotations

from djpt.description.files import FileResolver, file_resolver, set_file_resolver
from djpt.mitsuba.log import Logger, logger, set_logger

__all__ = ["Thread"]


class Thread:
    """The process, as scripts for older versions of Mitsuba address it: ``Thread.thread().file_resolver()``."""

    @staticmethod
    def thread() -> Thread:
        """The calling thread: all share one resolver and one logger."""
        return Thread()

    @staticmethod
    def file_resolver() -> FileResolver:
        """`djpt.file_resolver`."""
        return file_resolver()

    @staticmethod
    def set_file_resolver(resolver: FileResolver, /) -> None:
        """`djpt.set_file_resolver`."""
        set_file_resolver(resolver)

    @staticmethod
    def logger() -> Logger:
        """`djpt.logger`."""
        return logger()

    @staticmethod
    def set_logger(logger: Logger) -> None:
        """`djpt.set_logger`."""
        set_logger(logger)

    @staticmethod
    def wait_for_tasks() -> None:
        """Return at once: files are complete when the call that writes them returns."""

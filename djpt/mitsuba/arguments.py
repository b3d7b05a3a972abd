"""Command lines of scripts: `ArgParser`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, overload

from djpt.errors import DjptError, near_miss

__all__ = ["ArgParser"]


class Argument:
    """One option: how often it was given, and its values."""

    def __init__(self, prefixes: Sequence[str], extra: bool, values: list[str] | None = None) -> None:
        self.prefixes = tuple(prefixes)
        self._extra = extra
        self._values = [] if values is None else values

    def __bool__(self) -> bool:
        return bool(self._values)

    def extra(self) -> bool:
        """Whether the option has a value."""
        return self._extra

    def count(self) -> int:
        """How often it was given."""
        return len(self._values)

    def next(self) -> Argument:
        """The same option from its second use on."""
        return Argument(self.prefixes, self._extra, self._values[1:])

    def as_string(self) -> str:
        """The first value.

        Raises:
            DjptError: the option wasn't given.
        """
        if not self._values:
            raise DjptError(f"the option {self} wasn't given")
        return self._values[0]

    def as_int(self) -> int:
        """The first value as a whole number; raises `DjptError` if it is none."""
        try:
            return int(self.as_string())
        except ValueError:
            raise DjptError(f"the option {self} needs a whole number, found '{self.as_string()}'") from None

    def as_float(self) -> float:
        """The first value as a number; raises `DjptError` if it is none."""
        try:
            return float(self.as_string())
        except ValueError:
            raise DjptError(f"the option {self} needs a number, found '{self.as_string()}'") from None

    def __str__(self) -> str:
        return "/".join(prefix or "(without a name)" for prefix in self.prefixes)


class ArgParser:
    """Options of one letter (``-a``, ``-abc``, ``-f0.25``) and of several (``--int 34``)."""

    Arg = Argument

    def __init__(self) -> None:
        self._args: list[Argument] = []
        self._executable = ""

    @overload
    def add(self, prefix: str, extra: bool = False) -> Argument: ...
    @overload
    def add(self, prefixes: Iterable[str], extra: bool = False) -> Argument: ...

    def add(  # type: ignore[misc]  # the overloads name their first argument differently
        self, prefix: Any = None, extra: bool = False, *, prefixes: Any = None
    ) -> Argument:
        """Declare an option.

        Args:
            prefix: its name; the empty name takes what belongs to no option.
            prefixes: its names, in place of one.
            extra: whether it has a value.
        """
        names = prefix if prefixes is None else prefixes
        argument = Argument([names] if isinstance(names, str) else list(names), extra)
        self._args.append(argument)
        return argument

    def parse(self, arguments: Sequence[str], /) -> None:
        """Read a command line, whose first word is the program.

        Raises:
            DjptError: an unknown option, or one without its value.
        """
        words = list(arguments)
        self._executable = words.pop(0) if words else ""
        for argument in self._args:
            argument._values.clear()
        while words:
            word = words.pop(0)
            if word.startswith("--"):
                self._take(self._find(word), word, words)
            elif word.startswith("-") and len(word) > 1:
                self._short(word[1:], words)
            else:
                self._find("")._values.append(word)

    def executable_name(self) -> str:
        """The first word of the command line."""
        return self._executable

    def _short(self, letters: str, words: list[str]) -> None:
        """Read options of one letter; what follows one with a value is its value."""
        while letters:
            argument, rest = self._find(f"-{letters[0]}"), letters[1:]
            if argument.extra() and rest:
                argument._values.append(rest)
                return
            self._take(argument, f"-{letters[0]}", words)
            letters = rest

    def _take(self, argument: Argument, word: str, words: list[str]) -> None:
        if argument.extra() and not words:
            raise DjptError(f"the option {word} needs a value")
        argument._values.append(words.pop(0) if argument.extra() else word)

    def _find(self, prefix: str) -> Argument:
        found = next((argument for argument in self._args if prefix in argument.prefixes), None)
        if found is None:
            named = (str(argument) for argument in self._args if any(argument.prefixes))
            raise DjptError(f"unknown argument '{prefix}'{near_miss(prefix, named)}")
        return found

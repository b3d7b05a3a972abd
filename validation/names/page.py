"""The page of the documentation that lists Mitsuba's names, and reading it back."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable

from djpt.validation.names.compare import Finding, Verdict
from djpt.validation.report import read_beside

__all__ = ["counts", "read_names", "render_page", "share"]

HERE = "## Here"
LINE = re.compile(r"^\* `([\w.]+)`: (.*)$")


def counts(found: Iterable[Finding]) -> Counter[Verdict]:
    """The number of names with each verdict."""
    return Counter(f.verdict for f in found)


def share(number: Counter[Verdict]) -> float:
    """The share of names that are here, among those that aren't left out."""
    asked_for = number.total() - number[Verdict.EXCLUDED]
    return number[Verdict.HERE] / asked_for if asked_for else 1.0


def render_page(found: list[Finding]) -> str:
    """The page in Markdown."""
    different = [f"* `{f.name.path}`: {f.note}" for f in found if f.verdict is Verdict.DIFFERENT]
    lines = [read_beside(__file__, "head.txt"), *summary(found), *exclusions(found), "## Different", "", *different, ""]
    lines += ["## Absent", "", *by_owner(found, Verdict.ABSENT), "", HERE, "", *by_owner(found, Verdict.HERE)]
    return "\n".join(lines) + "\n"


def summary(found: list[Finding]) -> list[str]:
    """The numbers by kind of name."""
    lines = ["| | here | different | absent | left out | share here |", "|---|---|---|---|---|---|"]
    kinds = {
        "modules": ("module",),
        "classes and their constructors": ("class",),
        "types of numbers and arrays": ("array type",),
        "functions": ("function",),
        "methods": ("method",),
        "attributes": ("property",),
        "members of enumerations": ("member",),
        "constants": ("constant",),
    }
    rows = {title: [f for f in found if f.name.kind in chosen] for title, chosen in kinds.items()}
    for title, row in [*rows.items(), ("**all**", found)]:
        n = counts(row)
        columns = [n[Verdict.HERE], n[Verdict.DIFFERENT], n[Verdict.ABSENT], n[Verdict.EXCLUDED]]
        lines.append(f"| {title} | {' | '.join(map(str, columns))} | {100 * share(n):.1f} % |")
    return [*lines, "", "The share is that of the names that aren't left out.", ""]


def exclusions(found: list[Finding]) -> list[str]:
    """The names that are left out, by reason."""
    families = defaultdict(list)
    for f in found:
        if f.verdict is Verdict.EXCLUDED:
            families[f.note].append(f)
    lines = ["## Left out", ""]
    for why, family in families.items():
        lines += [f"{why}", f": {len(family)}: {names_of(family)}", ""]
    return lines


def by_owner(found: list[Finding], verdict: Verdict) -> list[str]:
    """One line of names per class or module; `mitsuba` stands for the module itself."""
    owners = defaultdict(list)
    for f in found:
        if f.verdict is verdict:
            owners[f.name.owner or "mitsuba"].append(f.name.path.rpartition(".")[2])
    return [f"* `{owner}`: {' '.join(names)}" for owner, names in owners.items()]


def names_of(family: list[Finding]) -> str:
    """The names of a family; members of a class that is in it itself go without saying."""
    paths = [f.name.path for f in family]
    return ", ".join(f"`{path}`" for path in paths if path.rpartition(".")[0] not in paths)


def read_names(page: str) -> list[str]:
    """The names that a page lists as here."""
    found = (LINE.match(line) for line in page.partition(HERE)[2].splitlines())
    lines = [(match[1], match[2].split()) for match in found if match]
    return [name if owner == "mitsuba" else f"{owner}.{name}" for owner, names in lines for name in names]

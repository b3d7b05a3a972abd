"""Write docs/public-scenes.md: ``python public_scenes.py RESULTS.json...``, files of ``djpt benchmarks --json``.

The scenes are those of https://github.com/mitsuba-renderer/mitsuba-data; several files, from one machine, are put
together. A scene that several measure counts as the last one says.
"""

from __future__ import annotations

import json
import statistics
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

PAGE = Path(__file__).resolve().parent.parent / "docs" / "public-scenes.md"

GROUPS = {
    "materials on spheres (tests)": ("bsdf_spheres/",),
    "participating media (tests)": ("participating_media/",),
    "other tests": ("tests/",),
    "materials (documentation)": ("scenes/bsdf_",),
    "other documentation": ("docs/",),
    "complete scenes": ("scenes/",),
}
"""Titles, and what the names of a group's scenes contain; a scene belongs to the first that fits."""

LIMIT = 0.99
"""Scenes with fewer equal pixels are listed."""


def group_of(row: dict[str, Any]) -> str:
    """The group of a scene."""
    return next((title for title, parts in GROUPS.items() if any(part in row["name"] for part in parts)), "others")


def quantile(values: Sequence[float], share: float) -> float:
    """The value below which a share of the values lies, interpolated."""
    ordered = sorted(values)
    place = share * (len(ordered) - 1)
    low = int(place)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (place - low) * (ordered[high] - ordered[low])


def page(machine: dict[str, Any], what: str, rows: list[dict[str, Any]]) -> Iterator[str]:
    """The lines of the page."""
    shown = [row for row in rows if row["ratio"] is not None]
    ratios = [row["ratio"] for row in shown]
    slower = [ratio for ratio in ratios if ratio < 1]
    yield "# Public scenes"
    yield ""
    yield (
        "Mitsuba's time divided by djpt's for the scenes of Mitsuba's documentation and tests, "
        "[mitsuba-data](https://github.com/mitsuba-renderer/mitsuba-data), none of which was made for djpt. "
        "[Measuring speed](guides/benchmarks.md) explains the columns; "
        "`python benchmarks/public_scenes.py RESULTS.json` writes this page."
    )
    yield ""
    yield (
        f"{machine['cpu']}, {machine['vectors']}, {machine['cores']} cores, {machine['threads']} threads, "
        f"LLVM {machine['llvm']}; djpt {machine['djpt']}, Mitsuba {machine['mitsuba']}, Dr.Jit {machine['drjit']}. "
        f"{what[0].upper()}{what[1:]}."
    )
    yield ""
    yield "| scenes | number | image | 10 % | first image | equal pixels, median | slower than Mitsuba |"
    yield "|---|---|---|---|---|---|---|"
    groups = {title: [row for row in shown if group_of(row) == title] for title in (*GROUPS, "others")}
    for title, members in [*groups.items(), ("**all**", shown)]:
        if members:
            own = [row["ratio"] for row in members]
            first = statistics.geometric_mean(row["first_ratio"] for row in members)
            equal = statistics.median(row["equal"] for row in members if row["equal"] is not None)
            yield (
                f"| {title} | {len(members)} | {statistics.geometric_mean(own):.2f} | {quantile(own, 0.1):.2f} | "
                f"{first:.2f} | {equal:.2%} | {sum(ratio < 1 for ratio in own)} |"
            )
    yield ""
    yield (
        f"Image and first image: geometric means; 10 %: a tenth of the scenes has a smaller ratio. "
        f"{len(slower)} of {len(shown)} scenes are slower than in Mitsuba. A pixel of many samples counts as different "
        "if rounding has changed one path among them, which happens to most pixels where paths are long, as in media; "
        "means agree. In `hello`, Mitsuba adds up the light samples of `direct` where djpt takes their mean."
    )
    for title, members in groups.items():
        if members:
            yield from ("", f"## {title[0].upper()}{title[1:]}", "")
            yield "| scene | image | Mitsuba / djpt, ms | first image | first load | equal pixels |"
            yield "|---|---|---|---|---|---|"
            yield from map(line, sorted(members, key=lambda row: row["ratio"]))
    failed = [row for row in rows if row["ratio"] is None]
    if failed:
        yield from ("", "## Not rendered by both", "")
        yield from (f"* `{row['name']}`: {reason(row)}" for row in failed)


def line(row: dict[str, Any]) -> str:
    """The line of a scene."""
    ratio = f"{row['ratio']:.2f}" if row["ratio"] >= 1 else f"**{row['ratio']:.2f}**"
    theirs, ours = (1e3 * statistics.median(times) for times in zip(*row["image"], strict=True))
    equal = (
        "" if row["equal"] is None else f"{row['equal']:.2%}" if row["equal"] >= LIMIT else f"**{row['equal']:.2%}**"
    )
    name = row["name"].removesuffix(".xml")
    for folder in ("tests/", "docs/", "scenes/"):
        name = name.removeprefix(folder)
    name = name.replace("_", "\\_")
    more = f"{row['first_ratio']:.2f} | {row['load_ratio']:.2f} | {equal}"
    return f"| {name} | {ratio} | {theirs:.0f} / {ours:.0f} | {more} |"


def reason(row: dict[str, Any]) -> str:
    """Why a scene isn't compared."""
    words = "; ".join(f"{who}: {why}" for who, why in row["failures"].items())
    return " ".join(words.split())[:160]


def main() -> None:
    """Write the page from the files on the command line."""
    found = [json.loads(Path(name).read_text()) for name in sys.argv[1:]]
    if not found:
        sys.exit((__doc__ or "").split("\n")[0])
    rows = {row["name"]: row for results in found for row in results["rows"]}
    kept = [row for _, row in sorted(rows.items())]
    PAGE.write_text("\n".join(page(found[-1]["machine"], found[-1]["what"], kept)) + "\n")
    print(f"{PAGE}: {len(kept)} scenes")


if __name__ == "__main__":
    main()

"""The table of the benchmarks: a row per scene, and what the rows have in common."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

__all__ = ["HEADING", "RATIOS", "SceneRow", "line", "numbers", "summary"]

EQUAL = 0.99
"""Images of one seed agree if this share of their pixels does; rounding changes some paths."""


@dataclass
class SceneRow:
    """One scene in both renderers. Times are seconds, pairs of Mitsuba's and djpt's."""

    name: str
    load: tuple[float, float] | None = None
    """The first load in a process."""
    load_again: tuple[float, float] | None = None
    """The median of further loads."""
    first: tuple[float, float] | None = None
    """The first image, with an empty kernel cache."""
    image: list[tuple[float, float]] = field(default_factory=list)
    """Images in turns, kernels compiled."""
    equal: float | None = None
    """The share of pixels that agree at equal seeds."""
    bias: float | None = None
    """The relative difference of the means, and in standard errors of the difference."""
    bias_in_errors: float | None = None
    rmse: float | None = None
    """The root of the relative mean square difference."""
    failures: dict[str, str] = field(default_factory=dict)
    """Why a renderer has no image, by renderer."""
    more: dict[str, Any] = field(default_factory=dict)
    """What the table doesn't show: samples, shape of the image, times of kernels."""

    @classmethod
    def of(cls, name: str, found: dict[str, Any]) -> SceneRow:
        """The row that the results of `one_scene` make."""
        row = cls(name, failures=dict(found.get("failures", {})))
        for key in ("load", "load_again", "first"):
            times = found.get(key, {})
            if "mitsuba" in times and "djpt" in times:
                setattr(row, key, (times["mitsuba"], times["djpt"]))
        row.image = [(theirs, ours) for theirs, ours in found.get("image", [])]
        for key in ("equal", "bias", "bias_in_errors", "rmse"):
            setattr(row, key, found.get(key))
        row.more = {key: found[key] for key in ("spp", "shape", "optimize", "kernels", "first_kernels") if key in found}
        return row

    @property
    def ratio(self) -> float | None:
        """Mitsuba's time / djpt's for an image, the median of the pairs."""
        return statistics.median(a / b for a, b in self.image) if self.image else None

    @property
    def load_ratio(self) -> float | None:
        """Mitsuba's time / djpt's for the first load."""
        return self.load[0] / self.load[1] if self.load else None

    @property
    def load_again_ratio(self) -> float | None:
        """Mitsuba's time / djpt's for further loads."""
        return self.load_again[0] / self.load_again[1] if self.load_again else None

    @property
    def first_ratio(self) -> float | None:
        """Mitsuba's time / djpt's for the first image, without loading."""
        return self.first[0] / self.first[1] if self.first else None

    @property
    def differs(self) -> bool:
        """Whether images of one seed disagree by more than rounding."""
        return self.equal is not None and self.equal < EQUAL


RATIOS = {
    "image": "ratio",
    "first image": "first_ratio",
    "first load": "load_ratio",
    "further loads": "load_again_ratio",
}
"""What is compared, with the properties of rows that tell it."""


def numbers(row: SceneRow) -> dict[str, Any]:
    """A row for JSON."""
    ratios = {name: getattr(row, name) for name in RATIOS.values()}
    return {**asdict(row), **ratios}


# ---- text -------------------------------------------------------------------------------


COLUMNS: tuple[tuple[str, Callable[[SceneRow], str]], ...] = (
    ("image", lambda row: _number(row.ratio, "{:.2f}")),
    ("ms", lambda row: _times([statistics.median(t) for t in zip(*row.image, strict=True)] if row.image else None)),
    ("first", lambda row: _number(row.first_ratio, "{:.2f}")),
    ("ms", lambda row: _times(row.first)),
    ("load", lambda row: _number(row.load_ratio, "{:.2f}")),
    ("ms", lambda row: _times(row.load)),
    ("equal", lambda row: _number(row.equal, "{:.2%}")),
    ("bias", lambda row: _number(row.bias, "{:+.1e}")),
    ("RMSE", lambda row: _number(row.rmse, "{:.1e}")),
)

LAYOUT = "{:58} {:>6} {:>13} {:>6} {:>13} {:>6} {:>13} {:>8} {:>9} {:>8}"
HEADING = LAYOUT.format("scene", *(name for name, _ in COLUMNS))


def _number(value: float | None, form: str) -> str:
    return "" if value is None else form.format(value)


def _times(pair: Sequence[float] | None) -> str:
    return "" if pair is None else " / ".join(f"{1e3 * time:.0f}" for time in pair)


def line(row: SceneRow) -> str:
    """One line of the table."""
    text = LAYOUT.format(row.name, *(cell(row) for _, cell in COLUMNS)).rstrip()
    return text + "".join(f"\n    {who}: {why[:300]}" for who, why in row.failures.items())


def summary(rows: Sequence[SceneRow]) -> Iterator[str]:
    """What the rows have in common: quantiles, means, the slowest, those that differ, those that fail."""
    yield ""
    yield "Mitsuba / djpt      smallest     10 %     25 %   median     75 %     90 %  largest   geometric mean"
    for what, ratio in RATIOS.items():
        values = sorted(value for row in rows if (value := getattr(row, ratio)) is not None)
        if values:
            shares = " ".join(f"{_quantile(values, q):8.2f}" for q in (0, 0.1, 0.25, 0.5, 0.75, 0.9, 1))
            yield f"{what:19} {shares} {statistics.geometric_mean(values):16.2f}   ({len(values)} scenes)"

    shown = sorted((row for row in rows if row.image), key=lambda row: row.ratio or 0)
    if shown:
        slower = [row for row in shown if (row.ratio or 0) < 1]
        yield ""
        yield f"Slower than Mitsuba: {len(slower)} of {len(shown)}"
        for row in slower:
            yield f"  {row.ratio:5.2f}  {row.name}  ({_kernels(row)})"
    different = [row for row in rows if row.differs]
    equal = [row.equal for row in rows if row.equal is not None]
    if equal:
        yield ""
        yield f"Equal pixels at equal seeds: {statistics.median(equal):.2%} in the median scene"
        yield f"Below {EQUAL:.0%}: {len(different)}"
    for row in sorted(different, key=lambda row: row.equal or 0):
        yield (
            f"  {row.equal:7.2%}  {row.name}: bias {row.bias:+.1e} ({row.bias_in_errors:+.1f} standard errors), "
            f"RMSE {row.rmse:.1e}"
        )
    failed = [row for row in rows if row.failures]
    if failed:
        yield ""
        yield f"Not rendered by both: {len(failed)}"


def _quantile(values: Sequence[float], share: float) -> float:
    """The value below which a share of the sorted `values` lies, interpolated."""
    place = share * (len(values) - 1)
    low = int(place)
    high = min(low + 1, len(values) - 1)
    return values[low] + (place - low) * (values[high] - values[low])


def _kernels(row: SceneRow) -> str:
    found = row.more.get("kernels", {}).get("djpt")
    if not found:
        return ""
    return f"{1e3 * found['run']:.0f} of {1e3 * found['wall']:.0f} ms in {found['launches']} kernels"

"""The gain of each idea behind djpt's speed: the Cornell box with one of them taken away.

    python benchmarks/ablations.py [--spp N] [--pairs N]

Each line is the time without the idea divided by the time with it, median of interleaved pairs
(smallest, largest). The images stay the same. Reaches into djpt's internals; not an example.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import statistics
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any
from unittest.mock import patch

from versus_mitsuba import cornell_box, seconds

from djpt.core import lookup
from djpt.geometry import unrolled
from djpt.shapes import axes

Render = Callable[[int], Any]


def renderer(spp: int, **options: Any) -> Render:
    """A function of the seed that renders a scene of its own."""
    loaded = djpt.load_dict(cornell_box(djpt, "box"))
    return lambda seed: djpt.render(loaded, spp=spp, seed=seed, **options)


@contextmanager
def no_select_chains() -> Iterator[None]:
    """Gather all tables from memory."""
    with patch.object(lookup, "MAX_CHAIN", 1):
        yield


@contextmanager
def no_shared_axes() -> Iterator[None]:
    """Give every plane and slab axes of its own, known as values only."""
    with patch.object(axes, "ALIGNED", -1.0):
        yield


@contextmanager
def no_hull_culling() -> Iterator[None]:
    """Test shadow rays against all shapes."""
    with patch.object(unrolled.Unrolled, "_is_hull", lambda *_: False):
        yield


CASES: list[tuple[str, Callable[[], AbstractContextManager[None]], dict[str, Any]]] = [
    ("path regeneration (flat against wave)", nullcontext, {"schedule": "wave"}),
    ("select chains instead of gathers", no_select_chains, {}),
    ("shared and coordinate axes", no_shared_axes, {}),
    ("hull culling of shadow rays", no_hull_culling, {}),
]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--pairs", type=int, default=7)
    arguments = parser.parse_args()
    for name, without, options in CASES:
        full = renderer(arguments.spp)
        with without():
            reduced = renderer(arguments.spp, **options)
            seconds(lambda r=reduced: r(0))
        seconds(lambda r=full: r(0))
        ratios = []
        for seed in range(1, arguments.pairs + 1):
            with without():
                slow = seconds(lambda r=reduced, s=seed: r(s))
            ratios.append(slow / seconds(lambda r=full, s=seed: r(s)))
        print(f"{name:42} {statistics.median(ratios):5.2f} ({min(ratios):.2f}, {max(ratios):.2f})", flush=True)


if __name__ == "__main__":
    main()

"""``python -m tests.fuzz``: attack djpt for a while, and save what it finds."""

from __future__ import annotations

import argparse
import random
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from tests.fuzz.families import FAMILIES, WEIGHTS
from tests.fuzz.pool import Pool
from tests.fuzz.rounds import Tally, attack

ROUND = 50
"""Cases of one round, all of one family."""


def main() -> int:
    """Run cases until time or cases are used up; 1 if there were findings."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=None, help="how long (default: until --cases have run)")
    parser.add_argument("--cases", type=int, default=None, help="how many (default: 1000, or until --minutes are over)")
    parser.add_argument("--seed", type=int, default=0, help="equal seeds give equal cases (default: 0)")
    parser.add_argument("--family", choices=list(FAMILIES), action="append", help="only these (default: all)")
    parser.add_argument("--out", type=Path, default=Path("build/fuzz"), help="for findings (default: build/fuzz)")
    parser.add_argument("--seconds", type=float, default=20, help="of processor time, then a case hangs (default: 20)")
    parser.add_argument("--memory", type=float, default=6, help="GiB that a process can address (default: 6)")
    chosen = parser.parse_args()
    most = chosen.cases or (1000 if chosen.minutes is None else sys.maxsize)
    end = time.monotonic() + 60 * (chosen.minutes or 1e9)
    families = chosen.family or list(FAMILIES)
    weights = [WEIGHTS[family] for family in families]
    rng = random.Random(chosen.seed)
    known: set[tuple[str, ...]] = set()
    tally: Tally = Tally()
    chosen.out.mkdir(parents=True, exist_ok=True)
    with Pool(chosen.seconds, memory=int(chosen.memory * 2**30)) as pool:
        while tally.total() < most and time.monotonic() < end:
            family, seed = rng.choices(families, weights)[0], rng.randrange(2**32)
            finding = attack(pool, family, seed, min(ROUND, most - tally.total()), known, tally)
            if finding is not None:
                folder = chosen.out / f"{len(known):03}-{family}-{finding.verdict.outcome.replace(' ', '-')}"
                finding.case.save(folder)
                (folder / "finding.txt").write_text(str(finding), encoding="utf-8", errors="backslashreplace")
                print(f"{folder}: {finding}\n", flush=True)
            elif sys.stderr.isatty():
                print(f"\r{tally.total()} cases, {len(known)} findings", end="", file=sys.stderr, flush=True)
            (chosen.out / "counts.txt").write_text("\n".join(rows(tally)) + "\n", encoding="utf-8")
    print(*rows(tally), f"{len(known)} kinds of findings", sep="\n")
    return 1 if known else 0


def rows(tally: Tally) -> Iterator[str]:
    """The numbers of cases: one line for each family, and the sums."""
    for family in FAMILIES:
        counts = {outcome: n for (name, outcome), n in sorted(tally.items()) if name == family}
        if counts:
            yield f"{family}: {sum(counts.values())} cases: {', '.join(f'{n} {name}' for name, n in counts.items())}"
    outcomes = Tally()
    for (_, outcome), n in tally.items():
        outcomes["", outcome] += n
    yield f"all: {tally.total()} cases: {', '.join(f'{n} {name}' for (_, name), n in sorted(outcomes.items()))}"


if __name__ == "__main__":
    sys.exit(main())

"""``python -m tests.fuzz``: attack djpt for a while, and save what it finds."""

from __future__ import annotations

import argparse
import random
import sys
import time
from collections import Counter
from pathlib import Path

from tests.fuzz.families import FAMILIES, WEIGHTS
from tests.fuzz.pool import Pool
from tests.fuzz.rounds import attack

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
    parser.add_argument("--seconds", type=float, default=20, help="a case that takes longer hangs (default: 20)")
    parser.add_argument("--memory", type=float, default=6, help="GiB that a process can address (default: 6)")
    chosen = parser.parse_args()
    most = chosen.cases or (1000 if chosen.minutes is None else sys.maxsize)
    end = time.monotonic() + 60 * (chosen.minutes or 1e9)
    families = chosen.family or list(FAMILIES)
    weights = [WEIGHTS[family] for family in families]
    rng = random.Random(chosen.seed)
    known: set[tuple[str, ...]] = set()
    ran: Counter[str] = Counter()
    with Pool(chosen.seconds, int(chosen.memory * 2**30)) as pool:
        while sum(ran.values()) < most and time.monotonic() < end:
            family, seed = rng.choices(families, weights)[0], rng.randrange(2**32)
            before = pool.counts.total()
            finding = attack(pool, family, seed, min(ROUND, most - sum(ran.values())), known)
            ran[family] += max(1, pool.counts.total() - before)
            if finding is not None:
                folder = chosen.out / f"{len(known):03}-{family}-{finding.verdict.outcome.replace(' ', '-')}"
                finding.case.save(folder)
                (folder / "finding.txt").write_text(str(finding), encoding="utf-8", errors="backslashreplace")
                print(f"{folder}: {finding}\n", flush=True)
            elif sys.stderr.isatty():
                print(f"\r{sum(ran.values())} cases, {len(known)} findings", end="", file=sys.stderr, flush=True)
        print(f"{sum(ran.values())} cases ({', '.join(f'{n} {name}' for name, n in sorted(ran.items()))})")
        print(f"{', '.join(f'{n} {name}' for name, n in sorted(pool.counts.items()))}; {len(known)} kinds of findings")
    return 1 if known else 0


if __name__ == "__main__":
    sys.exit(main())

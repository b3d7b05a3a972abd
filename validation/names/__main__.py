"""The command ``python -m djpt.validation.names``: the shares, and the page of the documentation."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path

import djpt
from djpt.validation.names.compare import Finding, Verdict, counts, findings, read_names, render_page, share

PAGE = Path(__file__).resolve().parents[2] / "docs" / "names.md"


def main() -> int:
    """Run the command; 1 if names that the page lists have gone."""
    parser = argparse.ArgumentParser(prog="python -m djpt.validation.names", description=__doc__)
    parser.add_argument("names", nargs="*", help="list what is different or absent among these, such as Ray3f")
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.name}, unless names have gone")
    parser.add_argument("--let-go", action="store_true", help="write the page even if names have gone")
    options = parser.parse_args()
    djpt.set_variant("llvm_ad_rgb")
    djpt.types  # noqa: B018  (LLVM is chosen before Mitsuba loads Dr.Jit)
    mitsuba = importlib.import_module("mitsuba")
    mitsuba.set_variant("llvm_ad_rgb")
    found = findings(mitsuba, djpt)
    for prefix in options.names:
        show(found, prefix)
    number = counts(found)
    print(", ".join(f"{number[v]} {v.value}" for v in Verdict) + f"; here: {100 * share(number):.1f} % of the rest")
    now = {f.name.path for f in found if f.verdict is Verdict.HERE}
    gone = [name for name in read_names(PAGE.read_text() if PAGE.exists() else "") if name not in now]
    if gone:
        print(f"gone: {', '.join(gone)}")
    if options.write and (options.let_go or not gone):
        PAGE.write_text(render_page(found))
        print(f"wrote {PAGE}")
        return 0
    return 1 if gone else 0


def show(found: list[Finding], prefix: str) -> None:
    """Print what isn't here of a class, a module or a name."""
    for f in found:
        if (f.name.path + ".").startswith(prefix + ".") and f.verdict is not Verdict.HERE:
            print(f"{f.verdict.value:10} {f.name.path:40} {f.note}")


if __name__ == "__main__":
    raise SystemExit(main())

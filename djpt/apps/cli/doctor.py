"""The command ``djpt doctor``: what was found on this machine, what was chosen and why, and what to do.

`examine` collects the findings, `print_report` shows them. The backend is tried in a
process of its own, so that even a library that aborts gives a finding. Works without Dr.Jit.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import signal
import subprocess
import sys
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import click

import djpt
from djpt.apps.cli.console import Command
from djpt.core.terminal import beneath, visible
from djpt.errors import BackendError
from djpt.jit.backends import VARIANTS, variant
from djpt.jit.llvm.finder import PATH_VARIABLE, SEARCH_VARIABLE, Search, libatomic_missing, search

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["Finding", "Report", "command", "examine", "print_report"]

Verdict = Literal["ok", "note", "problem"]

VARIABLE = "DJPT_RAY_QUERIES"
"""The environment variable of `djpt.geometry.engines`, which can't be imported where Dr.Jit doesn't load."""

_TRIAL = """
import json, sys
import djpt
from djpt.errors import BackendError
from djpt.jit.backends import load_backend
try:
    backend = load_backend()
except BackendError as error:
    print(json.dumps({"error": str(error)}))
    sys.exit()
import drjit as dr
total = dr.sum(dr.minimum(dr.arange(backend.Float, 8), 3.5))[0]
answer = {"total": total, "threads": dr.thread_count()}
if "llvm" in backend.__name__:
    from djpt.jit.llvm.lanes import instruction_set, lane_count
    answer["llvm"] = ".".join(map(str, dr.detail.llvm_version()))
    answer["lanes"], answer["instructions"] = lane_count(), instruction_set()
print(json.dumps(answer))
"""
_RAYS = """
import json
import djpt
from djpt.errors import DjptError
try:
    from djpt.geometry.bvh.calls.searches import SEARCHES, why_not
    from djpt.geometry.engines import chosen
    print(json.dumps({"chosen": chosen(), "why_not": {search: why_not(search) for search in SEARCHES}}))
except DjptError as error:
    print(json.dumps({"error": str(error)}))
"""
_TRIAL_TOTAL = 0 + 1 + 2 + 3 + 4 * 3.5


@dataclass(frozen=True)
class Finding:
    """One line of the report; `advice` says what to do, or gives the reason."""

    topic: str
    found: str
    verdict: Verdict = "ok"
    advice: str = ""


@dataclass(frozen=True)
class Report:
    """The findings of `examine`. `usable` tells whether djpt can render on this machine."""

    findings: tuple[Finding, ...]
    usable: bool

    def __getitem__(self, topic: str) -> Finding:
        """The finding about `topic`; KeyError if there is none."""
        for finding in self.findings:
            if finding.topic == topic:
                return finding
        raise KeyError(topic)


def examine() -> Report:
    """Examine the machine. Takes about two seconds; changes nothing and raises no `DjptError`."""
    libraries = search()
    trial = _trial()
    return Report(
        (
            Finding("djpt", f"{djpt.__version__} in {os.path.dirname(djpt.__file__)}"),
            Finding("Python", f"{platform.python_version()} in {sys.prefix}"),
            _processor(),
            _package("drjit", "needed"),
            _libatomic(),
            _llvm(libraries),
            _variant(),
            trial,
            *([_ray_queries()] if trial.verdict == "ok" else []),
            _package("mitsuba", "only for validation: pip install mitsuba==3.9.1"),
        ),
        usable=trial.verdict == "ok",
    )


def _processor() -> Finding:
    name = f"{platform.system()} {platform.machine()}, {os.cpu_count()} threads"
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            flags = next((line.split() for line in file if line.startswith("flags")), None)
    except OSError:
        flags = None
    if flags is None or platform.machine() != "x86_64":
        return Finding("Processor", name)
    known = [flag for flag in ("fma", "avx2", "avx512f") if flag in flags]
    if "fma" not in known:
        return Finding("Processor", name, "problem", "Dr.Jit's CPU backend needs the FMA instructions")
    return Finding("Processor", f"{name}, {' '.join(known)}")


def _package(name: str, purpose: str) -> Finding:
    try:
        return Finding(name, importlib.metadata.version(name))
    except importlib.metadata.PackageNotFoundError:
        return Finding(name, "not installed", "problem" if purpose == "needed" else "note", purpose)


def _libatomic() -> Finding:
    if libatomic_missing():
        advice = "sudo apt-get install -y libatomic1, or without root: python -m djpt.jit.llvm"
        return Finding("libatomic", "libatomic.so.1 is missing, Dr.Jit can't be imported without it", "problem", advice)
    return Finding("libatomic", "there" if sys.platform == "linux" else "not needed here")


def _llvm(libraries: Search) -> Finding:
    if libraries.chosen is None:
        needed = VARIANTS.get(os.environ.get("DJPT_VARIANT", ""), "llvm") == "llvm"
        return Finding("LLVM", "no usable library", "problem" if needed else "note", libraries.explain())
    if libraries.from_user:
        why = f"{PATH_VARIABLE} asks for it"
    elif libraries.folders:
        why = f"the best one in {SEARCH_VARIABLE}={os.pathsep.join(libraries.folders)}"
    else:
        why = "the newest tested version"
    passed_over = [*libraries.rejected, *libraries.spare]
    if passed_over:
        why += "; passed over:\n" + "\n".join(f"    {candidate}" for candidate in passed_over)
    return Finding("LLVM", str(libraries.chosen), "ok", why)


def _variant() -> Finding:
    source = "DJPT_VARIANT" if os.environ.get("DJPT_VARIANT") else "the default"
    try:
        return Finding("Variant", f"{variant()} ({source})")
    except BackendError as error:
        return Finding("Variant", os.environ.get("DJPT_VARIANT", ""), "problem", str(error))


def _answer(what: str, topic: str, code: str) -> dict[str, Any] | Finding:
    """The output of a program that tries something in another process, or its error."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    try:
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False, env=environment
        )
    except (OSError, subprocess.SubprocessError) as error:
        return Finding(topic, f"{what} could not be run", "problem", str(error))
    lines = done.stdout.strip().splitlines()
    if done.returncode or not lines:
        status = done.returncode
        how = f"signal {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"
        return Finding(topic, f"{what} ended with {how}", "problem", done.stderr.strip()[-1000:])
    answer: dict[str, Any] = json.loads(lines[-1])
    return answer


def _trial() -> Finding:
    """Run a small kernel in another process."""
    answer = _answer("a small kernel", "Trial", _TRIAL)
    if isinstance(answer, Finding):
        return answer
    if "error" in answer:
        return Finding("Trial", "a small kernel was not run", "problem", answer["error"])
    if answer["total"] != _TRIAL_TOTAL:
        return Finding("Trial", f"a small kernel computed {answer['total']}, not {_TRIAL_TOTAL}", "problem")
    return Finding("Trial", f"a small kernel ran{_width(answer)}, {answer['threads']} threads")


def _ray_queries() -> Finding:
    """Trace rays whose hits are known by compiled functions, in another process."""
    answer = _answer("a trial of ray queries", "Ray queries", _RAYS)
    if isinstance(answer, Finding):
        return replace(answer, advice=f"set {VARIABLE}=steps\n{answer.advice}".strip())
    if "error" in answer:
        return Finding("Ray queries", answer["error"], "problem")
    if answer["chosen"] == "rings":
        return Finding(
            "Ray queries", "rings: all rays of a packet side by side, by compiled functions that passed their test"
        )
    why = answer["why_not"]["rings"] or f"{VARIABLE}={os.environ.get(VARIABLE, '')}"
    if answer["chosen"] == "call":
        return Finding(
            "Ray queries", "one ray after the other, by compiled functions that passed their test", "note", why
        )
    why = answer["why_not"]["call"] or why
    return Finding("Ray queries", "by steps, which are slower on most machines", "note", why)


def _width(answer: dict[str, Any]) -> str:
    """The compiler and target of the kernel, such as `` on LLVM 19.1.7, 16 lanes (AVX-512)``."""
    if "llvm" not in answer:
        return ""
    instructions = f" ({answer['instructions']})" if answer["instructions"] else ""
    return f" on LLVM {answer['llvm']}, {answer['lanes']} lanes{instructions}"


def print_report(report: Report, console: Console | None = None) -> None:
    """Print the findings, the advice below each, and a closing line. `console`: a rich console, default stdout."""
    from rich.console import Console
    from rich.text import Text

    console = console or Console(file=beneath(sys.stdout), soft_wrap=True, highlight=False)
    marks = {"ok": ("ok", "green"), "note": ("--", "yellow"), "problem": ("!!", "bold red")}
    width = max(len(finding.topic) for finding in report.findings)
    said: set[str] = set()
    for finding in report.findings:
        mark, style = marks[finding.verdict]
        found = visible(finding.found, kept="\n")
        console.print(Text.assemble((mark, style), f"  {finding.topic:<{width}}  {found}"))
        if finding.advice and finding.advice not in said:
            said.add(finding.advice)
            for line in finding.advice.splitlines():
                console.print(Text(f"{'':{width + 6}}{visible(line)}", "" if finding.verdict == "problem" else "dim"))
    if report.usable:
        console.print(Text("djpt can render on this machine.", "green"))
    else:
        console.print(Text("djpt can't render on this machine yet: see the lines marked !!", "bold red"))


def main() -> int:
    """Run ``djpt doctor``: print the report, and return 0 if djpt can render here, else 3."""
    report = examine()
    print_report(report)
    return 0 if report.usable else 3


@click.command("doctor", cls=Command, renders=False)
def command() -> None:
    """Report what djpt found on this machine, and how to fix problems.

    Every choice is printed with its reason.
    """
    raise click.exceptions.Exit(main())

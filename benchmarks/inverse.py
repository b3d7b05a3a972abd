"""Problems of inverse rendering, each solved in Mitsuba as its authors solve it, and in djpt: the time to equal errors.

Mitsuba: path replay (or projective sampling, for what moves) and Adam. Each problem has three learning rates, and for
each error the fastest counts. djpt: Gauss-Newton steps, diagonal where all derivatives have one sign (`optimize`), else
damped and taken back (`least_squares`), with one setting for each problem. Both start from the same values, with the
same pictures, rendered by each renderer itself, and the same samples per pixel; `least_squares` begins with fewer and
ends with more, its derivatives of a cloud have four times as many, and those of a caustic half as many. Samples are
djpt's `sobol`, in Mitsuba those of its scenes, `independent`. For what moves it compares images on both sides
of each unknown, which need no projective sampling.

The error is the mean absolute difference from the true values, relative to that at the start. Seconds are those of the
processor, of the search alone: kernels are compiled before, and errors aren't timed. There is one thread, since threads
of Dr.Jit that wait for others keep the processor busy: beside other programs, small kernels would seem to take several
times as long as they do.

    python benchmarks/inverse.py --page docs/inverse.md

writes the page with its pictures.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import json
import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
from inverse_caustic import caustic
from inverse_scenes import Problem, environment, material, normals, paints, pose, roughness, texture, view, volume
from inverse_shape import shape

from djpt.apps.benchmarks.measuring import heading, machine
from djpt.apps.optimization import least_squares, optimize
from djpt.jit.llvm.gathers import gather_as_llvm_does
from djpt.validation.bridge import mitsuba_scene, to_mitsuba

PROBLEMS: dict[str, Callable[[], Problem]] = {
    "paints": paints,
    "texture": texture,
    "environment": environment,
    "pose": pose,
    "roughness": roughness,
    "normals": normals,
    "material": material,
    "view": view,
    "volume": volume,
    "shape": shape,
    "caustic": caustic,
}
TARGETS = (0.4, 0.2, 0.1)
"""The errors to be reached, relative to that at the start."""
LONGEST = 20.0
"""The processor's seconds after which one of Mitsuba's rates is given up."""
SEARCH = 2**20
"""The first seed of searches, beyond those of pictures."""


# ---- searches --------------------------------------------------------------------------------


@dataclass
class Course:
    """The errors of a search and the processor's seconds at which they were reached."""

    label: str
    points: list[tuple[float, float]] = field(default_factory=list)
    last: Any = None

    def seconds(self, error: float) -> float:
        """The time at which an error was first reached; infinite if it wasn't."""
        return next((t for t, e in self.points if e <= error), math.inf)

    @property
    def best(self) -> float:
        """The least error of all."""
        return min((e for _, e in self.points), default=1.0)


class Clock:
    """The processor's seconds, without the time in which errors are computed."""

    def __init__(self) -> None:
        self._spent, self._since = 0.0, time.process_time()

    def stop(self) -> float:
        """Stop, and return the time so far."""
        dr.sync_thread()
        self._spent += time.process_time() - self._since
        return self._spent

    def go(self) -> None:
        """Go on."""
        self._since = time.process_time()


@dataclass
class Renderer:
    """A problem's scene in djpt or in Mitsuba, with the picture."""

    module: Any
    problem: Problem
    scene: Any

    def __post_init__(self) -> None:
        self.params = self.module.traverse(self.scene)
        self.typed = getattr(self.module, self.problem.kind)
        self.target = self.picture(self.problem.truth, 512)

    def picture(self, x: np.ndarray, spp: int = 256) -> Any:
        """The picture at some values of the unknowns."""
        self.set(self.typed(x))
        image = self.image(spp=spp, seed=SEARCH - 1)
        return self.module.TensorXf(np.array(image))

    def image(self, **options: Any) -> Any:
        """The pictures of all sensors, side by side."""
        if self.module is djpt or self.problem.views == 1:
            return self.module.render(self.scene, **options)
        return dr.concat(
            [self.module.render(self.scene, sensor=k, **options) for k in range(self.problem.views)], axis=1
        )

    def set(self, x: Any) -> None:
        """Set the unknowns."""
        self.problem.apply(self.module, self.params, x)
        self.params.update()

    def error(self, x: Any) -> float:
        """The error of the unknowns, relative to that at the start."""
        truth, start, seen = self.problem.truth, self.problem.start, self.problem.seen
        found, wanted, begun = seen(np.array(x).reshape(truth.shape)), seen(truth), seen(start)
        return float(np.abs(found - wanted).mean() / np.abs(begun - wanted).mean())

    def adam(self, rate: float, steps: int, seconds: float = math.inf) -> Course:
        """Adam, given up after so many steps or seconds."""
        problem, course = self.problem, Course(f"Adam, rate {rate:g}")
        optimizer = djpt.ad.Adam(lr=rate, uniform=problem.uniform, params={"x": self.typed(problem.start)})
        clock = Clock()
        for step in range(steps):
            self.set(optimizer["x"])
            image = self.image(params=self.params, spp=problem.spp, seed=SEARCH + step)
            dr.backward(dr.mean(dr.square(image - self.target), axis=None))
            optimizer.step()
            optimizer["x"] = dr.clip(dr.detach(optimizer["x"]), *problem.bounds)
            dr.eval(optimizer["x"])
            spent = clock.stop()
            course.points.append((spent, self.error(optimizer["x"])))
            course.last = np.array(optimizer["x"])
            if course.best <= TARGETS[-1] or spent > seconds:
                break
            clock.go()
        return course

    def best(self, steps: int) -> Course:
        """djpt's search."""
        return self.gauss_newton(steps) if self.problem.method == "gauss_newton" else self.least_squares(steps)

    def gauss_newton(self, steps: int) -> Course:
        """`optimize` with Gauss-Newton steps."""
        problem, course = self.problem, Course("optimize, gauss_newton")
        self.set(self.typed(problem.start))
        (key,) = problem.keys
        clock = Clock()

        def seen(done: Any) -> bool:
            spent = clock.stop()
            course.points.append((spent, self.error(done.values[key])))
            course.last = np.array(done.values[key])
            clock.go()
            return course.best <= TARGETS[-1]

        optimize(
            self.scene,
            key,
            [self.target],
            optimizer="gauss_newton",
            spp=problem.spp,
            rate=lambda i: min(1.6, 8 / (i + 1)),
            iterations=steps,
            callback=seen,
            seed=5,
        )
        return course

    def least_squares(self, steps: int) -> Course:
        """Damped steps that are taken back."""
        problem, course = self.problem, Course("least_squares")
        clock = Clock()
        # Variables of this function, where `dr.freeze` finds their arrays.
        module, scene, target, apply, spp = self.module, self.scene, self.target, problem.apply, problem.spp
        spp, spp_grad = spp // problem.spp_divisor, problem.spp_derivatives

        def residual(x: Any, seed: Any) -> Any:
            params = module.traverse(scene)
            apply(module, params, x["x"])
            params.update()
            return module.render(scene, params, spp=spp, seed=seed, spp_grad=spp_grad) - target

        def seen(i: int, loss: float, x: Any) -> bool:
            spent = clock.stop()
            course.last = np.array(x["x"])
            course.points.append((spent, self.error(course.last)))
            clock.go()
            return course.best <= TARGETS[-1]

        least_squares(
            residual,
            {"x": self.typed(problem.start)},
            bounds={"x": problem.bounds},
            differences={"x": problem.differences},
            coarse=problem.coarse,
            images=4 * problem.spp_divisor**2,
            frozen=problem.frozen,
            iterations=steps,
            callback=seen,
            seed=5,
        )
        return course


def in_djpt(problem: Problem, sampler: str = "sobol") -> Any:
    """A scene in djpt, with one sensor for all views."""
    description = problem.scene(problem.size)
    if problem.differences and description["integrator"]["type"] == "direct_projective":
        description["integrator"] = {"type": "direct"}
    if problem.views > 1:
        views = {f"sensor{k}": description.pop(f"sensor{k}") for k in range(problem.views)}
        wide = {**views["sensor0"]["film"], "width": problem.views * problem.size}
        description["sensor"] = {"type": "batch", "film": wide, **views}
    description["sensor"] = {**description["sensor"], "sampler": {"type": sampler}}
    return djpt.load_dict(description)


def in_mitsuba(mi: Any, description: dict[str, Any]) -> Any:
    """A scene in Mitsuba."""
    with mitsuba_scene(None):
        return mi.load_dict(to_mitsuba(description))


@dataclass
class Result:
    """The courses of a problem, and the time to each error."""

    problem: Problem
    ours: Course
    theirs: list[Course]
    pictures: dict[str, np.ndarray]

    def ratios(self) -> list[tuple[float, str]]:
        """Mitsuba's best time / djpt's, by the errors, as numbers and in words.

        If Mitsuba never reached an error, the time until it was given up bounds the ratio; not a number if djpt didn't.
        """
        found = []
        for error in TARGETS:
            t, o = min(course.seconds(error) for course in self.theirs), self.ours.seconds(error)
            sign = "=" if math.isfinite(t) else ">"
            longest = max(course.points[-1][0] for course in self.theirs)
            value = min(t, longest) / o if math.isfinite(o) else math.nan
            found.append((value, f"{seconds(t)} / {seconds(o)}" + f" {sign} {value:.2g}" * math.isfinite(value)))
        return found

    def cells(self) -> list[str]:
        """Both times and their ratio, by the errors, in words."""
        return [words for _, words in self.ratios()]


def solve(mi: Any, problem: Problem) -> Result:
    """Solve a problem in both renderers."""
    ours = Renderer(djpt, problem, in_djpt(problem))
    theirs = Renderer(mi, problem, in_mitsuba(mi, problem.scene(problem.size)))
    ours.best(1)  # compiles
    mine = ours.best(problem.iterations)
    print(f"djpt: {', '.join(f'{t:.2f} s {e:.3f}' for t, e in mine.points)}", file=sys.stderr, flush=True)
    their_adam = gather_as_llvm_does()(theirs.adam)
    their_adam(problem.rates[0], 2)
    courses = list[Course]()
    # The middle first: it is often the fastest, and the others are given up when they take as long.
    for rate in (problem.rates[1], problem.rates[0], problem.rates[2]):
        fastest = min((course.seconds(TARGETS[-1]) for course in courses), default=LONGEST)
        courses.append(their_adam(rate, problem.steps, min(fastest, LONGEST)))
    last = mine.last if mine.last is not None else problem.start
    pictures = {
        "start": np.array(ours.picture(problem.start)),
        "djpt": np.array(ours.picture(last.reshape(problem.truth.shape))),
        "truth": np.array(ours.target),
    }
    return Result(problem, mine, courses, pictures)


# ---- the report ------------------------------------------------------------------------------


def seconds(value: float) -> str:
    """A time, or a dash."""
    return f"{value:.1f}" if math.isfinite(value) else "-"


def geometric_mean(values: list[float]) -> float:
    """The geometric mean of those that are numbers."""
    known = [value for value in values if math.isfinite(value)]
    return math.exp(np.mean(np.log(known))) if known else math.nan


def said(result: Result) -> str:
    """A problem's results as a line of text."""
    return f"{result.problem.name:<34}" + "".join(f"{cell:>24}" for cell in result.cells())


def page(results: list[Result], facts: str, folder: Path) -> str:
    """The page, whose pictures are written to a folder `images` beside it."""
    heads = "".join(f" {e:g} |" for e in TARGETS)
    lines = [
        "# Inverse problems, against Mitsuba",
        "",
        "`python benchmarks/inverse.py --page docs/inverse.md` writes this page. " + DESCRIBED,
        "",
        f"| seconds, Mitsuba / djpt = ratio, to an error of |{heads}",
        "|---|" + "---|" * len(TARGETS),
    ]
    for result in results:
        lines.append(f"| {result.problem.name} |" + "".join(f" {cell} |" for cell in result.cells()))
    means = [geometric_mean([ratio for ratio, _ in result.ratios()]) for result in results]
    lines += [
        "",
        f"Geometric means of the three ratios: {', '.join(f'{mean:.2g}' for mean in means)}; of all problems "
        f"{geometric_mean(means):.2g}, the worst {np.nanmin(means):.2g}. {facts}",
        "",
    ]
    for result in results:
        problem = result.problem
        name = problem.name.replace(",", "").replace(" ", "_")
        # Several views side by side are wide: one row above the other.
        height, width = result.pictures["truth"].shape[:2]
        axis = 0 if width > height else 1
        djpt.write(folder / "images" / f"inverse_{name}.png", np.concatenate(list(result.pictures.values()), axis=axis))
        fastest = min(result.theirs, key=lambda course: course.seconds(TARGETS[-1]))
        rates = ", ".join(f"{rate:g}" for rate in problem.rates)
        lines += [
            f"## {problem.name[0].upper()}{problem.name[1:]}",
            "",
            f"{problem.about} {problem.truth.size} numbers, {problem.size} x {problem.size} pixels, {problem.spp} spp.",
            "",
            f"![Start, found by djpt, truth](images/inverse_{name}.png)",
            "",
            f"*Start, found by djpt, truth.* Mitsuba: the best of Adam with the rates {rates} (to the last error: "
            f"{fastest.label}, {len(fastest.points)} steps, least error {fastest.best:.3f}). djpt: `{problem.method}`, "
            f"{len(result.ours.points)} steps, least error {result.ours.best:.3f}.",
            "",
        ]
    return "\n".join(lines)


DESCRIBED = (
    "Mitsuba solves each problem by path replay, or by projective sampling for what moves, and Adam; of three learning "
    "rates the fastest counts, for each error by itself. djpt solves it by Gauss-Newton steps with one setting, or, "
    "where noise hides the second order, by Adam with the middle one of the rates. Both have the same start, pictures "
    "of their own, and the same number of samples per pixel, but `least_squares` begins with fewer and ends with more. "
    "djpt's sampler is `sobol`, Mitsuba's the default one, `independent`. "
    "The error is the mean absolute difference from the truth relative to that at the start; seconds are those of the "
    "processor, of one thread, kernels compiled before. A dash: the error wasn't reached; the time until then is a "
    "bound on the ratio."
)


def main() -> int:
    """Solve the problems, print a table, write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problems", nargs="*", choices=[*PROBLEMS, []], default=[])
    parser.add_argument("--page", type=Path, metavar="FILE", help="write a page in Markdown, with pictures")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the courses of all searches")
    parser.add_argument("--threads", type=int, default=1, help="of both renderers (default: 1)")
    chosen = parser.parse_args()
    dr.set_thread_count(chosen.threads)
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    facts = heading(machine(), "Mitsuba's seconds / djpt's, of the processor")
    print(facts)
    print(f"{'error, relative to the start':<34}" + "".join(f"{e:>24g}" for e in TARGETS))
    results = []
    for name in chosen.problems or list(PROBLEMS):
        results.append(solve(mi, PROBLEMS[name]()))
        print(said(results[-1]), flush=True)
        for course in [results[-1].ours, *results[-1].theirs]:
            print(f"    {course.label}: {len(course.points)} steps, least error {course.best:.3f}", flush=True)
    if chosen.json:
        courses = {r.problem.name: {c.label: c.points for c in [r.ours, *r.theirs]} for r in results}
        chosen.json.write_text(json.dumps(courses, indent=1) + "\n")
    if chosen.page:
        chosen.page.write_text(page(results, facts, chosen.page.parent))
    return 0


if __name__ == "__main__":
    sys.exit(main())

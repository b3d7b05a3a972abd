"""The plugin of pytest: images of tests are compared with stored references, and reports of failures are kept.

    def test_glass(djpt_compare):
        djpt_compare("glass.xml", spp=256, flip=0.05)

A module of its own beside the package: pytest imports it at each start, and djpt only with the first comparison.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from djpt.validation.comparison import Comparison

__all__ = ["ImageCheck", "djpt_compare", "pytest_addoption", "pytest_configure", "pytest_terminal_summary"]

KEPT = pytest.StashKey[list[str]]()
"""The lines of the summary at the end of a run."""


class ImageCheck:
    """Compares an image of a test with its reference: the value of the fixture `djpt_compare`.

    * `references`: the folder of the references of a module of tests, ``references/MODULE`` beside it.
    * `reports`: the folder for reports of failures.
    * `update`: whether references are written in place of being compared with.
    """

    def __init__(self, test: str, references: Path, reports: Path, update: bool, notes: list[str]) -> None:
        self.test, self.references, self.reports, self.update = test, references, reports, update
        self._notes = notes

    def __call__(
        self, scene: Any, name: str | None = None, spp: int = 256, *, against: Any = None, **options: Any
    ) -> Comparison | None:
        """Compare, and raise `ComparisonError`, an `AssertionError`, if the images differ.

        Args:
            scene: The scene to render, or a function that returns an array; see `djpt.validation.compare`.
            name: The name of the reference; by default that of the test with its parameters.
            spp: Samples per pixel, of the reference as well.
            against: The other side in place of a reference, such as Mitsuba's renderer or an image.
            options: Thresholds by name, such as ``flip=0.05``, and arguments of `djpt.validation.compare`.

        Returns:
            The comparison; None if a reference has been written.

        Raises:
            ComparisonError: The images differ, or there is no reference yet.
        """
        __tracebackhide__ = True  # a failure shows the test, not this file
        from djpt.validation import ComparisonError, compare
        from djpt.validation.metrics import LIMITS

        file = re.sub(r"[^\w.,=-]+", "-", self.test if name is None else name).strip("-")
        target = self.references / f"{file}.exr"
        limits = {key: options.pop(key) for key in LIMITS if key in options}
        if against is None and self.update:
            self._store(target, scene, spp, options)
            return None
        if against is None and not target.exists():
            raise ComparisonError(f"no reference '{target}': look at the image, then run pytest --djpt-update")
        beside = target if against is None else against
        result = compare(scene, spp, against=beside, limits=limits, name=file, **options)
        if not result.checks:
            raise ComparisonError(
                "nothing to assert: images whose noise is unknown need a threshold, such as rmse=0.01"
            )
        if not result.passed:
            report = self.reports / f"{self.references.name}-{file}.html"
            report.parent.mkdir(parents=True, exist_ok=True)
            result.write_page(report)
            self._notes.append(f"report: {report}")
            raise ComparisonError("\n".join(["the images differ:", *result.failures, f"report: {report}", str(result)]))
        return result

    def _store(self, target: Path, scene: Any, spp: int, options: dict[str, Any]) -> None:
        from djpt.validation import store_reference

        known = ("batches", "schedule", "parameters", "width", "height", "rfilter", "integrator")
        target.parent.mkdir(parents=True, exist_ok=True)
        store_reference(target, scene, spp, **{key: value for key, value in options.items() if key in known})
        self._notes.append(f"reference: {target}")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of this plugin."""
    group = parser.getgroup("djpt", "djpt: comparing images")
    group.addoption("--djpt-update", action="store_true", help="write new references for djpt_compare")
    group.addoption("--djpt-reports", metavar="DIR", default="djpt-reports", help="folder for reports of failures")


def pytest_configure(config: pytest.Config) -> None:
    """Begin the list of notes for the summary at the end."""
    config.stash[KEPT] = []


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Report the references that were written, and the places of reports."""
    notes = config.stash.get(KEPT, [])
    if notes:
        terminalreporter.section("djpt")
        for note in notes:
            terminalreporter.write_line(note)


@pytest.fixture
def djpt_compare(request: pytest.FixtureRequest) -> ImageCheck:
    """A function that compares an image with the reference of the test, or with anything else: see `ImageCheck`."""
    config = request.config
    reports = Path(config.getoption("djpt_reports"))
    return ImageCheck(
        request.node.name,
        request.path.parent / "references" / request.path.stem,
        reports if reports.is_absolute() else config.rootpath / reports,
        bool(config.getoption("djpt_update")),
        config.stash[KEPT],
    )

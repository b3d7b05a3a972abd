"""The plugin of pytest, in runs of pytest of their own."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.kit.processes import ROOT, run_python

pytest_plugins = ["pytester"]

pytest.importorskip("scipy")

TESTS = """
import numpy as np
import pytest

def noise(spp, seed):
    return {factor} * np.random.default_rng(seed).gamma(spp, 1 / spp, (20, 24, 3)).astype(np.float32)

def test_noise(djpt_compare):
    djpt_compare(noise, spp=64)

@pytest.mark.parametrize("name", ["a/b", "c"])
def test_named(djpt_compare, name):
    djpt_compare(noise, name, spp=64, rmse=1)
"""


def written(pytester: pytest.Pytester, factor: float = 1.0, text: str = TESTS) -> None:
    pytester.makepyfile(test_images=text.replace("{factor}", str(factor)))


def ran(pytester: pytest.Pytester, *arguments: str) -> pytest.RunResult:
    # A process of its own: one that ends takes its modules along, which Dr.Jit doesn't survive.
    return pytester.runpytest_subprocess("-p", "pytest_djpt", *arguments)


def test_starting_is_light() -> None:
    code = "import sys, pytest_djpt; print([m for m in ('djpt', 'numpy', 'drjit') if m in sys.modules])"
    assert run_python("-c", code, cwd=ROOT).stdout.strip() == "[]"


def test_the_entry_point() -> None:
    project = (ROOT / "pyproject.toml").read_text()
    section = project.partition("[project.entry-points.pytest11]\n")[2].partition("\n\n")[0]
    assert section == 'pytest_djpt = "pytest_djpt"'


def test_djpt_is_imported_where_pytest_rewrites_its_modules(pytester: pytest.Pytester) -> None:
    """It does so with all that an installed plugin's package has, by a loader that can't tell their source."""
    pytester.makeconftest("import pytest; pytest.register_assert_rewrite('djpt')")
    pytester.makepyfile(
        """
        import djpt

        def test_it():
            assert type(djpt.__spec__.loader).__name__ == "AssertionRewritingHook"
            assert not djpt.load_dict({"type": "sphere"}).is_mesh()
        """
    )
    ran(pytester).assert_outcomes(passed=1)


def test_references_are_written_compared_and_reported(pytester: pytest.Pytester) -> None:
    written(pytester)
    result = ran(pytester)
    result.assert_outcomes(failed=3)
    result.stdout.fnmatch_lines(["*no reference *test_noise.exr*--djpt-update*"])
    result.stdout.no_fnmatch_line("*def __call__*")
    folder = pytester.path / "references" / "test_images"
    assert not folder.exists(), "only when asked"

    result = ran(pytester, "--djpt-update")
    result.assert_outcomes(passed=3)
    result.stdout.fnmatch_lines(["reference: *test_noise.exr"])
    assert {path.name for path in folder.iterdir()} == {"test_noise.exr", "a-b.exr", "c.exr"}
    assert (folder / "test_noise.exr").stat().st_size < 40_000
    before = {path: path.read_bytes() for path in folder.iterdir()}

    ran(pytester).assert_outcomes(passed=3)
    assert not (pytester.path / "djpt-reports").exists()

    written(pytester, 1.05)
    result = ran(pytester, "--djpt-reports", "kept")
    result.assert_outcomes(failed=3)
    result.stdout.fnmatch_lines(["*ComparisonError: the images differ:*", "*image mean: FAILED*", "report: *.html"])
    # A failure shows the line of the test, not the source of the plugin.
    result.stdout.fnmatch_lines([">       djpt_compare(noise, spp=64)"])
    result.stdout.no_fnmatch_line("*def __call__*")
    result.stdout.no_fnmatch_line("*pytest_djpt.py*")
    reports = sorted((pytester.path / "kept").iterdir())
    assert [path.name for path in reports] == [f"test_images-{name}.html" for name in ("a-b", "c", "test_noise")]
    assert "FAILED" in reports[0].read_text()
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.slow
def test_thresholds_and_other_sides(pytester: pytest.Pytester) -> None:
    text = """
        import numpy as np
        import pytest

        image = np.full((16, 16, 3), 0.5, np.float32)

        def test_image(djpt_compare):
            assert djpt_compare(image, against=image * 1.01, rmse=0.01).rmse < 0.006

        def test_too_far(djpt_compare):
            djpt_compare(image, against=image * 1.1, rmse=0.01)

        def test_nothing_asked(djpt_compare):
            djpt_compare(image, against=image)

        def test_closed_form(djpt_compare):
            djpt_compare(lambda: image, against=lambda: image)
    """
    written(pytester, text=text)
    result = ran(pytester)
    result.assert_outcomes(passed=2, failed=2)
    result.stdout.fnmatch_lines(["*RMSE 0.05 above 0.01*", "*nothing to assert*"])


@pytest.mark.slow
def test_scenes_of_mitsuba(pytester: pytest.Pytester) -> None:
    pytest.importorskip("mitsuba")
    text = """
        import djpt

        def test_box(djpt_compare):
            djpt_compare("cornell_box", spp=16, width=8, rfilter="box", same_seed=0.9)

        def test_own_plugin(djpt_compare):
            import mitsuba as mi

            mi.set_variant("llvm_ad_rgb")
            box = djpt.validation.mitsuba_renderer(djpt.cornell_box())
            djpt_compare(lambda spp, seed: box(1, seed)[:8, :8], "corner", spp=8, bias=1e9, tests=False)
    """
    written(pytester, text=text)
    ran(pytester, "--djpt-update").assert_outcomes(passed=2)
    ran(pytester).assert_outcomes(passed=2)
    assert list(Path(pytester.path).rglob("*.exr"))

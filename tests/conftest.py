"""Import djpt before anything imports Dr.Jit or Mitsuba: it chooses the LLVM library that they open."""

from __future__ import annotations

import gc
import os
import signal
from collections import Counter
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.register_assert_rewrite("tests.kit")

from tests.kit.quick_kernels import keep_apart, skip_passes, without_notes  # noqa: E402

keep_apart()

import djpt  # noqa: F401, E402 isort: skip
import drjit as dr  # noqa: E402

from djpt.description import registry  # noqa: E402
from tests.kit.lanes import lanes_from_environment  # noqa: E402
from tests.kit.threads import threads  # noqa: E402

skip_passes()
lanes_from_environment()

# Processes that run tests side by side (`pytest -n`) share the processors: threads in excess of them take time from the
# others, since they watch for work between kernels.
if "PYTEST_XDIST_WORKER_COUNT" in os.environ:
    dr.set_thread_count(max(1, (os.cpu_count() or 1) // int(os.environ["PYTEST_XDIST_WORKER_COUNT"])))


# Shells start what runs in the background without the signal that some tests send.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


TESTS = Path(__file__).parent
LONGEST = (
    *("gradients/test_matrix", "silhouettes/test_cases", "schedules/test_memory", "integrators/test_upbp"),
    *("silhouettes/test_other_viewers", "gradients/test_random_scenes", "gradients/test_block_maps"),
    *("validation/test_gradcheck", "gradients/test_materials", "materials/test_sampling", "docs/test_command_line"),
    *("integrators/test_same_seed", "docs/test_pages", "integrators/test_bdpt", "integrators/test_photon_mapping"),
    *("commands/test_ladder_page", "integrators/test_guided", "gradients/test_images", "materials/test_principled"),
    *("gradients/test_machine", "sampling/test_samplers", "integrators/test_light_tracing", "geometry/test_scale"),
    *("validation/test_compare", "docs/test_examples", "lights/test_textured", "geometry/test_curves"),
    *("integrators/test_statistics", "integrators/test_ladder", "scenes/test_rewritings", "optimization/test_optimize"),
    *("long_renders/test_passes", "media/test_volpath"),
)
"""The files that take longest. Processes side by side begin with them, and so end together."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark all but every n-th case of sparse tests as slow, and begin with the longest files if several run at once.

    An n without common factors with the numbers of values of each parameter meets each value.
    """
    cases: Counter[str] = Counter()
    for item in items:
        sparse = item.get_closest_marker("sparse")
        if sparse is not None:
            test = item.nodeid.partition("[")[0]
            if cases[test] % sparse.args[0]:
                item.add_marker(pytest.mark.slow)
            cases[test] += 1
    if "PYTEST_XDIST_WORKER_COUNT" in os.environ:
        ranks = {TESTS / f"{name}.py": rank for rank, name in enumerate(LONGEST)}
        items.sort(key=lambda item: ranks.get(item.path, len(ranks)))


def pytest_collection_finish() -> None:
    """Let the garbage collector pass over what stays to the end: modules, and thousands of tests."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Give back memory after slow tests, and after files.

    Dr.Jit keeps that of arrays that are gone, by sizes, and over hundreds of tests these add up to gigabytes.
    """
    if item.get_closest_marker("slow") or nextitem is None or nextitem.path != item.path:
        dr.flush_malloc_cache()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Let a run end whatever dies, see `tests.kit.scheduling`."""
    if config.getvalue("dist") != "loadfile":
        return None
    from tests.kit.scheduling import FileScheduling

    return FileScheduling(config, log)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Leave out what LLVM says of quick kernels."""
    report = yield
    report.sections = [(title, without_notes(text)) for title, text in report.sections]
    return report


@pytest.fixture(scope="module", autouse=True)
def plugins_of_a_file() -> Iterator[None]:
    """Forget the plugins that a file's tests register, but for djpt's own, which are registered when needed."""
    plugins = registry._plugins
    before = dict(plugins)
    yield
    for name, (_, factory) in list(plugins.items()):
        if name in before:
            plugins[name] = before[name]
        elif not registry.is_own(factory):
            del plugins[name]


@pytest.fixture
def second_thread() -> Iterator[None]:
    """For tests in which Mitsuba reads or writes EXR files: with a single thread it waits for ever for a second."""
    with threads(max(2, dr.thread_count())):
        yield


@pytest.fixture(scope="module")
def mi() -> Any:
    """Mitsuba, in the variant whose arrays are djpt's; the test is skipped where it isn't installed."""
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("llvm_ad_rgb")
    return mitsuba

"""What `make release` makes of the changelog and of its files."""

from __future__ import annotations

import hashlib
import runpy
from pathlib import Path

import pytest

import djpt
from tests.kit.processes import ROOT

SCRIPT = ROOT / "packaging" / "release.py"

pytestmark = pytest.mark.skipif(not SCRIPT.exists(), reason="not a working copy of the repository")

CHANGELOG = (
    "# Changelog\n\n## [Unreleased]\n\n* new\n\n## [2.10.0] - 2026-01-02\n\n* ten\n\n## [2.1.0] - 2025-12-31\n\n* one\n"
)


def test_the_notes_are_the_section_of_the_version() -> None:
    changes = runpy.run_path(str(SCRIPT))["changes"]
    assert changes(CHANGELOG, "2.10.0") == "* ten"
    assert changes(CHANGELOG, "2.1.0") == "* one"
    with pytest.raises(SystemExit, match=r"no section '## \[2\.1\] - "):
        changes(CHANGELOG, "2.1")
    with pytest.raises(SystemExit):
        changes("## [1.0.0] - 2026-01-01\n\n## [0.9.0] - 2025-01-01\n\n* old\n", "1.0.0")


def test_this_version_has_notes() -> None:
    names = runpy.run_path(str(SCRIPT))
    assert names["version"]() == djpt.__version__
    assert names["changes"]((ROOT / "CHANGELOG.md").read_text(), djpt.__version__)


def test_hashes_are_those_of_sha256sum(tmp_path: Path) -> None:
    file = tmp_path / "a.whl"
    file.write_bytes(b"wheel")
    assert runpy.run_path(str(SCRIPT))["hashes"]([file]) == f"{hashlib.sha256(b'wheel').hexdigest()}  a.whl\n"

"""The backend: chosen once, and never a crash instead of an error."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

import djpt
from djpt.errors import BackendError
from djpt.jit.backends import VARIANTS, set_variant, variant, variants
from tests.kit.processes import compile_library, old_llvm, run_python

USE = "import djpt; print(djpt.Float(1, 2) + 1)"


def readable(done: subprocess.CompletedProcess[str], *parts: str) -> None:
    """The process ended by an uncaught BackendError, not by a signal, and its text contains `parts`."""
    assert done.returncode == 1, (done.returncode, done.stderr)
    message = done.stderr[done.stderr.index("djpt.errors.BackendError: ") :]
    for part in parts:
        assert part in message
    assert "Traceback" not in message


def test_a_usable_llvm_is_found() -> None:
    done = run_python("-c", USE)
    assert (done.returncode, done.stdout, done.stderr) == (0, "[2, 3]\n", "")


def test_import_needs_no_llvm(tmp_path: Path) -> None:
    done = run_python("-c", "import djpt, djpt.errors; print(djpt.__version__)", folders=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{djpt.__version__}\n", "")


@pytest.mark.parametrize(
    "use", [USE, "from djpt.jit.types import Float", "import djpt; djpt.set_variant('llvm_ad_rgb'); djpt.types"]
)
def test_no_llvm(tmp_path: Path, use: str) -> None:
    readable(
        run_python("-c", use, folders=tmp_path),
        "needs a shared LLVM library, version 17 or newer",
        "No libLLVM was found",
    )


@pytest.mark.parametrize("version", [14, 15, 16])
def test_an_old_llvm_is_not_used(tmp_path: Path, version: int) -> None:
    old_llvm(tmp_path, version)
    readable(run_python("-c", USE, folders=tmp_path), "Looked at", f"(LLVM {version}: too old, 17 is needed)")


@pytest.mark.parametrize("version", [14, 15, 16])
def test_an_old_llvm_that_the_user_asks_for_is_not_used(tmp_path: Path, version: int) -> None:
    library = old_llvm(tmp_path, version)
    readable(
        run_python("-c", USE, library=library),
        f"DRJIT_LIBLLVM_PATH is set to a library that the CPU backend of Dr.Jit can't use:\n    {library}",
        f"LLVM {version}: too old",
    )


def test_a_wrong_library_of_the_user_is_named(tmp_path: Path) -> None:
    readable(run_python("-c", USE, library=tmp_path / "libLLVM.so"), "no such file")
    readable(run_python("-c", USE, library=tmp_path), "Is a directory")
    (tmp_path / "libLLVM-19.so").write_text("not a library")
    readable(run_python("-c", USE, library=tmp_path / "libLLVM-19.so"), "LLVM 19: ")


def test_a_file_name_that_lies(tmp_path: Path) -> None:
    source = "void LLVMGetVersion(unsigned *a, unsigned *b, unsigned *c) { *a = 15; *b = *c = 0; }"
    if not compile_library(tmp_path / "libLLVM.so.19.1", source):
        pytest.skip("needs a C compiler")
    readable(run_python("-c", USE, folders=tmp_path), "LLVM 15: too old")
    readable(run_python("-c", USE, library=tmp_path / "libLLVM.so.19.1"), "LLVM 15: too old")


def test_a_library_without_a_version_in_its_name(tmp_path: Path) -> None:
    if not compile_library(tmp_path / "libLLVM.so", "int nothing;"):
        pytest.skip("needs a C compiler")
    readable(run_python("-c", USE, folders=tmp_path), "not LLVM, or older than 17")


def test_the_next_best_is_taken_if_the_best_does_not_open(tmp_path: Path) -> None:
    usable = run_python("-c", "import os, djpt; print(os.environ['DRJIT_LIBLLVM_PATH'])").stdout.strip()
    (tmp_path / "libLLVM.so.22.1").write_text("not a library")
    (tmp_path / "libLLVM-17.so").symlink_to(usable)
    old_llvm(tmp_path, 15)
    done = run_python("-c", USE, folders=tmp_path)
    assert (done.returncode, done.stdout) == (0, "[2, 3]\n"), done.stderr


def test_mitsuba_and_dr_jit_use_the_chosen_llvm(tmp_path: Path) -> None:
    """djpt's choice holds for whoever imports Dr.Jit after `import djpt`."""
    pytest.importorskip("mitsuba")
    code = """
import djpt
import mitsuba as mi
mi.set_variant("llvm_ad_rgb")
import drjit as dr
assert dr.detail.llvm_version()[0] >= 17
print(mi.Float(1) + djpt.Float(1))
"""
    done = run_python("-c", code)
    assert (done.returncode, done.stdout) == (0, "[2]\n"), done.stderr


def test_dr_jit_imported_before_with_an_old_llvm(tmp_path: Path) -> None:
    library = old_llvm(tmp_path, 15)
    code = f"""
import os
os.environ["DRJIT_LIBLLVM_PATH"] = {str(library)!r}
try:
    import drjit
except (ImportError, NameError):
    raise SystemExit("needs libatomic.so.1 where the system finds it")
del os.environ["DRJIT_LIBLLVM_PATH"]
import djpt
djpt.Float(1, 2)
"""
    done = run_python("-c", code)
    if done.stderr.startswith("needs libatomic"):
        pytest.skip("a private libatomic.so.1 is only found by djpt")
    readable(done, "Dr.Jit was imported before djpt", "import djpt before drjit and mitsuba")


def test_a_child_process_searches_for_itself(tmp_path: Path) -> None:
    """What djpt writes into the environment isn't mistaken for the user's wish."""
    code = """
import subprocess, sys, djpt
child = "from djpt.jit.llvm import prepare; print(prepare().from_user)"
print(subprocess.run([sys.executable, "-c", child], capture_output=True, text=True).stdout)
"""
    assert run_python("-c", code).stdout.strip() == "False"
    assert run_python("-c", code, folders=tmp_path).stdout.strip() == "False"


def test_missing_libatomic_is_explained() -> None:
    """Dr.Jit 1.5.0 hides the reason behind a NameError of its own."""
    code = """
import importlib, djpt, djpt.jit.backends
real = importlib.import_module
def failing(name, package=None):
    if name != "drjit":
        return real(name, package)
    try:
        raise ImportError("libatomic.so.1: cannot open shared object file")
    except ImportError:
        _drjit_ext
importlib.import_module = failing
djpt.Float(1)
"""
    readable(run_python("-c", code), "Dr.Jit needs libatomic.so.1", "apt-get install -y libatomic1")


# ------------------------- Variants -------------------------


def test_the_default() -> None:
    assert variant() == "llvm_ad_rgb"
    assert djpt.variant is variant


def test_set_variant_is_refused_once_types_are_in_use() -> None:
    djpt.Float(1)
    set_variant("llvm_ad_rgb")
    set_variant("cuda_ad_rgb", "llvm_ad_rgb")
    with pytest.raises(BackendError, match="can't change to 'cuda_ad_rgb', the types of 'llvm_ad_rgb' are already"):
        set_variant("cuda_ad_rgb")
    with pytest.raises(BackendError, match=r"none of these.*\ncuda_ad_rgb: .*already in use.*\nfoo: .*unknown variant"):
        set_variant("cuda_ad_rgb", "foo")
    assert variant() == "llvm_ad_rgb"


def test_unknown_variants() -> None:
    with pytest.raises(BackendError, match="unknown variant 'llvm_ad_rgp'; did you mean 'llvm_ad_rgb'"):
        set_variant("llvm_ad_rgp")
    with pytest.raises(BackendError, match="at least one name"):
        set_variant()
    readable(run_python("-c", USE, variant="scalar_rgb"), "DJPT_VARIANT: unknown variant 'scalar_rgb'")


@pytest.mark.parametrize("name", ["llvm_ad_spectral", "scalar_mono", "scalar_rgb_double", "cuda_ad_rgb_polarized"])
def test_variants_that_compute_something_else(name: str) -> None:
    with pytest.raises(
        BackendError, match=f"the variant '{name}' isn't available: djpt computes with red, green and blue"
    ):
        set_variant(name)
    set_variant(name, "llvm_ad_rgb")
    assert variant() == "llvm_ad_rgb"


@pytest.mark.parametrize("names", ["scalar_rgb", "foo', 'scalar_rgb", "llvm_rgb"])
@pytest.mark.sparse(2)
def test_other_rgb_variants_stand_for_the_one_in_use(names: str) -> None:
    """One note says so, however often they are set."""
    code = f"""
import djpt
djpt.set_variant('{names}')
print(djpt.variant(), djpt.Float(1))
djpt.set_variant('{names}')
"""
    done = run_python("-c", code)
    assert done.stdout == "llvm_ad_rgb [1]\n"
    assert done.stderr.count("djpt has no variant") == 1
    assert "'llvm_ad_rgb' computes the same and is used instead" in done.stderr


def test_the_variants_that_run_here() -> None:
    assert variants()[0] == "llvm_ad_rgb"
    assert set(variants()) <= set(VARIANTS)


def test_set_variant_before_the_first_type() -> None:
    done = run_python("-c", "import djpt; djpt.set_variant('llvm_ad_rgb'); print(djpt.variant(), djpt.Float(1))")
    assert done.stdout == "llvm_ad_rgb [1]\n"


def test_set_variant_takes_the_first_that_runs() -> None:
    code = """
import djpt
djpt.set_variant("cuda_ad_rgb", "llvm_ad_rgb")
print(djpt.variant(), djpt.Float(1))
"""
    assert run_python("-c", code).stdout in ("llvm_ad_rgb [1]\n", "cuda_ad_rgb [1]\n")


def test_cuda_without_a_gpu() -> None:
    done = run_python("-c", USE, variant="cuda_ad_rgb")
    if done.returncode == 0:
        pytest.skip("this machine has a GPU")
    readable(done, "variant 'cuda_ad_rgb' needs an NVIDIA GPU")


def test_no_variant_runs(tmp_path: Path) -> None:
    done = run_python("-c", "import djpt; djpt.set_variant('llvm_ad_rgb', 'cuda_ad_rgb'); djpt.Float", folders=tmp_path)
    if done.returncode == 0:
        pytest.skip("this machine has a GPU")
    readable(done, "none of these variants can run", "llvm_ad_rgb: ", "cuda_ad_rgb: ")

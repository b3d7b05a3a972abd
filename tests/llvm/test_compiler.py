"""Machine code is made once per text, kept on disk, and never taken from a damaged file."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from djpt.jit.llvm import compiler
from djpt.jit.llvm.compiler import CompilationError, Llvm, cache_folder, compiled, llvm
from djpt.jit.llvm.ir import I64, Module
from tests.kit.processes import ROOT


def adding(number: int) -> str:
    """A module with a function `add` that adds a number, and one that doubles."""
    module = Module()
    for name, times in (("add", 1), ("twice", 2)):
        with module.function(name, [("x", I64)], I64) as f:
            f.give(f.parameters[0] * times + (number if name == "add" else 0))
    return module.text()


def called(address: int, x: int) -> int:
    return int(ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.c_uint64)(address)(x))


def forget() -> None:
    """Let the next compilation begin as in a new process. Functions stay in memory."""
    for function in (compiler.compiled, compiler.loaded, compiler.llvm):
        function.cache_clear()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setenv("DRJIT_CACHE_DIR", str(tmp_path))
    return tmp_path / "djpt"


@pytest.fixture
def compilations(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """The texts that LLVM compiles."""
    texts: list[str] = []
    compile_text = Llvm.object_file

    def counted(self: Llvm, text: str) -> bytes:
        texts.append(text)
        return compile_text(self, text)

    monkeypatch.setattr(Llvm, "object_file", counted)
    forget()
    yield texts
    forget()


def add(number: int, x: int = 1) -> int:
    return called(compiled(adding(number), ("add",))["add"], x)


# ---- the cache --------------------------------------------------------------------------------------


def test_a_module_is_compiled_once(folder: Path, compilations: list[str]) -> None:
    assert add(5) == add(5) == 6
    assert len(compilations) == 1
    assert [path.suffix for path in folder.iterdir()] == [".o"]


def test_other_functions_of_a_module_can_be_asked_for_later(folder: Path, compilations: list[str]) -> None:
    text = adding(6)
    assert called(compiled(text, ("add",))["add"], 1) == 7
    both = compiled(text, ("twice", "add"))
    assert called(both["twice"], 4) == 8 and called(both["add"], 4) == 10
    assert len(compilations) == 1


def test_the_next_process_loads_the_file(folder: Path, compilations: list[str]) -> None:
    assert add(7) == 8
    before = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    forget()
    assert add(7) == 8
    assert len(compilations) == 1
    assert {path: path.stat().st_mtime_ns for path in folder.iterdir()} == before


SCRIPT = """
import ctypes, sys
from djpt.jit.llvm.compiler import Llvm, compiled
if sys.argv[2] == "loads":
    Llvm.object_file = None
address = compiled(open(sys.argv[1]).read(), ("add",))["add"]
print(ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.c_uint64)(address)(1))
"""


def run(text: Path, what: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", SCRIPT, str(text), what],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        cwd=ROOT,
        env={**os.environ, **environment},
    )


def test_processes_share_files(folder: Path, tmp_path: Path) -> None:
    text = tmp_path / "module.ll"
    text.write_text(adding(8))
    for what in ("compiles", "loads"):
        done = run(text, what)
        assert done.stdout == "9\n", done.stderr
    assert len(list(folder.iterdir())) == 1


DAMAGES = {
    "empty": lambda content: b"",
    "short": lambda content: content[:20],
    "cut": lambda content: content[: len(content) // 2],
    "without its end": lambda content: content[:-1],
    "one bit": lambda content: content[:100] + bytes([content[100] ^ 4]) + content[101:],
    "zeros": lambda content: bytes(len(content)),
    "longer": lambda content: content + b"\0",
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_replaced(damage: str, folder: Path, compilations: list[str]) -> None:
    assert add(9) == 10
    (path,) = folder.iterdir()
    content = path.read_bytes()
    path.write_bytes(DAMAGES[damage](content))
    forget()
    assert add(9) == 10
    assert len(compilations) == 2
    assert path.read_bytes() == content


def test_the_file_of_another_module_is_not_used(folder: Path, compilations: list[str]) -> None:
    assert add(10) == 11
    (path,) = folder.iterdir()
    content = path.read_bytes()
    assert add(11) == 12
    (other,) = set(folder.iterdir()) - {path}
    other.write_bytes(content)
    forget()
    assert add(11) == 12


def test_a_cache_that_cant_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compilations: list[str]) -> None:
    """A file stands where the folder should be: not even root can write there."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("DRJIT_CACHE_DIR", str(tmp_path / "file"))
    assert add(12) == 13
    forget()
    assert add(12) == 13
    assert len(compilations) == 2


def test_a_folder_in_place_of_the_file(folder: Path, compilations: list[str]) -> None:
    assert add(13) == 14
    (path,) = folder.iterdir()
    path.unlink()
    path.mkdir()
    forget()
    assert add(13) == 14
    assert list(folder.iterdir()) == [path]  # nothing half-written stays behind


def test_the_cache_is_beside_drjits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRJIT_CACHE_DIR", str(tmp_path))
    assert cache_folder() == tmp_path / "djpt"
    monkeypatch.delenv("DRJIT_CACHE_DIR")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".drjit" / "djpt"


def test_without_a_home_nothing_is_kept(monkeypatch: pytest.MonkeyPatch, compilations: list[str]) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("DRJIT_CACHE_DIR", raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    assert add(14) == 15


# ---- modules ----------------------------------------------------------------------------------------


def test_modules_may_have_functions_of_one_name(folder: Path) -> None:
    modules = [compiled(adding(20 + k), ("add", "twice")) for k in range(3)]
    assert [called(functions["add"], 1) for functions in modules] == [21, 22, 23]
    assert len({address for functions in modules for address in functions.values()}) == 6


def test_internal_functions_of_one_name(folder: Path) -> None:
    def module(number: int) -> str:
        result = Module()
        with result.function("inner", [("x", I64)], I64, internal=True) as f:
            with f.each(0, f.parameters[0]) as i, f.when(i == 1000):
                f.give(0)
            f.give(f.parameters[0] + number)
        with result.function("outer", [("x", I64)], I64) as f:
            inner = f.call("inner", f.parameters, I64)
            assert inner is not None
            f.give(inner)
        return result.text()

    assert [called(compiled(module(k), ("outer",))["outer"], 1) for k in (1, 2)] == [2, 3]


def test_threads_compile_at_the_same_time(folder: Path, compilations: list[str]) -> None:
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(add, [30 + k // 8 for k in range(32)])) == [31 + k // 8 for k in range(32)]
    assert len(compilations) == 4


# ---- errors -----------------------------------------------------------------------------------------

MISTAKES = {
    "expected instruction opcode": "define i64 @{prefix}add(i64 %x) #0 {\n  frobnicate i64 %x\n}\n",
    "use of undefined value '@nothing'": "define void @{prefix}add() #0 {\n  call void @nothing()\n  ret void\n}\n",
    "defined with type": "define i64 @{prefix}add(i32 %x) #0 {\n  ret i64 %x\n}\n",
    "does not dominate all uses": (
        "define i64 @{prefix}add(i1 %c) #0 {\n  br i1 %c, label %a, label %b\na:\n  %x = add i64 1, 2\n  br label %b\n"
        "b:\n  ret i64 %x\n}\n"
    ),
}


@pytest.mark.parametrize("words", MISTAKES)
def test_mistakes_are_reported_in_llvms_words(words: str, folder: Path) -> None:
    with pytest.raises(CompilationError, match=words):
        compiled(MISTAKES[words], ("add",))
    assert not folder.exists()
    assert add(40) == 41


def test_a_version_of_llvm_that_lacks_a_pass(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiler, "PASSES", ("function(no-such-pass)", "default<O2>"))
    forget()
    assert called(compiled(adding(11), ("add",))["add"], 4) == 15
    monkeypatch.setattr(compiler, "PASSES", ("function(no-such-pass)", "function(nor-this)"))
    forget()
    with pytest.raises(CompilationError, match="nor-this"):
        compiled(adding(12), ("add",))


def test_a_function_that_isnt_there(folder: Path) -> None:
    with pytest.raises(CompilationError, match=r"Symbols not found: .*_subtract"):
        compiled(adding(41), ("subtract",))
    assert add(41) == 42


def test_the_library_must_be_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH")
    forget()
    with pytest.raises(CompilationError, match="set DRJIT_LIBLLVM_PATH"):
        add(42)


def test_the_library_must_be_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = tmp_path / "libLLVM.so"
    path.write_text("not a library\n")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(path))
    forget()
    with pytest.raises(CompilationError, match=r"DRJIT_LIBLLVM_PATH: .*libLLVM\.so"):
        add(43)


def test_the_processor_must_be_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("platform.machine", lambda: "pdp11")
    forget()
    with pytest.raises(CompilationError, match="unknown processor 'pdp11'; known: x86_64, "):
        add(44)


def test_a_library_without_a_function() -> None:
    with pytest.raises(CompilationError, match="the LLVM library has no function LLVMNothing"):
        llvm()("LLVMNothing", None)

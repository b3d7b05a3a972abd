"""The compilation of IR by the LLVM library that Dr.Jit has opened.

`compiled` turns a module of `djpt.llvm.ir` into functions in memory. It takes a tenth of a second or two, once
for each text: machine code is kept in a folder beside Dr.Jit's kernels and loaded by the next process.

Only functions of LLVM's C interface are used, which LLVM keeps stable from version to version.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import drjit as dr

from djpt.errors import DjptError
from djpt.llvm.lanes import features, processor

__all__ = ["CompilationError", "compiled"]

BACKENDS = {"x86_64": "X86", "amd64": "X86", "aarch64": "AArch64", "arm64": "AArch64"}
"""LLVM's names of the processors that `platform.machine()` may report."""

AGGRESSIVE, POSITION_INDEPENDENT, SMALL = 3, 2, 3
"""Entries of LLVM's enumerations of optimisation levels, relocation modes and code models."""

OBJECT_FILE = 1

POINTER, TEXT = ctypes.c_void_p, ctypes.c_char_p
LINKER = ctypes.CFUNCTYPE(POINTER, POINTER, POINTER, TEXT)
SECTION_LINKER = "CreateRTDyldObjectLinkingLayerWithSectionMemoryManager"


class CompilationError(DjptError):
    """LLVM can't compile a module."""


class Llvm:
    """LLVM's C interface, and what all modules share."""

    def __init__(self) -> None:
        path = os.environ.get("DRJIT_LIBLLVM_PATH")
        if not path:
            raise CompilationError("the LLVM library that Dr.Jit has opened isn't known: set DRJIT_LIBLLVM_PATH")
        backend = BACKENDS.get(platform.machine().lower())
        if backend is None:
            raise CompilationError(f"unknown processor '{platform.machine()}'; known: {', '.join(BACKENDS)}")
        self._library = ctypes.CDLL(path)
        for part in ("TargetInfo", "Target", "TargetMC", "AsmPrinter"):
            self(f"LLVMInitialize{backend}{part}", None)
        self._jit = POINTER()
        # The default linker looks for functions of LLVM among the symbols of the process, where Dr.Jit hides them.
        self._linker = LINKER(lambda _, session, __: self(f"LLVMOrc{SECTION_LINKER}", POINTER, session))
        builder = self("LLVMOrcCreateLLJITBuilder", POINTER)
        self("LLVMOrcLLJITBuilderSetObjectLinkingLayerCreator", None, builder, self._linker, None)
        self.check(self("LLVMOrcCreateLLJIT", POINTER, ctypes.byref(self._jit), builder))
        self._dylib = self("LLVMOrcLLJITGetMainJITDylib", POINTER, self._jit)

    def __call__(self, name: str, result: Any, *arguments: Any) -> Any:
        """Call a function of LLVM; Python's integers are passed as C's `int`, `bytes` as strings."""
        function = self._library[name]
        function.restype = result
        return function(*(POINTER(a) if isinstance(a, int) and a > 2**31 else a for a in arguments))

    def check(self, error: int | None) -> None:
        """Raise what an `LLVMErrorRef` says, if it isn't null."""
        if error:
            raise CompilationError(self("LLVMGetErrorMessage", TEXT, error).decode(errors="replace"))

    def load(self, code: bytes, names: Sequence[str], prefix: str) -> dict[str, int]:
        """Link an object file into the process, and return the addresses of its functions."""
        buffer = self("LLVMCreateMemoryBufferWithMemoryRangeCopy", POINTER, code, ctypes.c_size_t(len(code)), b"")
        self.check(self("LLVMOrcLLJITAddObjectFile", POINTER, self._jit, self._dylib, buffer))
        result = {}
        for name in names:
            address = ctypes.c_uint64()
            symbol = f"{prefix}{name}".encode()
            self.check(self("LLVMOrcLLJITLookup", POINTER, self._jit, ctypes.byref(address), symbol))
            result[name] = int(address.value)
        return result

    def object_file(self, text: str) -> bytes:
        """Compile IR."""
        context, module, message = self("LLVMContextCreate", POINTER), POINTER(), TEXT()
        source = text.encode()
        buffer = self(
            "LLVMCreateMemoryBufferWithMemoryRangeCopy", POINTER, source, ctypes.c_size_t(len(source)), b"djpt"
        )
        arguments = (context, buffer, ctypes.byref(module), ctypes.byref(message))
        if self("LLVMParseIRInContext", ctypes.c_int, *arguments):
            raise CompilationError((message.value or b"").decode(errors="replace"))
        triple, target = self("LLVMGetDefaultTargetTriple", POINTER), POINTER()
        if self("LLVMGetTargetFromTriple", ctypes.c_int, triple, ctypes.byref(target), ctypes.byref(message)):
            raise CompilationError((message.value or b"").decode(errors="replace"))
        cpu, options = processor().encode(), ",".join(features()).encode()
        machine = self(
            "LLVMCreateTargetMachine",
            POINTER,
            *(target, triple, cpu, options, AGGRESSIVE, POSITION_INDEPENDENT, SMALL),
        )
        builder = self("LLVMCreatePassBuilderOptions", POINTER)
        self.check(self("LLVMRunPasses", POINTER, module, b"default<O2>", machine, builder))
        code = POINTER()
        arguments = (machine, module, OBJECT_FILE, ctypes.byref(message), ctypes.byref(code))
        if self("LLVMTargetMachineEmitToMemoryBuffer", ctypes.c_int, *arguments):
            raise CompilationError((message.value or b"").decode(errors="replace"))
        size = self("LLVMGetBufferSize", ctypes.c_size_t, code)
        result = ctypes.string_at(self("LLVMGetBufferStart", POINTER, code), size)
        for release, what in (
            ("LLVMDisposeMemoryBuffer", code),
            ("LLVMDisposePassBuilderOptions", builder),
            ("LLVMDisposeModule", module),
            ("LLVMDisposeTargetMachine", machine),
            ("LLVMDisposeMessage", triple),
            ("LLVMContextDispose", context),
        ):
            self(release, None, what)
        return result


@cache
def llvm() -> Llvm:
    """The library, opened at the first call."""
    return Llvm()


@cache
def compiled(text: str, names: tuple[str, ...]) -> dict[str, int]:
    """Compile a module for this machine: the addresses of the functions `names`.

    `text` is what `djpt.llvm.ir.Module.text` gives, in which ``{prefix}`` stands before the names of functions that
    others may call, so that modules can't disturb each other. Functions stay in memory as long as the process.

    Raises:
        CompilationError: LLVM isn't found, or finds a mistake.
    """
    library = llvm()
    digest = hashlib.sha256(f"{text}{dr.detail.llvm_version()}{processor()}{features()}".encode()).hexdigest()
    prefix = f"djpt_{digest[:16]}_"
    path = cache_folder() / f"{digest[:32]}.o"
    code = path.read_bytes() if path.is_file() else b""
    if not code:
        target = f'"target-cpu"="{processor()}" "target-features"="{",".join(features())}"'
        attributes = f"attributes #0 = {{ nounwind {target} }}\n"
        code = library.object_file(text.replace("{prefix}", prefix) + attributes)
        with suppress(OSError):
            keep(code, path)
    return library.load(code, names, prefix)


def cache_folder() -> Path:
    """The folder for compiled functions, inside Dr.Jit's for kernels."""
    return Path(os.environ.get("DRJIT_CACHE_DIR") or Path.home() / ".drjit") / "djpt"


def keep(code: bytes, path: Path) -> None:
    """Write a file in one move, so that other processes never read half of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
        file.write(code)
    os.replace(file.name, path)

"""The compilation of IR by the LLVM library that Dr.Jit has opened.

`compiled` turns a module of `djpt.jit.llvm.ir` into functions in memory. It takes a tenth of a second or two, once
for each text: machine code is kept in a folder beside Dr.Jit's kernels and loaded by the next process. Each file
ends in a checksum, and one that is damaged is replaced.

Only functions of LLVM's C interface are used, which LLVM keeps stable from version to version.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
from contextlib import ExitStack, suppress
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Any

from djpt.errors import DjptError
from djpt.jit.llvm.lanes import target

__all__ = ["CompilationError", "cache_folder", "compiled"]

BACKENDS = {"x86_64": "X86", "amd64": "X86", "aarch64": "AArch64", "arm64": "AArch64"}
"""LLVM's names of the processors that `platform.machine()` may report."""

AGGRESSIVE, POSITION_INDEPENDENT, SMALL = 3, 2, 3
"""Entries of LLVM's enumerations of optimisation levels, relocation modes and code models."""

OBJECT_FILE, RETURN_STATUS = 1, 2
"""Entries of the enumerations of file types, and of what to do about mistakes in a module."""

PASSES = ("function(sroa,early-cse,simplifycfg,loop-mssa(loop-rotate,licm),gvn)", "default<O2>")
"""The optimisations; the second in versions of LLVM that don't know one of the first.

Code that was written by hand for vectors gets no faster by LLVM's usual hundred passes, which take two thirds of the
time of a compilation.
"""

POINTER, TEXT = ctypes.c_void_p, ctypes.c_char_p
LINKER = ctypes.CFUNCTYPE(POINTER, POINTER, POINTER, TEXT)
SECTION_LINKER = "CreateRTDyldObjectLinkingLayerWithSectionMemoryManager"

LOCK = Lock()
"""Held while the library is opened, and while `LOCKS` changes."""

LOCKS: dict[str, Lock] = {}
"""A lock for each text: threads compile different texts at the same time, and none twice."""


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
        try:
            self._library = ctypes.CDLL(path)
        except OSError as error:
            raise CompilationError(f"DRJIT_LIBLLVM_PATH: {error}") from None
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
        try:
            function = self._library[name]
        except AttributeError:
            raise CompilationError(f"the LLVM library has no function {name}") from None
        function.restype = result
        return function(*(POINTER(a) if isinstance(a, int) and a >= 2**31 else a for a in arguments))

    def check(self, error: int | None) -> None:
        """Raise what an `LLVMErrorRef` says, if it isn't null."""
        if error:
            raise CompilationError(self("LLVMGetErrorMessage", TEXT, error).decode(errors="replace"))

    def checked(self, message: ctypes.c_char_p, name: str, *arguments: Any) -> None:
        """Call a function that returns whether it fails; `message`, among its arguments, says why."""
        if self(name, ctypes.c_int, *(ctypes.byref(a) if a is message else a for a in arguments)):
            raise CompilationError((message.value or b"").decode(errors="replace"))

    def load(self, code: bytes) -> None:
        """Link an object file into the process."""
        self.check(self("LLVMOrcLLJITAddObjectFile", POINTER, self._jit, self._dylib, self.buffer(code)))

    def address(self, symbol: str) -> int:
        """The address of a function that has been loaded."""
        address = ctypes.c_uint64()
        self.check(self("LLVMOrcLLJITLookup", POINTER, self._jit, ctypes.byref(address), symbol.encode()))
        return int(address.value)

    def buffer(self, content: bytes) -> int:
        """A copy of some bytes, which the function that reads it releases."""
        size = ctypes.c_size_t(len(content))
        return int(self("LLVMCreateMemoryBufferWithMemoryRangeCopy", POINTER, content, size, b"djpt"))

    def object_file(self, text: str) -> bytes:
        """Compile IR."""
        message, module, code = TEXT(), POINTER(), POINTER()
        with ExitStack() as stack:

            def released(release: str, what: Any) -> Any:
                stack.callback(self, release, None, what)
                return what

            context = released("LLVMContextDispose", self("LLVMContextCreate", POINTER))
            place = ctypes.byref(module)
            self.checked(message, "LLVMParseIRInContext", context, self.buffer(text.encode()), place, message)
            released("LLVMDisposeModule", module)
            # The passes rely on rules that the parser doesn't check, such as that values are computed before their use.
            self.checked(message, "LLVMVerifyModule", module, RETURN_STATUS, message)
            machine = released("LLVMDisposeTargetMachine", self.machine())
            options = released("LLVMDisposePassBuilderOptions", self("LLVMCreatePassBuilderOptions", POINTER))
            self.optimise(module, machine, options)
            emit, place = "LLVMTargetMachineEmitToMemoryBuffer", ctypes.byref(code)
            self.checked(message, emit, machine, module, OBJECT_FILE, message, place)
            released("LLVMDisposeMemoryBuffer", code)
            size = self("LLVMGetBufferSize", ctypes.c_size_t, code)
            return ctypes.string_at(self("LLVMGetBufferStart", POINTER, code), size)

    def optimise(self, module: Any, machine: Any, options: Any) -> None:
        """Apply the first of `PASSES` that this version of LLVM knows."""
        for passes in PASSES:
            try:
                return self.check(self("LLVMRunPasses", POINTER, module, passes.encode(), machine, options))
            except CompilationError:
                if passes == PASSES[-1]:
                    raise

    def machine(self) -> int:
        """A description of this machine."""
        message, found = TEXT(), POINTER()
        triple = self("LLVMGetDefaultTargetTriple", POINTER)
        try:
            self.checked(message, "LLVMGetTargetFromTriple", triple, ctypes.byref(found), message)
            cpu, options = target().processor.encode(), ",".join(target().features).encode()
            levels = (AGGRESSIVE, POSITION_INDEPENDENT, SMALL)
            return int(self("LLVMCreateTargetMachine", POINTER, found, triple, cpu, options, *levels))
        finally:
            self("LLVMDisposeMessage", None, triple)


@cache
def llvm() -> Llvm:
    """The library, opened at the first call."""
    return Llvm()


@cache
def compiled(text: str, names: tuple[str, ...]) -> dict[str, int]:
    """Compile a module for this machine: the addresses of the functions `names`.

    `text` is what `djpt.jit.llvm.ir.Module.text` gives, in which ``{prefix}`` stands before the names of functions that
    others may call, so that modules can't disturb each other. Functions stay in memory as long as the process.

    Raises:
        CompilationError: LLVM isn't found, or finds a mistake.
    """
    with LOCK:
        library, lock = llvm(), LOCKS.setdefault(text, Lock())
    with lock:
        prefix = loaded(text)
    return {name: library.address(f"{prefix}{name}") for name in names}


@cache
def loaded(text: str) -> str:
    """Bring a module into memory; return what its functions' names begin with."""
    library = llvm()
    machine = target()
    known = f'"target-cpu"="{machine.processor}" "target-features"="{",".join(machine.features)}"'
    source = f"{text}attributes #0 = {{ nounwind {known} }}\n"
    digest = hashlib.sha256(f"{source}{machine.version}{PASSES}".encode()).hexdigest()
    prefix = f"djpt_{digest[:16]}_"
    code = found(digest)
    if code is None:
        code = library.object_file(source.replace("{prefix}", prefix))
        # Without a folder to keep it in, the next process compiles again.
        with suppress(OSError):
            keep(code, digest)
    library.load(code)
    return prefix


# ---- files -----------------------------------------------------------------------------------------------------


def cache_folder() -> Path:
    """The folder for compiled functions, inside Dr.Jit's for kernels.

    Raises:
        OSError: There is none.
    """
    folder = os.environ.get("DRJIT_CACHE_DIR")
    try:
        return Path(folder or Path.home() / ".drjit") / "djpt"
    except RuntimeError as error:
        raise OSError(str(error)) from None


def file_of(digest: str) -> Path:
    """The file of a module."""
    return cache_folder() / f"{digest[:32]}.o"


def checksum(code: bytes, digest: str) -> bytes:
    """The bytes behind stored machine code: also tell one module's from another's."""
    return hashlib.sha256(code + digest.encode()).digest()


def found(digest: str) -> bytes | None:
    """The machine code of a module, if there is an undamaged file."""
    try:
        content = file_of(digest).read_bytes()
    except OSError:
        return None
    size = hashlib.sha256().digest_size
    code, end = content[:-size], content[-size:]
    return code if end == checksum(code, digest) else None


def keep(code: bytes, digest: str) -> None:
    """Write a file in one move, so that other processes never read half of it."""
    import tempfile  # takes as long as loading a module that is kept

    path = file_of(digest)
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file, ExitStack() as stack:
        stack.callback(os.unlink, file.name)
        file.write(code + checksum(code, digest))
        file.flush()
        os.replace(file.name, path)
        stack.pop_all()

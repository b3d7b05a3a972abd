"""The choice of Dr.Jit's backend: ``llvm_ad_rgb`` (the CPU) or ``cuda_ad_rgb``.

The choice is made once per process, when the first name that needs a backend is used
(`djpt.types` calls `load_backend`). Until then it can be changed: `set_variant` comes
first, then the environment variable ``DJPT_VARIANT``, then the default ``llvm_ad_rgb``.
"""

from __future__ import annotations

import importlib
import os
import re
import warnings
from types import ModuleType

from djpt.errors import BackendError, near_miss
from djpt.jit.llvm.finder import MINIMUM, PATH_VARIABLE, prepare

__all__ = ["DEFAULT", "VARIANTS", "load_backend", "set_variant", "variant", "variants"]

VARIANTS = {"llvm_ad_rgb": "llvm", "cuda_ad_rgb": "cuda"}
"""The Dr.Jit backend of each variant, by the variant's name."""

DEFAULT = "llvm_ad_rgb"

RGB = re.compile(r"(scalar|llvm|cuda|metal)(_ad)?_rgb$")
"""Mitsuba's variants that compute what djpt computes: they mean the same here."""

OTHER = re.compile(r"(scalar|llvm|cuda|metal)(_ad)?_(mono|rgb|spectral)(_polarized)?(_double)?$")
"""All of Mitsuba's variants."""

_LIBATOMIC = """Dr.Jit needs libatomic.so.1, which this system doesn't have. Any one of these installs it:
    sudo apt-get install -y libatomic1   Debian, Ubuntu
    sudo dnf install -y libatomic        Fedora
    python -m djpt.jit.llvm                  Linux x86-64, into this Python environment, no root needed"""


class _State:
    """The choice of this process: `name` until a backend is loaded, `module` from then on."""

    name: str | None = None
    module: ModuleType | None = None
    noted: bool = False
    """True if it was said that one variant stands for another."""


def variant() -> str:
    """The name of the variant in use, or of the one that the first use of a type will load.

    Raises:
        BackendError: ``DJPT_VARIANT`` names an unknown variant.
    """
    if _State.name is not None:
        return _State.name
    name = os.environ.get("DJPT_VARIANT") or DEFAULT
    return _checked(name, "the environment variable DJPT_VARIANT")


def variants() -> list[str]:
    """The names of the variants that this machine can run, the default first. Loads Dr.Jit."""
    drjit = _import_drjit()
    runs = {"llvm": drjit.has_backend(drjit.JitBackend.LLVM), "cuda": drjit.has_backend(drjit.JitBackend.CUDA)}
    return [name for name, backend in VARIANTS.items() if runs[backend]]


def _checked(name: str, where: str) -> str:
    if isinstance(name, str) and name in VARIANTS:
        return name
    if isinstance(name, str) and OTHER.match(name) and not RGB.match(name):
        raise BackendError(
            f"{where}: the variant {name!r} isn't available: djpt computes with red, green and blue, unpolarised and "
            f"in single precision; use {DEFAULT!r}"
        )
    raise BackendError(f"{where}: unknown variant {name!r}{near_miss(str(name), VARIANTS)}")


def _own(name: str) -> str:
    """The variant of djpt that one of Mitsuba's stands for; raises `BackendError`."""
    if not isinstance(name, str) or name in VARIANTS or not RGB.match(name):
        return _checked(name, "set_variant")
    own = _State.name or DEFAULT
    if not _State.noted:
        _State.noted = True
        warnings.warn(f"djpt has no variant {name!r}: {own!r} computes the same and is used instead", stacklevel=3)
    return own


def set_variant(*names: str) -> None:
    """Choose the variant: the first of `names` that this machine can run (Mitsuba's meaning).

    Optional; without it ``llvm_ad_rgb`` is used. A single name is taken as it is, and checked
    when a type is first used. Several names are tried in turn, which loads the backend.
    Mitsuba's other rgb variants, such as ``scalar_rgb``, stand for the variant in use; a warning says so once.

    Raises:
        BackendError: no name or an unknown one was given, none of several can be run, or
            the types of another variant are in use already.
    """
    if not names:
        raise BackendError("set_variant: expected at least one name" + near_miss("", VARIANTS))
    if len(names) == 1:
        name = _own(names[0])
        if _State.module is not None and name != _State.name:
            raise BackendError(_in_use(name))
        _State.name = name
        return
    before, problems = _State.name, []
    for asked in names:
        try:
            name = _own(asked)
            if _State.module is not None and name != before:
                raise BackendError(_in_use(name))
            _State.name = name
            load_backend()
        except BackendError as error:
            _State.name = before
            problems.append(f"{asked}: {error}")
        else:
            return
    raise BackendError("set_variant: none of these variants can run:\n" + "\n".join(problems))


def _in_use(name: str) -> str:
    return (
        f"set_variant: can't change to {name!r}, the types of {_State.name!r} are already in use; "
        "call set_variant() right after 'import djpt'"
    )


def load_backend() -> ModuleType:
    """Import Dr.Jit and return the module with its types: `drjit.llvm.ad` or `drjit.cuda.ad`.

    Nothing of Dr.Jit may be used before: without a usable LLVM its first array would end
    the process instead of raising an exception.

    Raises:
        BackendError: the backend can't be used on this machine; the message says what to do.
    """
    if _State.module is not None:
        return _State.module
    name = variant()
    backend = VARIANTS[name]
    found = prepare()
    if backend == "llvm" and found.chosen is None and not found.too_late:
        raise BackendError(found.explain())
    drjit = _import_drjit()
    if backend == "llvm":
        _check_llvm(drjit)
        # It imports Dr.Jit.
        from djpt.jit.llvm.gathers import gather_by_instruction

        gather_by_instruction()
    elif not drjit.has_backend(drjit.JitBackend.CUDA):
        raise BackendError(
            f"variant {name!r} needs an NVIDIA GPU and a working CUDA driver, and Dr.Jit found none; "
            f"use {DEFAULT!r} (the default) instead"
        )
    _State.module = importlib.import_module(f"drjit.{backend}.ad")
    _State.name = name
    return _State.module


def _import_drjit() -> ModuleType:
    try:
        return importlib.import_module("drjit")
    except (ImportError, NameError) as error:
        # Dr.Jit 1.5.0's handler of a failed import fails itself, with a NameError whose context is the reason.
        reason = f"{error} {error.__context__}"
        if "libatomic" in reason:
            raise BackendError(_LIBATOMIC) from error
        raise BackendError(f"Dr.Jit can't be imported: {error.__context__ or error}") from error


def _check_llvm(drjit: ModuleType) -> None:
    """Raise `BackendError` unless Dr.Jit has a usable LLVM: an unusable one would end the process."""
    found = prepare()
    usable = drjit.has_backend(drjit.JitBackend.LLVM)
    version = tuple(drjit.detail.llvm_version()) if usable else (0,)
    if version[0] >= MINIMUM:
        return
    if not found.too_late:
        raise BackendError(
            f"Dr.Jit can't use the LLVM library that djpt chose, {found.chosen}. The processor must have AVX2 and FMA "
            f"(ARM: NEON). Set {PATH_VARIABLE} to another libLLVM, version {MINIMUM} or newer."
        )
    had = f"loaded LLVM {version[0]}, which would crash the process" if usable else "found no usable LLVM"
    advice = "import djpt before drjit and mitsuba" if found.chosen else found.explain()
    raise BackendError(f"Dr.Jit was imported before djpt and {had}: {advice}")

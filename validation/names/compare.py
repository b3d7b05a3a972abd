"""Each public name of Mitsuba beside djpt's."""

from __future__ import annotations

import ast
import dataclasses
import dis
import enum
import inspect
import re
import sys
import typing
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from inspect import Parameter, Signature
from types import FunctionType, MethodType, ModuleType
from typing import Any

from djpt.mitsuba.names import reason
from djpt.validation.report import read_beside

__all__ = [
    "Finding",
    "PublicName",
    "Verdict",
    "counts",
    "findings",
    "public_names",
    "read_names",
    "refused_call",
    "render_page",
    "share",
    "signatures",
]

MISSING: Any = object()


class Verdict(enum.Enum):
    """The result for a name."""

    HERE = "here"
    DIFFERENT = "different"
    EXCLUDED = "left out"
    ABSENT = "absent"


@dataclass(frozen=True)
class Finding:
    """A public name of Mitsuba, and what djpt has."""

    name: PublicName
    verdict: Verdict
    note: str = ""
    """The difference, or the reason to leave the name out."""


def findings(mitsuba: ModuleType, djpt: Any) -> list[Finding]:
    """Compare all public names of `mitsuba` with those of `djpt`.

    A name that is here is here, also if there is a reason to leave it out.
    """
    return [finding(name, djpt) for name in public_names(mitsuba)]


def finding(name: PublicName, djpt: Any) -> Finding:
    """Compare one name."""
    found = look_up(djpt, name.path)
    why = reason(name.path)
    if found is MISSING:
        return Finding(name, Verdict.EXCLUDED, why) if why else Finding(name, Verdict.ABSENT)
    problem = COMPARE[name.kind](name, found)
    if problem is None:
        return Finding(name, Verdict.HERE)
    return Finding(name, Verdict.EXCLUDED, why) if why else Finding(name, Verdict.DIFFERENT, problem)


@dataclass(frozen=True)
class Field:
    """An attribute that only the objects of a class have."""

    name: str


@dataclass(frozen=True)
class Method:
    """A method as a class has it."""

    cls: type
    value: Any
    """The attribute as `getattr` returns it."""
    static: Any
    """The attribute as the class stores it."""


def look_up(root: Any, path: str) -> Any:
    """The object that a dotted path leads to, or `MISSING`."""
    value = root
    for part in path.split("."):
        if inspect.isclass(value):
            value = member(value, part)
        else:
            try:
                value = getattr(value, part)
            except Exception:  # names that are refused on purpose raise what the script shall see
                return MISSING
        if value is MISSING:
            return MISSING
    return value


def member(cls: type, name: str) -> Any:
    """The attribute that the objects of a class have under a name."""
    static = inspect.getattr_static(cls, name, MISSING)
    if static is not MISSING:
        value = getattr(cls, name)
        if inspect.isclass(value) or isinstance(value, (property, enum.Enum)) or not callable(value):
            return value
        return Method(cls, value, static)
    return Field(name) if name in fields(cls) else MISSING


def fields(cls: type) -> set[str]:
    """The attributes that objects of a class get: fields, annotations, assignments in ``__init__``."""
    names = {f.name for f in dataclasses.fields(cls)} if dataclasses.is_dataclass(cls) else set()
    for base in cls.__mro__:
        names.update(vars(base).get("__annotations__", {}))
        constructor = vars(base).get("__init__")
        if isinstance(constructor, FunctionType):
            names.update(i.argval for i in dis.get_instructions(constructor) if i.opname == "STORE_ATTR")
    return names


def compare_class(name: PublicName, ours: Any) -> str | None:
    """Compare the constructors of two classes."""
    if not inspect.isclass(ours):
        return None if callable(ours) else "no class"
    constructor = vars(name.value).get("__init__")
    if not (isinstance(constructor, FunctionType) or hasattr(constructor, "__nb_signature__")):
        return None  # inherited, or no objects of it can be made
    return refusal(signatures(constructor, bound=True), signatures(ours, bound=False))


def compare_array_type(name: PublicName, ours: Any) -> str | None:
    """Compare the element type and the size of two types of arrays; other classes of Dr.Jit may be derived from."""
    import drjit as dr

    if ours is name.value or (inspect.isclass(ours) and issubclass(ours, name.value)):
        return None
    if not (inspect.isclass(ours) and dr.is_array_v(ours) and dr.is_array_v(name.value)):
        return f"another type: {getattr(ours, '__name__', ours)}"
    traits: list[Callable[[Any], Any]] = [dr.type_v, dr.size_v, dr.depth_v, dr.is_matrix_v, dr.is_tensor_v, dr.is_jit_v]
    return None if all(f(ours) == f(name.value) for f in traits) else f"another type: {ours.__name__}"


def compare_method(name: PublicName, ours: Any) -> str | None:
    """Compare the calls that two methods allow."""
    if not isinstance(ours, Method):
        return "an attribute, not a method"
    static = isinstance(name.value, (staticmethod, classmethod)) or type(name.value).__name__ == "nb_func"
    value = name.value.__func__ if isinstance(name.value, (staticmethod, classmethod)) else name.value
    theirs = signatures(value, bound=isinstance(name.value, classmethod) or not static)
    plain = isinstance(ours.static, FunctionType) or hasattr(ours.static, "__nb_signature__")
    if static and plain:
        return "needs an object of the class"
    return refusal(theirs, signatures(ours.value, bound=plain))


def compare_constant(name: PublicName, ours: Any) -> str | None:
    """Compare two values."""
    found = isinstance(ours, (Method, Field, property))
    return f"another value: {ours!r}" if found or ours != name.value else None


def refusal(theirs: list[inspect.Signature], ours: list[inspect.Signature]) -> str | None:
    """Say which call is refused."""
    if not theirs:
        return None
    if not ours:
        return "no readable signature"
    call = refused_call(theirs, ours)
    return f"refuses {call}" if call else None


COMPARE: dict[str, Callable[[PublicName, Any], str | None]] = {
    "module": lambda name, ours: None,  # compared name by name
    "class": compare_class,
    "array type": compare_array_type,
    "function": lambda name, ours: (
        refusal(signatures(name.value, bound=False), signatures(ours, bound=False))
        if callable(ours)
        else "not a function"
    ),
    "method": compare_method,
    "property": lambda name, ours: "a method, not an attribute" if isinstance(ours, Method) else None,
    "constant": compare_constant,
    "member": lambda name, ours: compare_constant(replace(name, value=name.value.value), getattr(ours, "value", ours)),
}


# ---- the calls that a function allows --------------------------------------------------------


UNNAMED = re.compile(r"(arg\d*|other)$")
"""Parameters that nobody names: nanobind's names for those without one, and the original of a copy."""


def signatures(function: Any, *, bound: bool) -> list[Signature]:
    """The overloads of a function, without the parameter that holds the object of a method.

    Read from nanobind's records, from ``typing.overload`` (Python 3.11 and newer) or from the function itself;
    empty if there is nothing to read.

    Args:
        function: anything that can be called.
        bound: whether the first parameter is the object, to be left out.
    """
    if inspect.isclass(function) and (overloads := declared_overloads(function.__init__)):
        return [without_first(s) for s in overloads]
    records = getattr(function, "__nb_signature__", None)
    if isinstance(records, tuple):
        found = [parse(record[0]) for record in records]
    elif overloads := declared_overloads(function):
        found = overloads
    else:
        try:
            found = [inspect.signature(function)]
        except (TypeError, ValueError):
            return []
    return [without_first(s) for s in found] if bound else found


def declared_overloads(function: Any) -> list[Signature]:
    """The forms that a function declares: by `djpt.core.forms`, or by ``typing.overload`` (Python 3.11 on)."""
    forms: list[Signature] | None = getattr(function, "__signatures__", None)
    if forms is not None:
        return forms
    if sys.version_info < (3, 11) or not isinstance(function, (FunctionType, MethodType)):
        return []
    return [inspect.signature(overload) for overload in typing.get_overloads(function)]


def parse(text: str) -> Signature:
    """The signature that a record of nanobind's gives as a line of Python; types are dropped, defaults are `None`."""
    text = re.sub(r"\\\d+", "None", text.strip())
    while (shorter := re.sub(r"\[[^\[\]]*\]", "", text)) != text:
        text = shorter
    try:
        definition = ast.parse(f"{text}: ...").body[0]
    except SyntaxError:
        raise ValueError(f"unreadable signature: {text}") from None
    if not isinstance(definition, ast.FunctionDef):
        raise ValueError(f"not a function: {text}")
    return Signature(list(parameters(definition.args)))


def parameters(found: ast.arguments) -> Iterator[Parameter]:
    """The parameters of a parsed definition, in order."""
    positional = [*found.posonlyargs, *found.args]
    required = len(positional) - len(found.defaults)
    last_unnamed = max((i for i, argument in enumerate(positional) if UNNAMED.match(argument.arg)), default=-1)
    unnamed = max(len(found.posonlyargs), last_unnamed + 1)
    for index, argument in enumerate(positional):
        kind = Parameter.POSITIONAL_ONLY if index < unnamed else Parameter.POSITIONAL_OR_KEYWORD
        yield Parameter(argument.arg, kind, default=None if index >= required else Parameter.empty)
    if found.vararg:
        yield Parameter(found.vararg.arg, Parameter.VAR_POSITIONAL)
    for argument, default in zip(found.kwonlyargs, found.kw_defaults, strict=True):
        yield Parameter(argument.arg, Parameter.KEYWORD_ONLY, default=None if default else Parameter.empty)
    if found.kwarg:
        yield Parameter(found.kwarg.arg, Parameter.VAR_KEYWORD)


def without_first(signature: Signature) -> Signature:
    """The signature of a bound method."""
    found = list(signature.parameters.values())
    takes_all = found and found[0].kind is Parameter.VAR_POSITIONAL
    return signature if takes_all else signature.replace(parameters=found[1:])


def refused_call(theirs: list[Signature], ours: list[Signature]) -> str | None:
    """The first call that one of `theirs` allows and none of `ours` does, as text; None if there is none.

    Every overload is called with its required arguments and with all, by position and by name. A name that
    only falls into ``**kwargs`` counts as refused: that function would take any misspelling, too.
    """
    for signature in theirs:
        for positional, named in calls(signature):
            if not any(accepts(s, positional, named) for s in ours):
                return "(" + ", ".join([*positional, *(f"{name}=" for name in named)]) + ")"
    return None


def calls(signature: Signature) -> Iterator[tuple[list[str], list[str]]]:
    """The calls to try: names of arguments by position, and names of arguments by name."""
    variadic = (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)
    found = [p for p in signature.parameters.values() if p.kind not in variadic]
    required = [p for p in found if p.default is Parameter.empty]
    for chosen in [required, found] if len(required) < len(found) else [found]:
        by_position = [p.name for p in chosen if p.kind is not Parameter.KEYWORD_ONLY]
        only_named = [p.name for p in chosen if p.kind is Parameter.KEYWORD_ONLY]
        yield by_position, only_named
        unnamed = [p.name for p in chosen if p.kind is Parameter.POSITIONAL_ONLY]
        if len(unnamed) < len(by_position):
            yield unnamed, [p.name for p in chosen if p.name not in unnamed]


def accepts(signature: Signature, positional: list[str], named: list[str]) -> bool:
    """True if a call binds, with each name to a parameter of that name."""
    known = {
        p.name
        for p in signature.parameters.values()
        if p.kind in (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)
    }
    if not set(named) <= known:
        return False
    try:
        signature.bind(*positional, **dict.fromkeys(named))
    except TypeError:
        return False
    return True


# ---- the public names of Mitsuba's module ----------------------------------------------------


LEFT_OUT = {"python", "testing", "test", "llvm_ad_rgb", "mitsuba_alias", "mitsuba_ext", "casters", "cast_object"}
"""Other paths to the same names, and what belongs to Mitsuba's own tests and binary modules."""


@dataclass(frozen=True)
class PublicName:
    """One name, such as ``Ray3f``, ``Ray3f.o`` or ``warp.square_to_tent``."""

    path: str
    value: Any
    kind: str
    """``module``, ``class``, ``array type``, ``method``, ``property``, ``member`` of an enumeration, ``function`` or
    ``constant``."""

    @property
    def owner(self) -> str:
        """The class or module that the name belongs to; empty for Mitsuba itself."""
        return self.path.rpartition(".")[0]


def public_names(mitsuba: ModuleType) -> list[PublicName]:
    """All public names of Mitsuba in the variant that is set, each once.

    A name that a class inherits belongs to its base; an object with several names is entered at the first.
    Operators (``__add__``) aren't counted; constructors are part of their class.
    """
    return list(in_module(mitsuba, "", set()))


def in_module(module: ModuleType, prefix: str, seen: set[int]) -> Iterator[PublicName]:
    """The names of a module and of all in it; what a file of Python imports from another isn't its own."""
    seen.add(id(module))
    imports_count = not str(getattr(module, "__file__", "")).endswith(".py") or hasattr(module, "__path__")
    for name in sorted(dir(module)):
        if name.startswith("_") or name in LEFT_OUT:
            continue
        value, path = getattr(module, name), f"{prefix}{name}"
        if isinstance(value, ModuleType):
            if value.__name__.startswith("mitsuba.") and id(value) not in seen:
                yield PublicName(path, value, "module")
                yield from in_module(value, f"{path}.", seen)
        elif not imports_count and getattr(value, "__module__", module.__name__) != module.__name__:
            continue
        elif inspect.isclass(value):
            if is_theirs(value):
                yield from in_class(value, path, seen)
        elif callable(value):
            if is_theirs(value):
                yield PublicName(path, value, "function")
        elif isinstance(value, (bool, int, float, str)):
            yield PublicName(path, value, "constant")


def is_theirs(value: Any) -> bool:
    """True if an object is Mitsuba's or Dr.Jit's, or a type of numbers, and not an import from elsewhere."""
    home = str(getattr(value, "__module__", "") or "")
    return home.split(".")[0] in ("mitsuba", "drjit", "") or (home == "builtins" and inspect.isclass(value))


def in_class(cls: type, path: str, seen: set[int]) -> Iterator[PublicName]:
    """A class and what is defined in it."""
    own = not cls.__module__.startswith(("drjit", "builtins"))
    yield PublicName(path, cls, "class" if own and not is_array(cls) else "array type")
    if not own or id(cls) in seen:
        return
    seen.add(id(cls))
    if issubclass(cls, enum.Enum):
        for name, member in cls.__members__.items():
            yield PublicName(f"{path}.{name}", member, "member")
        return
    for name in sorted(vars(cls)):
        if name.startswith("_") or name in ("DRJIT_STRUCT", "Domain", "Variant"):
            continue
        value = vars(cls)[name]
        if inspect.isclass(value):
            yield from in_class(value, f"{path}.{name}", seen)
        elif hasattr(value, "original_method"):  # callable on the class and on an object
            yield PublicName(f"{path}.{name}", value.original_method, "method")
        elif callable(value) or isinstance(value, (staticmethod, classmethod)):
            yield PublicName(f"{path}.{name}", value, "method")
        elif isinstance(value, property):
            yield PublicName(f"{path}.{name}", value, "property")
        elif isinstance(value, (bool, int, float, str)):
            yield PublicName(f"{path}.{name}", value, "constant")
        elif isinstance(value, enum.Enum):
            continue  # a member of a nested enumeration, exported to the class


def is_array(cls: type) -> bool:
    """True if a class is a Dr.Jit array of numbers, as opposed to one of pointers."""
    import drjit as dr

    return issubclass(cls, dr.ArrayBase) and not any(hasattr(v, "__nb_signature__") for v in vars(cls).values())


# ---- the page of the documentation, and reading it back --------------------------------------


HERE = "## Here"
LINE = re.compile(r"^\* `([\w.]+)`: (.*)$")


def counts(found: Iterable[Finding]) -> Counter[Verdict]:
    """The number of names with each verdict."""
    return Counter(f.verdict for f in found)


def share(number: Counter[Verdict]) -> float:
    """The share of names that are here, among those that aren't left out."""
    asked_for = number.total() - number[Verdict.EXCLUDED]
    return number[Verdict.HERE] / asked_for if asked_for else 1.0


def render_page(found: list[Finding]) -> str:
    """The page in Markdown."""
    different = [f"* `{f.name.path}`: {f.note}" for f in found if f.verdict is Verdict.DIFFERENT]
    lines = [
        read_beside(__file__, "head.txt"),
        *summary(found),
        read_beside(__file__, "scripts.txt"),
        *exclusions(found),
    ]
    lines += ["## Different", "", *different, ""]
    lines += ["## Absent", "", *by_owner(found, Verdict.ABSENT), "", HERE, "", *by_owner(found, Verdict.HERE)]
    return "\n".join(lines) + "\n"


def summary(found: list[Finding]) -> list[str]:
    """The numbers by kind of name."""
    lines = ["| | here | different | absent | left out | share here |", "|---|---|---|---|---|---|"]
    kinds = {
        "modules": ("module",),
        "classes and their constructors": ("class",),
        "types of numbers and arrays": ("array type",),
        "functions": ("function",),
        "methods": ("method",),
        "attributes": ("property",),
        "members of enumerations": ("member",),
        "constants": ("constant",),
    }
    rows = {title: [f for f in found if f.name.kind in chosen] for title, chosen in kinds.items()}
    for title, row in [*rows.items(), ("**all**", found)]:
        n = counts(row)
        columns = [n[Verdict.HERE], n[Verdict.DIFFERENT], n[Verdict.ABSENT], n[Verdict.EXCLUDED]]
        lines.append(f"| {title} | {' | '.join(map(str, columns))} | {100 * share(n):.1f} % |")
    return [*lines, "", "The share is that of the names that aren't left out.", ""]


def exclusions(found: list[Finding]) -> list[str]:
    """The names that are left out, by reason."""
    families = defaultdict(list)
    for f in found:
        if f.verdict is Verdict.EXCLUDED:
            families[f.note].append(f)
    lines = ["## Left out", ""]
    for why, family in families.items():
        lines += [f"{why}", f": {len(family)}: {names_of(family)}", ""]
    return lines


def by_owner(found: list[Finding], verdict: Verdict) -> list[str]:
    """One line of names per class or module; `mitsuba` stands for the module itself."""
    owners = defaultdict(list)
    for f in found:
        if f.verdict is verdict:
            owners[f.name.owner or "mitsuba"].append(f.name.path.rpartition(".")[2])
    return [f"* `{owner}`: {' '.join(names)}" for owner, names in owners.items()]


def names_of(family: list[Finding]) -> str:
    """The names of a family; members of a class that is in it itself go without saying."""
    paths = [f.name.path for f in family]
    return ", ".join(f"`{path}`" for path in paths if path.rpartition(".")[0] not in paths)


def read_names(page: str) -> list[str]:
    """The names that a page lists as here."""
    found = (LINE.match(line) for line in page.partition(HERE)[2].splitlines())
    lines = [(match[1], match[2].split()) for match in found if match]
    return [name if owner == "mitsuba" else f"{owner}.{name}" for owner, names in lines for name in names]

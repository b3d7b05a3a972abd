"""Who imports whom, read from the sources: every import counts, at the top, inside functions and for types alike."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

__all__ = ["Graph", "circles", "imports", "modules", "room", "rooms"]

LINKED = ("integrators", "materials", "scenes", "validation")
"""Folders at the top of the repository that are subpackages of djpt by symbolic links."""

BY_STRING = ("import_module", "__import__")
"""The functions that import what a string names."""

Graph = dict[str, set[str]]
"""What each module imports, or each room."""


def modules(root: Path) -> dict[str, Path]:
    """All modules of the package by name."""
    found = {}
    for folder in ("djpt", *LINKED):
        package = folder if folder == "djpt" else f"djpt.{folder}"
        for path in sorted((root / folder).rglob("*.py")):
            inside = path.relative_to(root / folder).with_suffix("").parts
            if folder == "djpt" and inside[0] in LINKED:
                continue
            found[".".join((package, *(inside[:-1] if inside[-1] == "__init__" else inside)))] = path
    return found


def imports(sources: Mapping[str, str]) -> Graph:
    """The modules that each of the `sources` imports from.

    A name that a package only hands on counts as an import of the module that defines it: `from djpt.shapes import
    Mesh` is an arrow to `djpt.shapes.mesh`. Imports by a string count, too. The package djpt itself is no target: it
    hands on all public names.
    """
    trees = {name: ast.parse(source) for name, source in sources.items()}
    defined = {name: _defined(tree) for name, tree in trees.items()}
    statements = {name: list(_statements(tree.body)) for name, tree in trees.items()}
    froms = {name: [s for s in own if isinstance(s, ast.ImportFrom)] for name, own in statements.items()}
    handed_on = {
        name: {alias.asname or alias.name: (node.module, alias.name) for node in own for alias in node.names}
        for name, own in froms.items()
    }

    def origin(module: str | None, name: str) -> str:
        """The module that defines what `from module import name` brings."""
        seen = set()
        while module is not None and (module, name) not in seen:
            seen.add((module, name))
            if f"{module}.{name}" in trees:
                return f"{module}.{name}"
            if module not in trees or name in defined[module] or name not in handed_on[module]:
                return module
            module, name = handed_on[module][name]
        return module or ""

    graph: Graph = {}
    for importer, tree in trees.items():
        found = {origin(node.module, alias.name) for node in froms[importer] for alias in node.names}
        found |= {alias.name for node in statements[importer] if isinstance(node, ast.Import) for alias in node.names}
        if any(word in sources[importer] for word in BY_STRING):
            found |= _by_string(tree)
        graph[importer] = found & set(trees) - {importer, "djpt"}
    return graph


def _statements(body: Iterable[ast.AST]) -> Iterator[ast.AST]:
    """All statements, with those inside of others, but no expressions, which are most of a tree."""
    for node in body:
        yield node
        for inside in ("body", "orelse", "finalbody", "handlers", "cases"):
            yield from _statements(getattr(node, inside, ()))


def _defined(tree: ast.Module) -> set[str]:
    """The names that a module gives to classes, functions and values of its own."""
    own = {node.name for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef)}
    assigned = [target for node in tree.body if isinstance(node, ast.Assign) for target in node.targets]
    return own | {target.id for target in assigned if isinstance(target, ast.Name)}


def _by_string(tree: ast.Module) -> set[str]:
    """What is given as a string to `import_module` and its kin."""
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and node.args]
    first = [c.args[0] for c in calls if ast.unparse(c.func).split(".")[-1] in BY_STRING]
    return {str(argument.value) for argument in first if isinstance(argument, ast.Constant)}


def room(module: str) -> str:
    """The room that a module is in: the folder of djpt, or itself if it stands beside the folders."""
    return module.split(".")[1] if "." in module else module


def rooms(graph: Graph) -> Graph:
    """The same between rooms."""
    found: Graph = {room(module): set() for module in graph}
    for module, targets in graph.items():
        found[room(module)] |= {room(target) for target in targets} - {room(module)}
    return found


def circles(graph: Mapping[str, Iterable[str]]) -> list[list[str]]:
    """The sets of more than one vertex that all lead to each other, directly or by way of others; the largest first."""

    def reached(start: str) -> set[str]:
        seen: set[str] = set()
        waiting = [start]
        while waiting:
            fresh = set(graph[waiting.pop()]) - seen
            seen |= fresh
            waiting += fresh
        return seen

    reach = {vertex: reached(vertex) for vertex in graph}
    tied = {frozenset(other for other in reach[v] if v in reach[other]) for v in graph if v in reach[v]}
    return sorted((sorted(part) for part in tied if len(part) > 1), key=lambda part: (-len(part), part))

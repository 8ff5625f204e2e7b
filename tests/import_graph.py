"""The package's modules and what each imports, read from the source without running it."""

import ast
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

__all__ = ["PACKAGE", "PROJECT", "Module", "closure", "find_cycle", "read_modules"]

PROJECT = Path(__file__).resolve().parents[1]
PACKAGE = PROJECT / "usdsmoke"


@dataclass(frozen=True)
class Module:
    """One source file of the package; names are relative to it: ``vdb.read``, "" for itself."""

    name: str
    file_path: Path
    tree: ast.Module
    ours: frozenset[str]  # modules of the package it imports: lazily and for type checkers, too
    ours_that_run: frozenset[str]  # without what is for type checkers alone
    foreign: frozenset[str]  # top-level packages outside the standard library that can be loaded
    ours_at_top: frozenset[str]  # those imported when the module is
    foreign_at_top: frozenset[str]


@cache
def read_modules() -> dict[str, Module]:
    """Every module of the package by name."""
    files = sorted(PACKAGE.rglob("*.py"))
    known = {_name_of(file_path) for file_path in files}
    return {_name_of(file_path): _read_module(file_path, known) for file_path in files}


def closure(modules: Mapping[str, Module], name: str) -> set[str]:
    """``name`` and all modules of ours that it can load, directly or not."""
    reached, waiting = set(), [name]
    while waiting:
        current = waiting.pop()
        if current not in reached:
            reached.add(current)
            waiting += modules[current].ours_that_run
    return reached


def find_cycle(imports: Mapping[str, Iterable[str]]) -> list[str]:
    """A ring of names that import one another, or an empty list.

    Args:
        imports: what each name imports.
    """
    done: set[str] = set()

    def visit(name: str, trail: list[str]) -> list[str]:
        if name in trail:
            return [*trail[trail.index(name) :], name]
        if name in done:
            return []
        for other in sorted(imports[name]):
            ring = visit(other, [*trail, name])
            if ring:
                return ring
        done.add(name)
        return []

    for name in imports:
        ring = visit(name, [])
        if ring:
            return ring
    return []


def _name_of(file_path: Path) -> str:
    parts = file_path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _read_module(file_path: Path, known: set[str]) -> Module:
    tree = ast.parse(file_path.read_text(encoding="utf-8"), str(file_path))
    everything = _imported(tree, file_path, nested=True, types=True)
    that_runs = _imported(tree, file_path, nested=True, types=False)
    at_top = _imported(tree, file_path, nested=False, types=False)
    name = _name_of(file_path)
    return Module(
        name,
        file_path,
        tree,
        frozenset(_ours(everything, known) - {name}),
        frozenset(_ours(that_runs, known) - {name}),
        frozenset(_foreign(that_runs)),
        frozenset(_ours(at_top, known) - {name}),
        frozenset(_foreign(at_top)),
    )


def _imported(tree: ast.AST, file_path: Path, nested: bool, types: bool) -> set[str]:
    """Dotted names that the code imports; those for type checkers alone only with ``types``."""
    names: set[str] = set()
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test) and not types:
            continue
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, (
                f"{file_path}:{node.lineno}: relative import; write usdsmoke...."
            )
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif nested or not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
            names |= _imported(node, file_path, nested, types)
    return names


def _ours(names: set[str], known: set[str]) -> set[str]:
    """The modules behind dotted names: usdsmoke.vdb.read.read_grids is vdb.read."""
    found = set()
    for name in names:
        parts = name.split(".")
        if parts[0] != PACKAGE.name:
            continue
        inner = parts[1:]
        while inner and ".".join(inner) not in known:
            inner = inner[:-1]
        found.add(".".join(inner))
    return found


def _foreign(names: set[str]) -> set[str]:
    tops = {name.split(".")[0] for name in names}
    return {top for top in tops if top not in sys.stdlib_module_names and top != PACKAGE.name}

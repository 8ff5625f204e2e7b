"""Names in backquotes, in docstrings and comments of the package, lead to something."""

import ast
import re
from functools import cache

import pytest

from tests.fixtures.import_graph import PACKAGE, Module, read_modules
from usdsmoke.config.settings import Config

MODULES = read_modules()
SETTINGS = {name: set(section) for name, section in Config().model_dump().items()}
QUOTED = re.compile(r"`([A-Za-z_][\w.]*)`")
FILE_ENDS = ("json", "usda", "vdb", "npy", "yaml", "j2", "py")
OF_OTHERS = {"grid_sample", "node.output", "pbrlib_defs", "stdlib_defs"}  # torch, MaterialX


@cache
def defined(module: str) -> frozenset[str]:
    """Functions, classes, methods and variables of a module."""
    nodes = list(ast.walk(MODULES[module].tree))
    names = {n.name for n in nodes if isinstance(n, (ast.FunctionDef, ast.ClassDef))}
    stored = {n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
    return frozenset(names | stored)


@cache
def at_top() -> dict[str, set[str]]:
    """Functions and classes at the top of any module: by name, what is defined in the class."""
    found: dict[str, set[str]] = {}
    for module in MODULES.values():
        for node in module.tree.body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                found.setdefault(node.name, set()).update(members(node))
    return found


def members(node: ast.AST) -> set[str]:
    """Methods and fields of a class."""
    nodes = list(ast.walk(node))
    names = {n.name for n in nodes if isinstance(n, ast.FunctionDef)}
    stored = {n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
    selves = {
        n.attr for n in nodes if isinstance(n, ast.Attribute) and isinstance(n.ctx, ast.Store)
    }
    return names | stored | selves


@cache
def in_classes() -> frozenset[str]:
    """Fields and methods of all classes."""
    trees = (module.tree for module in MODULES.values())
    classes = [n for tree in trees for n in ast.walk(tree) if isinstance(n, ast.ClassDef)]
    return frozenset(name for node in classes for name in members(node))


@cache
def foreign() -> frozenset[str]:
    """Packages of others that are imported anywhere."""
    return frozenset().union(*(module.foreign for module in MODULES.values()))


@cache
def identifiers() -> frozenset[str]:
    """All names that the package's code has anywhere, those in texts included."""
    found: set[str] = set()
    for module in MODULES.values():
        found |= set(module.name.split("."))
        for node in ast.walk(module.tree):
            for name in ("id", "attr", "arg", "name"):
                if isinstance(value := getattr(node, name, None), str):
                    found |= set(value.split("."))
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                if "\n" not in node.value and "`" not in node.value:
                    found |= set(re.findall(r"\w+", node.value))
    return frozenset(found)


def leads_to_a_module(name: str) -> bool:
    """``vdb.read``, ``read.find_grid``, ``core.features.layers``: the end of a module's path."""
    parts = name.removeprefix(f"{PACKAGE.name}.").split(".")
    for n in range(len(parts), 0, -1):
        start = ".".join(parts[:n])
        for module in MODULES:
            if module == start or module.endswith(f".{start}"):
                if n == len(parts) or parts[n] in defined(module):
                    return True
    return False


def is_known(name: str, module: Module) -> bool:
    if name in OF_OTHERS:
        return True
    first, _, rest = name.partition(".")
    if not rest:  # only names of several words: a single one may be a value or a foreign word
        whole = re.fullmatch(r"[a-z]+(_[a-z]+)+", name)
        return not whole or name in identifiers()
    if name.endswith(FILE_ENDS) or rest.split(".")[0] in SETTINGS.get(first, ()):
        return True
    if leads_to_a_module(name):
        return True
    is_local = first in {n.arg for n in ast.walk(module.tree) if isinstance(n, ast.arg)}
    if is_local:
        return rest not in at_top() or rest in in_classes()
    if first in at_top():
        return rest.split(".")[0] in at_top()[first]
    if first[0].isupper():
        return True  # USD's own, such as Sdf.ValueBlock
    return first in foreign() | defined(module.name) or rest in ("x", "y", "z")  # of a grid


@pytest.mark.parametrize("name", MODULES)
def test_names_in_backquotes_exist(name: str) -> None:
    module = MODULES[name]
    quoted = set(QUOTED.findall(module.file_path.read_text(encoding="utf-8")))
    assert [q for q in sorted(quoted) if not is_known(q, module)] == []


@pytest.mark.parametrize(
    "gone",
    ["usd.asset_paths", "core.layers", "grids.content_hash", "config.style_shares", "error_choice"],
)
def test_names_of_nothing_are_noticed(gone: str) -> None:
    assert not is_known(gone, MODULES["core.steps.targets"])

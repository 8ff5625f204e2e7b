"""The rules of docs/architecture.md hold: its two tables are read here, so they cannot go stale."""

import ast
import itertools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.fixtures.import_graph import PACKAGE, PROJECT, closure, find_cycle, read_modules

MODULES = read_modules()
DOCUMENT = PROJECT / "docs" / "architecture.md"
SOURCE_FOLDERS = ("usdsmoke", "tests", "examples", "tools", "benchmarks")
LONGEST_FILE, LONGEST_FUNCTION, MOST_PARAMETERS = 400, 60, 7
MOST_FILES, MOST_AT_TOP, MOST_NAMES = 15, 14, 12  # in a folder, in usdsmoke/, in an __init__

# Exceptions, each with its reason. Never more than three.
EXCEPTIONS: dict[str, str] = {}

# Modules that others import although the subpackage has a face: the face would load too much.
BESIDE_FACES = {
    "pictures.drawing": "needs the core, and whoever reads a style image does not",
    "pictures.preview": "needs OpenUSD",
    "pictures.preview_volumes": "needs OpenUSD",
}


def table(first: str) -> dict[str, list[str]]:
    """The rows of the document's table by first cell, without backquotes; ``first`` heads it."""
    text = DOCUMENT.read_text(encoding="utf-8")
    lines = text[text.index(f"| {first} |") :].splitlines()
    rows = [line.strip("| \n").split("|") for line in itertools.takewhile(str.strip, lines)]
    return {row[0].strip(" `"): [cell.strip() for cell in row[1:]] for row in rows[2:]}


# subpackage: level; (3, 2) is the second part of level 3. A subpackage may be one file.
LEVELS = {
    subpackage: tuple(int(number) for number in cells[0].split("."))
    for subpackage, cells in table("subpackage").items()
}
# third-party package: where it may be loaded
LOADED_IN = {
    package: set(re.findall(r"`([a-z_.]+)`", cells[0]))
    for names, cells in table("package").items()
    for package in names.replace("`", "").replace(",", " ").split()
}


def subpackage_of(name: str) -> str:
    """The row that a module belongs to: the longest name that it begins with."""
    parts = name.split(".")
    for n in range(len(parts), 0, -1):
        if ".".join(parts[:n]) in LEVELS:
            return ".".join(parts[:n])
    return ""


def may_import(name: str, other: str) -> bool:
    """Lower levels; on its own level only what is before it in the same folder."""
    here, there = LEVELS[name], LEVELS[other]
    if here[0] != there[0]:
        return there < here
    return name == other or (name.split(".")[0] == other.split(".")[0] and there < here)


def source_files(*folders: str) -> Iterator[Path]:
    for folder in folders:
        yield from sorted((PROJECT / folder).rglob("*.py"))


def folders_of(root: Path) -> list[Path]:
    return [p for p in sorted(root.rglob("*")) if p.is_dir() and any(p.glob("*.py"))]


def test_every_module_is_in_a_subpackage() -> None:
    assert not [n for n in MODULES if n not in ("", "__main__", "core") and not subpackage_of(n)]


@pytest.mark.parametrize("name", [n for n in MODULES if subpackage_of(n)])
def test_imports_go_down(name: str) -> None:
    """Lazy imports and those for type checkers count; all may import the package itself."""
    bad = {
        other
        for other in MODULES[name].ours
        if other
        and (other == "__main__" or not may_import(subpackage_of(name), subpackage_of(other)))
    }
    bad = {other for other in bad if f"{name} -> {other}" not in EXCEPTIONS}
    assert not bad, (
        f"usdsmoke.{name} imports {sorted(bad)}, which are not below {subpackage_of(name)}"
    )


def behind_faces(name: str, tree: ast.Module) -> list[str]:
    """The modules that ``name`` imports past the ``__init__`` of a subpackage that has a face."""
    nodes = (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom))
    found = []
    for other in sorted({(node.module or "").removeprefix("usdsmoke.") for node in nodes}):
        faces = [face for face in FACES if other.startswith(f"{face}.")]
        face = max(faces, key=len, default="")
        inside = f"{name}.".startswith(f"{face}.")
        if face and other not in FACES and not inside and not {face, other} & BESIDE_FACES.keys():
            found.append(other)
    return found


@pytest.mark.parametrize("name", [n for n in MODULES if n])
def test_a_subpackage_with_a_face_is_imported_through_it(name: str) -> None:
    assert behind_faces(name, MODULES[name].tree) == []


def test_an_import_past_a_face_is_found() -> None:
    tree = ast.parse("def f():\n    from usdsmoke.usd.stage.lights import lit_by\n")
    assert behind_faces("audit.inputs", tree) == behind_faces("usd.gate", tree) != []
    assert behind_faces("usd.stage.source", tree) == []
    assert behind_faces("audit.inputs", ast.parse("from usdsmoke.usd.stage import lit_by")) == []


def packages_loaded(name: str) -> set[str]:
    """Third-party packages that a module imports, or loads by name with ``importlib``."""
    tree = MODULES[name].tree
    if not any(isinstance(n, ast.Attribute) and n.attr == "import_module" for n in ast.walk(tree)):
        return set(MODULES[name].foreign)
    texts = [n.value for n in ast.walk(tree) if isinstance(n, ast.Constant)]
    named = {text.partition(".")[0] for text in texts if isinstance(text, str)}
    return MODULES[name].foreign | (named & LOADED_IN.keys())


def test_a_package_that_is_loaded_by_name_is_seen() -> None:
    assert packages_loaded("vdb.binding") == {"numpy", "openvdb", "pyopenvdb"}


FOR_TYPES_ALONE = {"typing_extensions"}


@pytest.mark.parametrize("package", sorted(LOADED_IN.keys() - FOR_TYPES_ALONE))
def test_every_place_that_the_document_names_loads_the_package(package: str) -> None:
    loading = [name for name in MODULES if package in packages_loaded(name)]
    for place in LOADED_IN[package]:
        assert any(n == place or n.startswith(f"{place}.") for n in loading), (
            f"nothing in usdsmoke.{place} loads {package}"
        )


@pytest.mark.parametrize("name", MODULES)
def test_packages_are_loaded_only_where_the_document_says(name: str) -> None:
    for package in packages_loaded(name):
        allowed = LOADED_IN.get(package, set())
        inside = any(name == place or name.startswith(f"{place}.") for place in allowed)
        assert inside or (name == "" and package == "pxr"), (
            f"usdsmoke.{name} loads {package}; only {sorted(allowed)} may"
        )


@pytest.mark.parametrize(
    ("subpackages", "never"),
    [
        (("base",), {"torch", "pxr", "openvdb", "pyopenvdb"}),
        (("vdb",), {"torch", "pxr"}),
        (("core",), {"pxr", "OpenEXR", "openvdb", "pyopenvdb"}),
        (("usd",), {"torch"}),
        (("planning",), {"torch"}),
    ],
)
def test_nothing_heavy_is_reached_through_others(
    subpackages: tuple[str, ...], never: set[str]
) -> None:
    for name in MODULES:
        if name.split(".")[0] in subpackages:
            for other in closure(MODULES, name):
                found = MODULES[other].foreign & never
                assert not found, f"usdsmoke.{name} reaches {found} through usdsmoke.{other}"


def test_command_line_loads_nothing_heavy_at_its_top() -> None:
    waiting, reached = {"ui.cli.main"}, set()
    while waiting:
        name = waiting.pop()
        reached.add(name)
        waiting |= MODULES[name].ours_at_top - reached
    assert not [name for name in reached if MODULES[name].foreign_at_top & {"torch", "pxr"}]


def test_packages_of_extras_are_loaded_inside_functions() -> None:
    extras = {"av", "distributed", "dask", "openjd", "matplotlib", "prov"}
    assert not [name for name, module in MODULES.items() if module.foreign_at_top & extras]


def test_files_import_in_no_circle() -> None:
    assert find_cycle({name: module.ours - {""} for name, module in MODULES.items()}) == []


def test_a_circle_of_imports_is_found() -> None:
    line = {"a": ["b", "c"], "b": ["c"], "c": []}
    assert find_cycle(line) == []
    assert find_cycle({**line, "c": ["a"]}) == ["a", "b", "c", "a"]


def test_an_import_upwards_is_found() -> None:
    assert may_import("core.steps", "core.fields") and may_import("ui", "base")
    assert not may_import("core.fields", "core.steps") and not may_import("base", "ui")
    assert not may_import("core.smoke", "vdb") and not may_import("vdb", "core.smoke")


def test_folders_are_not_crowded() -> None:
    counts = {
        str(f.relative_to(PACKAGE)): len([p for p in f.glob("*.py") if p.stem != "__init__"])
        for f in folders_of(PACKAGE)
    }
    crowded = {folder: n for folder, n in counts.items() if n > MOST_FILES}
    assert not crowded
    top = [p for p in PACKAGE.iterdir() if p.name not in ("__init__.py", "__main__.py")]
    entries = [p for p in top if p.suffix == ".py" or (p.is_dir() and p.name != "__pycache__")]
    assert len(entries) <= MOST_AT_TOP, sorted(p.name for p in entries)


@pytest.mark.parametrize("folder", folders_of(PACKAGE), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_every_folder_has_an_init_that_describes_it(folder: Path) -> None:
    """Its ``__init__`` says what each file holds and has a dozen names at most."""
    if folder == PACKAGE:
        return
    name = ".".join(folder.relative_to(PACKAGE).parts)
    init = MODULES.get(name)
    assert init is not None, f"{folder} has no __init__.py"
    text = ast.get_docstring(init.tree) or ""
    files = [p.stem for p in folder.glob("*.py") if p.stem != "__init__"]
    unnamed = [stem for stem in files if f"`{stem}`" not in text]
    assert text and not unnamed, f"{folder}/__init__.py does not say what {unnamed} hold"
    assert len(public_names(init.tree) or []) <= MOST_NAMES


@pytest.mark.parametrize("folder", ["usdsmoke", "tests"])
def test_files_stay_short(folder: str) -> None:
    lengths = {p: len(p.read_text(encoding="utf-8").splitlines()) for p in source_files(folder)}
    long_files = {str(p): n for p, n in lengths.items() if n > LONGEST_FILE}
    assert not long_files, f"more than {LONGEST_FILE} lines"


def test_functions_stay_short() -> None:
    long_functions = []
    for file_path in source_files(*SOURCE_FOLDERS):
        for node in ast.walk(ast.parse(file_path.read_text(encoding="utf-8"))):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                n_lines = (node.end_lineno or 0) - node.lineno + 1
                if n_lines > LONGEST_FUNCTION:
                    long_functions.append(f"{file_path}:{node.lineno} {node.name}: {n_lines} lines")
    assert not long_functions


def test_functions_take_few_parameters() -> None:
    crowded = []
    for name, module in MODULES.items():
        for node in ast.walk(module.tree):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                n = len([a for a in arguments if a.arg not in ("self", "cls")])
                if n > MOST_PARAMETERS:
                    crowded.append(f"{name}.{node.name}: {n}")
    assert not crowded


def test_files_are_named_after_their_subject() -> None:
    vague = {"utils", "util", "helpers", "helper", "misc", "common"}
    assert not [p for p in source_files(*SOURCE_FOLDERS) if p.stem in vague]


def test_exceptions_are_few_and_explained() -> None:
    exceptions = {**EXCEPTIONS, **BESIDE_FACES}
    assert len(exceptions) <= 3 and all(exceptions.values())


@pytest.mark.parametrize("name", MODULES)
def test_public_names_are_documented(name: str) -> None:
    """A face lists what it offers; in any other file a name without an underscore is public."""
    module = MODULES[name]
    assert ast.get_docstring(module.tree), f"{module.file_path} has no docstring"
    definitions = [
        node
        for node in module.tree.body
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef))
    ]
    public = [node for node in definitions if not node.name.startswith("_")]
    bare = [node.name for node in public if not documented(node)]
    assert not bare, f"{module.file_path}: no docstring on {bare}"
    listed = public_names(module.tree)
    if listed is None:
        is_face = module.file_path.name == "__init__.py" and len(module.tree.body) > 1
        assert not is_face, f"{module.file_path} has no __all__"
        return
    unlisted = {node.name for node in public} - set(listed)
    assert not unlisted, f"{module.file_path} defines {sorted(unlisted)}, not in __all__"
    absent = set(listed) - {node.name for node in definitions} - assigned_or_imported(module.tree)
    assert not absent, f"{module.file_path} lists {sorted(absent)}, which it does not define"


def public_names(tree: ast.Module) -> list[str] | None:
    """The content of ``__all__``."""
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if any(isinstance(t, ast.Name) and t.id == "__all__" for t in targets):
            return list(ast.literal_eval(node.value))  # type: ignore[attr-defined]
    return None


FACES = {
    name
    for name, module in MODULES.items()
    if name and module.file_path.name == "__init__.py" and public_names(module.tree)
}


def assigned_or_imported(tree: ast.Module) -> set[str]:
    """Names that a module has without a ``def`` or ``class``; type checkers' imports count."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            names |= {alias.asname or alias.name for alias in node.names}
    return names


def documented(node: ast.AST) -> bool:
    """Whether a function, or a class with its public methods, has docstrings."""
    if not ast.get_docstring(node):  # type: ignore[arg-type]
        return False
    methods = [n for n in ast.iter_child_nodes(node) if isinstance(n, ast.FunctionDef)]
    own = [n for n in methods if isinstance(node, ast.ClassDef) and not n.name.startswith("_")]
    return all(ast.get_docstring(n) for n in own)

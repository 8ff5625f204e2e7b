"""The floor plan holds: who imports whom, how long things are, what is public and documented.

The table below is the one of docs/architecture.md.
"""

import ast
import re
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from tests.import_graph import PROJECT, Module, closure, find_cycle, read_modules

MODULES = read_modules()

OPENVDB = {"openvdb", "pyopenvdb"}
GROUND = {
    "errors", "sections", "look_sections", "setting_checks", "config", "volume", "time_codes",
    "naming",
}  # fmt: skip
REQUESTS = {"request_attributes", "volume_requests"}
PLAN = {
    "plan", "plan_record", "volume_settings", "needs", "camera_needs", "control_needs",
    "loss_needs", "estimate", "frames", "windows",
}  # fmt: skip
WITHOUT_TORCH = {  # planning may count with these
    "core.controls", "core.frustum", "core.progress", "core.schedule",
}  # fmt: skip

# module: (what else of ours it may import, packages it may import); the first match counts.
TABLE: list[tuple[str, set[str], set[str]]] = [
    ("errors", set(), set()),
    ("sections", {"look_sections", "setting_checks"}, set()),
    ("look_sections", {"setting_checks"}, set()),
    ("setting_checks", {"errors"}, set()),
    ("config", {"errors", "sections", "setting_checks"}, {"yaml"}),
    ("volume", {"errors"}, {"numpy"}),
    ("time_codes", {"errors"}, set()),
    ("naming", {"errors"}, set()),
    ("publish", {"errors"}, set()),
    ("memory", set(), set()),
    ("torch_environment", set(), set()),
    ("provenance", {"errors"}, set()),
    ("provenance_versions", set(), set()),
    ("provenance_stage", {"volume"}, {"numpy"}),
    ("provenance_records", {"errors", "diagnostics", "grids.*", "layer.seal"}, {"pxr"}),
    ("provenance_*", {"*"}, set()),
    ("prov_json", {"provenance_records"}, set()),
    ("run_figures", set(), set()),
    ("error_bounds", set(), set()),
    ("error_budget", {"error_bounds"}, set()),
    ("error_choice", {"error_bounds"}, set()),
    ("storage_error", {"sections", "volume"}, {"numpy"}),
    ("windows", {"errors", "config"}, set()),
    ("blend", {"errors", "volume"}, {"numpy"}),
    ("colour_grids", {"naming", "sections", "volume"}, {"numpy"}),
    ("locks", {"errors", "publish"}, set()),
    ("schema", {"errors"}, {"pxr"}),
    ("diagnostics", {"errors"}, {"pxr"}),
    ("relationships", set(), {"pxr"}),
    ("asset_files", set(), {"pxr"}),
    ("request_attributes", set(), set()),
    ("request_values", set(), {"pxr"}),
    ("volume_requests", GROUND | {"schema", "relationships", "request_*"}, {"pxr"}),
    (
        "stage*",
        GROUND
        | {"stage*", "schema", "diagnostics", "relationships", "provenance"}
        | {"asset_files", *REQUESTS},
        {"pxr", "numpy"},
    ),
    (
        "layer*",
        GROUND | {"layer*", "schema", "diagnostics", "relationships", "provenance", "publish"},
        {"pxr", "numpy"},
    ),
    (
        "validat*",
        GROUND
        | {"validat*", "schema", "diagnostics", "relationships", "provenance", "grids.*"}
        | {"asset_files", *REQUESTS},
        {"pxr", "numpy"},
    ),
    ("grids.binding", GROUND | {"grids*"}, {"numpy"} | OPENVDB),
    ("grids.worker", GROUND | {"grids*", "publish"}, {"numpy"} | OPENVDB),
    ("grids.write", GROUND | {"grids*", "publish"}, {"numpy"} | OPENVDB),
    ("grids*", GROUND | {"grids*", "publish"}, {"numpy"}),
    ("images*", {"errors", "publish"}, {"numpy", "OpenEXR", "PIL"}),
    ("contact_sheet*", GROUND | {"images", "publish"}, {"numpy", "PIL"}),
    (
        "core*",
        {"errors", "sections", "config", "volume", "memory", "storage_error", "core*"},
        {"numpy", "torch"},
    ),
    ("run_progress", GROUND | WITHOUT_TORCH, set()),
    ("run_changes", set(), set()),
    ("run_choice", GROUND | {"run_changes", "run_folder"}, set()),
    ("run_[fw]*", GROUND | {"publish", "provenance", "locks", "run_folder"}, set()),
    ("progress", GROUND | {"run_progress"}, {"rich"}),
    ("frames", GROUND | PLAN | {"grids*"}, {"numpy"}),
    ("volume_settings", GROUND | {"request_attributes"}, set()),
    ("plan_record", PLAN, set()),
    ("plan", GROUND | PLAN | {"grids.header"} | WITHOUT_TORCH, {"numpy"}),
    ("needs", GROUND | PLAN | {"grids.header"} | WITHOUT_TORCH, {"numpy"}),
    ("camera_needs", GROUND | PLAN | {"grids.header"} | WITHOUT_TORCH, {"numpy"}),
    ("control_needs", GROUND | PLAN | WITHOUT_TORCH, set()),
    ("loss_needs", {"config", "core.definition"}, set()),
    ("estimate", GROUND | PLAN | {"grids.header"} | WITHOUT_TORCH, {"numpy"}),
    ("inspection*", {"*"}, {"pxr", "numpy"}),
    ("openjd_template", {"errors"}, {"yaml"}),
    # Dask is an extra that may be missing; it is loaded by those who ask for a cluster alone.
    ("cluster_*", {"errors"}, {"distributed"}),
    ("cluster", {"*"}, {"distributed"}),
    (
        "pipeline_features",
        {"core.definition", "core.layers", "core.vgg19_file", "provenance", "sections"},
        set(),
    ),
    ("pipeline*", {"*"}, {"pxr", "numpy", "torch"}),
    ("preview*", {"*"}, {"pxr", "numpy"}),
    ("report.diagrams", {"errors", "report.records"}, {"matplotlib"}),
    ("report*", {"*"}, {"numpy", "torch"}),
    ("cli*", {"*"}, {"rich"}),
    # Qt comes through pxr.Usdviewq, which only usdview has; only this module needs it.
    ("usdview.container", set(), {"pxr"}),
    ("usdview*", {"*"}, {"pxr"}),
    ("__main__", {"cli"}, set()),
    ("", set(), set()),
]

# What a module must not reach, not even through others.
OUT_OF_REACH: list[tuple[str, set[str]]] = [
    ("inspection*", {"torch"}),
    ("prov*", {"torch"}),
    ("pipeline_features", {"torch"}),
    ("validators", {"torch"}),
    ("stage*", {"torch"} | OPENVDB),
    ("layer*", {"torch"} | OPENVDB),
    ("grids*", {"torch", "pxr"}),
    ("plan", {"torch", "pxr"} | OPENVDB),
    ("core*", {"pxr", "OpenEXR"} | OPENVDB),
]

SOURCE_FOLDERS = ("usdsmoke", "tests", "examples", "tools", "benchmarks")
LONGEST_FILE, LONGEST_FUNCTION = 300, 60


def source_files(*folders: str) -> Iterator[Path]:
    for folder in folders:
        yield from sorted((PROJECT / folder).rglob("*.py"))


def matches(name: str, patterns: set[str]) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in patterns)


@pytest.mark.parametrize("name", MODULES)
def test_module_imports_only_what_the_table_allows(name: str) -> None:
    row = next((row for row in TABLE if fnmatchcase(name, row[0])), None)
    assert row is not None, (
        f"usdsmoke.{name} is in no row of the table; add it here and in docs/architecture.md"
    )
    # The package itself is light and gives __version__ to all.
    ours = {other for other in MODULES[name].ours if other and not matches(other, row[1])}
    assert not ours, f"usdsmoke.{name} imports {sorted(ours)}; it may import {sorted(row[1])}"
    foreign = MODULES[name].foreign - row[2]
    assert not foreign, f"usdsmoke.{name} imports {sorted(foreign)}; it may import {sorted(row[2])}"


@pytest.mark.parametrize(("pattern", "never"), OUT_OF_REACH)
def test_module_reaches_nothing_heavy_through_others(pattern: str, never: set[str]) -> None:
    for name in MODULES:
        if fnmatchcase(name, pattern):
            for other in closure(MODULES, name):
                found = MODULES[other].foreign & never
                assert not found, f"usdsmoke.{name} reaches {found} through usdsmoke.{other}"


def test_command_line_loads_nothing_heavy_at_its_top() -> None:
    waiting, reached = {"cli"}, set()
    while waiting:
        name = waiting.pop()
        reached.add(name)
        waiting |= MODULES[name].ours_at_top - reached
    assert not [name for name in reached if MODULES[name].foreign_at_top & {"torch", "pxr"}]


def test_packages_of_extras_are_loaded_inside_functions() -> None:
    extras = {"distributed", "dask", "openjd", "matplotlib"}
    assert not [name for name, module in MODULES.items() if module.foreign_at_top & extras]


def test_nothing_but_its_command_needs_the_report() -> None:
    inside = {name for name in MODULES if name.startswith("report")}
    users = {name for name in MODULES if MODULES[name].ours & inside} - inside
    assert users == {"cli_report"}


def test_the_report_loads_torch_inside_functions() -> None:
    assert not [
        n for n in MODULES if n.startswith("report") and "torch" in MODULES[n].foreign_at_top
    ]


def test_imports_form_no_cycle() -> None:
    assert find_cycle(MODULES) == []


def test_a_ring_of_imports_is_found() -> None:
    def module(name: str, *ours: str) -> Module:
        none: frozenset[str] = frozenset()
        return Module(name, Path(), ast.parse(""), frozenset(ours), none, none, none)

    line = {"a": module("a", "b", "c"), "b": module("b", "c"), "c": module("c")}
    assert find_cycle(line) == []
    assert find_cycle({**line, "c": module("c", "a")}) == ["a", "b", "c", "a"]


def test_every_module_is_named_in_the_document() -> None:
    text = (PROJECT / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([a-z_*/]+)`", text))
    patterns = {name.removesuffix("/*") for name in named}
    rooms = {name.split(".")[0] for name in MODULES} - {"", "__main__"}
    missing = {room for room in rooms if not matches(room, patterns)}
    assert not missing, f"docs/architecture.md does not say what {sorted(missing)} may import"


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


def test_files_are_named_after_their_subject() -> None:
    vague = {"utils", "util", "helpers", "helper", "misc", "common"}
    assert not [p for p in source_files(*SOURCE_FOLDERS) if p.stem in vague]


@pytest.mark.parametrize("name", MODULES)
def test_public_names_are_listed_and_documented(name: str) -> None:
    module = MODULES[name]
    assert ast.get_docstring(module.tree), f"{module.file_path} has no docstring"
    if module.file_path.name == "__init__.py" and len(module.tree.body) == 1:
        return  # a folder's docstring alone
    listed = public_names(module.tree)
    assert listed is not None, f"{module.file_path} has no __all__"
    definitions = {
        node.name: node
        for node in module.tree.body
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef))
    }
    unlisted = {item for item in definitions if not item.startswith("_")} - set(listed)
    assert not unlisted, f"{module.file_path} defines {sorted(unlisted)}, not in __all__"
    absent = set(listed) - set(definitions) - assigned_or_imported(module.tree)
    assert not absent, f"{module.file_path} lists {sorted(absent)}, which it does not define"
    bare = [item for item in listed if item in definitions and not documented(definitions[item])]
    assert not bare, f"{module.file_path}: no docstring on {bare}"


def public_names(tree: ast.Module) -> list[str] | None:
    """The content of ``__all__``."""
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if any(isinstance(t, ast.Name) and t.id == "__all__" for t in targets):
            return list(ast.literal_eval(node.value))  # type: ignore[attr-defined]
    return None


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

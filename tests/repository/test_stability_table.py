"""docs/stability.md claims what tests check, and nothing else."""

import ast
import re
from functools import cache

import pytest

import usdsmoke.base.errors
from tests.fixtures.import_graph import PROJECT
from tests.stability import (
    DOCUMENT,
    ENTRIES,
    NOT_YET_CHECKED,
    REFERENCE,
    Entry,
    render_document,
)

GROUPS = [
    "Volume", "Optics", "Transport", "Transforms", "Time", "Style image", "Optimiser",
    "Repeatability", "Faults of the reference code",
]  # fmt: skip
TESTS = sorted({test for entry in ENTRIES for test in entry.tests})


@cache
def read_tests(file_name: str) -> tuple[dict[str, ast.FunctionDef], set[str]]:
    """A test file's functions that pytest collects, and the texts that can name their cases."""
    tree = ast.parse((PROJECT / file_name).read_text(encoding="utf-8"))
    functions = {
        node.name: node
        for node in tree.body
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    }
    constants = (node.value for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return functions, {value for value in constants if isinstance(value, str)}


@pytest.mark.parametrize("test", TESTS)
def test_every_test_that_is_named_exists_and_is_run(test: str) -> None:
    found = re.fullmatch(r"(tests/[\w/]+/)?((?:tests/)?test_\w+\.py)::(\w+)(?:\[(.+)\])?", test)
    assert found, f"{test} is no path::function[case]"
    functions, texts = read_tests((found[1] or "") + found[2])
    assert found[3] in functions
    assert not re.search(r"\b(skip|importorskip|shared_file)\(", ast.unparse(functions[found[3]]))
    marks = [ast.unparse(mark) for mark in functions[found[3]].decorator_list]
    assert not [mark for mark in marks if re.search(r"\b(skip|skipif|xfail)\b", mark)]
    if found[4]:
        assert found[4] in texts
        assert any("parametrize" in mark for mark in marks)


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.what)
def test_every_entry_has_a_test_and_a_known_end(entry: Entry) -> None:
    assert entry.tests
    assert re.match(r"(finite|named error \w+): \w", entry.happens)
    for name in re.findall(r"named error (\w+)", entry.happens):
        assert issubclass(getattr(usdsmoke.base.errors, name), usdsmoke.base.errors.UsdSmokeError)
        files = {test.partition("::")[0] for test in entry.tests}
        assert any(name in (PROJECT / file).read_text(encoding="utf-8") for file in files)


def test_every_group_has_entries_and_no_entry_stands_twice() -> None:
    assert list(dict.fromkeys(entry.group for entry in ENTRIES)) == GROUPS
    claims = [entry.what for entry in ENTRIES]
    assert len(set(claims)) == len(claims)
    assert not set(claims) & set(NOT_YET_CHECKED)


def test_every_fault_of_the_reference_code_is_answered_once_and_in_order() -> None:
    numbers = [entry.what.partition(":")[0] for entry in REFERENCE]
    assert numbers == [f"W{n}" for n in range(1, 23)]


def test_the_document_is_the_one_the_list_gives() -> None:
    assert DOCUMENT.read_text(encoding="utf-8") == render_document(), (
        "docs/stability.md is not what tests/stability.py gives; run: python -m tests.stability"
    )

"""The tone of messages, held here once; other tests check the facts in a message."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.fixtures.import_graph import read_modules
from usdsmoke.base import errors

TESTS = Path(__file__).parents[1]
ERRORS = {n for n, c in vars(errors).items() if isinstance(c, type) and issubclass(c, Exception)}
HARSH = re.compile(r"\b(please|sorry|illegal|invalid|abort|fatal|failed to)\b|!(?!/)", re.I)
OF_A_BUG = "This is a bug in usdsmoke. Please report it."
ENDS = (".", "{}", '"')  # of a sentence, of what is filled in, of a command to copy
PLAIN = re.compile(r"[A-Za-z][a-z']*(\\?[,.:;])?")


def raised(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and text of each error of the package's own types, {} for what is filled in."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and node.exc.args:
            if ast.unparse(node.exc.func).split(".")[-1] in ERRORS:
                yield node.lineno, filled(node.exc.args[0])


def filled(node: ast.expr) -> str:
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=values):
            return "".join(filled(value) for value in values)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return filled(left) + filled(right)
        case _:
            return "{}"


def objection(text: str) -> str:
    """What is wrong with the tone of a message; empty if nothing is."""
    if not text.endswith(ENDS):
        return "it ends without a full stop"
    if found := HARSH.search(text.replace(OF_A_BUG, "")):
        return f"it says {found.group()!r}"
    if longest := max(len(sentence.split()) for sentence in re.split(r"[.:;] ", text)):
        return f"a sentence has {longest} words" if longest > 40 else ""
    return ""


def phrases(text: str) -> list[str]:
    """Runs of three and more plain words of a pattern, those of a list aside."""
    runs: list[list[str]] = [[]]
    for word in text.split(" "):
        if not PLAIN.fullmatch(word):
            runs.append([])
        elif not word.endswith(","):
            runs[-1].append(word)
    return [" ".join(run) for run in runs if len(run) > 2]


def patterns(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and text of each ``match=`` in a test."""
    for node in ast.walk(tree):
        if isinstance(node, ast.keyword) and node.arg == "match":
            if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
                yield node.value.lineno, node.value.value


def test_errors_are_calm_sentences() -> None:
    texts = [
        (f"{name}:{line}", text)
        for name, module in read_modules().items()
        for line, text in raised(module.tree)
    ]
    assert len(texts) > 150
    found = [f"{where}: {said}: {text}" for where, text in texts if (said := objection(text))]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("text", ["no file", "Invalid size {}.", "{}!", "very " * 41 + "long."])
def test_a_harsh_or_endless_message_is_found(text: str) -> None:
    assert objection(text)


def test_tests_expect_facts_in_messages_and_no_phrases() -> None:
    found = [
        f"{file.relative_to(TESTS)}:{line}: {phrase}"
        for file in sorted(TESTS.rglob("*.py"))
        for line, pattern in patterns(ast.parse(file.read_text(encoding="utf-8")))
        for phrase in phrases(pattern)
    ]
    assert not found, "\n".join(found)


def test_a_phrase_is_found() -> None:
    assert phrases(r"look\.usda does not hold a look") == ["does not hold a look"]
    assert not phrases(r"look\.usda .* variants fire, ice, smoke")

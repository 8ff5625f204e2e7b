"""The documents: their links lead somewhere, and what they name exists."""

import contextlib
import io
import re
import runpy
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
import yaml

from usdsmoke.ui.cli.main import main

PROJECT = Path(__file__).resolve().parents[2]
FOLDERS = (".", "docs", "docs/decisions", "benchmarks", "examples", "examples/plume")
DOCUMENTS = sorted(path for folder in FOLDERS for path in PROJECT.joinpath(folder).glob("*.md"))
WIDTH = 100


def run(*arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, cwd=PROJECT, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def printed_by(*arguments: str) -> str:
    """What ``usdsmoke`` prints."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):  # --help exits
        assert main(list(arguments)) == 0
    return printed.getvalue()


@cache
def help_of(command: str) -> str:
    return printed_by(*([command] if command else []), "--help")


@cache
def settings() -> dict[str, dict[str, object]]:
    return yaml.safe_load(printed_by("settings"))


def prose(document: Path) -> str:
    """The text without fenced code."""
    return re.sub(r"^ *```.*?^ *```$", "", document.read_text("utf-8"), flags=re.M | re.S)


def anchors(document: Path) -> set[str]:
    """The anchors of the headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", prose(document), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def relative(document: Path) -> str:
    return str(document.relative_to(PROJECT))


@pytest.mark.parametrize("document", DOCUMENTS, ids=relative)
def test_links_lead_to_files_and_headings(document: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", prose(document)):
        if link.startswith(("http:", "https:")):
            continue
        name, _, anchor = link.partition("#")
        target = (document.parent / name).resolve() if name else document
        assert target.exists(), f"{link} leads nowhere"
        if anchor:
            assert anchor in anchors(target), f"{link}: no such heading"


@pytest.mark.parametrize("document", DOCUMENTS, ids=relative)
def test_lines_are_at_most_100_columns_wide(document: Path) -> None:
    wide = [
        line
        for line in prose(document).splitlines()
        if len(line) > WIDTH and not line.startswith(("|", "![")) and " " in line.strip("-* ")
    ]
    assert wide == []


def test_every_picture_is_shown_or_linked() -> None:
    texts = "".join(path.read_text("utf-8") for path in PROJECT.glob("**/*.md"))
    unused = [p.name for p in (PROJECT / "docs/pictures").iterdir() if p.name not in texts]
    assert unused == []


def test_every_picture_has_a_command_that_exists() -> None:
    """In the table of benchmarks/README.md: a module with these options, or the command."""
    pictures = PROJECT / "docs/pictures"
    table = (PROJECT / "benchmarks/README.md").read_text("utf-8").partition("## Pictures")[2]
    made = set()
    for names, command in re.findall(r"^\| (`.*?`) \| (`.*`.*) \|$", table, flags=re.M):
        assert re.search(r"`(make demo|python -m benchmarks\.\w+)\b", command), command
        for module, options in re.findall(r"python -m benchmarks\.(\w+)([^`]*)", command):
            source = (PROJECT / f"benchmarks/{module}.py").read_text("utf-8")
            for option in re.findall(r"(?<!\S)--[a-z-]+", options):
                assert f'"{option}"' in source, f"{module} has no {option}"
        for name in re.findall(r"`(.*?)`", names):
            found = set(pictures.glob(name))
            assert found, f"{name} is no picture"
            made |= found
    left = sorted(p.name for p in pictures.rglob("*") if p.is_file() and p not in made)
    assert left == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=relative)
def test_commands_and_their_options_exist(document: Path) -> None:
    if document.name == "CHANGELOG.md" or document.parent.name == "decisions":
        return  # these speak of their own day
    known = set(re.findall(r"^    ([a-z-]+)\b", help_of(""), flags=re.M))
    text = document.read_text("utf-8").replace("\\\n", " ")
    code = [*re.findall(r"^ *```.*?^ *```$", text, flags=re.M | re.S)]
    code += re.findall(r"`([^`\n]+)`", prose(document))
    plain = re.sub(r"\s#.*", "", "\n".join(code))
    for command, rest in re.findall(r"\busdsmoke ([a-z][a-z-]+)\b([^\n|]*)", plain):
        assert command in known, f"usdsmoke {command}"
        options = set(re.findall(r"(?<!\S)--[a-z-]+", help_of(command).replace(",", " ")))
        for option in re.findall(r"(?<!\S)--[a-z-]+", rest):
            assert option in options, f"usdsmoke {command} {option}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=relative)
def test_settings_that_are_named_exist(document: Path) -> None:
    if document.name == "CHANGELOG.md" or document.parent.name == "decisions":
        return
    sections = settings()
    for section, name in re.findall(r"--set ([a-z_0-9]+)\.(\w+)=", document.read_text("utf-8")):
        assert name in sections.get(section, {}), f"{section}.{name} is no setting"
    for section, name in re.findall(r"`(\w+)\.(\w+)[`=]", prose(document)):
        if section in sections:
            assert name in sections[section], f"{section}.{name} is no setting"


def test_names_in_the_recipes_exist() -> None:
    """Functions, classes and constants that contributors are sent to."""
    code = "\n".join(
        source.read_text("utf-8")
        for folder in ("usdsmoke", "tests", "benchmarks", "tools")
        for source in (PROJECT / folder).rglob("*.py")
    )
    for name in ("recipes.md", "architecture.md"):
        words = re.findall(r"`([\w.]+)(?:\([^`]*\))?`", prose(PROJECT / "docs" / name))
        for word in words:
            last = word.rpartition(".")[2]
            if re.search(r"[A-Z_]", last) and last.lower() not in ("md", "name", "key"):
                assert re.search(rf"\b{last}\b", code), f"{name}: {word}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=relative)
def test_source_files_that_are_named_exist(document: Path) -> None:
    if document.parent.name == "decisions" or document.name == "CHANGELOG.md":
        return  # these speak of their own day
    roots = "usdsmoke|tests|benchmarks|docs|examples|schemas|tools"
    for name in re.findall(rf"`((?:{roots})/[\w/.]+)`", prose(document)):
        assert (PROJECT / name).exists() or "NAME" in name, f"{name} is not there"


def test_the_tables_of_settings_are_those_of_the_command() -> None:
    run("tools/generate_settings.py", "--check")


def test_the_index_of_benchmarks_names_every_one_that_can_be_run() -> None:
    index = (PROJECT / "benchmarks/README.md").read_text("utf-8")
    runnable = {
        path.stem
        for path in PROJECT.glob("benchmarks/*.py")
        if 'if __name__ == "__main__"' in path.read_text("utf-8")
    }
    assert {name for name in runnable if f"`{name}`" not in index} == set()


@pytest.mark.parametrize("document", DOCUMENTS, ids=relative)
def test_paragraphs_are_wrapped(document: Path) -> None:
    """Run `python tools/wrap_prose.py FILE`."""
    if document.is_relative_to(PROJECT / "benchmarks/results"):
        return  # written by benchmarks
    text = document.read_text("utf-8")
    assert runpy.run_path(str(PROJECT / "tools/wrap_prose.py"))["wrap_prose"](text) == text

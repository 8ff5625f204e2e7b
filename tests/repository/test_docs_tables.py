"""Tables that the documents keep by hand say what the product says."""

import re
from pathlib import Path

import pytest

from tests.fixtures.usd_fixtures import needs_usd
from usdsmoke.config.resolve import read_settings, resolve_config
from usdsmoke.ui.cli.arguments import build_parser
from usdsmoke.ui.cli.options import given_settings
from usdsmoke.usd.rules import register_validators

DOCS = Path(__file__).resolve().parents[2] / "docs"


def table(document: str, heading: str) -> list[tuple[str, str]]:
    """The rows of the table whose first column has this heading, without backticks."""
    text = (DOCS / document).read_text("utf-8").replace("`", "")
    found = re.search(rf"^\| {heading} \|[^\n]*\n\| ---[^\n]*\n((?:\|[^\n]*\n)+)", text, re.M)
    assert found, f"{document} has no table of {heading}s"
    rows = [row.strip("| ").split(" | ") for row in found[1].splitlines()]
    return [(first, second) for first, second in rows]


@needs_usd(26, 5)
def test_validators_are_listed_with_the_rule_that_usd_shows() -> None:
    validation = pytest.importorskip("pxr.UsdValidation")
    names, registry = register_validators(), validation.ValidationRegistry()
    rules = {name.split(":")[1]: registry.GetValidatorMetadata(name).doc for name in names}
    listed = table("errors.md", "validator")
    assert dict(listed) == rules and len(listed) == len(rules)


def test_options_that_are_short_for_settings_are_listed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        build_parser().parse_args(["stylize", "--help"])
    parts = " ".join(capsys.readouterr().out.split()).split(" --")
    told = {part.split()[0]: re.findall(r"\((\w+\.\w+)\)", part) for part in parts[1:]}
    told["prim"] = ["stage.prims"]  # its help is about prims
    listed = table("settings.md", "option")
    settings = {option[2:].split()[0]: [name.split("=")[0]] for option, name in listed}
    assert settings == {option: names for option, names in told.items() if names}


@pytest.mark.parametrize(
    ("option", "setting"), [row for row in table("settings.md", "option") if "=" in row[1]]
)
def test_an_option_does_what_its_setting_does(option: str, setting: str) -> None:
    arguments = build_parser().parse_args(["stylize", "shot.usda", "-o", "out", *option.split()])
    assert resolve_config(*given_settings(arguments)) == resolve_config(read_settings([setting]))
    assert resolve_config(read_settings([setting])) != resolve_config({})

"""Validators on what Volumes ask for themselves."""

from pathlib import Path

import pytest

from tests.fixtures.usd_fixtures import (
    density_prim,
    needs_usd,
    sequence,
    world,
    write_sequence,
    write_text,
)
from usdsmoke.usd.rules import Finding, Severity, validate

pytestmark = needs_usd(26, 5)

APPLIED = '(prepend apiSchemas = ["UsdSmokeStyleAPI"])'


def findings(folder: Path, request: str, meta: str = APPLIED) -> list[Finding]:
    """Those about requests."""
    write_sequence(folder, [1])
    body = f"""
    def Volume "smoke" {meta}
    {{
        rel field:density = </World/smoke/density>
        {request.replace("@@", "usdSmoke:request:")}
        {density_prim(sequence([1]))}
    }}
"""
    found = validate(write_text(folder / "s.usda", world(body)))
    return [item for item in found if item.rule.startswith(("Request", "Schema"))]


def test_a_sound_request_finds_nothing(tmp_path: Path) -> None:
    assert findings(tmp_path, "double @@strength = 0.5\nrel @@mask = </World/smoke/density>") == []


@pytest.mark.parametrize(
    ("request_text", "place", "message"),
    [
        ("double @@strength = 2", "strength", "is 2.0"),
        ("double @@gama = 2", "gama", "'usdSmoke:request:gamma'"),
        ("asset[] @@styleImages = [@./no.png@]", "styleImages", "no file is found there"),
        ("rel @@camera = [</a>, </b>]", "camera", "has 2 targets"),
        ("rel @@camera = </World/none>", "camera", "where there is no prim"),
        ("rel @@camera = </World/smoke>", "camera", "is of type Volume"),
        ("rel @@mask = </World>", "mask", "is of type Xform"),
        ('string @@styleImages = "fire.png"', "styleImages", "is 'fire.png'"),
        ("rel @@seed = </World>", "seed", "is a relationship. Author an attribute"),
        ("int64 @@seed.timeSamples = { 1: 1, 2: 3 }", "seed", "changes over time (at timeCode 2)"),
    ],
)
def test_a_wrong_request_is_an_error_at_its_property(
    tmp_path: Path, request_text: str, place: str, message: str
) -> None:
    (finding,) = findings(tmp_path, request_text)
    assert (finding.severity, finding.rule) == (Severity.ERROR, "RequestInvalid")
    assert finding.prim_path == f"/World/smoke.usdSmoke:request:{place}"
    assert message in finding.message


def test_every_wrong_attribute_is_found(tmp_path: Path) -> None:
    found = findings(tmp_path, "double @@strength = 2\nint64 @@seed = -1\nint @@iterations = -1")
    assert [item.prim_path.rpartition(":")[2] for item in found] == [
        "iterations", "seed", "strength",
    ]  # fmt: skip


def test_a_request_without_the_schema_applied_is_a_warning(tmp_path: Path) -> None:
    (finding,) = findings(tmp_path, "double @@strength = 2", meta="")
    assert (finding.severity, finding.rule) == (Severity.WARN, "RequestNotApplied")
    assert finding.prim_path == "/World/smoke"
    assert "usdSmoke:request:strength" in finding.message


def test_a_request_on_a_prim_that_is_no_volume_is_a_warning(tmp_path: Path) -> None:
    text = world('def Mesh "m" (prepend apiSchemas = ["UsdSmokeStyleAPI"]) {}')
    found = validate(write_text(tmp_path / "s.usda", text))
    (finding,) = [item for item in found if item.rule == "RequestMisplaced"]
    assert (finding.severity, finding.prim_path) == (Severity.WARN, "/World/m")
    assert "of type Mesh" in finding.message

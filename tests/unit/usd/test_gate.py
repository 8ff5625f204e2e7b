"""A look is judged apart from its source: the findings that both have are not the look's."""

import json
import xml.etree.ElementTree as ElementTree

import pytest

from tests.fixtures.usd_fixtures import (
    density_prim,
    make_look,
    needs_usd,
    sequence,
    volume_prim,
    world,
    write_sequence,
    write_text,
)
from usdsmoke.base.errors import StageError
from usdsmoke.ui.cli.main import main
from usdsmoke.ui.cli.text import validation_text
from usdsmoke.usd.gate import junit_xml, validate_look
from usdsmoke.usd.rules import Finding, Severity, validate

pytestmark = needs_usd(26, 5)


def test_faults_of_the_source_are_not_the_look_s(tmp_path, capsys):
    write_sequence(tmp_path, [1, 2])
    other = volume_prim(density_prim("asset filePath = @./cache/gone.vdb@"), "other")
    body = volume_prim(density_prim(sequence([1, 2]))) + other
    write_text(tmp_path / "shot.usda", world(body))
    files = make_look(tmp_path / "shot.usda", tmp_path / "out", ours=True, prims=["/World/smoke"])
    assert any(finding.severity == Severity.ERROR for finding in validate(files.root_stage))
    own, of_source = validate_look(files.root_stage)
    assert not [finding for finding in own if finding.severity == Severity.ERROR]
    assert "FieldFileMissing" in {finding.rule for finding in of_source}
    assert main(["validate", str(files.root_stage)]) == 1
    assert main(["validate", "--look-only", str(files.root_stage)]) == 0
    assert "in the source too" in capsys.readouterr().out
    # a fault of the look counts, and is found by CI
    (tmp_path / "out/vdb/smoke.0002.vdb").unlink()
    report = tmp_path / "report.xml"
    command = ["validate", "--look-only", "--json", "--junit", str(report), str(files.root_stage)]
    assert main(command) == 1
    found = json.loads(capsys.readouterr().out)
    assert {item["prim_path"] for item in found["of_source"]} & {"/World/other/density"}
    suite = ElementTree.parse(report).getroot()
    assert int(suite.attrib["failures"]) >= 1
    assert "smoke.0002.vdb" in ElementTree.tostring(suite, encoding="unicode")
    rules = sorted({item["rule"] for item in found["findings"] if item["severity"] == "error"})
    ignored = [word for rule in rules for word in ("--ignore", rule)]
    assert main(["validate", "--look-only", *ignored, str(files.root_stage)]) == 0


@pytest.mark.parametrize("mode", ["sublayer", "reference"])
def test_a_missing_file_of_the_look_that_is_no_field_is_the_looks(tmp_path, mode):
    """OpenUSD's own validator follows the look even where it is muted."""
    write_sequence(tmp_path, [1])
    body = volume_prim(density_prim(sequence([1])))
    write_text(tmp_path / "shot.usda", world(body))
    files = make_look(tmp_path / "shot.usda", tmp_path / "out", ours=True, mode=mode)
    (shader,) = (tmp_path / "out").glob("*.glslfx")
    assert not [f for f in validate_look(files.root_stage)[0] if f.severity == Severity.ERROR]
    shader.unlink()
    own, of_source = validate_look(files.root_stage)
    assert any(shader.name in f.message for f in own if f.severity == Severity.ERROR)
    assert not any(shader.name in f.message for f in of_source)


def test_a_stage_without_a_look_is_refused(tmp_path):
    write_sequence(tmp_path, [1])
    body = volume_prim(density_prim(sequence([1])))
    with pytest.raises(StageError, match="no look"):
        validate_look(write_text(tmp_path / "shot.usda", world(body)))


def test_an_unknown_rule_cannot_be_ignored(tmp_path, capsys):
    write_sequence(tmp_path, [1])
    file_path = write_text(tmp_path / "shot.usda", world(volume_prim(density_prim(sequence([1])))))
    assert main(["validate", str(file_path), "--ignore", "FrameGop"]) == 1
    assert "FrameGap" in capsys.readouterr().err
    assert main(["validate", str(file_path), "--ignore", "VolumeExtentMissing"]) == 0


def test_warnings_fail_on_request(tmp_path, capsys):
    body = volume_prim(density_prim(sequence([1])))
    write_sequence(tmp_path, [1])
    file_path = str(write_text(tmp_path / "shot.usda", world(body)))  # without an extent
    report = tmp_path / "report.xml"
    command = ["validate", file_path, "--json", "--junit", str(report)]

    def ends(*options):
        code = main([*command, *options])
        suite = ElementTree.parse(report).getroot()
        found = json.loads(capsys.readouterr().out)
        return code, found, suite

    code, found, suite = ends()
    rules = {item["rule"] for item in found["findings"] if item["severity"] == "warn"}
    assert (code, found["errors"], suite.attrib["failures"]) == (0, 0, "0") and rules
    code, found, suite = ends("--strict")
    assert code == 1 and int(suite.attrib["failures"]) == len(rules)
    code, found, suite = ends("--strict", *(w for rule in rules for w in ("--ignore", rule)))
    assert code == 0 and found["ignored"].keys() == rules
    assert int(suite.attrib["skipped"]) == len(rules)


def test_many_findings_of_one_rule_are_a_few_lines():
    many = [Finding(Severity.ERROR, "Many", f"/v{n}", None, f"it is {n}") for n in range(30)]
    one = Finding(Severity.ERROR, "One", "/v0", None, "alone")
    few = validation_text("a.usda", [*many, one], everything=False).splitlines()
    assert len(few) < 8 and "27 more" in few[3] and "alone" in few[4]
    assert few[-1] == "a.usda: 31 errors"
    assert len(validation_text("a.usda", [*many, one]).splitlines()) == 32


def test_junit_passes_without_errors_and_survives_any_text():
    assert ElementTree.fromstring(junit_xml("a", [])).attrib["failures"] == "0"
    warning = Finding(Severity.WARN, "GridMissing", "/a", 1.0, "<&\x00\x1b \U0001f4a8")
    suite = ElementTree.fromstring(junit_xml("a<b", [warning]))
    assert suite.attrib["failures"] == "0" and suite.find("testcase/system-out") is not None

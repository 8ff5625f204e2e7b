"""The volume validators: each finds its own fault, names prim and timeCode, and is silent else."""

import json
import os
import subprocess
import sys

import pytest
from pxr import Sdf, Usd

import usdsmoke
from tests.fixtures.usd_fixtures import (
    density_prim,
    needs_usd,
    plume_stage,
    sampled,
    sequence,
    volume_prim,
    world,
    write_empty,
    write_sequence,
    write_text,
    write_vdb,
)
from usdsmoke.base.errors import StageError
from usdsmoke.usd.rules import PREFIX, Severity, register_validators, validate
from usdsmoke.vdb import header

UsdValidation = pytest.importorskip("pxr.UsdValidation")
pytestmark = needs_usd(26, 5)

DENSITY = "/World/smoke/density"
FILE = "asset filePath = @./cache/smoke.0001.vdb@"
EXTENT = "float3[] extent = [(-9, -9, -9), (9, 9, 9)]\n"
TWO = "rel field:density = </World/smoke/density>\nrel field:temp = </World/smoke/temp>"


def findings(folder, body, relations=None, extent=EXTENT):
    """What ours find on a stage whose Volume has ``body``, after its first file was written."""
    if not (folder / "cache/smoke.0001.vdb").exists():
        write_sequence(folder, [1])
    text = world(volume_prim(extent + body, relations=relations))
    return ours(write_text(folder / "shot.usda", text))


def ours(stage_file):
    return [item for item in validate(stage_file) if ":" not in item.rule]


def only(found, rule):
    """The one finding that there is, of the rule that is meant."""
    assert [item.rule for item in found] == [rule], found
    return found[0]


def test_a_sound_stage_has_no_findings(tmp_path):
    assert validate(plume_stage(tmp_path)) == []


def test_the_rules_stand_in_usds_own_registry():
    names = register_validators()
    assert register_validators() == names
    registry = UsdValidation.ValidationRegistry()
    assert all(registry.HasValidator(name) for name in names)
    assert len(names) == 25
    metadata = registry.GetValidatorMetadata(PREFIX + "GridMissing")
    assert "usdsmoke" in metadata.GetKeywords()
    assert metadata.GetSchemaTypes() == ["UsdVolVolume"]


def test_any_program_can_run_them_through_usd(tmp_path):
    stage_file = plume_stage(tmp_path)
    (tmp_path / "cache/smoke.0003.vdb").unlink()
    validators = UsdValidation.ValidationRegistry().GetOrLoadValidatorsByName(register_validators())
    errors = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(stage_file)))
    assert [str(error.GetIdentifier()) for error in errors] == [
        "usdsmokeValidators:FieldFileMissing.FieldFileMissing"
    ]
    wanted = "timeCode 3: filePath is @./cache/smoke.0003.vdb@: there is no such file"
    assert errors[0].GetMessage().startswith(wanted)


def test_an_older_openusd_is_named_with_the_version_that_is_needed(tmp_path, monkeypatch):
    stage_file = plume_stage(tmp_path)
    monkeypatch.setitem(sys.modules, "pxr.UsdValidation", None)
    monkeypatch.delattr("pxr.UsdValidation", raising=False)
    with pytest.raises(StageError, match=r"OpenUSD 26\.05"):
        validate(stage_file)
    assert usdsmoke.inspect(stage_file)["volumes"]


def test_a_missing_extent_is_found(tmp_path):
    found = only(findings(tmp_path, density_prim(FILE), extent=""), "VolumeExtentMissing")
    assert (found.severity, found.prim_path) == (Severity.WARN, "/World/smoke")


@pytest.mark.parametrize(
    ("relation", "words"),
    [
        ("rel field:temp", "no target"),
        ("rel field:temp = [</World/a>, </World/b>]", "</World/a>, </World/b>"),
        ("rel field:temp = </World/none>", "</World/none>"),
        ("rel field:temp = </World>", "Xform"),
        ("rel field:temp = </World/smoke.extent>", "</World/smoke.extent>"),
    ],
)
def test_a_relationship_that_leads_nowhere_is_found(tmp_path, relation, words):
    relations = f"rel field:density = </World/smoke/density>\n{relation}"
    found = only(findings(tmp_path, density_prim(FILE), relations), "FieldTargetInvalid")
    assert found.severity == Severity.ERROR
    assert found.prim_path == "/World/smoke.field:temp"
    assert words in found.message


@pytest.mark.parametrize(
    ("name", "severity"),
    [("density", Severity.ERROR), ("vel", Severity.WARN), ("velocity_x", Severity.WARN)],
)
def test_a_density_or_velocity_of_another_kind_is_found(tmp_path, name, severity):
    field = density_prim("asset filePath = @./old.f3d@", name).replace("OpenVDB", "Field3D")
    field = field.replace('token fieldClass = "fogVolume"', "")
    body = field if name == "density" else density_prim(FILE) + field
    relations = None if name == "density" else TWO.replace("temp", name)
    found = only(findings(tmp_path, body, relations), "FieldKindUnsupported")
    assert (found.severity, found.prim_path) == (severity, f"/World/smoke.field:{name}")
    for fact in (f"</World/smoke/{name}>", "Field3DAsset", "old.f3d", '"density"', "OpenVDBAsset"):
        assert fact in found.message


def test_other_fields_of_another_kind_are_allowed(tmp_path):
    temp = density_prim("asset filePath = @./old.f3d@", "temp").replace("OpenVDB", "Field3D")
    temp = temp.replace('token fieldClass = "fogVolume"', "")
    assert findings(tmp_path, density_prim(FILE) + temp, TWO) == []


def test_missing_files_are_found_once_a_path_with_their_time_codes(tmp_path):
    write_sequence(tmp_path, [1, 2])
    found = findings(tmp_path, density_prim(sequence([1, 2, 3, 4])))
    assert [(item.rule, item.time_code) for item in found] == [
        ("FieldFileMissing", 3.0),
        ("FieldFileMissing", 4.0),
    ]
    assert found[0].prim_path == DENSITY
    same = sampled("asset filePath", {1: "@./a.vdb@", 2: "@./a.vdb@", 3: "@./a.vdb@"})
    found = only(findings(tmp_path, density_prim(same)), "FieldFileMissing")
    assert found.time_code == 1.0
    assert found.message.endswith("(also at timeCodes 2,3)")
    same = sampled("asset filePath", {1: "@./a.vdb@", 2: "@./a.vdb@"})
    found = only(findings(tmp_path, density_prim(same)), "FieldFileMissing")
    assert found.message.endswith("(also at timeCode 2)")


@pytest.mark.parametrize(
    ("files", "words"),
    [
        *[(text, "filePath is empty") for text in ("", "asset filePath = @@")],
        ("asset filePath = @op:/obj/smoke@", "a node inside Houdini"),
        ("asset filePath = @./notes.vdb@", "notes.vdb is not a valid VDB file"),
        ("asset filePath = @./folder.vdb@", "is a folder"),
    ],
)
def test_a_file_that_cannot_be_read_is_found(tmp_path, files, words):
    write_text(tmp_path / "notes.vdb", "not a volume, but long enough to be looked into")
    (tmp_path / "folder.vdb").mkdir()
    found = only(findings(tmp_path, density_prim(files)), "FieldFileMissing")
    assert found.severity == Severity.ERROR
    assert words in found.message


def test_a_grid_that_the_file_lacks_is_found_with_those_it_has(tmp_path):
    write_vdb(tmp_path / "cache/smoke.0001.vdb", ["temp", "vel"])
    found = only(findings(tmp_path, density_prim(FILE)), "GridMissing")
    assert (found.severity, found.prim_path, found.time_code) == (Severity.ERROR, DENSITY, None)
    assert "temp, vel" in found.message


def test_an_index_beyond_the_grids_of_one_name_is_found(tmp_path):
    write_vdb(tmp_path / "cache/smoke.0001.vdb", ["density", "density"])
    index = sampled("int fieldIndex", {1: "1", 2: "5"})
    found = only(findings(tmp_path, density_prim(FILE, extra=index)), "GridMissing")
    assert found.time_code == 2.0


def test_a_data_type_that_does_not_fit_is_found_and_a_missing_one_noted(tmp_path):
    wrong = density_prim(FILE).replace('"float"', '"float3"')
    found = only(findings(tmp_path, wrong), "FieldTypeMismatch")
    assert found.severity == Severity.ERROR
    assert 'is "float3" but the grid "density" holds float' in found.message
    missing = density_prim(FILE).replace('token fieldDataType = "float"', "")
    assert only(findings(tmp_path, missing), "FieldTypeMismatch").severity == Severity.INFO
    assert findings(tmp_path, density_prim(FILE).replace('"float"', '"half"')) == []


@pytest.mark.parametrize(
    ("token", "grid_class", "wrong"),
    [
        ("levelSet", "fog volume", True),
        ("fogVolume", "level set", True),
        ("fogVolume", "", False),
        ("unknown", "level set", False),
    ],
)
def test_a_class_that_contradicts_the_grids_is_found(tmp_path, token, grid_class, wrong):
    write_vdb(tmp_path / "cache/smoke.0001.vdb", ["temp"], grid_class=grid_class)
    temp = density_prim(FILE, "temp", grid='token fieldName = "temp"').replace("fogVolume", token)
    found = findings(tmp_path, temp, "rel field:temp = </World/smoke/temp>")
    assert [item.rule for item in found] == (["FieldClassMismatch"] if wrong else [])


@pytest.mark.parametrize("token", ["levelSet", "unknown"])
def test_a_density_that_is_a_level_set_is_found_whatever_its_field_says(tmp_path, token):
    files = sampled("asset filePath", {n: f"@./cache/smoke.{n:04d}.vdb@" for n in (1, 2, 3)})
    for n in (1, 3):
        write_vdb(tmp_path / f"cache/smoke.{n:04d}.vdb")
    write_vdb(tmp_path / "cache/smoke.0002.vdb", grid_class="level set")
    body = density_prim(files).replace("fogVolume", token)
    found = [item for item in findings(tmp_path, body) if item.rule != "FieldClassMismatch"]
    error = only(found, "GridUnsupported")
    assert (error.severity, error.prim_path, error.time_code) == (Severity.ERROR, DENSITY, 2.0)
    for fact in ("smoke.0002.vdb", '"density"', "level set", "Convert"):
        assert fact in error.message


def test_a_density_of_vectors_is_found(tmp_path):
    write_vdb(tmp_path / "cache/smoke.0001.vdb", ["vel"])
    body = density_prim(FILE, grid='token fieldName = "vel"').replace('"float"', '"float3"')
    found = [item for item in findings(tmp_path, body) if item.severity == Severity.ERROR]
    assert '"vel"' in only(found, "GridUnsupported").message


def test_what_the_density_may_not_be_other_fields_may_be(tmp_path):
    write_vdb(tmp_path / "cache/smoke.0001.vdb", ["temp"], grid_class="level set")
    temp = density_prim(FILE, "temp", grid='token fieldName = "temp"')
    temp = temp.replace("fogVolume", "levelSet")
    assert findings(tmp_path, temp, "rel field:temp = </World/smoke/temp>") == []


def test_a_token_that_the_schema_does_not_know_is_found(tmp_path):
    body = density_prim(FILE, extra='token vectorDataRoleHint = "Colour"')
    found = only(findings(tmp_path, body), "FieldTokenUnknown")
    assert found.severity == Severity.ERROR
    assert found.prim_path == f"{DENSITY}.vectorDataRoleHint"
    assert '"Colour". Use one of None, Point, Normal, Vector, Color' in found.message


@pytest.mark.parametrize(
    ("codes", "gaps"),
    [
        ([1, 2, 3, 7, 8, 9], [3.0]),
        ([1, 2, 3, 7, 8, 20], [3.0, 8.0]),
        ([1, 3, 5, 7], []),
        ([1, 2], []),
        ([0, 1, 3], [1.0]),
        ([1, 10, 12], []),
        ([1, 1.5, 2, 2.5], []),
    ],
)
def test_a_hole_in_a_regular_sequence_is_found(tmp_path, codes, gaps):
    files = sampled("asset filePath", dict.fromkeys(codes, "@./cache/smoke.0001.vdb@"))
    found = findings(tmp_path, density_prim(files))
    assert [(item.rule, item.time_code) for item in found] == [("FrameGap", gap) for gap in gaps]


def test_a_blocked_sample_inside_a_sequence_is_a_gap(tmp_path):
    values = dict.fromkeys([1, 2, 3, 4, 5], "@./cache/smoke.0001.vdb@") | {4: "None"}
    found = only(findings(tmp_path, density_prim(sampled("asset filePath", values))), "FrameGap")
    assert "between the timeCodes 3 and 5" in found.message


def test_an_absolute_path_is_a_warning(tmp_path):
    write_sequence(tmp_path, [1])
    body = density_prim(f"asset filePath = @{tmp_path}/cache/smoke.0001.vdb@")
    found = only(findings(tmp_path, body), "AbsolutePath")
    assert (found.severity, found.prim_path) == (Severity.WARN, DENSITY)


def test_fields_from_several_files_are_found(tmp_path):
    for code in (1, 2, 3):
        write_vdb(tmp_path / f"cache/smoke.{code:04d}.vdb", ["density", "temp"])
    temp = density_prim(sequence([1, 3]), name="temp", grid='token fieldName = "temp"')
    found = only(
        findings(tmp_path, density_prim(sequence([1, 2, 3])) + temp, TWO), "MixedFilesPerVolume"
    )
    assert (found.severity, found.time_code) == (Severity.WARN, 2.0)
    assert "density in smoke.0002.vdb, temp in smoke.0001.vdb" in found.message
    write_vdb(tmp_path / "other/smoke.0001.vdb", ["temp"])
    write_vdb(tmp_path / "other/smoke.0003.vdb", ["temp"])
    temp = temp.replace("cache/", "other/")
    found = only(findings(tmp_path, density_prim(sequence([1])) + temp, TWO), "MixedFilesPerVolume")
    assert "cache/smoke.0001.vdb, temp in" in found.message and "other/smoke" in found.message


def test_smoke_that_is_known_to_be_empty_needs_no_extent(tmp_path):
    (tmp_path / "cache").mkdir()
    write_empty(tmp_path / "cache/smoke.0001.vdb")
    empty = density_prim(FILE, grid='token fieldName = "emission"')
    assert "VolumeExtentMissing" not in {item.rule for item in findings(tmp_path, empty, extent="")}


def test_an_empty_grid_in_a_file_of_its_own_is_no_fault(tmp_path):
    write_sequence(tmp_path, [1])
    write_empty(tmp_path / "none.vdb")
    relations = TWO.replace("temp", "emission")
    empty = density_prim(
        "asset filePath = @./none.vdb@", "emission", grid='token fieldName = "emission"'
    ).replace('"float"', '"float3"')
    assert findings(tmp_path, density_prim(FILE) + empty, relations) == []


def test_a_relationship_of_another_name_than_its_grid_is_found(tmp_path):
    write_vdb(tmp_path / "cache/smoke.0001.vdb", ["soot"])
    body = density_prim(FILE, grid='token fieldName = "soot"')
    found = only(findings(tmp_path, body), "FieldNameMismatch")
    assert 'field:density shows the grid "soot"' in found.message


def test_split_velocity_components_have_their_usual_names(tmp_path):
    write_vdb(tmp_path / "cache/smoke.0001.vdb", ["density", "vel.x"])
    vel = density_prim(FILE, "vel_x", grid='token fieldName = "vel.x"')
    relations = TWO.replace("temp", "vel_x")
    assert findings(tmp_path, density_prim(FILE) + vel, relations) == []


def test_fields_whose_voxels_do_not_meet_are_found_unless_it_is_velocity(tmp_path):
    write_vdb(tmp_path / "cache/smoke.0001.vdb", ["density", "temp", "vel", "velocity"])
    shift = """
            double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 2: (0.1, 0, 0) }
            uniform token[] xformOpOrder = ["xformOp:translate"]"""
    files = sampled("asset filePath", dict.fromkeys([1, 2], "@./cache/smoke.0001.vdb@"))
    for name, rules in (("temp", ["GridTransformMismatch"]), ("vel", []), ("velocity", [])):
        other = density_prim(files, name, shift, f'token fieldName = "{name}"')
        if name != "temp":
            other = other.replace('"float"', '"float3"').replace("fogVolume", "unknown")
        found = findings(tmp_path, density_prim(files) + other, TWO.replace("temp", name))
        assert sorted(item.rule for item in found) == ["FieldPlaceDiffers", *rules]
        assert {item.time_code for item in found} == {2.0}


def test_stock_validators_are_heard_too_and_nothing_is_said_twice(tmp_path, capfd):
    write_sequence(tmp_path, [1])
    text = world(volume_prim(EXTENT + density_prim("asset filePath = @./gone.vdb@")))
    stage_file = write_text(tmp_path / "shot.usda", text.replace('    upAxis = "Z"\n', ""))
    found = validate(stage_file)
    rules = [item.rule for item in found]
    assert "usdGeomValidators:StageMetadataChecker.MissingUpAxisMetadata" in rules
    assert any(rule.startswith("usdUtilsValidators:MissingReferenceValidator") for rule in rules)
    assert len(set(found)) == len(found)
    order = [list(Severity).index(item.severity) for item in found]
    assert order == sorted(order)
    assert capfd.readouterr() == ("", "")


def test_an_openusd_that_takes_no_validators_from_python_is_named_too(tmp_path, monkeypatch):
    monkeypatch.delattr(UsdValidation.ValidationRegistry, "RegisterPrimValidator")
    _, year, month = Usd.GetVersion()
    with pytest.raises(StageError, match=rf"26\.05.*{year}\.{month:02}"):
        validate(plume_stage(tmp_path))


def test_what_is_no_stage_is_refused(tmp_path):
    with pytest.raises(StageError, match=r"no file .*none\.usda"):
        validate(tmp_path / "none.usda")


def test_a_long_sequence_reads_every_header_once(tmp_path, monkeypatch):
    codes = list(range(1, 61))
    write_sequence(tmp_path, codes)
    for file_path in tmp_path.rglob("*.vdb"):
        os.utime(file_path, (0, 0))  # a file that has just been written is read again
    read, now = [], header._read_now
    monkeypatch.setattr(header, "_read_now", lambda path: read.append(path) or now(path))
    assert findings(tmp_path, density_prim(sequence(codes))) == []
    assert len(read) == len(set(read)) == 60


def test_validating_never_loads_torch_or_openvdb(tmp_path):
    stage_file = plume_stage(tmp_path)
    code = f"""
import sys, json
from usdsmoke.usd.rules import validate
found = validate({str(stage_file)!r})
loaded = [name for name in ("torch", "openvdb", "pyopenvdb") if name in sys.modules]
print(json.dumps([len(found), loaded]))
"""
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )  # fmt: skip
    assert json.loads(answer.stdout) == [0, []]
    assert answer.stderr == ""


def test_a_finding_may_quote_bytes_that_are_no_utf8(tmp_path):
    write_sequence(tmp_path, (1,))
    body = volume_prim(density_prim(sequence((1,))).replace("token", "Zq9xJ", 1))  # a type's name
    crate = tmp_path / "shot.usdc"
    Sdf.Layer.FindOrOpen(str(write_text(tmp_path / "shot.usda", world(body)))).Export(str(crate))
    assert b"Zq9xJ" in crate.read_bytes()
    crate.write_bytes(crate.read_bytes().replace(b"Zq9xJ", b"Zq\xffxJ"))
    assert any("Zq\ufffdxJ" in finding.message for finding in validate(crate))

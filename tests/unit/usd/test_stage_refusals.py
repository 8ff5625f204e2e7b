"""What is refused on the way in: each with the prim, what was found, and what to do."""

import os
import re
import zipfile

import pytest
from pxr import Sdf, Usd

from tests.fixtures.usd_fixtures import (
    HEADER,
    density_prim,
    needs_usd,
    plume_stage,
    sampled,
    sequence,
    volume_prim,
    world,
    write_sequence,
    write_text,
    write_vdb,
)
from usdsmoke.base.errors import AssetNotResolved, FieldNotFound, StageError, VolumeNotFound
from usdsmoke.config.run_sections import StageConfig
from usdsmoke.usd.look.root import copy_stage_metadata
from usdsmoke.usd.rules import validate
from usdsmoke.usd.stage import find_volumes, open_stage

DEFAULT = "asset filePath = @./cache/smoke.0001.vdb@"


def refuse(folder, body, error, reason, header=HEADER, **settings):
    stage = open_stage(write_text(folder / "shot.usda", world(body, header)))
    with pytest.raises(error, match=reason):
        find_volumes(stage, StageConfig(**settings))


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("none.usda", None, r"there is no file .*none\.usda"),
        (
            "bad.usda",
            '#usda 1.0\ndef Xform "a" {',
            r"bad\.usda.* valid \.usda file \(line [23]\b.*\)",
        ),
        (
            "bad.usda",
            "#usda 1.0\n(\n    framesPerSecond = nan\n)\n",
            r"bad\.usda.* valid \.usda file \(line 3: .*framesPerSecond",
        ),
        ("bad.usdc", "PXR-USDC nonsense", r"bad\.usdc.*too small.* damaged"),
        ("notes.txt", "hello", r"notes\.txt.* not a USD file.*\.usda"),
    ],
)
def test_a_file_that_is_no_stage_is_refused_in_one_line(tmp_path, capfd, name, content, reason):
    if content is not None:
        write_text(tmp_path / name, content)
    with pytest.raises(StageError, match=reason) as caught:
        open_stage(tmp_path / name)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_a_folder_instead_of_a_stage_is_refused(tmp_path):
    with pytest.raises(StageError, match=r"is a folder.*\.usda"):
        open_stage(tmp_path)


def test_what_the_system_refuses_to_open_is_named_with_its_reason(tmp_path, monkeypatch):
    stage_file = write_text(tmp_path / "bad.usda", "no usd at all")

    def refused(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("builtins.open", refused)
    with pytest.raises(StageError, match=r"bad\.usda.*Permission denied.*permissions"):
        open_stage(stage_file)


def test_bytes_that_are_no_text_are_named_by_their_line(tmp_path):
    file_path = tmp_path / "bad.usda"
    file_path.write_bytes(b'#usda 1.0\ndef Volume "a\xff" {}')
    with pytest.raises(
        StageError, match=r"bad\.usda.* valid \.usda file \(line 2\b[^:]*(: [^:]*)?\)"
    ):
        open_stage(file_path)


def test_a_value_that_usd_cannot_read_is_a_problem_of_the_stage(tmp_path):
    write_sequence(tmp_path, [1])
    moved = 'token xformOp:translate = "far"\nuniform token[] xformOpOrder = ["xformOp:translate"]'
    body = volume_prim(moved + density_prim(sequence([1])))
    refuse(tmp_path, body, StageError, "a value that cannot be read.*Repair")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("timeCodesPerSecond", "0"),
        ("timeCodesPerSecond", "-1"),
        ("metersPerUnit", "0"),
        ("metersPerUnit", "nan"),
        ("framesPerSecond", "inf"),  # OpenUSD refuses the others itself
    ],
)
def test_a_rate_or_unit_that_is_not_positive_is_refused(tmp_path, name, value):
    header = re.sub(rf"\b{name} = .*", f"{name} = {value}", HEADER)
    assert header != HEADER
    write_sequence(tmp_path, [1])
    body = volume_prim(density_prim(sequence([1])))
    refuse(tmp_path, body, StageError, rf"{name} of .*shot\.usda is {value}\b", header=header)


@pytest.mark.parametrize(("name", "value"), [("startTimeCode", "<>"), ("endTimeCode", "nan")])
def test_a_first_or_last_time_that_is_no_number_is_refused(tmp_path, name, value):
    header = re.sub(rf"\b{name} = .*\n", "", HEADER).replace("(", f"(\n    {name} = {value}", 1)
    write_sequence(tmp_path, [1])
    body = volume_prim(density_prim(sequence([1])))
    refuse(tmp_path, body, StageError, rf"{name} of .*shot\.usda is", header=header)


def test_metadata_of_another_type_cannot_be_copied(tmp_path):
    source, layer = Sdf.Layer.CreateAnonymous(), Sdf.Layer.CreateAnonymous()
    source.ImportFromString("#usda 1.0\n(\n    startTimeCode = <>\n)\n")
    with pytest.raises(StageError, match=r"startTimeCode of .*type"):
        copy_stage_metadata(Usd.Stage.Open(source), layer, tmp_path)


def test_a_text_that_is_no_utf8_is_a_problem_of_the_stage(tmp_path):
    write_sequence(tmp_path, [1])
    asked = 'uniform token[] usdSmoke:request:steps = ["Zq9xJ"]\n'
    body = volume_prim(asked + density_prim(sequence([1])))
    body = body.replace('"smoke"', '"smoke" (prepend apiSchemas = ["UsdSmokeStyleAPI"])', 1)
    crate = tmp_path / "shot.usdc"
    Sdf.Layer.FindOrOpen(str(write_text(tmp_path / "shot.usda", world(body)))).Export(str(crate))
    crate.write_bytes(crate.read_bytes().replace(b"Zq9xJ", b"Zq\xffxJ"))
    with pytest.raises(StageError, match=r"Zq\ufffdxJ.*UTF-8"):
        find_volumes(open_stage(crate), StageConfig())


def test_a_stage_without_volumes_is_refused(tmp_path):
    refuse(tmp_path, 'def Mesh "m" {}', VolumeNotFound, "no Volume on the stage .*meshes")


def test_a_stage_without_volumes_is_refused_also_by_the_oldest_usd(tmp_path, monkeypatch):
    monkeypatch.delattr(Usd.Stage, "GetCompositionErrors", raising=False)  # it came with 24.08
    refuse(tmp_path, 'def Mesh "m" {}', VolumeNotFound, "no Volume on the stage")


@needs_usd(24, 8)
def test_a_broken_arc_is_named_where_the_volume_may_lie_behind_it(tmp_path, capfd):
    body = 'def "smoke" (references = @./gone.usda@) {}'
    refuse(tmp_path, body, VolumeNotFound, r"missing.*gone\.usda")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        ("/World/fire", "no prim </World/fire> .* </World/smoke>"),
        ("/World/empty", "</World/empty> is of type Xform.*</World/smoke>"),
        ("/World/plain", "</World/plain> is of no type.*</World/smoke>"),
        ("/World/off", "</World/off> is inactive"),
        ("World/smoke", "'World/smoke' is not"),
        ("/World/smoke.extent", "smoke.extent' is not a prim path"),
        ("a b", "'a b' is not"),
    ],
)
def test_a_named_prim_that_is_no_volume_is_refused_with_those_there_are(tmp_path, path, reason):
    write_sequence(tmp_path, [1])
    body = (
        volume_prim(density_prim(DEFAULT))
        + 'def "plain" {}\ndef Xform "empty" {}\ndef Volume "off" (active=false) {}'
    )
    refuse(tmp_path, body, VolumeNotFound, reason, prims=[path])


def test_an_instance_proxy_is_refused_with_its_source(tmp_path):
    write_sequence(tmp_path, [1])
    body = f"""
    class "source"
    {{
        def Volume "v" {{ rel field:density = </World/source/v/density>\n{density_prim(DEFAULT)} }}
    }}
    def "copy" (instanceable = true
                references = </World/source>) {{}}
"""
    reason = "</World/copy/v>: it is inside the instance </World/copy>.*</World/source/v>"
    refuse(tmp_path, body, StageError, reason)
    refuse(tmp_path, body, StageError, "set instanceable = false", prims=["/World/copy/v"])
    outside = body + volume_prim("", relations="rel field:density = </World/copy/v/density>")
    reason = "cannot change the field </World/copy/v/density>"
    refuse(tmp_path, outside, StageError, reason, prims=["/World/smoke"])


def test_a_level_set_is_not_proposed_as_the_density(tmp_path):
    surface = density_prim(DEFAULT, "ball").replace("fogVolume", "levelSet")
    body = volume_prim(surface, relations="rel field:ball = </World/smoke/ball>")
    refuse(tmp_path, body, FieldNotFound, r"field:ball\).*level set(?!.*stage\.density)")


@pytest.mark.parametrize(
    ("relations", "reason"),
    [
        ("", r'no relationship "field:density" .*none'),
        (
            "rel field:temp = </World/smoke/t>",
            'no relationship "field:density" .*field:temp',
        ),
        ("rel field:density", "has no target"),
        ("rel field:density = </World/none>", "leads to </World/none>, where there is no prim"),
        ("rel field:density = </World>", "leads to </World>, which is of type Xform"),
        ("rel field:density = [</World/a>, </World/b>]", "has 2 targets"),
        ("rel field:density = </World/smoke.extent>", "where there is no prim"),
    ],
)
def test_a_density_that_leads_nowhere_is_refused(tmp_path, relations, reason):
    refuse(tmp_path, volume_prim("", relations=relations), FieldNotFound, reason)


@pytest.mark.parametrize(
    ("asset", "reason"),
    [
        ("@@", "is @@, authored in .*shot.usda: "),
        ("@./none.vdb@", "@./none.vdb@, authored in .*shot.usda: there is no such file"),
        ("@op:/obj/smoke/cache@", r"a node inside Houdini"),
        ("@./box.usdz[smoke.vdb]@", r"inside the package .*box\.usdz"),
        ("@./folder.vdb@", r"folder\.vdb is a folder"),
    ],
)
def test_a_path_that_is_no_file_on_disk_is_refused(tmp_path, asset, reason):
    (tmp_path / "folder.vdb").mkdir()
    write_vdb(tmp_path / "smoke.vdb")
    with zipfile.ZipFile(tmp_path / "box.usdz", "w") as package:
        package.write(tmp_path / "smoke.vdb", "smoke.vdb")
    body = volume_prim(density_prim(f"asset filePath = {asset}"))
    refuse(tmp_path, body, AssetNotResolved, reason)


def packed_shot(folder):
    """A stage whose two fields, of two timeCodes each, lie inside a package."""
    with zipfile.ZipFile(folder / "box.usdz", "w") as package:
        for code in (1, 2):
            package.write(write_vdb(folder / f"{code}.vdb"), f"in/{code}.vdb")
    files = sampled("asset filePath", {code: f"@./box.usdz[in/{code}.vdb]@" for code in (1, 2)})
    other = sampled("asset filePath", {code: f"@./box.usdz[in/{3 - code}.vdb]@" for code in (1, 2)})
    relations = "\n".join(f"rel field:{n} = </World/smoke/{n}>" for n in ("density", "heat"))
    body = density_prim(files) + density_prim(other, "heat")
    return write_text(folder / "shot.usda", world(volume_prim(body, relations=relations)))


def test_no_timecode_can_be_left_out_where_all_lie_in_a_package(tmp_path):
    with pytest.raises(AssetNotResolved, match="the package") as caught:
        find_volumes(open_stage(packed_shot(tmp_path)), StageConfig())
    assert "--allow-missing" not in str(caught.value)


@needs_usd(26, 5)
def test_a_package_is_one_finding_and_names_in_it_are_whole(tmp_path):
    found = validate(packed_shot(tmp_path))
    (missing,) = [item.message for item in found if item.rule == "FieldFileMissing"]
    assert "density, heat" in missing and "box.usdz" in missing
    (mixed,) = [item.message for item in found if item.rule == "MixedFilesPerVolume"]
    assert "density in 1.vdb, heat in 2.vdb" in mixed


def test_a_field_without_any_file_path_is_refused(tmp_path):
    reason = "</World/smoke/density> of Volume </World/smoke> has no filePath at any timeCode"
    refuse(tmp_path, volume_prim(density_prim("")), AssetNotResolved, reason)
    blocked = density_prim(sampled("asset filePath", {1: "None", 2: "None"}))
    refuse(tmp_path, volume_prim(blocked), AssetNotResolved, reason)


def test_all_missing_files_are_named_at_once(tmp_path):
    write_sequence(tmp_path, [1])
    body = volume_prim(density_prim(sequence([1, 2, 3, 4, 9])))
    reason = r"</World/smoke/density> at timeCode 2 is .*0002\.vdb@.*timeCodes 3,4,9\)"
    refuse(tmp_path, body, AssetNotResolved, reason)


def test_a_missing_velocity_file_is_refused_too(tmp_path):
    write_sequence(tmp_path, [1])
    relations = "rel field:density = </World/smoke/density>\nrel field:vel = </World/smoke/vel>"
    body = density_prim(DEFAULT) + density_prim("asset filePath = @./v.vdb@", name="vel")
    refuse(tmp_path, volume_prim(body, relations=relations), AssetNotResolved, "</World/smoke/vel>")


@pytest.mark.parametrize(
    ("frames", "reason"),
    [
        ("9", r"no density is authored at timeCode 9 .*</World/smoke> has 1-4"),
        ("0", "at timeCode 0 .*</World/smoke> has 1-4"),
        ("1,2.5", r"at timeCode 2\.5"),
        ("2-9", r"at timeCode 9 .*--allow-missing"),  # a farm would deliver a short shot
        ("10-20", "at any timeCode in '10-20' .*</World/smoke> has 1-4"),
    ],
)
def test_time_codes_that_do_not_exist_are_refused_with_those_that_do(tmp_path, frames, reason):
    with pytest.raises(StageError, match=reason):
        find_volumes(open_stage(plume_stage(tmp_path)), StageConfig(frames=frames))


def test_a_single_frame_inside_a_gap_is_refused(tmp_path):
    write_sequence(tmp_path, [1, 3])
    values = {1: "@./cache/smoke.0001.vdb@", 2: "None", 3: "@./cache/smoke.0003.vdb@"}
    body = volume_prim(density_prim(sampled("asset filePath", values)))
    refuse(tmp_path, body, StageError, "at timeCode 2 .*</World/smoke> has 1,3", frames="2")


def test_frames_of_a_still_volume_are_refused(tmp_path):
    write_sequence(tmp_path, [1])
    body = volume_prim(density_prim("asset filePath = @./cache/smoke.0001.vdb@"))
    refuse(tmp_path, body, StageError, "has 1 and is not animated", frames="5")


def test_a_named_volume_without_selected_frames_is_refused(tmp_path):
    write_sequence(tmp_path, [1, 2, 3])
    body = volume_prim(density_prim(sequence([1, 2])), name="early") + volume_prim(
        density_prim(sequence([3])), name="late"
    )
    reason = r"</World/early>.* timeCodes 1,2, none .* '3'"
    names = ["/World/early", "/World/late"]
    refuse(tmp_path, body, StageError, reason, frames="3", prims=names)


@pytest.mark.parametrize("frames", ["9", "7-9"])
def test_no_frame_at_all_is_refused_even_where_frames_may_be_missing(tmp_path, frames):
    config = StageConfig(frames=frames, allow_missing=True)
    with pytest.raises(StageError, match="</World/smoke> has 1-4"):
        find_volumes(open_stage(plume_stage(tmp_path)), config)
    for file_path in (tmp_path / "cache").iterdir():
        file_path.unlink()
    with pytest.raises(StageError, match=r"timeCodes 1-4.*Choose other frames"):
        find_volumes(open_stage(tmp_path / "shot.usda"), StageConfig(allow_missing=True))


def test_a_gap_inside_a_range_is_named(tmp_path):
    stage_file = plume_stage(tmp_path)
    text = stage_file.read_text()
    stage_file.write_text(text.replace("3: @./cache/smoke.0003.vdb@,", ""))
    source = find_volumes(open_stage(stage_file), StageConfig(frames="1-4"))
    assert [frame.time_code for frame in source.volumes[0].frames] == [1, 2, 4]
    (sentence,) = source.missing
    assert "between 2 and 4" in sentence and "1-4" in sentence
    assert find_volumes(open_stage(stage_file), StageConfig(frames="1-2,4")).missing == ()
    assert find_volumes(open_stage(stage_file), StageConfig()).missing == ()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_an_unreadable_stage_is_refused(tmp_path):
    stage_file = plume_stage(tmp_path)
    stage_file.chmod(0)
    with pytest.raises(StageError, match=r"permissions"):
        open_stage(stage_file)


def test_an_up_axis_that_no_view_turns_around_is_refused(tmp_path):
    header = re.sub(r"upAxis = .*", 'upAxis = "X"', HEADER)
    write_sequence(tmp_path, [1])
    body = volume_prim(density_prim(sequence([1])))
    refuse(tmp_path, body, StageError, "upAxis", header=header)


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ('token fieldName = "density"', "int fieldName = 3"),
        ('token fieldName = "density"', 'smoke fieldName = "density"'),  # a type USD does not know
        ('token fieldName = "density"', 'string fieldIndex = "a"'),
        (DEFAULT, 'string filePath = "./cache/smoke.0001.vdb"'),
    ],
)
def test_values_of_another_type_than_the_schemas_count_as_none(tmp_path, right, wrong):
    write_sequence(tmp_path, (1,))
    body = density_prim(DEFAULT).replace(right, wrong)
    stage = open_stage(write_text(tmp_path / "shot.usda", world(volume_prim(body))))
    if "filePath" in wrong:
        with pytest.raises(AssetNotResolved, match="has no filePath at any timeCode"):
            find_volumes(stage, StageConfig())
    else:
        (frame,) = find_volumes(stage, StageConfig()).volumes[0].frames
        assert (frame.fields["density"].grid_name, frame.fields["density"].grid_index) == ("", None)
    assert any("TypeMismatch" in finding.rule for finding in validate(stage))

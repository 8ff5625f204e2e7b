"""What verify notices, each kind of change by its name; and its silence where there is none."""

import json
import re
import shutil
from pathlib import Path

import pytest
from PIL import Image
from pxr import Sdf

from tests.fixtures.pipeline_fixtures import FakeCore, Shot, make_shot, run
from tests.fixtures.usd_fixtures import needs_usd, write_vdb
from usdsmoke.audit import Change, verification, verify
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.pipeline import StylizeResult, assemble
from usdsmoke.ui.cli.main import main
from usdsmoke.usd.rules import validate
from usdsmoke.vdb.binding import find_binding
from usdsmoke.vdb.read import GridRequest, read_grids
from usdsmoke.vdb.write import write_frame
from usdsmoke.vdb.written import State, Written

Finished = tuple[Shot, StylizeResult]


@pytest.fixture
def finished(shot: Shot, core: FakeCore) -> Finished:
    return shot, run(shot)


def only(finished: Finished) -> Change:
    """The one change there is, as every way to the record tells it."""
    shot, result = finished
    changes = verify(result.look_layer)
    assert verify(shot.output) == verify(str(result.root_stage)) == changes
    (change,) = changes
    return change


def test_an_untouched_result_is_as_recorded(
    finished: Finished, capsys: pytest.CaptureFixture[str]
) -> None:
    shot, result = finished
    assert verify(result.root_stage) == []
    assert main(["verify", str(shot.output)]) == 0
    assert capsys.readouterr().out == f"{shot.output}: as recorded\n"


def test_an_untouched_result_in_a_moved_folder_is_as_recorded(finished: Finished) -> None:
    shot, result = finished
    moved = shot.folder.with_name(f"{shot.folder.name}_elsewhere")
    shutil.move(shot.folder, moved)
    assert verify(moved / "out") == []
    assert verify(moved / "out" / result.frames[0].relative_to(shot.output)) == []


def test_an_input_with_other_voxels_is_named(finished: Finished) -> None:
    file = finished[0].stage.parent / "cache/smoke.0002.vdb"
    write_vdb(file, value=0.125)
    change = only(finished)
    assert (change.kind, change.severity, change.file) == ("input-edited", "changed", str(file))
    assert change.expected.startswith("density ") and change.expected != f"density {change.found}"


@needs_usd(26, 5)
def test_another_shader_of_the_look_s_material_is_named(finished: Finished) -> None:
    shot, result = finished
    shader = shot.output / "look.glslfx"
    assert not [item for item in validate(result.root_stage) if item.rule == "ResultChanged"]
    shader.write_text(shader.read_text() + "// mine\n")
    change = only(finished)
    assert (change.kind, change.severity, change.file) == ("result-edited", "changed", str(shader))
    (found,) = [item for item in validate(result.root_stage) if item.rule == "ResultChanged"]
    assert found.severity == "error" and "look.glslfx" in found.message
    shader.unlink()
    assemble(shot.output)
    assert verify(result.root_stage) == []


def test_changes_are_told_in_words_and_hashes_on_request(
    finished: Finished, capsys: pytest.CaptureFixture[str]
) -> None:
    shot, result = finished
    write_vdb(shot.stage.parent / "cache/smoke.0002.vdb", value=0.125)
    result.frames[2].unlink()
    (edited, missing) = sorted(verify(shot.output), key=lambda change: change.kind)
    hashes = [edited.expected.split()[-1], edited.found.split(",")[0], missing.expected.split()[-1]]
    assert main(["verify", str(shot.output)]) == 1
    few = capsys.readouterr().out
    assert "smoke.0002.vdb: density changed, written 20" in few and "found no file" in few
    assert main(["verify", str(shot.output), "--verbose"]) == 1
    whole = capsys.readouterr().out
    assert all(digest in whole and digest not in few for digest in hashes)
    assert str(result.frames[2]) in few  # its folder is named by digits too


def test_an_input_that_was_written_anew_with_the_same_grids_is_a_note(finished: Finished) -> None:
    file = finished[0].stage.parent / "cache/smoke.0002.vdb"
    before = file.read_bytes()
    write_vdb(file, value=0.5 + 2 / 8)
    assert file.read_bytes() != before
    change = only(finished)
    assert (change.kind, change.severity, change.file) == ("input-rewritten", "note", str(file))


@pytest.mark.usefixtures("core")
def test_another_velocity_in_a_file_of_the_same_density_is_an_edited_input(tmp_path: Path) -> None:
    shot = make_shot(tmp_path, names=("density", "vel"))
    done = shot, run(shot)
    file = shot.stage.parent / "cache/smoke.0001.vdb"
    assert verify(done[1].look_layer) == []
    config = GridsConfig()
    density, velocity = read_grids(file, [GridRequest("density"), GridRequest("vel")], config)
    velocity.values[0, 0, 0] += 1
    write_frame(file, [density, velocity], {}, False, config)
    change = only(done)
    assert change.kind == "input-edited" and change.expected.startswith("vel ")


@pytest.mark.usefixtures("core")
def test_a_velocity_that_is_only_copied_is_compared_too(tmp_path: Path) -> None:
    shot = make_shot(tmp_path, names=("density", "vel"))
    done = shot, run(shot, "layer.copy_velocity=true")
    file = shot.stage.parent / "cache/smoke.0003.vdb"
    before = file.read_bytes()
    write_vdb(file, ("density", "vel"), value=0.5 + 3 / 8)
    assert file.read_bytes() != before
    change = only(done)
    assert (change.kind, change.severity) == ("input-rewritten", "note")
    assert "vel" not in change.found
    density, velocity = read_grids(
        file, [GridRequest("density"), GridRequest("vel")], GridsConfig()
    )
    velocity.values[0, 0, 0] += 1
    write_frame(file, [density, velocity], {}, False, GridsConfig())
    assert only(done).expected.startswith("vel ")
    write_vdb(file, ("density", "vel"), value=0.125)
    assert {change.expected.split()[0] for change in verify(done[1].look_layer)} >= {"density"}


def test_an_input_that_is_gone_is_named(finished: Finished) -> None:
    file = finished[0].stage.parent / "cache/smoke.0003.vdb"
    file.unlink()
    changes = verify(finished[1].look_layer)
    assert [(c.kind, c.file) for c in changes if c.severity == "changed"] == [
        ("input-missing", str(file))
    ]


def test_a_changed_value_of_the_stage_is_named(finished: Finished) -> None:
    stage = finished[0].stage
    stage.write_text(stage.read_text().replace("metersPerUnit = 0.5", "metersPerUnit = 0.25"))
    change = only(finished)
    assert (change.kind, change.file) == ("stage-edited", str(stage))
    assert (change.expected, change.found) == ("metersPerUnit 0.5", "metersPerUnit 0.25")


def test_a_moved_volume_is_a_changed_stage(finished: Finished) -> None:
    layer = Sdf.Layer.OpenAsAnonymous(str(finished[0].stage))
    prim = layer.GetPrimAtPath("/World/smoke")
    Sdf.AttributeSpec(prim, "xformOp:translate", Sdf.ValueTypeNames.Double3).default = (1, 0, 0)
    order = Sdf.AttributeSpec(prim, "xformOpOrder", Sdf.ValueTypeNames.TokenArray)
    order.default = ["xformOp:translate"]
    layer.Export(str(finished[0].stage))
    change = only(finished)
    assert change.kind == "stage-edited" and change.expected.startswith("</World/smoke> ")
    assert "(a transform)" in change.found


def test_what_the_volume_has_nothing_to_do_with_may_change(finished: Finished) -> None:
    stage = finished[0].stage
    stage.write_text(stage.read_text() + '\ndef Sphere "other"\n{\n}\n')
    assert verify(finished[1].look_layer) == []


def test_a_stage_that_is_gone_is_named(finished: Finished) -> None:
    finished[0].stage.unlink()
    (change,) = verify(finished[1].look_layer)
    assert (change.kind, change.file) == ("stage-missing", str(finished[0].stage))


def test_another_style_image_under_the_same_name_is_named(finished: Finished) -> None:
    Image.new("RGB", (24, 16), (9, 8, 7)).save(finished[0].style)
    change = only(finished)
    assert (change.kind, change.file) == ("style-edited", str(finished[0].style))


def test_a_style_image_that_is_gone_is_named(finished: Finished) -> None:
    finished[0].style.unlink()
    change = only(finished)
    assert (change.kind, change.file) == ("style-missing", str(finished[0].style))


def test_a_changed_stage_is_named_though_the_style_image_is_gone(finished: Finished) -> None:
    stage = finished[0].stage
    finished[0].style.unlink()
    stage.write_text(stage.read_text().replace("metersPerUnit = 0.5", "metersPerUnit = 0.25"))
    kinds = [change.kind for change in verify(finished[1].look_layer)]
    assert kinds == ["stage-edited", "style-missing"]


def test_a_result_that_is_gone_is_named(finished: Finished) -> None:
    finished[1].frames[1].unlink()
    change = only(finished)
    assert (change.kind, change.file) == ("result-missing", str(finished[1].frames[1]))


@pytest.mark.parametrize("what", ["root", "run", "damage"])
def test_what_shows_and_repeats_a_result_is_noted_where_it_is_gone(
    what: str, finished: Finished
) -> None:
    shot, result = finished
    (run_file,) = shot.output.glob("vdb/*/run.json")
    if what == "damage":
        run_file.write_text("{")
    else:
        (run_file if what == "run" else result.root_stage).unlink()
    (change,) = verify(result.look_layer)
    kinds = {"root": "root-missing", "run": "run-missing", "damage": "run-damaged"}
    assert (change.kind, change.severity) == (kinds[what], "note")


def test_files_are_looked_for_too_where_the_stage_is_gone(finished: Finished) -> None:
    shot, result = finished
    shot.stage.unlink()
    gone = shot.stage.parent / "cache/smoke.0002.vdb"
    gone.unlink()
    kinds = {change.kind: change.file for change in verify(result.look_layer)}
    assert kinds == {"stage-missing": str(shot.stage), "input-missing": str(gone)}


def test_a_shader_of_the_look_that_is_gone_is_named(finished: Finished) -> None:
    (shader,) = finished[0].output.glob("*.glslfx")
    shader.unlink()
    change = only(finished)
    assert (change.kind, change.file) == ("result-missing", str(shader))


def test_a_result_with_another_frame_in_its_place_is_named(finished: Finished) -> None:
    first, second, _ = finished[1].frames
    shutil.copyfile(first, second)
    change = only(finished)
    assert (change.kind, change.file) == ("result-replaced", str(second))


def test_a_result_with_edited_voxels_and_its_old_metadata_is_named(finished: Finished) -> None:
    openvdb, file = find_binding(), str(finished[1].frames[1])
    grids, metadata = openvdb.readAll(file)
    (density,) = [grid for grid in grids if grid.name == "density"]
    density.fill((0, 0, 0), (0, 0, 0), 5.0)
    openvdb.write(file, grids=grids, metadata=metadata)
    change = only(finished)
    assert (change.kind, change.file) == ("result-edited", file)


def test_a_result_with_the_same_grids_in_other_bytes_is_noted(finished: Finished) -> None:
    openvdb, file = find_binding(), str(finished[1].frames[1])
    grids, metadata = openvdb.readAll(file)
    openvdb.write(file, grids=grids, metadata={**metadata, "comment": "written anew"})
    change = only(finished)
    assert (change.kind, change.severity, change.file) == ("result-rewritten", "note", file)


@pytest.mark.parametrize("is_damaged", [False, True])
def test_bytes_are_compared_where_grids_are_not(
    finished: Finished, monkeypatch: pytest.MonkeyPatch, is_damaged: bool
) -> None:
    unread = Written(State.UNCHECKED, "no memory")
    monkeypatch.setattr(verification, "compare_written", lambda *_: unread)
    first, *others = finished[1].frames
    if is_damaged:
        damage(first)
    kinds = {change.file: change.kind for change in verify(finished[1].look_layer)}
    assert kinds.pop(str(first)) == ("result-edited" if is_damaged else "unchecked")
    assert kinds == {str(file): "unchecked" for file in others}


def damage(file: Path) -> None:
    """Turn one bit in the middle of a file."""
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)


def test_a_look_edited_by_hand_is_named(finished: Finished) -> None:
    look = finished[1].look_layer
    text = look.read_text()
    edited = text.replace("usdSmoke:extinctionPerDensity = 2", "usdSmoke:extinctionPerDensity = 3")
    assert edited != text
    look.write_text(edited)
    change = only(finished)
    assert (change.kind, change.file) == ("layer-edited", str(look))


def test_an_edited_record_is_named(finished: Finished) -> None:
    look = finished[1].look_layer
    text = look.read_text()
    edited = re.sub(r'(seed.?": )0', r"\g<1>1", text, count=1)
    assert edited != text
    look.write_text(edited)
    change = only(finished)
    assert (change.kind, change.file) == ("record-edited", str(look))


@pytest.mark.parametrize("key", ["tool", "version", "look", "stage"])
def test_an_edited_plain_value_is_an_edited_record(finished: Finished, key: str) -> None:
    look = finished[1].look_layer
    edit_values(look, **{key: "other"})
    assert [change.kind for change in verify(look)] == ["record-edited"]


@pytest.mark.parametrize("key", ["settings", "frames", "source_files", "results", "packages"])
@pytest.mark.parametrize("value", ["{", 7, None])
def test_a_damaged_record_is_an_edited_record_and_stops_nothing(
    finished: Finished, key: str, value: object
) -> None:
    look = finished[1].look_layer
    values = Sdf.Layer.OpenAsAnonymous(str(look)).customLayerData["usdsmoke"]
    record = {**json.loads(values["record"]), key: value}
    edit_values(look, record=json.dumps(record))
    assert [change.kind for change in verify(look)] == ["record-edited"]


def edit_values(file: Path, **values: str) -> None:
    """Put texts into the record of a look layer."""
    layer = Sdf.Layer.OpenAsAnonymous(str(file))
    data = dict(layer.customLayerData)
    layer.customLayerData = {**data, "usdsmoke": {**data["usdsmoke"], **values}}
    layer.Export(str(file))


def test_an_edited_input_of_a_frame_that_the_stage_no_longer_has_is_named(
    finished: Finished,
) -> None:
    stage = finished[0].stage
    file = stage.parent / "cache/smoke.0002.vdb"
    write_vdb(file, value=0.125)
    stage.write_text(stage.read_text().replace(", 2: @./cache/smoke.0002.vdb@", ""))
    found = {change.kind: change.file for change in verify(finished[1].look_layer)}
    assert found == dict.fromkeys(("stage-edited", "stage-files"), str(stage)) | {
        "input-edited": str(file)
    }


def test_other_versions_are_notes(finished: Finished, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("usdsmoke.audit.verification.__version__", "9.9")
    change = only(finished)
    assert (change.kind, change.severity) == ("version", "note")
    assert change.found == "usdsmoke 9.9"
    assert main(["verify", str(finished[0].output)]) == 0


@pytest.mark.usefixtures("core")
def test_another_parameter_file_of_the_features_is_named(shot: Shot) -> None:
    weights = shot.folder / "weights.pth"
    weights.write_bytes(b"first")
    result = run(shot, "features.network=vgg19", f"features.vgg19_file={weights}")
    assert verify(result.look_layer) == []
    weights.write_bytes(b"second")
    (change,) = verify(result.look_layer)
    assert (change.kind, change.file) == ("features-edited", str(weights))
    weights.unlink()
    (change,) = verify(result.look_layer)
    assert change.kind == "features-missing"


def test_json_and_exit_code_tell_changes(
    finished: Finished, capsys: pytest.CaptureFixture[str]
) -> None:
    finished[1].frames[0].unlink()
    assert main(["verify", str(finished[0].output), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["as_recorded"] is False
    assert [change["kind"] for change in found["changes"]] == ["result-missing"]
    assert main(["verify", str(finished[0].output)]) == 1
    assert f"changed  result-missing  {finished[1].frames[0]}: exp" in capsys.readouterr().out


def test_a_frame_without_its_look_is_compared_with_its_own_hash(
    finished: Finished, tmp_path: Path
) -> None:
    alone = shutil.copyfile(finished[1].frames[0], tmp_path / "alone.vdb")
    assert {change.severity for change in verify(alone)} == {"note"}


def test_a_stage_without_a_look_is_refused(shot: Shot, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(shot.stage), "--json"]) == 1
    error = json.loads(capsys.readouterr().out)["error"]
    assert error["type"] == "LayerError" and "no usdsmoke record" in error["message"]

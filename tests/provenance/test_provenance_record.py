"""What a run leaves written down: in the layer, in the authorship record, in every frame's file."""

import json
import re
from pathlib import Path

import pytest
from pxr import Sdf, Usd, UsdMedia

from tests.fixtures.pipeline_fixtures import PROJECT, FakeCore, Shot, make_shot, run
from tests.fixtures.usd_fixtures import needs_usd, write_text
from usdsmoke.audit import provenance, verify
from usdsmoke.base.record_format import Figure, RunRecord, hash_file
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.core.features.definition import embedded_hash
from usdsmoke.pipeline import assemble
from usdsmoke.vdb.content_hash import hash_vdb_file
from usdsmoke.vdb.header import read_header

PACKAGES = {"python", "usd-core", "torch", "numpy", "openvdb"}


def record_of(layer: Path) -> RunRecord:
    (found,) = provenance(layer)
    return found.record


@pytest.mark.usefixtures("core")
def test_the_layer_holds_what_it_takes_to_run_again(shot: Shot) -> None:
    result = run(shot, "optimize.seed=3")
    record = record_of(result.look_layer)
    assert (shot.output / record.stage).resolve() == shot.stage.resolve()
    (style,) = record.style_request
    assert (shot.output / style).resolve() == shot.style.resolve()
    assert record.settings["optimize"]["seed"] == record.seed == 3
    assert record.explicit == ("optimize.seed",)
    assert set(record.packages) == PACKAGES
    assert record.features == "embedded" and record.features_hash == embedded_hash()
    assert record.created <= record.finished


@pytest.mark.usefixtures("core")
def test_every_frame_names_its_file_and_sources_with_hashes(shot: Shot) -> None:
    record = record_of(run(shot).look_layer)
    assert [frame.time_code for frame in record.frames] == [1, 2, 3]
    for frame in record.frames:
        assert record.results[frame.file] == hash_vdb_file(shot.output / frame.file, GridsConfig())
        (source,) = frame.sources
        file_path = (shot.output / source.file).resolve()
        assert (source.field, source.grid) == ("density", "density")
        assert source.hash == hash_vdb_file(file_path, GridsConfig())
        relative = file_path.relative_to(shot.stage.parent.resolve())
        assert record.source_files[str(relative)] == hash_file(file_path)


@pytest.mark.usefixtures("core")
def test_the_velocity_that_was_read_has_a_hash(tmp_path: Path) -> None:
    shot = make_shot(tmp_path, names=("density", "vel"))
    frame = record_of(run(shot).look_layer).frames[0]
    hashes = {source.field: source.hash for source in frame.sources}
    assert set(hashes) == {"density", "velocity"} and all(map(len, hashes.values()))


@pytest.mark.usefixtures("core")
def test_a_frame_s_file_has_what_it_takes_to_check_it_and_no_more(shot: Shot) -> None:
    result = run(shot)
    found = read_header(result.frames[1]).metadata
    ours = {key.removeprefix("usdsmoke:") for key in found if key.startswith("usdsmoke:")}
    assert ours == {"version", "run", "source", "source_sha256", "content_sha256"}
    record = record_of(result.look_layer)
    assert found["usdsmoke:run"] == record.run
    assert found["usdsmoke:source"] == "smoke.0002.vdb"
    assert found["usdsmoke:source_sha256"] == record.frames[1].sources[0].hash
    assert found["usdsmoke:content_sha256"] == record.results[record.frames[1].file]


@pytest.mark.usefixtures("core")
def test_layer_and_folder_have_the_same_record(shot: Shot) -> None:
    result = run(shot)
    values = Sdf.Layer.FindOrOpen(str(result.look_layer)).customLayerData["usdsmoke"]
    kept = result.frames[0].with_name("provenance.json").read_text(encoding="utf-8")
    assert kept == values["record"] == record_of(result.look_layer).to_text()


def test_figures_of_the_layer_are_mean_and_largest_of_the_frames(
    shot: Shot, core: FakeCore
) -> None:
    result = run(shot)
    figures = record_of(result.look_layer).figures
    assert figures["temporal error colour"] == Figure(0.5, 0.5, 2)
    (kept,) = shot.output.glob("vdb/*/run.json")
    reports = [frame["report"] for frame in json.loads(kept.read_text())["frames"].values()]
    assert sum("temporal" in report for report in reports) == 2


@pytest.mark.usefixtures("core")
def test_a_result_as_source_does_not_pass_its_own_record_on(shot: Shot, tmp_path: Path) -> None:
    first = run(shot)
    metadata = read_header(first.frames[0]).metadata
    second = Shot(tmp_path, first.root_stage, shot.style, tmp_path / "again")
    again = read_header(
        run(second, "optimize.steps=[shape]", "stage.restylize=true").frames[0]
    ).metadata
    assert again["usdsmoke:run"] != metadata["usdsmoke:run"]
    assert again["usdsmoke:source_sha256"] != metadata["usdsmoke:source_sha256"]


@needs_usd(26, 11)
@pytest.mark.usefixtures("core")
def test_the_authorship_names_what_the_result_is_made_from(shot: Shot) -> None:
    stage = Usd.Stage.Open(str(run(shot).root_stage))
    (record,) = UsdMedia.AuthorshipAPI.GetAll(stage.GetPrimAtPath("/World/smoke"))
    inputs = list(record.GetInputsAttr().Get())
    names = inputs[::2]
    assert names == ["style", "sources", "features", "seed"]
    assert inputs[1] == f"style.png {hash_file(shot.style)}"


@pytest.mark.usefixtures("core")
def test_the_source_that_goes_on_being_shown_has_its_empty_file_on_record(shot: Shot) -> None:
    record = record_of(run(shot, "stage.frames=2").look_layer)
    assert len(record.results) == 2 and len(record.frames) == 1
    for name, digest in record.results.items():
        assert hash_vdb_file(shot.output / name, GridsConfig()) == digest


@pytest.mark.usefixtures("core")
def test_the_document_explains_every_key_and_every_kind_of_change(shot: Shot) -> None:
    text = (PROJECT / "docs/provenance.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([\w-]+)`", text))
    assert set(record_of(run(shot).look_layer).to_json()) <= named
    sources = [PROJECT / f"usdsmoke/audit/{name}.py" for name in ("inputs", "verification")]
    calls = "".join(source.read_text(encoding="utf-8") for source in sources)
    kinds = set(re.findall(r'Change(?:\.note)?\(\s*"([a-z-]+)"', calls))
    assert len(kinds) > 12 and kinds <= named


@pytest.mark.usefixtures("core")
def test_no_file_of_a_result_names_a_folder_that_the_shot_lies_in(tmp_path: Path) -> None:
    """Though the plan tells of a Volume inside an instance, and of the layer it comes from, and
    though a setting names a file."""
    shot = make_shot(tmp_path / "somebody")
    text = shot.stage.read_text(encoding="utf-8").rstrip().removesuffix("}")
    steam = text.replace("World", "Steam")
    write_text(shot.stage.with_name("steam.usda"), f"{steam}}}\n")
    nested = 'def "set" (instanceable = true\nreferences = @./steam.usda@</Steam>) {}'
    write_text(shot.stage, f"{text}{nested}\n}}\n")
    weights = shot.folder / "weights.pth"
    weights.write_bytes(b"parameters")
    network = ("features.network=vgg19", f"features.vgg19_file={weights}")
    record = record_of(run(shot, *network).look_layer)
    assert any("</Steam/smoke> in steam.usda" in text for text in record.omitted)
    named = [
        path.name
        for path in shot.output.rglob("*")
        if path.is_file() and b"somebody" in path.read_bytes()
    ]
    assert named == []
    moved = tmp_path / "moved"
    shot.folder.rename(moved)
    assert verify(moved / "out/look.usda") == []
    assert assemble(moved / "out", mode="reference").root_stage.is_file()  # from its own record

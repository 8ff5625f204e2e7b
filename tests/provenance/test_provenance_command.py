"""usdsmoke provenance: the record from whatever somebody has at hand, as a table and as JSON."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from pxr import Sdf

from tests.fixtures.pipeline_fixtures import PROJECT, FakeCore, Shot, run
from tests.fixtures.usd_fixtures import write_text
from usdsmoke.audit import provenance, verify
from usdsmoke.pipeline import StylizeResult
from usdsmoke.ui.cli.main import main

ASSET = """#usda 1.0
(
    defaultPrim = "World"
)
def "World" (
    prepend references = @./in/shot.usda@
    variants = {
        string look = "original"
    }
    prepend variantSets = "look"
)
{
    variantSet "look" = {
        "original" {
        }
        "stylized" (
            prepend references = @./out/look.usda@</World>
        ) {
        }
    }
}
"""


@pytest.fixture
def finished(shot: Shot, core: FakeCore) -> tuple[Shot, StylizeResult]:
    return shot, run(shot, "optimize.seed=3")


def test_every_way_leads_to_the_same_record(finished: tuple[Shot, StylizeResult]) -> None:
    shot, result = finished
    asset = write_text(shot.folder / "asset.usda", ASSET)  # a look in a variant not selected
    for file in (result.look_layer, result.root_stage, asset, result.frames[2], shot.output):
        (record,) = provenance(file)
        assert record.file == result.look_layer
        assert record.record.seed == 3


def test_the_look_upon_a_look_is_found_first_and_then_the_other(
    finished: tuple[Shot, StylizeResult],
) -> None:
    shot, first = finished
    upon = Shot(shot.folder, first.root_stage, shot.style, shot.folder / "upon")
    second = run(upon, "optimize.seed=4", "stage.restylize=true")
    records = provenance(second.root_stage)
    assert [record.file for record in records] == [second.look_layer, first.look_layer]
    assert records[0].depth < records[1].depth


def test_a_frame_alone_tells_what_it_knows(
    finished: tuple[Shot, StylizeResult], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = finished[1]
    alone = shutil.copyfile(result.frames[0], tmp_path / "alone.vdb")
    assert main(["provenance", str(alone), "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["records"]
    values = Sdf.Layer.FindOrOpen(str(result.look_layer)).customLayerData["usdsmoke"]
    assert (found["run"], found["version"]) == (values["run"], values["version"])
    (recorded,) = provenance(result.look_layer)
    (frame,) = found["frames"]
    (source,) = frame["sources"]
    assert source["hash"] == recorded.record.frames[0].sources[0].hash
    name = recorded.record.frames[0].file
    assert list(found["results"].values()) == [recorded.record.results[name]]


def test_a_run_whose_look_is_lost_still_has_its_record(
    finished: tuple[Shot, StylizeResult],
) -> None:
    result = finished[1]
    (before,) = provenance(result.look_layer)
    result.look_layer.unlink()
    kept = result.frames[0].with_name("provenance.json")
    for file in (result.frames[1], kept):
        (found,) = provenance(file)
        assert (found.file, found.record) == (kept, before.record)
    assert verify(result.frames[1]) == []


def test_a_record_of_another_format_or_none_at_all_is_refused_in_one_line(
    finished: tuple[Shot, StylizeResult], capsys: pytest.CaptureFixture[str]
) -> None:
    shot, result = finished
    layer = Sdf.Layer.OpenAsAnonymous(str(result.look_layer))
    data, text = dict(layer.customLayerData), layer.customLayerData["usdsmoke"]["record"]
    other = json.dumps({"format": 7, "version": "9.9"})
    for record, facts in ((other, ("format 7", "9.9")), (text[:100], ("cannot read", "record"))):
        layer.customLayerData = {**data, "usdsmoke": {**data["usdsmoke"], "record": record}}
        layer.Export(str(result.look_layer))
        for command in ("provenance", "rerun"):
            words = ["-o", str(shot.folder / "again")] if command == "rerun" else []
            assert main([command, str(result.look_layer), *words]) == 1
            out, err = capsys.readouterr()
            assert out == "" and "Traceback" not in err and str(result.look_layer) in err
            assert all(fact in err for fact in facts)
        assert main(["verify", str(result.look_layer)]) == 1
        assert "record-edited" in capsys.readouterr().out
    assert not (shot.folder / "again").exists()


def test_json_has_the_nested_values_as_values(
    finished: tuple[Shot, StylizeResult], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["provenance", str(finished[1].root_stage), "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["records"]
    assert found["stage"] == "../in/shot.usda" and found["format"] == 1
    assert [frame["time_code"] for frame in found["frames"]] == [1, 2, 3]
    assert found["source_files"].keys() == {f"cache/smoke.{n:04d}.vdb" for n in (1, 2, 3)}


def test_the_table_has_a_line_for_every_fact(
    finished: tuple[Shot, StylizeResult], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["provenance", str(finished[0].output)]) == 0
    lines = capsys.readouterr().out.splitlines()
    facts = {line.split("  ")[0] for line in lines}
    assert {
        "record",
        "made with",
        "with",
        "platform",
        "started",
        "stage",
        "style",
        "features",
        "seed",
    } <= facts
    assert {"setting", "input", "result", "time", "figure"} <= facts
    assert any(line.split() == ["optimize.seed=3"] for line in lines)
    assert any(line.split()[0] == "platform" and "processor=stand-in" in line for line in lines)
    assert any("../in/style.png" in line for line in lines)


def test_what_has_no_record_is_refused(shot: Shot, capsys: pytest.CaptureFixture[str]) -> None:
    source = shot.stage.parent / "cache/smoke.0001.vdb"
    for file, reason in (
        (shot.stage, "no usdsmoke record"),
        (source, "no usdsmoke record"),
        (shot.stage.parent, "no usdsmoke record"),
        (shot.folder / "none.usda", "there is no"),
        (shot.style, "not a USD file"),
    ):
        assert main(["provenance", str(file)]) == 1
        out, err = capsys.readouterr()
        assert out == "" and reason in err and str(file) in err


def test_a_folder_without_its_layers_has_the_records_of_its_runs(
    finished: tuple[Shot, StylizeResult], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = shutil.copytree(finished[0].output, tmp_path / "copy")
    (folder,) = (output / "vdb").iterdir()
    record = (folder / "provenance.json").read_text()
    (folder / "provenance.json").write_text("{")  # is not read while there are layers
    known = [item.record.run for item in provenance(output)]
    (folder / "provenance.json").write_text(record)
    for layer in output.glob("*.usd*"):
        layer.write_text(layer.read_text() + "}")
    assert [item.record.run for item in provenance(output)] == known
    (damaged,) = verify(output)
    assert damaged.kind == "result-missing" and "look.usda" in damaged.found
    for layer in output.glob("*.usd*"):
        layer.unlink()
    assert [item.record.run for item in provenance(output)] == known
    assert [item.record.run for item in provenance(folder)] == known
    (lost,) = verify(output)  # the layer itself
    assert lost.kind == "result-missing"
    (folder / "provenance.json").write_text("{")
    assert main(["verify", str(output)]) == 1
    assert "provenance.json" in capsys.readouterr().err


def test_looking_loads_no_torch(finished: tuple[Shot, StylizeResult]) -> None:
    output = str(finished[0].output)
    code = (
        "import sys\nfrom usdsmoke.ui.cli.main import main\n"
        f"codes = [main([c, {output!r}]) for c in ('provenance', 'verify')]\n"
        "sys.exit(any(codes) or 'torch' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=PROJECT, timeout=60
    )
    assert done.returncode == 0, done.stderr

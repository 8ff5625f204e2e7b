"""From stage to look layer: what is written, what is left out, what is told."""

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdVol
from rich.console import Console

import usdsmoke
from tests.fixtures.counters import Reads
from tests.fixtures.grids_fixtures import check_content
from tests.fixtures.pipeline_fixtures import (
    FakeCore,
    FakeScene,
    Shot,
    make_shot,
    make_style,
    run,
    shown_files,
    values_of,
)
from tests.fixtures.usd_fixtures import density_prim, file_hashes, world, write_text, write_vdb
from usdsmoke.audit import provenance
from usdsmoke.base.frame_report import StepReport
from usdsmoke.base.record_format import Extinction
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.config.settings import Config
from usdsmoke.pipeline import stylize
from usdsmoke.runs.progress import RunProgress
from usdsmoke.ui.cli.progress_bar import ConsoleProgress
from usdsmoke.vdb.header import read_header
from usdsmoke.vdb.read import GridRequest, read_grids


@pytest.mark.usefixtures("core")
def test_every_timecode_shows_its_own_stylized_file(shot: Shot) -> None:
    result = run(shot)
    files = shown_files(result.root_stage)
    assert [Path(name).name for name in files.values()] == [
        "smoke.0001.vdb", "smoke.0002.vdb", "smoke.0003.vdb",
    ]  # fmt: skip
    for code, file_path in files.items():
        np.testing.assert_allclose(values_of(file_path), (0.5 + code / 8) / 2)
    assert shown_files(result.root_stage, "emission") == files
    assert [str(file_path) for file_path in result.frames] == list(files.values())


@pytest.mark.usefixtures("core")
def test_inputs_stay_as_they_are_and_nothing_temporary_is_left(shot: Shot) -> None:
    before = file_hashes(shot.stage.parent)
    result = run(shot)
    assert file_hashes(shot.stage.parent) == before
    (record,) = shot.output.glob("vdb/*/run.json")
    kept = {record, record.with_name("windows") / "0000.json", record.with_name("provenance.json")}
    kept.add(result.look_layer.with_suffix(".glslfx"))
    expected = {result.root_stage, result.look_layer, *result.contact_sheets, *result.frames}
    assert {p for p in shot.output.rglob("*") if p.is_file()} == expected | kept


@pytest.mark.usefixtures("core")
def test_the_file_tells_where_it_comes_from(shot: Shot) -> None:
    result = run(shot, "optimize.seed=3")
    metadata = read_header(result.frames[0]).metadata
    (found,) = provenance(result.look_layer)
    record = found.record
    assert metadata["usdsmoke:run"] == record.run
    assert metadata["creator"] == f"usdsmoke {usdsmoke.__version__}"
    assert record.settings["optimize"]["seed"] == 3
    assert len(record.frames) == 3
    assert metadata["usdsmoke:source_sha256"] == record.frames[0].sources[0].hash
    for file_path in result.frames:
        check_content(file_path)


@pytest.mark.usefixtures("core")
def test_the_plan_and_the_settings_stay_with_the_result(shot: Shot) -> None:
    result = run(shot, "optimize.seed=3", "windows.size=2")
    text = (result.frames[0].parent / "run.json").read_text()
    record = json.loads(text)
    assert record["description"]["settings"]["optimize"]["seed"] == 3
    assert [window["time_codes"] for window in record["plan"]["windows"]] == [[1, 2], [3]]
    planned = [(omission.what, omission.reason) for omission in result.plan.omitted]
    told = [(item["what"], item["reason"]) for item in record["plan"]["omitted"]]
    assert told == planned and planned
    assert str(shot.folder) not in text


@pytest.mark.usefixtures("core")
def test_a_source_creator_is_kept(tmp_path: Path) -> None:
    shot = make_shot(tmp_path, n_frames=1)
    write_vdb(shot.stage.parent / "cache/smoke.0001.vdb", metadata={"creator": "Solver 9"})
    assert read_header(run(shot).frames[0]).metadata["creator"] == "Solver 9"


@pytest.mark.usefixtures("core")
def test_without_a_colour_step_there_is_no_emission(shot: Shot) -> None:
    result = run(shot, "optimize.steps=[shape]")
    assert [grid.name for grid in read_header(result.frames[0]).grids] == ["density"]
    stage = Usd.Stage.Open(str(result.root_stage))
    assert not UsdVol.Volume(stage.GetPrimAtPath("/World/smoke")).HasFieldRelationship("emission")
    assert any(omission.what == "RGB emission" for omission in result.plan.omitted)


@pytest.mark.usefixtures("core")
def test_without_a_shape_step_the_density_keeps_its_bits(shot: Shot) -> None:
    result = run(shot, "optimize.steps=[colour]")
    source = read_grids(
        shot.stage.parent / "cache/smoke.0002.vdb", [GridRequest("density")], GridsConfig()
    )[0]
    written = read_grids(result.frames[1], [GridRequest("density")], GridsConfig())[0]
    assert source.values.tobytes() == written.values.tobytes()
    assert source.ijk_min == written.ijk_min
    np.testing.assert_array_equal(source.index_to_world, written.index_to_world)


@pytest.mark.usefixtures("core")
def test_prune_empties_both_grids_where_there_is_too_little_smoke(shot: Shot) -> None:
    result = run(shot, "grids.prune=0.35")  # frame 1 has 0.3125 after the shape step, 2 has 0.375
    assert values_of(result.frames[0]).size == 0
    assert values_of(result.frames[0], "emission").size == 0
    assert values_of(result.frames[1]).size > 0


@pytest.mark.usefixtures("core")
def test_other_timecodes_go_on_showing_the_source(shot: Shot) -> None:
    result = run(shot, "stage.frames=2")
    files = shown_files(result.root_stage)
    assert Path(files[1.0]).parent == shot.stage.parent / "cache"
    assert Path(files[2.0]) == result.frames[0]
    emission = shown_files(result.root_stage, "emission")
    assert values_of(emission[1.0], "emission").size == 0
    assert values_of(emission[2.0], "emission").size > 0


@pytest.mark.usefixtures("core")
def test_two_volumes_of_one_name_get_files_of_their_own(tmp_path: Path) -> None:
    write_vdb(tmp_path / "in/a.vdb", value=1.0)
    write_vdb(tmp_path / "in/b.vdb", value=2.0)
    groups = "".join(
        f"""
    def Xform "{name}"
    {{
        def Volume "smoke"
        {{
            rel field:density = </World/{name}/smoke/density>
            {density_prim(f"asset filePath = @./{name}.vdb@")}
        }}
    }}"""
        for name in "ab"
    )
    stage = write_text(tmp_path / "in/shot.usda", world(groups))
    result = stylize(stage, make_style(tmp_path / "style.png"), tmp_path / "out")
    names = [file_path.name for file_path in result.frames]
    assert names == ["World_a_smoke.0001.vdb", "World_b_smoke.0001.vdb"]
    assert [values_of(file_path).max() for file_path in result.frames] == [0.5, 1.0]
    assert len(result.contact_sheets) == 2


def test_velocity_is_read_in_windows_of_several_frames_only(tmp_path: Path, core: FakeCore) -> None:
    shot = make_shot(tmp_path, names=("density", "vel"))
    run(shot)
    assert core.velocities == [True, True, False]  # nothing goes on from the last frame
    core.velocities.clear()
    result = run(shot, "windows.size=1", force=True)
    assert core.velocities == [False, False, False]
    assert any(
        omission.what == "velocity grids" and "windows.size is 1" in omission.reason
        for omission in result.plan.omitted
    )


@pytest.mark.usefixtures("core")
def test_velocity_is_copied_as_it_is_when_asked_for(tmp_path: Path) -> None:
    shot = make_shot(tmp_path, n_frames=1, names=("density", "vel"))
    result = run(shot, "layer.copy_velocity=true")
    grids = {grid.name for grid in read_header(result.frames[0]).grids}
    assert grids == {"density", "emission", "vel"}
    np.testing.assert_array_equal(values_of(result.frames[0], "vel"), 0.625)


def test_progress_tells_every_frame_and_ends_at_one(shot: Shot, core: FakeCore) -> None:
    reports: list[RunProgress] = []
    run(shot, progress=reports.append)
    assert [r.step for r in reports[:3]] == ["check"] * 3
    shares = [r.share for r in reports if r.step in ("shape", "colour", "write")]
    assert shares == sorted(shares) and shares[-1] == pytest.approx(1.0)
    assert [r.frame for r in reports if r.step == "write"] == [0, 1, 2]
    assert all(r.n_frames == 3 for r in reports if r.step == "colour")


def test_progress_counts_the_coarse_step_before_the_windows(shot: Shot, core: FakeCore) -> None:
    reports: list[RunProgress] = []
    run(shot, "windows.size=2", "windows.overlap=1", progress=reports.append)
    coarse, fine = (
        [report.share for report in reports if report.step in steps]
        for steps in (["coarse"], ["shape", "colour", "write"])
    )
    assert coarse[0] == 0 < coarse[-1] < fine[0]
    assert [*coarse, *fine] == sorted([*coarse, *fine])
    assert fine[-1] == pytest.approx(1.0)


def test_what_deserves_a_look_is_told_when_its_frame_is_written(shot: Shot, core: FakeCore) -> None:
    core.steps = {"colour": StepReport(loss=(9.0,), remaining=9.0)}
    reports: list[RunProgress] = []
    result = run(shot, progress=reports.append)
    steps = [(r.step, r.frame) for r in reports if r.step in ("write", "found")]
    assert steps == [(step, frame) for frame in range(3) for step in ("write", "found")]
    told = [finding for report in reports for finding in report.findings]
    assert told == list(result.error_budget.findings)
    stream = io.StringIO()
    with ConsoleProgress(Console(file=stream)) as progress:
        for report in reports:
            progress(report)
    (told_once,) = [line for line in stream.getvalue().splitlines() if line.startswith("note")]
    assert "smoke.0001.vdb: optimiser, colour is 100.0%" in told_once


def test_what_deserves_a_look_in_the_whole_shot_is_told_before_the_first_frame(
    shot: Shot, core: FakeCore
) -> None:
    core.scene = FakeScene(thick_share=0.001)
    reports: list[RunProgress] = []
    run(shot, progress=reports.append)
    steps = [report.step for report in reports]
    assert steps.index("found") < steps.index("shape")


@pytest.mark.usefixtures("core")
@pytest.mark.parametrize("kind", ["file", "sections", "config", "texts"])
def test_settings_come_as_a_file_as_sections_as_texts_or_ready_made(shot: Shot, kind: str) -> None:
    sections = {"windows": {"size": 2}}
    ways: dict[str, dict[str, Any]] = {
        "file": {"settings": write_text(shot.folder / "c.yaml", "windows: {size: 2}\n")},
        "sections": {"settings": [Config(), {"windows.size": 7}, sections]},
        "config": {"settings": resolve_config(sections)},
        "texts": {"settings": ["windows.size=7", "windows.size=2"]},
    }
    result = usdsmoke.stylize(shot.stage, style=[shot.style], output=shot.output, **ways[kind])
    assert [len(window.time_codes) for window in result.plan.volumes[0].windows] == [2, 1]


def test_every_source_frame_is_read_once(
    shot: Shot, core: FakeCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Checked, measured, stylized twice in the overlap, shown: each of them needs the frames."""
    reads = Reads(monkeypatch)
    run(shot, "windows.size=2", "windows.overlap=1")
    sources = [name for name, _ in reads.grids if (shot.stage.parent / name).is_file()]
    assert len(sources) == len(set(sources)) == 3


@pytest.mark.usefixtures("core")
def test_the_layer_tells_the_extinction_of_both_steps(shot: Shot) -> None:
    (found,) = provenance(run(shot).look_layer)
    assert found.record.extinction == {"/World/smoke": Extinction(colour=2.0, shape=1.0)}

"""usdsmoke rerun: the same content from the record alone, refusals by name, an honest exit code."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.fixtures.grids_fixtures import raw_grid, write_raw
from tests.fixtures.pipeline_fixtures import FakeCore, Shot, contents, make_shot, run
from tests.fixtures.usd_fixtures import file_hashes, write_vdb
from usdsmoke.audit import provenance, rerun
from usdsmoke.base.errors import LayerError, OutputExists
from usdsmoke.pipeline import StylizeResult
from usdsmoke.ui.cli.main import main

SETTINGS = ["optimize.seed=3", "windows.size=2", "windows.overlap=1"]


@pytest.fixture
def finished(shot: Shot, core: FakeCore) -> tuple[Shot, StylizeResult]:
    return shot, run(shot, *SETTINGS)


@pytest.mark.parametrize("way", ["look_layer", "root_stage"])
def test_the_record_is_enough_to_make_the_same_content_again(
    finished: tuple[Shot, StylizeResult], way: str
) -> None:
    shot, result = finished
    before = file_hashes(shot.folder)
    again = rerun(getattr(result, way), shot.folder / "again")
    assert again.differences == () and again.n_frames == 3
    assert contents(again.result.root_stage) == contents(result.root_stage)
    assert {k: v for k, v in file_hashes(shot.folder).items() if k in before} == before
    (one,), (other,) = provenance(result.look_layer), provenance(again.result.look_layer)
    assert one.record.run != other.record.run
    assert one.record.settings == other.record.settings


def test_the_command_says_that_the_content_is_the_same(
    finished: tuple[Shot, StylizeResult], capsys: pytest.CaptureFixture[str]
) -> None:
    shot, result = finished
    assert main(["rerun", str(shot.output), "-o", str(shot.folder / "again")]) == 0
    out = capsys.readouterr().out
    assert f"the same content in 3 frames as recorded in {result.look_layer}" in out
    arguments = ["rerun", str(result.root_stage), "-o", str(shot.folder / "third"), "--json"]
    assert main(arguments) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["as_recorded"] is True and found["differences"] == []


def test_changed_inputs_are_refused_by_name_before_anything_is_written(
    finished: tuple[Shot, StylizeResult],
) -> None:
    shot, result = finished
    write_vdb(shot.stage.parent / "cache/smoke.0002.vdb", value=0.125)
    shot.style.unlink()
    with pytest.raises(
        LayerError, match=r"smoke\.0002\.vdb.*style\.png: .*found no file(?!.*--force)"
    ):
        rerun(result.look_layer, shot.folder / "again")
    assert not (shot.folder / "again").exists()


def test_force_goes_on_and_the_other_content_shows_in_the_exit_code(
    finished: tuple[Shot, StylizeResult], capsys: pytest.CaptureFixture[str]
) -> None:
    shot, result = finished
    write_vdb(shot.stage.parent / "cache/smoke.0002.vdb", value=0.125)
    arguments = ["rerun", str(result.look_layer), "-o", str(shot.folder / "again"), "--force"]
    assert main(arguments) == 1
    out = capsys.readouterr().out
    assert "</World/smoke> at timeCode 2: recorded" in out
    assert "of 3 frames" in out


def test_a_core_that_computes_otherwise_is_found_out(
    finished: tuple[Shot, StylizeResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    shot, result = finished
    stylized = FakeCore._stylize

    def other(self: FakeCore, frame, config, carried, errors):  # type: ignore[no-untyped-def]
        return stylized(self, frame, config, carried + 1e-3, errors)

    monkeypatch.setattr(FakeCore, "_stylize", other)
    assert len(rerun(result.look_layer, shot.folder / "again").differences) == 3


def test_a_result_in_the_way_is_kept(finished: tuple[Shot, StylizeResult]) -> None:
    shot, result = finished
    before = file_hashes(shot.output)
    with pytest.raises(OutputExists):
        rerun(result.look_layer, shot.output)
    assert file_hashes(shot.output) == before


def test_a_frame_without_its_look_cannot_be_run_again(
    finished: tuple[Shot, StylizeResult], tmp_path: Path
) -> None:
    alone = tmp_path / "alone.vdb"
    alone.write_bytes(finished[1].frames[0].read_bytes())
    with pytest.raises(LayerError, match=r"alone\.vdb"):
        rerun(alone, tmp_path / "again")


@pytest.mark.usefixtures("core")
def test_a_part_of_a_sequence_is_made_again_as_that_part(shot: Shot) -> None:
    result = run(shot, "stage.frames=2")
    again = rerun(result.root_stage, shot.folder / "again")
    assert (again.n_frames, again.differences) == (1, ())


@pytest.mark.usefixtures("core")
def test_a_look_upon_a_look_is_made_again_upon_that_look(shot: Shot) -> None:
    first = run(shot)
    upon = Shot(shot.folder, first.root_stage, shot.style, shot.folder / "upon")
    second = run(upon, "stage.restylize=true", "optimize.seed=1")
    again = rerun(second.root_stage, shot.folder / "again")
    assert (again.record, again.differences) == (second.look_layer, ())


@pytest.mark.usefixtures("core")
def test_two_looks_side_by_side_must_be_told_apart(shot: Shot) -> None:
    run(shot, "layer.look=fire")
    run(shot, "layer.look=ice", "optimize.seed=1")
    with pytest.raises(LayerError, match=r"several looks: .*fire.*ice"):
        rerun(shot.output, shot.folder / "again")


def ball(shift: float) -> np.ndarray:
    """Smoke that thins out towards its border, 8 x 8 x 8 voxels."""
    axes = [np.linspace(-1, 1, 8)] * 3
    place = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1) - [shift, 0, 0]
    return np.clip(1 - (place**2).sum(-1), 0, 1)


@pytest.mark.usefixtures("quick_grids")
def test_the_real_core_makes_the_same_content_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shot = make_shot(tmp_path, n_frames=2)
    for code in (1, 2):
        write_raw(shot.stage.parent / f"cache/smoke.{code:04d}.vdb", raw_grid(ball(0.1 * code)))
    quick = ["optimize.iterations=3", "views.image_size=24", "views.pool=2", "optimize.threads=1"]
    settings = [part for setting in quick for part in ("--set", setting)]
    for arguments in (
        shot.arguments(*settings),
        ["rerun", str(shot.output / "shot_look.usda"), "-o", str(tmp_path / "again")],
    ):
        assert main(arguments) == 0
    assert "2 frames" in capsys.readouterr().out
    (record,) = provenance(tmp_path / "again")
    figures = record.record.figures.keys()
    assert {"shape seconds", "colour seconds", "shape loss", "colour loss"} <= figures
    assert {"shape mass error", "shape linear transport difference"} <= figures
    assert {"temporal error colour", "temporal error displacement"} <= figures

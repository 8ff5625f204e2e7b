"""The mask in plans and runs: what is told of it, when it is left out, what notices its change."""

from pathlib import Path

import pytest

from tests.fixtures.grids_fixtures import openvdb, write_raw
from tests.fixtures.mask_fixtures import frames_of, make_stage, plan_of, write_mask
from tests.fixtures.pipeline_fixtures import FakeCore, Shot, make_style, run
from usdsmoke.audit import provenance
from usdsmoke.base.errors import Interrupted, OutputExists
from usdsmoke.planning.estimate import MASK_BYTES
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.plan import Plan
from usdsmoke.usd.stage import open_stage
from usdsmoke.vdb.content_hash import hash_fields


def reason_for(plan: Plan, what: str) -> str:
    return next((item.reason for item in plan.omitted if item.what.startswith(what)), "")


@pytest.fixture
def masked_shot(tmp_path: Path) -> Shot:
    write_mask(tmp_path / "in/fade.vdb")
    style = make_style(tmp_path / "style.png")
    return Shot(tmp_path, make_stage(tmp_path / "in"), style, tmp_path / "out")


def test_the_plan_tells_of_the_mask_and_does_not_leave_its_field_alone(masked_shot: Shot) -> None:
    plan = plan_of(masked_shot.stage)
    assert "mask fade of 3 frames, which scales the effect" in plan.needed
    assert reason_for(plan, "mask field") == "" == reason_for(plan, "field ")
    assert [frame["mask"] for frame in plan.to_dict()["frames"]] == ["weight"] * 3
    unasked = plan_of(masked_shot.stage, "stage.mask=")
    assert not any("mask" in sentence for sentence in unasked.needed)
    assert "stage.mask" in reason_for(unasked, "mask field")
    assert reason_for(unasked, "field fade") != ""


@pytest.mark.parametrize("setting", ["optimize.strength=0", "losses.style=0"])
@pytest.mark.usefixtures("quick_grids")
def test_without_an_effect_there_is_nothing_to_mask(masked_shot: Shot, setting: str) -> None:
    plan = plan_of(masked_shot.stage, setting)
    assert "no effect" in reason_for(plan, "mask field")
    for frame in frames_of(masked_shot.stage, setting):
        assert frame.mask is None and frame.mask_to_stage is None


def test_an_empty_frame_needs_no_mask(masked_shot: Shot) -> None:
    empty = openvdb().FloatGrid()
    empty.name, empty.gridClass = "density", "fog volume"
    write_raw(masked_shot.stage.parent / "cache/smoke.0002.vdb", empty)
    plan = plan_of(masked_shot.stage)
    assert [frame.mask is None for frame in plan.volumes[0].frames] == [False, True, False]
    assert "mask fade of 2 frames, which scales the effect" in plan.needed
    only = plan_of(masked_shot.stage, "stage.frames=2")
    assert reason_for(only, "mask field") == "every frame is empty"


def test_the_masks_box_counts_in_the_memory(masked_shot: Shot) -> None:
    masked, plain = plan_of(masked_shot.stage), plan_of(masked_shot.stage, "stage.mask=")
    grown = masked.estimate.memory_gib - plain.estimate.memory_gib
    assert grown * 2**30 == pytest.approx(12 * MASK_BYTES, rel=1e-3)
    assert masked.estimate.bytes_written == plain.estimate.bytes_written


def test_the_core_gets_the_mask_and_the_layer_records_it_but_leaves_its_field_as_it_is(
    masked_shot: Shot, core: FakeCore
) -> None:
    result = run(masked_shot, "stage.mask=fade")
    assert core.masks == [True, True, True]
    (found,) = provenance(result.look_layer)
    grids = {
        (g.file.rpartition("/")[2], g.grid): g.hash for f in found.record.frames for g in f.sources
    }
    plan = plan_of(masked_shot.stage)
    mask = FrameReader(plan).read(plan.volumes[0], plan.volumes[0].frames[0]).mask
    assert grids["fade.vdb", "weight"] == hash_fields([mask])
    assert len(grids) == 4  # three densities and one mask for all
    stage = open_stage(result.root_stage)
    shown = stage.GetAttributeAtPath("/World/smoke/fade.filePath").Get(2)
    assert Path(shown.resolvedPath) == masked_shot.stage.parent / "fade.vdb"


def test_a_run_that_was_stopped_does_not_go_on_with_another_mask(
    masked_shot: Shot, core: FakeCore
) -> None:
    def stop(time_code: float) -> None:
        if time_code == 3.0:
            raise KeyboardInterrupt

    core.before_frame = stop
    with pytest.raises(Interrupted):
        run(masked_shot, "stage.mask=fade", "windows.size=1")
    core.before_frame = lambda time_code: None
    write_mask(masked_shot.stage.parent / "fade.vdb", value=0.25)
    with pytest.raises(OutputExists, match=r"fade\.vdb"):
        run(masked_shot, "stage.mask=fade", "windows.size=1")
    with pytest.raises(OutputExists, match=r"stage\.mask"):
        run(masked_shot, "windows.size=1")

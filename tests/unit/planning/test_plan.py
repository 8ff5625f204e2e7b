"""The plan: what is found from headers alone, what is left out and why, what it costs, refusals."""

import json
import math
import re
from pathlib import Path

import pytest

from tests.fixtures.pipeline_fixtures import Shot, make_shot
from tests.fixtures.usd_fixtures import (
    density_prim,
    plume_stage,
    volume_prim,
    world,
    write_text,
    write_vdb,
)
from usdsmoke.base.errors import DamagedFile, PlanError, UnsupportedGrid
from usdsmoke.config.resolve import resolve_config
from usdsmoke.planning import make_plan as plan_module
from usdsmoke.planning.make_plan import check_plan, make_plan
from usdsmoke.planning.plan import Plan
from usdsmoke.usd.stage import find_volumes, open_stage
from usdsmoke.vdb.binding import find_binding


def plan_of(stage: Path, *settings: str) -> Plan:
    config = resolve_config(settings)
    return make_plan(find_volumes(open_stage(stage), config.stage), config)


def reason_for(plan: Plan, what: str) -> str:
    """Why something is left out; "" when it is not."""
    return next((item.reason for item in plan.omitted if item.what.startswith(what)), "")


@pytest.fixture(autouse=True)
def no_voxels(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plan never opens a file with OpenVDB: that would be done by a child process."""

    def refuse(*arguments: object) -> None:
        raise AssertionError("the plan has read voxels")

    monkeypatch.setattr("usdsmoke.vdb.child.run_child", refuse)


def test_json_has_the_promised_keys_and_the_numbers_of_the_headers(shot: Shot) -> None:
    described = plan_of(shot.stage, "windows.size=2").to_dict()
    assert {"volumes", "frames", "windows", "needed", "omitted", "estimate"} <= set(described)
    assert [frame["active_voxels"] for frame in described["frames"]] == [24, 24, 24]
    assert [frame["box"] for frame in described["frames"]] == [[4, 3, 2]] * 3
    assert [frame["output_file"] for frame in described["frames"]] == [
        "smoke.0001.vdb", "smoke.0002.vdb", "smoke.0003.vdb",
    ]  # fmt: skip
    assert [window["time_codes"] for window in described["windows"]] == [(1, 2), (3,)]
    assert [frame["window"] for frame in described["frames"]] == [0, 0, 1]
    assert all(item["what"] and item["reason"] for item in described["omitted"])
    assert set(described["estimate"]) == {
        "memory_gib", "seconds", "coarse_seconds", "bytes_written", "bytes_temporary",
    }  # fmt: skip
    json.dumps(described, allow_nan=False)


@pytest.mark.parametrize(
    ("settings", "what", "reason"),
    [
        (["optimize.steps=[shape]"], "RGB emission", "no colour step"),
        (["optimize.steps=[colour]"], "displacement of the density", "no shape step"),
        ([], "transmittance along the rays of the shape step", "grey picture is the opacity"),
        (["stage.frames=2"], "velocity grids", "only one frame"),
        (["windows.size=1"], "velocity grids", "windows.size is 1"),
        ([], "velocity grids", "stage.velocity"),
        ([], "velocity grids", "stays in place unless stage.motion=estimate"),
        ([], "VGG-19 parameters", "embedded features need no file"),
        (["features.network=vgg19"], "network layers relu3_2 to relu5_4", "no layer in use"),
        (
            ["features.network=vgg19", "losses.content=1", "features.content_layers=[relu4_2]"],
            "network layers relu4_3 to relu5_4",
            "no layer in use",
        ),
        (["views.azimuth=0", "views.elevation=0"], "other views", "views.azimuth"),
        (["optimize.strength=0"], "the optimisation", "optimize.strength is 0"),
        (["losses.style=0"], "style loss and features", "losses.style is 0"),
        ([], "total variation loss", "losses.total_variation is 0"),
        ([], "photorealism loss", "losses.photorealism is 0"),
        (["stage.motion=estimate"], "velocity grids", "estimated instead"),
    ],
)
def test_what_a_scene_does_not_need_is_left_out_with_its_reason(
    shot: Shot, settings: list[str], what: str, reason: str
) -> None:
    assert reason in reason_for(plan_of(shot.stage, *settings), what)


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        ([], "RGB emission"),
        (["losses.total_variation=1"], "total variation loss"),
        (["losses.content=1"], "content loss"),
        (["features.network=vgg19"], "VGG-19 parameters"),
        ([], "other views"),
        (["optimize.steps=[colour]"], "transmittance"),
    ],
)
def test_what_is_needed_is_not_said_to_be_left_out(
    shot: Shot, settings: list[str], what: str
) -> None:
    assert reason_for(plan_of(shot.stage, *settings), what) == ""


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        (["views.pool=4", "views.count=9"], "4 views per iteration, drawn from 4"),
        (["views.pool=9", "views.count=4"], "4 views per iteration, drawn from 9"),
        (["views.azimuth=0", "views.elevation=0"], "1 view per iteration, drawn from 1"),
    ],
)
def test_the_views_are_those_that_the_run_draws(
    shot: Shot, settings: list[str], sentence: str
) -> None:
    assert sentence in plan_of(shot.stage, *settings).needed


def test_velocity_in_the_density_file_is_planned_for_frames_that_follow_on_others(
    tmp_path: Path,
) -> None:
    """The coarse step goes on from the first window's last frame; nothing from the shot's last."""
    shot = make_shot(tmp_path, names=("density", "vel"))
    frames = plan_of(shot.stage, "windows.size=2").to_dict()["frames"]
    assert [frame["velocity"] for frame in frames] == [["vel"], ["vel"], []]
    alone = plan_of(shot.stage, "windows.size=1").to_dict()["frames"]
    assert [frame["velocity"] for frame in alone] == [[], [], []]


def test_fields_and_empty_space_and_thin_volumes_are_named(tmp_path: Path) -> None:
    openvdb = find_binding()
    grid = openvdb.FloatGrid()
    grid.name, grid.gridClass = "density", "fog volume"
    for ijk in [(0, 0, 0), (9, 0, 9)]:
        grid.getAccessor().setValueOn(ijk, 1.0)
    openvdb.write(str(tmp_path / "thin.vdb"), grids=[grid])
    relations = "\n".join(f"rel field:{n} = </World/smoke/density>" for n in ("density", "heat"))
    body = density_prim("asset filePath = @./thin.vdb@")
    stage = write_text(tmp_path / "s.usda", world(volume_prim(body, relations=relations)))
    plan = plan_of(stage)
    assert "copy_fields" in reason_for(plan, "field heat of </World/smoke>")
    assert reason_for(plan, "everything three-dimensional") == "the volume is one voxel thick"
    assert "these voxels are empty" in reason_for(plan, "98% of the bounding boxes")


def test_every_cut_of_a_sequence_is_named_with_its_time_codes(tmp_path: Path) -> None:
    shot = make_shot(tmp_path, 12)
    plan = plan_of(shot.stage, "stage.frames=1-4,8-9,12", "windows.size=8")
    assert [window.time_codes for window in plan.volumes[0].windows] == [
        (1, 2, 3, 4), (8, 9), (12,),
    ]  # fmt: skip
    assert "cut between timeCodes 4 and 8, 9 and 12: " in reason_for(plan, "coherence over cuts")
    assert not reason_for(plan_of(shot.stage), "coherence over cuts")


def test_two_frames_by_the_stages_rates_are_no_cut(tmp_path: Path) -> None:
    shot = make_shot(tmp_path, 9)
    selected = "stage.frames=1-4,8-9"
    assert plan_of(shot.stage, selected).volumes[0].cuts == ((4, 8),)
    text = shot.stage.read_text().replace("framesPerSecond = 25", "framesPerSecond = 12.5")
    shot.stage.write_text(text)
    assert plan_of(shot.stage, selected).volumes[0].cuts == ()  # 2 timeCodes make a frame


def test_an_empty_frame_is_known_from_its_header(tmp_path: Path) -> None:
    stage = plume_stage(tmp_path)
    openvdb = find_binding()
    grid = openvdb.FloatGrid()
    grid.name, grid.gridClass = "density", "fog volume"
    openvdb.write(str(tmp_path / "cache/smoke.0002.vdb"), grids=[grid])
    plan = plan_of(stage)
    assert [frame.is_empty for frame in plan.volumes[0].frames] == [False, True, False, False]
    assert reason_for(plan, "pictures and features at timeCode 2") == "the frames are empty"


def test_a_grid_that_holds_no_smoke_is_refused_before_it_is_read(tmp_path: Path) -> None:
    write_vdb(tmp_path / "s.vdb", grid_class="level set")
    body = volume_prim(density_prim("asset filePath = @./s.vdb@"))
    stage = write_text(tmp_path / "s.usda", world(body))
    with pytest.raises(UnsupportedGrid, match="level set"):
        plan_of(stage)


def test_a_damaged_frame_is_named_with_its_time_code(tmp_path: Path) -> None:
    stage = plume_stage(tmp_path)
    (tmp_path / "cache/smoke.0002.vdb").write_bytes(b"")
    named = r"</World/smoke/density>, timeCode 2: .*smoke\.0002\.vdb is no VDB file: .*--frames"
    with pytest.raises(DamagedFile, match=named):
        plan_of(stage)


def test_too_little_memory_is_refused_with_both_numbers(shot: Shot) -> None:
    plan = plan_of(shot.stage, "optimize.memory_limit_gib=0.1")
    needed = f"{plan.estimate.memory_gib:.1f}"
    with pytest.raises(
        PlanError, match=rf"about {needed} GiB.*24 voxels.*0\.1 GiB.*views\.pool"
    ) as told:
        check_plan(plan)
    assert "All voxels of its box are active" in str(told.value)  # 2 x 3 x 4


def test_the_machines_memory_counts_when_no_limit_is_set(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan_module, "available_memory_gib", lambda: 0.25)
    with pytest.raises(PlanError, match=r" 0\.2 GiB .*machine\)"):
        check_plan(plan_of(shot.stage))
    monkeypatch.setattr(plan_module, "available_memory_gib", lambda: math.inf)
    check_plan(plan_of(shot.stage))


def test_too_little_disk_is_refused_with_both_numbers(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan_module, "free_disk_bytes", lambda folder: 1_000_000)
    with pytest.raises(
        PlanError,
        match=r"about 0\.2 MB .* 67 MB, .* disk of .* 1\.0 MB free",
    ):
        check_plan(plan_of(shot.stage), shot.output)


def test_frames_that_a_network_paints_by_themselves_share_nothing(shot: Shot) -> None:
    settings = ["windows.size=2", "optimize.start=network", "optimize.steps=[colour]"]
    (volume,) = plan_of(shot.stage, *settings, "optimize.iterations=0").volumes
    assert all(window.overlap == () and not window.continues for window in volume.windows)
    assert not volume.coarse_runs
    (volume,) = plan_of(shot.stage, *settings).volumes
    assert volume.windows[0].overlap


def test_the_plan_says_over_how_many_frames_a_network_saves_its_training(shot: Shot) -> None:
    alone = ["optimize.start=network", "optimize.steps=[colour]", "optimize.iterations=0"]
    (told,) = [note for note in plan_of(shot.stage, *alone).notes if "training" in note]
    (frames,) = re.findall(r"(\d+) frames?", told)
    seconds = [plan_of(shot.stage, *own).estimate.seconds for own in (alone, alone[1:2])]
    assert seconds[0] > seconds[1] and int(frames) > 3  # it does not pay for three
    assert not any("training" in note for note in plan_of(shot.stage).notes)


def test_every_frame_knows_the_largest_one_of_its_shot(tmp_path: Path) -> None:
    """It decides what the shape step moves, and so what a frame costs."""
    stage = plume_stage(tmp_path)
    openvdb = find_binding()
    grid = openvdb.FloatGrid()
    grid.fill((0, 0, 0), (9, 9, 9), 1.0)
    grid.name, grid.gridClass = "density", "fog volume"
    openvdb.write(str(tmp_path / "cache/smoke.0002.vdb"), grids=[grid])
    sizes = [frame.size for frame in plan_of(stage).volumes[0].frames]
    assert [size.active_voxels for size in sizes] == [24, 1000, 24, 24]
    assert [size.most_voxels for size in sizes] == [1000] * 4

"""A shot's camera in plans and runs: from an animated rig on the stage to the written voxels."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.fixtures.grids_fixtures import raw_grid, uniform, write_raw
from tests.fixtures.pipeline_fixtures import Shot, make_style, run, shown_files
from tests.fixtures.smoke_fixtures import puff
from tests.fixtures.usd_fixtures import (
    HEADER,
    density_prim,
    sequence,
    volume_prim,
    world,
    write_text,
)
from usdsmoke.base.errors import PlanError, StageError
from usdsmoke.base.volume import DenseField
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.farm import submit
from usdsmoke.planning.estimate import FrameSize, estimate_run
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.job import Job, Request, prepare_job
from usdsmoke.planning.plan import Plan
from usdsmoke.planning.remarks import list_remarks
from usdsmoke.runs.identity import describe_run
from usdsmoke.ui.cli.main import main
from usdsmoke.vdb.read import GridRequest, read_grids

N = 16
PATH = "/World/rig/camera"
PLACE = (
    "double3 xformOp:translate = (10, 0, 0)\nfloat3 xformOp:scale = (2, 2, 2)\n"
    'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]\n'
)
# Z is up, and the camera is turned to look along +Y; the rig's 4 units are 2 of the smoke's.
RIG = """
    def Xform "rig"
    {
        double3 xformOp:translate.timeSamples = { 1: (START, 0, 0), 3: (END, 0, 0) }
        float3 xformOp:scale = (2, 2, 2)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]

        def Camera "camera"
        {
            float focalLength = 50
            float horizontalAperture = 25
            float verticalAperture = 100
            float2 clippingRange = (0.1, 1000)
            double3 xformOp:translate = (0, -10, 2)
            float xformOp:rotateX = 90
            uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX"]
        }
    }
"""
SETTINGS = [
    "views.pool=2",
    "views.image_size=16",
    "features.layers=[oriented1, oriented2]",
    "shape.iterations=[2, 2]",
    "colour.iterations=[2, 2]",
    "windows.size=3",
]


def make_shot(folder: Path, start: float = 10.0, end: float = 90.0) -> Shot:
    """Smoke from x = 10 to 18; the rig goes along x and has lost it at timeCode 3."""
    (folder / "in/cache").mkdir(parents=True)
    grid = raw_grid(puff(N), matrix=uniform(0.25))
    for code in (1, 2, 3):
        write_raw(folder / f"in/cache/smoke.{code:04d}.vdb", grid)
    rig = RIG.replace("START", str(start)).replace("END", str(end))
    body = volume_prim(PLACE + density_prim(sequence((1, 2, 3)))) + rig
    stage = write_text(folder / "in/shot.usda", world(body, HEADER))
    return Shot(folder, stage, make_style(folder / "style.png"), folder / "out")


@pytest.fixture
def shot(tmp_path: Path) -> Shot:
    return make_shot(tmp_path)


def job_of(shot: Shot, *settings: str) -> Job:
    config = resolve_config([f"views.camera={PATH}", *settings])
    return prepare_job(Request(shot.stage, shot.style, shot.output, config))


def reasons(plan: Plan) -> dict[str, str]:
    return {item.what: item.reason for item in plan.omitted}


# Tangent at which the effect has ended, by voxel along j: a twentieth of the film, or two voxels.
END = 0.25 + np.maximum(0.05 * 0.5, 2 * 0.5 / (0.5 * np.arange(N)[:, None] + 20))


def rig_film(rig_x: float) -> np.ndarray:
    """Tangent across the picture of every voxel, [i j k], worked out by hand."""
    i, j, _ = np.indices((N, N, N))
    return (10 + 0.5 * i - rig_x) / (0.5 * j + 20)


@pytest.mark.usefixtures("quick_grids")
def test_every_frame_carries_the_camera_as_it_stands_then(shot: Shot) -> None:
    plan = job_of(shot).plan
    reader, (volume,) = FrameReader(plan), plan.volumes
    cameras = [reader.read(volume, frame).camera for frame in volume.frames]
    places = [camera.camera_to_stage for camera in cameras if camera is not None]
    assert [list(place[3, :3]) for place in places] == [[10, -20, 4], [50, -20, 4], [90, -20, 4]]
    assert places[0][2, :3] == pytest.approx([0, -2, 0], abs=1e-6)  # -Z looks along +Y
    assert all(
        frame.source.camera is None
        for frame in job_of(shot, "views.camera=").plan.volumes[0].frames
    )


def test_the_plan_tells_what_the_camera_leaves_out(shot: Shot) -> None:
    plan = job_of(shot).plan
    first, second, third = plan.volumes[0].frames
    side = np.linspace(-0.25, 7.75, 500)  # the file has all 16 x 16 x 16 voxels active
    film = side[:, None] / (side + 20)
    assert first.size.visible == pytest.approx((film < 0.25 + 1 / (side + 20)).mean(), abs=0.03)
    assert second.size.visible == third.size.visible == 0
    said = reasons(plan)
    assert said["the effect at timeCodes 2,3 of </World/smoke>"] == "outside the camera's frustum"
    part = [what for what in said if what.startswith("about ") and "of the smoke" in what]
    assert part and "views.camera" in said[part[0]]
    assert any(f"<{PATH}> at 3 timeCodes" in sentence for sentence in plan.needed)
    assert not any(what.startswith("detail finer") for what in said)
    plain = job_of(shot, "views.camera=").plan
    assert any("--camera" in note for note in plain.notes)
    assert not any("--camera" in note for note in plan.notes)
    assert plan.estimate.seconds < plain.estimate.seconds


def test_a_camera_that_sees_no_smoke_is_refused(tmp_path: Path) -> None:
    away = make_shot(tmp_path, start=90.0)
    told = rf"</World/smoke> is outside .*<{PATH}> at all timeCodes.*leave views.camera out"
    with pytest.raises(PlanError, match=told):
        job_of(away)
    config = resolve_config([f"views.camera={PATH}"])
    plan = prepare_job(Request(away.stage, away.style, away.output, config), fits=False).plan
    assert [text for text in plan.warnings if re.search(told, text)]
    with pytest.raises(PlanError, match=told):  # before a queue starts a hundred tasks
        submit(Request(away.stage, away.style, away.output, config))
    assert not any("grids.refine" in text for text in plan.notes)
    assert any("grids.refine" in text for text in job_of(away, "views.camera=").plan.notes)
    assert not away.output.exists()


def test_a_camera_that_sees_some_frames_is_not_refused(shot: Shot) -> None:
    assert job_of(shot).plan.warnings == ()
    with pytest.raises(PlanError, match="timeCodes"):
        job_of(shot, "stage.frames=2-3")


def test_the_plan_names_frames_whose_camera_stands_in_the_smoke(shot: Shot) -> None:
    def inside(place: str) -> list[str]:
        text = shot.stage.read_text().replace("(0, -10, 2)", place)
        shot.stage.write_text(text)
        return [text for text in list_remarks(job_of(shot).plan.volumes) if "clippingRange" in text]

    assert not inside("(0, -10, 2)")
    (remark,) = inside("(0, 2, 2)")  # 10 and 50 along x: the second is beyond the box
    assert "timeCode 1:" in remark


def test_detail_that_a_narrow_shot_cannot_show_is_left_out(shot: Shot) -> None:
    """10 units wide at a distance of 20 and a little: a pixel of ten covers one."""
    said = reasons(job_of(shot, "views.camera_width=10").plan)
    found = [what for what in said if what.startswith("detail finer")]
    assert len(found) == 1 and "camera_width" in said[found[0]]
    assert 0.98 < float(found[0].split()[3]) < 1.2


def test_a_share_in_sight_costs_that_share() -> None:
    config = resolve_config()
    size = {"active_voxels": 1_000_000, "box": (128, 128, 128)}  # blocks move in half of it, too
    whole, half, none = (
        estimate_run([FrameSize(**size, visible=seen)], config, threads=1).seconds  # type: ignore[arg-type]
        for seen in (1.0, 0.5, 0.0)
    )
    assert 0.4 < (half - none) / (whole - none) < 0.7 and none < 0.25 * whole


def test_another_camera_or_another_move_of_it_is_another_run(tmp_path: Path) -> None:
    shots = [make_shot(tmp_path / name, end=end) for name, end in (("a", 90), ("b", 90), ("c", 91))]
    one, same, other = (describe_run(job_of(shot), "") for shot in shots)
    assert one["stage"] == same["stage"] != other["stage"]
    assert one["settings"] == other["settings"]
    plain = [describe_run(job_of(shot, "views.camera="), "") for shot in shots]
    assert plain[0]["stage"] == plain[2]["stage"]  # who does not look through it does not mind
    assert plain[0]["settings"] != one["settings"]


def test_a_wrong_camera_is_refused_before_anything_is_written(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(StageError, match=r"</World/cam>.*</World/rig/camera>"):
        job_of(shot, "views.camera=/World/cam")
    assert main(shot.arguments("--camera", "/World/cam", "--dry-run")) == 1
    assert f"<{PATH}>" in capsys.readouterr().err
    assert main(shot.arguments("--camera", PATH, "--dry-run", "--verbose")) == 0
    assert f"the camera <{PATH}> at 3 timeCodes" in capsys.readouterr().out
    assert not shot.output.exists()


def dense(field: DenseField) -> np.ndarray:
    """On the voxels of the source, where anything is."""
    values = np.zeros((N, N, N, *field.values.shape[3:]), np.float32)
    low = field.ijk_min
    values[tuple(slice(a, a + n) for a, n in zip(low, field.values.shape, strict=False))] = (
        field.values
    )
    return values


@pytest.mark.usefixtures("quick_grids")
def test_written_voxels_outside_the_picture_are_the_sources_bit_for_bit(shot: Shot) -> None:
    result = run(shot, *SETTINGS, f"views.camera={PATH}")
    source = puff(N)
    for code, rig_x in ((1.0, 10.0), (2.0, 50.0), (3.0, 90.0)):
        wanted = [GridRequest("density"), GridRequest("emission")]
        fields = read_grids(shown_files(result.root_stage)[code], wanted, GridsConfig())
        density, emission = map(dense, fields)
        film = np.abs(rig_film(rig_x))
        outside = film > END + 1e-6
        assert outside.any() and np.array_equal(density[outside], source[outside])
        assert not emission[outside].any()
        inside = (film < 0.25) & (density > 0)
        if code == 1.0:
            assert emission[inside].any(axis=-1).mean() > 0.9
            assert not np.array_equal(density[inside], source[inside])
        else:
            assert not inside.any()


@pytest.mark.usefixtures("quick_grids")
def test_the_frames_report_counts_what_was_left_out(shot: Shot) -> None:
    result = run(shot, *SETTINGS, f"views.camera={PATH}")
    record = (result.frames[0].parent / "run.json").read_text(encoding="utf-8")
    film, source = np.abs(rig_film(10.0)), puff(N)
    n_outside = int(((film > END - 1e-9) & (source > 0)).sum())
    assert f'"voxels_outside_camera": {n_outside}' in record
    assert f'"voxels_outside_camera": {int((source > 0).sum())}' in record
    assert record.count('"left_out": "outside the camera\'s frustum"') == 2

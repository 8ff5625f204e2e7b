"""Parts of voxels that a run has chosen: what goes on with its result divides voxels alike."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from tests.fixtures.grids_fixtures import raw_grid, write_raw
from tests.fixtures.pipeline_fixtures import FakeCore, Shot, make_shot, run
from usdsmoke import rerun, verify
from usdsmoke.audit.record import find_records
from usdsmoke.base.errors import OutputExists, PlanError
from usdsmoke.farm import submit
from usdsmoke.farm.tasks import divide_run
from usdsmoke.pipeline import Request, assemble, plan_request, run_window
from usdsmoke.planning.job import prepare_job
from usdsmoke.runs.opening import find_growth

WINDOWS = ("windows.size=2", "windows.overlap=0", "windows.shared_octaves=0")
SMALL, LARGE = 70, 109  # voxels of which a plan makes 3 and 2 parts


def write_smoke(shot: Shot, code: int, n_voxels: int) -> None:
    values = np.full((n_voxels, 6, 6), 0.5 + code / 8, np.float32)
    write_raw(shot.stage.parent / f"cache/smoke.{code:04d}.vdb", raw_grid(values))


@pytest.fixture
def growing_shot(tmp_path: Path) -> Shot:
    """Smoke that is small in the first two frames."""
    shot = make_shot(tmp_path / "shot", n_frames=4)
    for code in range(1, 5):
        write_smoke(shot, code, SMALL if code < 3 else LARGE)
    return shot


def test_a_look_that_grows_keeps_its_voxels(growing_shot: Shot, core: FakeCore) -> None:
    run(growing_shot, *WINDOWS, "stage.frames=1-2")
    grown = run(growing_shot, *WINDOWS)
    assert core.stylized == [1, 2, 3, 4] and core.parts == [3, 3, 3, 3]
    assert verify(grown.look_layer) == []
    again = rerun(grown.look_layer, growing_shot.folder / "again")
    assert again.differences == () and core.parts[4:] == [3, 3, 3, 3]
    (found,) = find_records(grown.look_layer)
    assert set(found.record.refinements.values()) == {3}
    other = dataclasses.replace(growing_shot, output=growing_shot.folder / "at_once")
    run(other, *WINDOWS, "optics.frames=1-2")
    assert core.parts[8:] == [3, 3, 3, 3]


def test_the_plan_of_a_longer_look_is_that_of_its_voxels(
    growing_shot: Shot, core: FakeCore
) -> None:
    run(growing_shot, *WINDOWS, "stage.frames=1-2")
    request = Request(growing_shot.stage, growing_shot.style, growing_shot.output, WINDOWS)
    plan = plan_request(request)
    assert any("refined by 3" in note for note in plan.notes)
    assert not any("refined by 2" in note for note in plan.notes)
    fresh = dataclasses.replace(request, output=growing_shot.folder / "fresh")
    assert plan.estimate.bytes_written > 2 * plan_request(fresh).estimate.bytes_written
    run(growing_shot, *WINDOWS)
    assert core.parts == [3, 3, 3, 3]


def test_a_look_does_not_grow_by_frames_too_large_for_its_voxels(
    growing_shot: Shot, core: FakeCore
) -> None:
    run(growing_shot, *WINDOWS, "stage.frames=1-2")
    limit = "optimize.memory_limit_gib=4"
    values = np.full((LARGE, 60, 60), 0.5, np.float32)
    write_raw(growing_shot.stage.parent / "cache/smoke.0004.vdb", raw_grid(values))
    with pytest.raises(PlanError, match=r"it is 3\).*--force"):
        run(growing_shot, *WINDOWS, limit)
    assert core.parts == [3, 3]
    run(growing_shot, *WINDOWS, limit, force=True)
    assert core.parts[2:] == [1, 1, 1, 1]


def test_a_look_without_smoke_gets_no_frames_with_smoke(growing_shot: Shot, core: FakeCore) -> None:
    """Nothing is known of what such frames would have to share."""
    empty = raw_grid(np.zeros((0, 0, 0)))
    for code in (1, 2):
        write_raw(growing_shot.stage.parent / f"cache/smoke.{code:04d}.vdb", empty)
    core.scene = dataclasses.replace(core.scene, thick=0.0)
    run(growing_shot, *WINDOWS, "stage.frames=1-2")
    core.scene = dataclasses.replace(core.scene, thick=1.0)
    with pytest.raises(OutputExists, match=r"</World/smoke>.*--force"):
        run(growing_shot, *WINDOWS)
    run(growing_shot, *WINDOWS, force=True)
    assert core.parts[2:] == [2, 2, 2, 2]


def test_first_frames_that_a_machine_cannot_refine_are_told_too(
    growing_shot: Shot, core: FakeCore
) -> None:
    for code, box in enumerate(((SMALL, 50, 50), (SMALL, 50, 50), (LARGE, 60, 60)), 1):
        smoke = raw_grid(np.full(box, 0.5, np.float32))
        write_raw(growing_shot.stage.parent / f"cache/smoke.{code:04d}.vdb", smoke)
    run(growing_shot, *WINDOWS, "stage.frames=1-2")
    assert core.parts == [2, 2]
    with pytest.raises(PlanError, match=r"it is 2\).*--force"):
        run(growing_shot, *WINDOWS, "optimize.memory_limit_gib=2")


def test_a_queue_is_asked_for_the_memory_of_a_longer_look(
    growing_shot: Shot, core: FakeCore
) -> None:
    run(growing_shot, *WINDOWS, "stage.frames=1-2")
    write_raw(
        growing_shot.stage.parent / "cache/smoke.0004.vdb",
        raw_grid(np.full((LARGE, 60, 60), 0.5, np.float32)),
    )
    request = Request(growing_shot.stage, growing_shot.style, growing_shot.output, WINDOWS)
    finer = find_growth(prepare_job(request)).job.plan.estimate.memory_gib
    assert finer > 1.5 * prepare_job(request).plan.estimate.memory_gib
    assert divide_run(request).plan.estimate.memory_gib == finer
    template = submit(request).template.read_text()
    told = re.findall(r"amount\.worker\.memory\W+min: (\d+)", template)
    assert max(map(int, told)) / 1024 >= finer


def test_windows_of_a_farm_make_a_look_grow_with_its_voxels(
    growing_shot: Shot, core: FakeCore
) -> None:
    run(growing_shot, *WINDOWS, "stage.frames=1-2")
    request = Request(growing_shot.stage, growing_shot.style, growing_shot.output, WINDOWS)
    for window in (1, 0):
        run_window(request, window)
    result = assemble(growing_shot.output)
    assert verify(result.look_layer) == []
    assert core.parts == [3, 3, 3, 3]
    (found,) = find_records(result.look_layer)
    assert set(found.record.refinements.values()) == {3}


def test_larger_smoke_in_a_rewritten_file_keeps_the_voxels(
    growing_shot: Shot, core: FakeCore
) -> None:
    write_smoke(growing_shot, 3, SMALL), write_smoke(growing_shot, 4, SMALL)
    run(growing_shot, *WINDOWS)
    write_smoke(growing_shot, 4, LARGE)
    core.parts.clear()
    result = run(growing_shot, *WINDOWS)
    assert core.parts == [3, 3]  # of the window with the file
    again = rerun(result.look_layer, growing_shot.folder / "again")
    assert again.differences == () and core.parts[2:] == [3, 3, 3, 3]
    (found,) = find_records(result.look_layer)
    assert set(found.record.refinements.values()) == {3}

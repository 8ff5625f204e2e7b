"""Into how many parts a plan divides voxels: ``grids.refine``, where it is unset."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.fixtures.grids_fixtures import raw_grid, write_raw
from tests.fixtures.pipeline_fixtures import Shot, make_shot
from usdsmoke.base.errors import PlanError
from usdsmoke.pipeline import Request, plan_request
from usdsmoke.planning.plan import Plan

Box = tuple[int, int, int]


def plan_of(shot: Shot, *settings: str) -> Plan:
    return plan_request(Request(shot.stage, shot.style, shot.output, list(settings)))


def shot_of(tmp_path: Path, *boxes: Box) -> Shot:
    """A shot with a frame for each box of voxels, which smoke fills."""
    shot = make_shot(tmp_path, n_frames=len(boxes))
    for code, box in enumerate(boxes, 1):
        smoke = raw_grid(np.ones(box, np.float32))
        write_raw(shot.stage.parent / f"cache/smoke.{code:04d}.vdb", smoke)
    return shot


def parts_of(plan: Plan) -> int:
    (volume,) = plan.volumes
    return volume.config.grids.parts


@pytest.mark.parametrize(
    ("box", "settings", "parts"),
    [
        ((70, 6, 6), (), 3),
        ((23, 6, 6), (), 4),
        ((109, 6, 6), (), 2),  # the example plume with 80 voxels across
        ((88, 6, 6), (), 2),  # 176 of 192 pixels are enough
        ((143, 6, 1), (), 2),
        ((144, 6, 1), (), 1),
        ((222, 6, 6), (), 1),
        ((4, 6, 6), (), 1),
        ((110, 120, 1), (), 1),  # pictures of it, turned, have a pixel for two refined voxels
        ((70, 6, 6), ("grids.refine=1",), 1),
        ((70, 6, 6), ("grids.refine=5",), 5),
        ((100, 6, 6), ("views.image_size=128",), 1),
        ((70, 6, 6), ("optimize.strength=0",), 1),
        ((70, 50, 50), (), 2),  # 4.7 million voxels with 3
        ((70, 50, 60), (), 1),  # 1.7 million voxels with 2
    ],
)
def test_voxels_are_divided_where_they_are_coarser_than_pictures_and_few(
    tmp_path: Path, box: Box, settings: tuple[str, ...], parts: int
) -> None:
    assert parts_of(plan_of(shot_of(tmp_path, box), *settings)) == parts


@pytest.mark.parametrize("boxes", [((70, 6, 6), (109, 6, 6)), ((109, 6, 6), (20, 6, 6))])
def test_all_frames_have_the_parts_of_the_largest_one(
    tmp_path: Path, boxes: tuple[Box, ...]
) -> None:
    shot = shot_of(tmp_path, *boxes)
    assert parts_of(plan_of(shot)) == 2


def test_frames_that_are_measured_tell_what_is_sharper(tmp_path: Path) -> None:
    shot = shot_of(tmp_path, (70, 6, 6), (109, 6, 6))
    assert parts_of(plan_of(shot, "optics.frames=1")) == 3
    assert parts_of(plan_of(shot, "stage.frames=1")) == 3


def test_no_frame_gets_too_many_voxels_whichever_are_measured(tmp_path: Path) -> None:
    shot = shot_of(tmp_path, (70, 6, 6), (200, 40, 40))
    assert parts_of(plan_of(shot, "optics.frames=1")) == 1
    assert parts_of(plan_of(shot, "stage.frames=1", "optics.frames=1")) == 3


def test_no_voxel_gets_too_small_for_openvdb(tmp_path: Path) -> None:
    shot = make_shot(tmp_path, n_frames=1)
    for size, parts in ((1e-3, 4), (3e-5, 2), (2e-5, 1)):
        smoke = raw_grid(np.ones((20, 6, 6)), matrix=np.diag([size, size, size, 1.0]))
        write_raw(shot.stage.parent / "cache/smoke.0001.vdb", smoke)
        assert parts_of(plan_of(shot)) == parts
    with pytest.raises(PlanError, match=r"grids\.refine=2"):
        plan_of(shot, "grids.refine=2")


def test_named_frames_tell_whether_voxels_or_blocks_move(tmp_path: Path) -> None:
    """A grown look keeps this number, and its record names the frames of the first run."""
    shot = shot_of(tmp_path, (150, 10, 10), (150, 40, 40))
    for settings, most in (
        ((), 240_000),
        (("optics.frames=1",), 15_000),
        (("optics.frames=9",), 240_000),
    ):
        (volume,) = plan_of(shot, *settings).volumes
        assert [size.most_voxels for size in volume.sizes] == [most] * 2


def test_named_frames_without_smoke_tell_nothing(tmp_path: Path) -> None:
    shot = shot_of(tmp_path, (70, 6, 6), (109, 6, 6))
    write_raw(shot.stage.parent / "cache/smoke.0001.vdb", raw_grid(np.zeros((0, 0, 0))))
    assert parts_of(plan_of(shot, "optics.frames=1")) == 2


def test_voxels_do_not_depend_on_the_memory_and_too_little_is_told_with_the_setting(
    tmp_path: Path,
) -> None:
    shot = shot_of(tmp_path, (70, 50, 50))
    assert parts_of(plan_of(shot, "optimize.memory_limit_gib=4")) == 2
    with pytest.raises(PlanError, match=r"grids\.refine \(it is 2\)"):
        plan_of(shot, "optimize.memory_limit_gib=1.5")
    assert parts_of(plan_of(shot, "optimize.memory_limit_gib=1.5", "grids.refine=1")) == 1


@pytest.mark.parametrize(
    "settings", [(), ("optimize.start=network",), ("optimize.steps=[colour]",)]
)
@pytest.mark.parametrize("box", [(100, 40, 40), (76, 25, 25)])
def test_the_plan_tells_what_dividing_costs(
    tmp_path: Path, box: Box, settings: tuple[str, ...]
) -> None:
    shot = shot_of(tmp_path, box)
    own, unset = (plan_of(shot, *settings, *more) for more in (("grids.refine=1",), ()))
    (note,) = (note for note in unset.notes if "grids.refine=1" in note)
    (told,) = (float(found) for found in re.findall(r"([\d.]+) times", note))
    ratio = unset.estimate.seconds / own.estimate.seconds
    assert told == pytest.approx(ratio, rel=0.05)
    assert ratio > 1.5
    assert not any("grids.refine" in note for note in own.notes)


def test_what_is_dear_is_proposed_with_its_price(tmp_path: Path) -> None:
    shot, more = shot_of(tmp_path, (70, 50, 60)), "optimize.memory_limit_gib=100"
    plan, finer = (plan_of(shot, more, *given) for given in ((), ("grids.refine=2",)))
    (note,) = (note for note in plan.notes if "grids.refine=3" in note)
    told = [float(found) for found in re.findall(r"([\d.]+) (?:times|GiB)", note)]
    finest = plan_of(shot, more, "grids.refine=3").estimate
    assert told == pytest.approx([finest.seconds / plan.estimate.seconds, finest.memory_gib], 0.05)
    assert not any("grids.refine" in note for note in finer.notes)
    assert not any("grids.refine" in n for n in plan_of(shot, more, "grids.refine=1").notes)


@pytest.mark.parametrize(
    ("settings", "advice"),
    [
        (("grids.refine=2",), "views.image_size=444"),
        (("grids.refine=2", "views.image_size=444"), None),
        (("grids.refine=2", "views.image_size=384"), None),  # pixels of 1.2 voxels
        (("grids.refine=3", "views.image_size=384"), None),  # pixels of two thirds of a voxel
        (("grids.refine=1",), None),
        ((), None),
    ],
)
def test_voxels_that_pictures_join_again_are_told(
    tmp_path: Path, settings: tuple[str, ...], advice: str | None
) -> None:
    plan = plan_of(shot_of(tmp_path, (222, 6, 6)), *settings)
    told = [note for note in plan.notes if "grids.refine" in note]
    assert len(told) == (advice is not None)
    assert all(str(advice) in note for note in told)

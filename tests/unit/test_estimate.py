"""Estimates: they rise with what makes a run dear, and fall with what makes it cheap."""

import math
from pathlib import Path

import pytest

from usdsmoke.config import Config, resolve_config
from usdsmoke.estimate import (
    Estimate,
    FrameSize,
    available_memory_gib,
    estimate_run,
    free_disk_bytes,
)

FRAME = FrameSize(90_000, (51, 49, 96))


def estimate(*settings: str, frames: int = 1, n_styles: int = 1) -> Estimate:
    sizes = [FRAME] * frames
    return estimate_run(sizes, resolve_config(assignments=settings), n_styles, threads=2)


def test_time_and_bytes_add_up_over_frames_but_memory_does_not() -> None:
    one, ten = estimate(), estimate(frames=10)
    assert ten.bytes_written == 10 * one.bytes_written
    assert ten.memory_gib == one.memory_gib
    assert 8 * one.seconds < ten.seconds < 10 * one.seconds


@pytest.mark.parametrize(
    ("dear", "cheap"),
    [
        (["views.count=4"], []),
        (["views.image_size=384"], []),
        (["optimize.iterations=3000"], []),
        (["grids.refine=2"], []),
        ([], ["optimize.steps=[colour]"]),
        ([], ["optimize.strength=0"]),
    ],
)
def test_more_work_takes_more_time(dear: list[str], cheap: list[str]) -> None:
    assert estimate(*dear).seconds > 1.2 * estimate(*cheap).seconds


@pytest.mark.parametrize(
    "dear", [["views.pool=100"], ["views.image_size=512"], ["views.count=9"], ["grids.refine=2"]]
)
def test_more_data_takes_more_memory(dear: list[str]) -> None:
    assert estimate(*dear).memory_gib > estimate().memory_gib


def test_a_frame_that_starts_from_its_neighbour_is_cheaper() -> None:
    warm = FrameSize(FRAME.active_voxels, FRAME.box, window_start=False)
    assert estimate_run([warm], Config(), 1, 2).seconds < estimate().seconds / 2


def test_half_floats_and_no_colour_take_less_disk() -> None:
    full = estimate().bytes_written - 60_000
    assert estimate("grids.half=true").bytes_written - 60_000 == pytest.approx(full / 2, abs=1)
    assert estimate("optimize.steps=[shape]").bytes_written - 60_000 == pytest.approx(full / 4)
    assert full > 90_000 * 4 * 4  # never below the values themselves


def test_a_run_without_frames_or_with_empty_ones_costs_next_to_nothing() -> None:
    empty = estimate_run([FrameSize(0, (0, 0, 0))], Config(), 1, 2)
    assert estimate_run([], Config(), 1, 2).memory_gib == empty.memory_gib
    assert empty.seconds < 10


def test_the_machine_is_asked_for_memory_and_disk(tmp_path: Path) -> None:
    assert 0 < available_memory_gib() <= math.inf
    here, below = free_disk_bytes(tmp_path), free_disk_bytes(tmp_path / "not/yet/made")
    assert here > 0 and abs(here - below) < 100_000_000

"""What a camera does not see is painted, too, with fewer views."""

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from tests.fixtures.camera_fixtures import looking, seen_by
from tests.fixtures.smoke_fixtures import frame_of, smoke_of
from tests.fixtures.stylize_fixtures import quick_config, run_core, scene_of
from usdsmoke.core.steps import colour
from usdsmoke.core.steps.colour import colour_pool, run_colour_step
from usdsmoke.core.steps.targets import StepProblem, make_targets
from usdsmoke.core.views.cameras import angles_aside
from usdsmoke.core.views.scene import frame_views

DENSITY = np.ones((24, 24, 16), np.float32)  # opaque: no light of one side reaches the other one
CAMERA = looking((11.5, 11.5, 100), (11.5, 11.5, 7.5))
ROWS = np.arange(48)[:, None, None] // 6 % 2 == 1
STRIPES = np.where(ROWS, [1.0, 0.8, 0.1], [0.0, 0.1, 0.6]) * np.ones((48, 48, 3))
NARROW = {"azimuth": 12.0, "elevation": 6.0}
SEEDS = range(3)


def problem_of(seed: int = 0, **views: float) -> StepProblem:
    """A dense block before a camera, to be painted in stripes of six pixels."""
    config = quick_config(
        views={"pool": 16, "image_size": 24, "camera": "/camera", **views},
        optics={"depth": 60.0},
        optimize={"seed": seed},
    )
    scene = dataclasses.replace(scene_of([frame_of(DENSITY)], config), camera=CAMERA)
    targets = make_targets([STRIPES.astype(np.float32)], scene, config, torch.device("cpu"))
    return StepProblem(smoke_of(DENSITY), targets, scene, config)


def contrast(colours: Tensor) -> tuple[float, float]:
    """Of means over 3 x 3 pixels, in which noise has next to none, from the front and behind."""
    front, back = (_contrast(colours, side) for side in (0.0, 180.0))
    return front, back


def _contrast(colours: Tensor, side: float) -> float:
    problem, found = problem_of(**NARROW, centre_azimuth=side), []
    for view in colour_pool(problem, 1, 7).views:
        picture = view.picture(colours, problem.targets.background)
        blocks, inside = (avg_pool2d(x.movedim(-1, 0), 3) for x in (picture, view.guide[..., None]))
        found.append(float(blocks[:, inside[0] > 0.95].std(1).mean()))
    return sum(found) / len(found)


@cache
def painted(seed: int, is_narrow: bool) -> Tensor:
    views = NARROW if is_narrow else {}
    return run_colour_step(problem_of(seed, **views), [40, 40, 40])[0]


def loss_aside(seed: int, colours: Tensor) -> float:
    """Of the views away from the camera that the finest octave has."""
    problem = problem_of(seed)
    pool, targets = colour_pool(problem, 1, seed + 2), problem.targets
    with torch.no_grad():
        losses = [
            targets.at(1)(view.picture(colours, targets.background), view.guide, None, number)
            for number, view in enumerate(pool.drawn(99)[len(pool.drawn_in_front(99)) :])
        ]
    return float(sum(losses))


def test_smoke_before_a_camera_is_painted_behind_too() -> None:
    """On average over seeds: single ones differ by a third, and by processor."""
    front, back = np.mean([contrast(painted(seed, False)) for seed in SEEDS], axis=0)
    only_front, untouched = np.mean([contrast(painted(seed, True)) for seed in SEEDS], axis=0)
    assert front > 0.9 * only_front > 0.17
    assert back > 0.85 * front
    assert untouched < 0.65 * back


def test_frames_behind_a_neighbour_are_painted_behind_too() -> None:
    """They have iterations in the finest octave alone; on average over seeds."""
    found = []
    for seed in SEEDS:
        start = painted(seed, True)
        ends = [
            run_colour_step(problem_of(seed, **views), [0, 0, 60], start, warm=True)[0]
            for views in ({}, NARROW)
        ]
        found.append([loss_aside(seed, colours) for colours in (start, *ends)])
    before, after, untouched = np.mean(found, axis=0)
    assert after < 0.9 * before
    assert untouched > 0.95 * before


@pytest.mark.parametrize("is_coarse_step", [False, True])
def test_all_octaves_but_the_finest_of_a_result_are_coarse(
    is_coarse_step: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[bool] = []

    def pool(problem: StepProblem, factor: int, seed: int, is_coarse: bool) -> Any:
        told.append(is_coarse)
        return colour_pool(problem, factor, seed, is_coarse)

    monkeypatch.setattr(colour, "colour_pool", pool)
    problem = problem_of()
    scene = dataclasses.replace(problem.scene, is_coarse_step=is_coarse_step)
    run_colour_step(dataclasses.replace(problem, scene=scene), [1, 1, 1])
    assert told == [True, True, is_coarse_step]


def test_the_spread_of_views_is_that_of_what_the_camera_sees() -> None:
    """Other sides have other losses by far."""
    frame = seen_by(CAMERA, frame_of(DENSITY))
    found = []
    for views in ({}, NARROW):
        config = problem_of(**views).config
        config = config.with_values(
            {"optimize.steps": ["colour"], "colour.iterations": [20, 20, 48]}
        )
        (result,) = run_core([frame], config, styles=[STRIPES.astype(np.float32)])
        assert result.report.colour is not None and result.report.colour.view_spread is not None
        found.append(result.report.colour.view_spread)
    assert found[0] < 2 * found[1]


@pytest.mark.parametrize("is_coarse", [False, True])
def test_what_the_camera_sees_is_looked_at_more_often(is_coarse: bool) -> None:
    """By three of four views in the finest octave, by half of them in coarser ones."""
    pool = colour_pool(problem_of(), 1, 3, is_coarse)
    n_front = 8 if is_coarse else 12
    assert len(pool.drawn(99)) == 16 and len(pool.drawn_in_front(99)) == n_front
    narrow, front = colour_pool(problem_of(**NARROW), 1, 3, is_coarse), problem_of(pool=n_front)
    assert len(narrow.drawn_in_front(99)) == len(narrow.drawn(99)) == 16
    wanted = frame_views(front.smoke, front.config.views, front.scene, 3)
    shapes = [tuple(view.alpha.shape) for view in pool.drawn_in_front(99)]
    assert shapes == [(view.height, view.width) for view in wanted]
    aside = [tuple(view.alpha.shape) for view in pool.drawn(99)[n_front:]]
    assert min(width for _, width in aside) < min(width for _, width in shapes)  # the block's side


@pytest.mark.parametrize("views", [{"pool": 1}, {"azimuth": 0.0, "elevation": 0.0}])
def test_one_view_is_the_cameras(views: dict[str, float]) -> None:
    problem = problem_of(**views)
    wanted = frame_views(problem.smoke, problem.config.views, problem.scene, 3)
    (found,) = colour_pool(problem, 1, 3, True).drawn(9)
    assert [tuple(found.alpha.shape)] == [(view.height, view.width) for view in wanted]


@pytest.mark.parametrize("views", [{"centre_azimuth": 90.0}, {"centre_elevation": 40.0}])
def test_a_middle_that_is_set_leaves_no_views_aside(views: dict[str, float]) -> None:
    assert len(colour_pool(problem_of(**views), 1, 3, True).drawn_in_front(99)) == 16


@pytest.mark.parametrize(("n", "wanted"), [(0, []), (1, [180]), (4, [90, 150, 210, 270])])
def test_views_aside_are_even_and_away_from_the_camera(n: int, wanted: list[float]) -> None:
    angles = angles_aside(problem_of(elevation=10.0).config.views, n)
    assert angles[:, 0] == pytest.approx(wanted)
    assert (abs(angles[:, 1]) <= 10.0).all() and len(set(angles[:, 1])) == n

"""What a camera does not see is painted by the coarse octaves, and keeps that."""

import dataclasses

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from tests.fixtures.camera_fixtures import looking
from tests.fixtures.smoke_fixtures import frame_of, smoke_of
from tests.fixtures.stylize_fixtures import quick_config, scene_of
from usdsmoke.core.steps.colour import colour_pool, run_colour_step
from usdsmoke.core.steps.targets import StepProblem, make_targets

DENSITY = np.ones((24, 24, 10), np.float32)
CAMERA = looking((11.5, 11.5, 100), (11.5, 11.5, 4.5))
ROWS = np.arange(48)[:, None, None] // 6 % 2 == 1
STRIPES = np.where(ROWS, [1.0, 0.8, 0.1], [0.0, 0.1, 0.6]) * np.ones((48, 48, 3))
NARROW = {"azimuth": 12.0, "elevation": 6.0}


def problem_of(**views: float) -> StepProblem:
    """A dense block before a camera, to be painted in stripes of six pixels."""
    config = quick_config(
        views={"pool": 16, "image_size": 24, "camera": "/camera", **views}, optics={"depth": 30.0}
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


def test_smoke_before_a_camera_is_painted_behind_too() -> None:
    front, back = contrast(run_colour_step(problem_of(), [40, 40, 40])[0])
    only_front, untouched = contrast(run_colour_step(problem_of(**NARROW), [40, 40, 40])[0])
    assert front > 0.9 * only_front > 0.2
    assert untouched < 0.6 * front < 0.8 * back


def test_what_the_coarse_octaves_have_painted_behind_stays() -> None:
    painted = run_colour_step(problem_of(), [40, 40, 0])[0]
    _, before = contrast(painted)
    _, after = contrast(run_colour_step(problem_of(), [0, 0, 40], painted)[0])
    _, faded = contrast(run_colour_step(problem_of(**NARROW), [0, 0, 40], painted)[0])
    assert after > 0.95 * before
    assert faded < 0.85 * before

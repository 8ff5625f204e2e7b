"""What the colour step's rules do for views that it does not have."""

from typing import Any

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import puff, smoke_of
from usdsmoke.base.resolve import resolve_config
from usdsmoke.core.smoke.spread import Surroundings
from usdsmoke.core.smoke.srgb import luma
from usdsmoke.core.steps import colour
from usdsmoke.core.steps.colour_rules import find_rules
from usdsmoke.core.steps.targets import StepProblem, make_targets
from usdsmoke.core.views.scene import Scene


def problem_of(**views: Any) -> StepProblem:
    """A puff of 24 voxels and a style of wide stripes."""
    sections = {
        "views": {"pool": 4, "image_size": 24, **views},
        "optimize": {"threads": 1, "tolerance": 0.0},
    }
    config, smoke = resolve_config(sections), smoke_of(puff(24))
    scene = Scene(0.6, 0.3, 1.0, "Y", 1.0, 24)
    across = 0.5 + 0.4 * np.sin(np.arange(48) * (2 * np.pi / 16))
    pixels = np.stack(np.broadcast_arrays(across, across[:, None], 0.4), axis=-1)
    targets = make_targets([pixels.astype(np.float32)], scene, config, torch.device("cpu"))
    return StepProblem(smoke, targets, scene, config)


def outlying(problem: StepProblem, colours: torch.Tensor) -> float:
    """Mean distance of lumas from those around."""
    around = Surroundings(problem.smoke, torch.ones(len(colours)))
    return float(around.outlying(luma(colours), torch.arange(len(colours))).abs().mean())


def test_no_voxel_stands_out_and_unseen_views_are_nearer_to_a_smooth_style(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = problem_of()
    pool = colour.colour_pool(problem, 1, 99)

    def run() -> tuple[torch.Tensor, float]:
        colours, _ = colour.run_colour_step(problem, [0, 0, 40])
        background = problem.targets.background
        with torch.no_grad():
            unseen = [
                float(colour.pictures_loss(pool, colours, problem.targets.at(1), background, n))
                for n in range(4)
            ]
        return colours, sum(unseen)

    held = run()
    with monkeypatch.context() as patch:
        patch.setattr(Surroundings, "outlying", lambda self, values, rows: 0 * values[rows])
        free = run()
    assert outlying(problem, held[0]) < 0.2 * outlying(problem, free[0])
    assert held[1] < 0.9 * free[1]


def test_what_is_carried_seen_from_one_side_or_coarse_is_not_held() -> None:
    problem = problem_of()
    begun = torch.rand(len(problem.smoke.ijk), 3, generator=torch.Generator().manual_seed(0))
    held = colour.run_colour_step(problem, [0, 0, 3], begun, warm=True)[0]
    carried = colour.run_colour_step(problem, [0, 0, 3], begun, warm=True, carried=True)[0]
    assert outlying(problem, carried) > 2 * outlying(problem, held)
    for has_speckle, views in ((True, {"azimuth": 0, "elevation": 0}), (False, {})):
        assert find_rules(problem_of(**views), problem.smoke, None, has_speckle).speckle is None

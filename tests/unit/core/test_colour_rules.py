"""What the colour step's rules do for views that it does not have."""

from typing import Any

import numpy as np
import pytest
import torch

from tests.fixtures.stylize_fixtures import puff_problem, unseen_loss
from usdsmoke.core.smoke.spread import Surroundings
from usdsmoke.core.smoke.srgb import luma
from usdsmoke.core.steps.colour import run_colour_step
from usdsmoke.core.steps.colour_rules import find_rules
from usdsmoke.core.steps.targets import StepProblem


def problem_of(**views: Any) -> StepProblem:
    """A puff and a style of wide stripes."""
    across = 0.5 + 0.4 * np.sin(np.arange(48) * (2 * np.pi / 16))
    pixels = np.stack(np.broadcast_arrays(across, across[:, None], 0.4), axis=-1)
    return puff_problem(pixels.astype(np.float32), **views)


def outlying(problem: StepProblem, colours: torch.Tensor) -> float:
    """Mean distance of lumas from those around."""
    around = Surroundings(problem.smoke, torch.ones(len(colours)))
    return float(around.outlying(luma(colours), torch.arange(len(colours))).abs().mean())


def test_no_voxel_stands_out_and_unseen_views_are_nearer_to_a_smooth_style(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = problem_of()

    def run() -> tuple[torch.Tensor, float]:
        colours, _ = run_colour_step(problem, [0, 0, 40])
        return colours, unseen_loss(problem, colours)

    held = run()
    with monkeypatch.context() as patch:
        patch.setattr(Surroundings, "outlying", lambda self, values, rows: 0 * values[rows])
        free = run()
    assert outlying(problem, held[0]) < 0.2 * outlying(problem, free[0])
    assert held[1] < 0.9 * free[1]


def test_what_is_carried_seen_from_one_side_or_coarse_is_not_held() -> None:
    problem = problem_of()
    begun = torch.rand(len(problem.smoke.ijk), 3, generator=torch.Generator().manual_seed(0))
    held = run_colour_step(problem, [0, 0, 3], begun, warm=True)[0]
    carried = run_colour_step(problem, [0, 0, 3], begun, warm=True, carried=True)[0]
    assert outlying(problem, carried) > 2 * outlying(problem, held)
    for has_speckle, views in ((True, {"azimuth": 0, "elevation": 0}), (False, {})):
        assert find_rules(problem_of(**views), problem.smoke, None, has_speckle).speckle is None

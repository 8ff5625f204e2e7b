"""The colour step under masks that leave voxels out."""

from typing import Any

import pytest
import torch

from tests.fixtures.smoke_fixtures import puff, random_style, smoke_of
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.settings import Config
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.steps.colour import initial_colours, run_colour_step
from usdsmoke.core.steps.targets import StepProblem, make_targets
from usdsmoke.core.views.scene import Scene

SCENE = Scene(0.6, 0.3, 1.0, "Y", 1.0, 12)


def config_of(**sections: dict) -> Config:
    base = {
        "views": {"pool": 2},
        "features": {"layers": ["oriented1"]},
        "optimize": {"threads": 1, "tolerance": 0.0},
    }
    return resolve_config(base, sections)


def problem_of(smoke: ActiveSmoke, config: Config, mask: Any) -> StepProblem:
    targets = make_targets([random_style(16, 20)], SCENE, config, torch.device("cpu"))
    return StepProblem(smoke, targets, SCENE, config, mask)


@pytest.fixture(scope="module")
def smoke() -> ActiveSmoke:
    return smoke_of(puff(12))


class EveryThird:
    """A mask of single voxels, that hardly any coarser voxel's centre hits."""

    def at(self, positions: torch.Tensor) -> torch.Tensor:
        return ((positions.round().sum(1) % 3 == 0) & (positions % 1 == 0).all(1)).float()


class Nowhere:
    def at(self, positions: torch.Tensor) -> torch.Tensor:
        return torch.zeros(len(positions))


class CoarseCorner(EveryThird):
    """And a few voxels of the coarser octave, far from most of the painted ones."""

    def at(self, positions: torch.Tensor) -> torch.Tensor:
        return torch.maximum(super().at(positions), (positions < 4).all(1).float())


@pytest.mark.parametrize("mask", [EveryThird(), CoarseCorner()])
@pytest.mark.parametrize("iterations", [[1, 0], [1, 1]])
def test_painted_voxels_that_no_coarser_one_stands_for_start_from_noise(mask, iterations, smoke):
    """And not from black: of the coarser octave's colours there are none in reach.

    At the end of the finest octave, what hardly shows has the colours of what is near.
    """
    config = config_of(colour={"learning_rate": 1e-9})
    colours, _ = run_colour_step(problem_of(smoke, config, mask), iterations)
    chosen = mask.at(smoke.positions) > 0
    noise = initial_colours(smoke.take(chosen), "noise", 0)
    apart = (smoke.positions[chosen] > 6).any(1)
    assert len(colours) == len(noise) and int(apart.sum()) > 50
    if iterations[1]:
        assert colours[apart].mean().item() == pytest.approx(0.5, abs=0.1)
    else:
        assert torch.allclose(colours[apart], noise[apart], atol=1e-6)


def test_nothing_to_paint_gives_no_colours(smoke):
    config = config_of()
    colours, ends = run_colour_step(problem_of(smoke, config, Nowhere()), [2, 2])
    assert colours.shape == (0, 3) and ends == []

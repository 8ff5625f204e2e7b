"""Sheets, filaments and porous smoke are moved like thick smoke, whatever the resolution."""

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import frame_of, smoke_of
from tests.fixtures.stylize_fixtures import quick_config, run_core
from usdsmoke.core.steps.move import effect_on, fade_of, smoke_box

SIDE = 40


def sheet(thickness: int) -> np.ndarray:
    density = np.zeros((SIDE, SIDE, SIDE), np.float32)
    density[4:36, 20 : 20 + thickness, 4:36] = 1.0
    return density


def filaments() -> np.ndarray:
    density = np.zeros((SIDE, SIDE, SIDE), np.float32)
    for a in range(5, 36, 6):
        for b in range(5, 36, 6):
            density[2:38, a : a + 2, b : b + 2] = 1.0
    return density


def porous() -> np.ndarray:
    """A ball of which nine tenths are empty."""
    axes = np.arange(SIDE) - (SIDE - 1) / 2
    away = np.sqrt(sum(a**2 for a in np.meshgrid(axes, axes, axes, indexing="ij")))
    held = np.random.default_rng(0).random(away.shape) < 0.1
    return (held & (away < 16)).astype(np.float32)


SMOKES = {
    "one voxel": sheet(1), "two voxels": sheet(2), "filaments": filaments(), "porous": porous(),
}  # fmt: skip


def effect_of(density: np.ndarray, voxel: float = 1.0) -> tuple[torch.Tensor, torch.Tensor]:
    """The effect and the density on the box, [I J K] each."""
    smoke = smoke_of(density, np.diag([voxel, voxel, voxel, 1.0]))
    fade = fade_of(smoke)
    lattice = smoke_box(smoke, fade)
    box = lattice.fill(smoke)
    return effect_on(box, lattice, fade, None), box


@pytest.mark.parametrize("name", SMOKES)
def test_thin_smoke_can_be_moved_nearly_everywhere(name):
    effect, box = effect_of(SMOKES[name])
    inside = effect[box > 0]
    assert (inside == 0).float().mean() < 0.03
    assert inside.mean() > 0.5


@pytest.mark.parametrize("name", SMOKES)
def test_thin_smoke_is_moved(name):
    config = quick_config(
        shape={"iterations": [0, 40]}, optimize={"steps": ["shape"]}, losses={"statistic": "gram"}
    )
    report = run_core([frame_of(SMOKES[name])], config)[0].report.transport
    assert report.motionless < 0.03
    assert report.largest_displacement > 0.2 * report.cap


def test_thick_smoke_stays_in_place_at_its_border_and_not_inside():
    effect, box = effect_of(np.pad(np.ones((30, 30, 30), np.float32), 4))
    assert effect[box == 0].max() < 0.02
    middle = effect.shape[0] // 2
    assert effect[middle, middle, middle] > 0.99


@pytest.mark.parametrize("factor", [2, 3])
def test_the_fade_is_as_long_in_space_at_any_resolution(factor):
    """The same cube with smaller voxels: half of the effect is reached at the same depth."""
    depths = []
    for n in (1, factor):
        effect, _ = effect_of(np.ones((40 * n, 40 * n, 40 * n), np.float32), 1.0 / n)
        middle = effect.shape[0] // 2
        line = effect[: middle + 1, middle, middle]
        first = int((line > 0.5).nonzero()[0])
        part = (0.5 - line[first - 1]) / (line[first] - line[first - 1])
        padding = (effect.shape[0] - 40 * n) // 2
        depths.append((float(first - 1 + part) - padding + 0.5) / n)
    assert depths[1] == pytest.approx(depths[0], abs=0.2)


def test_octaves_in_which_nothing_can_move_are_left_out_and_told():
    """A stream function moves nothing along a row of voxels; a potential does."""
    row = frame_of(np.linspace(0.5, 1.0, 12).reshape(12, 1, 1))
    for kind, done, motionless in (("stream", (), 1.0), ("potential", (3, 3), 0.0)):
        shape = {"iterations": [3, 3], "displacement": kind}
        report = run_core([row], quick_config(shape=shape))[0].report
        assert report.shape.iterations == done
        assert report.transport.motionless == motionless

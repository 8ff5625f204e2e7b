"""How a network is trained: its parts, crops, and bits."""

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import frame_of, puff, random_style
from tests.fixtures.stylize_fixtures import problem_of, quick_config, scene_of
from usdsmoke.core.generator import definition
from usdsmoke.core.generator.network import Generator
from usdsmoke.core.training import train
from usdsmoke.core.training.canvas import Canvas, crop
from usdsmoke.core.training.frames import train_on_frames
from usdsmoke.core.training.train import TrainState

FRAMES = [frame_of(puff(12, seed), seed + 1.0) for seed in range(2)]
STYLE = random_style()
CONFIG = quick_config(colour={"smoothing": 0.25})
SCENE = scene_of(FRAMES, CONFIG)


def test_training_has_the_same_bits_with_any_number_of_threads() -> None:
    files = []
    for n_threads in (1, 2):
        values = {"optimize.threads": n_threads}
        config = CONFIG.with_values(values)
        found = train_on_frames(FRAMES[:2], [STYLE], SCENE, config, 4, lambda state: None)
        files.append(found.trained.generator.to_bytes({}))
    assert files[0] == files[1]


def test_large_frames_are_learned_from_crops_and_then_as_a_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, value in (("USUAL_VOXELS", 120), ("CROP_VOXELS", 250)):
        monkeypatch.setattr(definition, name, value)
    monkeypatch.setattr(train, "USUAL_VOXELS", 120)
    painted = []

    class Told(Canvas):
        def paint(self, generator: Generator, seed: int) -> torch.Tensor:
            colours = super().paint(generator, seed)
            painted.append(len(colours))
            return colours

    monkeypatch.setattr(train, "Canvas", Told)
    states = list[TrainState]()
    found = train_on_frames(FRAMES[:1], [STYLE], SCENE, CONFIG, 16, states.append).trained
    n = len(problem_of(FRAMES[0].density.values, SCENE, CONFIG).smoke.ijk)
    assert [size == n for size in painted] == [False] * 3 + [True] * 6  # n is 527
    assert max(painted[:3]) <= 250
    assert len(set(painted[:3])) > 1  # several crops
    assert [state.iteration for state in states] == list(range(len(painted)))
    assert {state.n_iterations for state in states} == {found.n_iterations} == {len(painted)}


def test_large_smoke_is_cropped_to_pieces_around_different_voxels() -> None:
    problem = problem_of(np.ones((40, 40, 40), np.float32), SCENE, CONFIG)
    one, other = crop(problem, 0, 60_000), crop(problem, 1, 60_000)
    assert 60_000 / 8 < len(one.smoke.ijk) < 60_000
    assert one.smoke.ijk.tolist() != other.smoke.ijk.tolist()
    small = problem_of(puff(12), SCENE, CONFIG)
    assert crop(small, 0, 60_000) is small


def test_a_crop_of_a_speck_and_a_far_sheet_is_not_the_speck_alone() -> None:
    """All of the sheet is equally far from the speck."""
    density = np.zeros((40, 12, 12), np.float32)
    density[0, 6, 6], density[39] = 1, 1
    problem = problem_of(density, SCENE, CONFIG)
    # the speck is the middle of some of them
    sizes = [len(crop(problem, number, 100).smoke.ijk) for number in range(600)]
    assert 50 <= min(sizes) and max(sizes) <= 100

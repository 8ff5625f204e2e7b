"""Dark areas of smoke are lifted with the marks in them; all else stays."""

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import random_style, smoke_of
from tests.fixtures.stylize_fixtures import finished, same_bits
from usdsmoke.config.settings import Config
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.smoke.tasks import computing_threads
from usdsmoke.core.steps.targets import make_targets
from usdsmoke.core.views.dark_areas import lift_dark_areas
from usdsmoke.core.views.joined import join_smoke
from usdsmoke.core.views.scene import Scene

N = 32  # voxels along a side of the block
SCENE = Scene(2.0, 1.0, 1.0, "Y", 1.0, N)  # pictures see half a voxel deep; nothing is joined
BLOCK = smoke_of(np.ones((N, N, N), np.float32))
WHITE = torch.ones(3)


def lifted(
    colours: np.ndarray,
    level: float = 0.3,
    painted: ActiveSmoke = BLOCK,
    scene: Scene = SCENE,
    hue: torch.Tensor = WHITE,
) -> np.ndarray:
    """Of a block of colours [I J K 3]."""
    at = tuple(painted.ijk.T.numpy())
    given = torch.as_tensor(colours[at], dtype=torch.float32)
    found = colours.astype(np.float32).copy()
    found[at] = lift_dark_areas(given, painted, join_smoke(BLOCK, scene), level, hue).numpy()
    return found


def even(colour: float | list[float]) -> np.ndarray:
    return np.broadcast_to(np.asarray(colour, float), (N, N, N, 3)).copy()


@pytest.mark.parametrize(
    ("value", "expected"),
    [(0.0, 0.0), (0.01, 0.09 / 1.08), (0.1, 0.3), (0.3, 0.3), (0.8, 0.8), (1.4, 1.4)],
)
def test_even_smoke_is_lifted_to_the_level_or_to_nine_times_its_brightness(value, expected) -> None:
    assert lifted(even(value)) == pytest.approx(even(expected), abs=2e-5)


def test_dark_red_is_no_hole() -> None:
    red = even([0.4, 0.02, 0.02])  # its luma is 0.1
    assert lifted(red) == pytest.approx(red, abs=1e-6)


def test_dark_marks_in_bright_smoke_stay() -> None:
    colours = even(0.7)
    colours[16, :, :] = 0.05  # a mark one voxel wide around the block
    assert lifted(colours) == pytest.approx(colours, abs=1e-6)


def test_marks_in_a_dark_area_are_seen() -> None:
    colours = even(0.05)
    colours[::3] = 0.09
    found = lifted(colours)
    front = np.s_[8:24, 8:24, N - 1, 0]
    assert found[front].mean() == pytest.approx(0.3, rel=0.05)
    assert np.ptp(found[front]) > 3 * np.ptp(colours[front])


def test_what_is_added_has_the_hue_that_the_style_has_at_the_level() -> None:
    dark = even([0.02, 0.02, 0.06])
    added = lifted(dark, hue=torch.tensor([1.0, 0.5, 0.0])) - dark
    first = 3 * 0.06 / 1.12 - 0.06  # three times as bright; then red is the brightest channel
    second = 3 * (0.02 + first) / (1 + 2 * (0.02 + first)) - (0.02 + first)
    assert added[..., 0] == pytest.approx(first + second, abs=1e-4)
    assert (
        added[..., 1] == pytest.approx(0.5 * added[..., 0], abs=1e-6)
        and abs(added[..., 2]).max() < 1e-6
    )


def test_the_hue_is_that_of_pixels_as_bright_as_the_level() -> None:
    """By the shares of the styles."""
    bands = np.array([[[0.9, 0.9, 0.9], [0.3, 0.15, 0.0], [0.0, 0.0, 0.02]]], np.float32)
    style = bands.repeat(8, 1).repeat(24, 0)
    other = np.full((24, 24, 3), [0.0, 0.15, 0.3], np.float32)
    scene = Scene(0.6, 0.3, 1.0, "Y", 1.0, 24)
    config = Config(style={"areas": "all"})
    white = np.ones((24, 24, 3), np.float32)  # of which no pixel is near the level
    dark = np.where(np.arange(24)[:, None] < 8, np.float32([0.02, 0, 0.03]), np.float32(1))
    dark = np.broadcast_to(dark, (24, 24, 3))
    for styles, expected in (
        ([style], [1, 0.5, 0]),
        ([style, other], [1 / 3, 2 / 3, 1]),
        ([style, white], [1, 0.5, 0]),
        ([dark], [1, 1, 1]),
    ):
        targets = make_targets(styles, scene, config, torch.device("cpu"))
        assert targets.hue_at(0.3).tolist() == pytest.approx(expected, abs=0.08)
    assert make_targets([style], scene, config, torch.device("cpu")).value == pytest.approx(0.3)


def test_what_no_picture_shows_does_not_count() -> None:
    shell, inside = even(0.1), even(0.1)
    inside[8:24, 8:24, 8:24] = 1.0
    surface = np.s_[8:24, 8:24, N - 1]
    assert lifted(inside)[surface] == pytest.approx(lifted(shell)[surface], abs=1e-3)


def test_smoke_that_has_no_colours_does_not_count() -> None:
    """Such as what the camera misses."""
    half = BLOCK.take(BLOCK.ijk[:, 0] < N // 2)
    found = lifted(even(0.1), painted=half)
    assert found[: N // 2] == pytest.approx(even(0.3)[: N // 2], abs=2e-5)


def test_joined_voxels_find_the_same_areas() -> None:
    colours = even(0.7)
    colours[:, : N // 2] = 0.1
    whole = lifted(colours)
    joined = lifted(colours, scene=Scene(2.0, 1.0, 0.25, "Y", 1.0, 16 * N))  # twice
    for rows in (np.s_[4:28, :6, 31], np.s_[4:28, 26:, 31]):
        assert joined[rows] == pytest.approx(whole[rows], abs=0.03)


def test_threads_do_not_change_the_bits() -> None:
    colours, found = np.random.default_rng(0).random((N, N, N, 3)) * 0.3, []
    for n in (1, 3):
        with computing_threads(n):
            found.append(lifted(colours))
    assert np.array_equal(*found)


def test_a_run_lifts_what_it_would_write_dark() -> None:
    bright = np.full((16, 16, 3), 0.95)  # of which few iterations leave the first colours far
    plain, found = (finished(style=bright, lift=lift) for lift in (0.0, 0.9))
    assert np.array_equal(plain.density.values, found.density.values)
    before, after = plain.emission.values, found.emission.values
    assert (after >= before - 1e-6).all() and after.sum() > 1.1 * before.sum()


def test_a_style_that_is_dark_as_a_whole_stays_dark() -> None:
    """Areas are lifted to nine tenths of its median at most."""
    plain, found = (finished(style=np.full((16, 16, 3), 0.06), lift=lift) for lift in (0.0, 0.9))
    assert found.emission.values == pytest.approx(plain.emission.values, rel=0.05, abs=1e-5)


def test_albedos_and_flat_smoke_are_left_alone() -> None:
    flat, dark = np.ones((16, 16, 1), np.float32), random_style() * 0.4
    assert same_bits(*(finished(flat, dark, lift=lift) for lift in (0.0, 0.9)))
    assert same_bits(*(finished(style=dark, lift=lift, target="albedo") for lift in (0.0, 0.9)))

"""Colours from the smoke around: of voxels that no view sees, and where hues disagree."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.fixtures.smoke_fixtures import frame_of, puff, random_style, smoke_of
from tests.fixtures.stylize_fixtures import quick_config, scene_of
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.smoke.noise import white_noise
from usdsmoke.core.smoke.spread import Surroundings, blend_chroma, spread_colours
from usdsmoke.core.smoke.srgb import luma
from usdsmoke.core.steps.colour import run_colour_step
from usdsmoke.core.steps.targets import StepProblem, make_targets


def block(n: int = 16) -> tuple[ActiveSmoke, Tensor]:
    """A cube of smoke, and the places of its voxels along z, in [0, 1)."""
    smoke = smoke_of(np.ones((n, n, n)))
    return smoke, (smoke.ijk[:, 2] - smoke.ijk[:, 2].min()).float() / n


def test_trusted_colours_stay_bit_by_bit():
    smoke, _ = block(4)
    colours = white_noise(smoke.ijk, 3, 0)
    assert torch.equal(spread_colours(smoke, colours, torch.ones(len(colours))), colours)
    nothing = torch.zeros(len(colours))
    assert torch.equal(spread_colours(smoke, colours, nothing), colours)  # nothing to take from


def test_the_hidden_half_takes_the_colour_of_the_seen_half_and_none_of_its_own():
    smoke, depth = block()
    seen = depth < 0.5
    noise = white_noise(smoke.ijk, 3, 0)
    blue = torch.tensor([0.1, 0.2, 0.9])
    colours = torch.where(seen[:, None], blue, noise)
    found = spread_colours(smoke, colours, seen.float())
    assert torch.allclose(found, blue.expand_as(found), atol=1e-6)
    assert torch.equal(found[seen], colours[seen])


def test_hidden_voxels_take_the_nearest_colours_low_passed():
    """Left red, right green, with grain: behind, each side keeps its own and the grain is gone."""
    smoke, depth = block(32)
    left = smoke.ijk[:, 0] - smoke.ijk[:, 0].min() < 16
    grain = 0.5 * (white_noise(smoke.ijk, 3, 1) - 0.5)
    red, green = torch.tensor([0.7, 0.3, 0.5]), torch.tensor([0.3, 0.7, 0.5])
    colours = torch.where(left[:, None], red, green) + grain
    seen = depth < 0.25
    found = spread_colours(smoke, torch.where(seen[:, None], colours, 0.0), seen.float())
    behind = (depth > 0.3) & (depth < 0.5)
    for side, colour in ((left, red), (~left, green)):
        there = found[behind & side]
        assert (there.mean(0) - colour).abs().max().item() < 0.13
    assert found[behind & left].std(0)[2].item() < 0.15 * grain[seen].std().item()


def test_trust_mixes_softly():
    smoke, depth = block(8)
    colours = (depth < 0.5).float()[:, None].expand(-1, 3).contiguous()
    steps = [
        spread_colours(smoke, colours, torch.where(depth < 0.5, 1.0, trust))[depth > 0.5].mean()
        for trust in (0.0, 0.3, 0.6, 0.9, 1.0)
    ]
    assert steps[0].item() == pytest.approx(1.0, abs=1e-6) and steps[-1].item() == 0.0
    assert all(a >= b for a, b in pairwise(steps)) and steps[1] > steps[-1]


def test_scattered_voxels_and_one_alone_have_some_colour():
    ijk = torch.tensor([[0, 0, 0], [900, 3, -70], [901, 3, -70]])
    smoke = ActiveSmoke(ijk, torch.ones(3), np.eye(4))
    colours, trust = torch.eye(3), torch.tensor([1.0, 1.0, 0.0])
    found = spread_colours(smoke, colours, trust)
    assert torch.equal(found[:2], colours[:2])
    assert found[2].sum().item() == pytest.approx(1.0) and found[2, 2].item() == 0.0
    assert found[2, 1].item() > 0.9  # the one beside it, not the one far away
    alone = smoke.take(torch.tensor([True, False, False]))
    assert torch.equal(spread_colours(alone, colours[:1], trust[:1]), colours[:1])


def painted(depth: float) -> tuple[Tensor, Tensor]:
    """Colours of a puff after the colour step from the front, and places from front to back."""
    frame = frame_of(puff(20))
    config = quick_config(
        views={"pool": 4, "image_size": 24, "azimuth": 5, "elevation": 3},
        colour={"iterations": [40, 40]}, optics={"depth": depth},
    )  # fmt: skip
    smoke, scene = smoke_of(frame.density.values), scene_of([frame], config)
    targets = make_targets([random_style(32, 32)], scene, config, torch.device("cpu"))
    colours, _ = run_colour_step(StepProblem(smoke, targets, scene, config), [40, 40])
    z = smoke.ijk[:, 2].float()  # the camera looks along -Z: large z is in front
    return colours, (z.max() - z) / (z.max() - z.min())


def test_behind_dense_smoke_there_is_no_noise():
    """The noise that colours start from has a deviation of 0.29; the smoke's back has little."""
    colours, depth = painted(30.0)
    front, back = colours[depth < 0.3], colours[depth > 0.7]
    assert back.std(0).max().item() < 0.06
    assert (back.std(0) < 0.7 * front.std(0)).all()
    assert (back.mean(0) - front.mean(0)).abs().max().item() < 0.12


def test_thin_smoke_keeps_what_was_optimised_throughout():
    colours, depth = painted(0.3)
    assert colours[depth > 0.7].std(0).min().item() > 0.09


def test_chroma_is_blended_and_luma_stays():
    smoke, _ = block()
    colours = 0.4 + 0.2 * white_noise(smoke.ijk, 3, 0)
    found = blend_chroma(Surroundings(smoke, torch.ones(len(colours))), colours)
    assert torch.allclose(luma(found), luma(colours), atol=1e-6)
    ijk = smoke.ijk - smoke.ijk.amin(0)
    inside = ((ijk > 0) & (ijk < 15)).all(dim=1)
    before, after = (c - luma(c)[:, None] for c in (colours, found))
    # of noise, weights of 1, 4 and 1 sixths along an axis leave the root of a half
    expected = 0.5**1.5
    assert (after[inside].std() / before[inside].std()).item() == pytest.approx(expected, rel=0.05)
    assert torch.allclose(
        blend_chroma(Surroundings(smoke, colours[:, 0]), 0 * colours + 0.3), 0 * colours + 0.3
    )


def test_chroma_is_that_of_the_denser_smoke():
    """A row of three: the one in the middle is denser, and the one in front not beside them."""
    smoke = ActiveSmoke(torch.tensor([[9, 0, 3], [0, 0, 1], [0, 0, 0]]), torch.ones(3), np.eye(4))
    colours = torch.tensor([[0.2, 0.3, 0.4], [0.5, 0.1, 0.3], [0.1, 0.5, 0.3]])
    weight = torch.tensor([1.0, 3.0, 1.0])
    found = blend_chroma(Surroundings(smoke, weight), colours)
    grey = luma(colours)[:, None]
    chroma = colours - grey
    assert torch.allclose(found[0], colours[0], atol=1e-6)
    assert torch.allclose(found[1], grey[1] + (12 * chroma[1] + chroma[2]) / 13, atol=1e-6)
    assert torch.allclose(found[2], grey[2] + (3 * chroma[1] + 4 * chroma[2]) / 7, atol=1e-6)
    assert torch.allclose(blend_chroma(Surroundings(smoke, torch.zeros(3)), colours), colours)


def outliers(values: np.ndarray, density: np.ndarray | None = None) -> np.ndarray:
    """How far the values of a box of voxels outlie; 0 where there is no smoke."""
    smoke = smoke_of(np.ones(values.shape) if density is None else density)
    place = tuple(smoke.ijk.T.numpy())
    lights = torch.as_tensor(values[place], dtype=torch.float32)
    around = Surroundings(smoke, torch.ones(len(lights)))
    found = np.zeros(values.shape)
    found[place] = around.outlying(lights, torch.arange(len(lights))).numpy()
    return found


@pytest.mark.parametrize("sign", [1, -1])
def test_a_voxel_outlies_all_but_one_of_those_beside_it(sign):
    values = np.zeros((7, 7, 7))
    values[3, 3, 3] = sign * 0.5
    np.testing.assert_allclose(outliers(values), values, atol=1e-6)
    values[3, 3, 4] = sign * 0.5  # two together: one equal voxel beside is not enough
    np.testing.assert_allclose(outliers(values)[3, 3, 3:5], sign * 0.5, atol=1e-6)
    values[3, 4, 3] = sign * 0.4  # the corner of three, beside a second one
    assert outliers(values)[3, 3, 3] == pytest.approx(sign * 0.1, abs=1e-6)


def test_slopes_edges_and_lines_do_not_outlie():
    i, j, k = np.indices((9, 9, 9))
    line = ((i == 4) & (j == 4)).astype(float)
    for values in (0.1 * i - 0.03 * k, (i + j > 8).astype(float), (i > 4).astype(float), line):
        inside = outliers(values)[1:-1, 1:-1, 1:-1]
        np.testing.assert_allclose(inside, 0, atol=1e-6)


def test_voxels_of_a_slab_and_alone_do_not_outlie():
    noise = np.random.default_rng(0).random((12, 9, 1))
    np.testing.assert_array_equal(outliers(noise), 0)
    assert np.abs(outliers(np.repeat(noise, 3, axis=2))).max() == 0  # alike along the third axis
    apart = np.zeros((5, 5, 5))
    apart[::2, ::2, ::2] = 1
    np.testing.assert_array_equal(outliers(np.random.default_rng(1).random((5, 5, 5)), apart), 0)


def test_what_outlies_is_that_of_all_voxels_for_some_rows_too():
    smoke = smoke_of(np.random.default_rng(2).random((9, 10, 11)) > 0.05)
    lights = torch.rand(len(smoke.ijk), generator=torch.Generator().manual_seed(0))
    around = Surroundings(smoke, torch.ones(len(lights)))
    rows = torch.arange(3, len(lights), 7)
    every = around.outlying(lights, torch.arange(len(lights)))
    assert torch.equal(around.outlying(lights, rows), every[rows])
    assert float((every != 0).float().mean()) > 0.1
    # once taken away, hardly any is left: voxels beside each other are levelled at once
    left = around.outlying(lights - every, torch.arange(len(lights)))
    assert float(left.abs().mean()) < 0.2 * float(every.abs().mean())

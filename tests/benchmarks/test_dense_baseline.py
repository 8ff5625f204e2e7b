"""The dense baseline draws, moves and differentiates what it says, to the order it says."""

import numpy as np
import pytest
import torch

from benchmarks.baselines import (
    DenseBox,
    advect_box,
    baseline_colour,
    baseline_shape,
    dense_box,
    inclusive_weights,
    rotate_box,
)
from tests.fixtures.smoke_fixtures import puff, random_style
from tests.fixtures.stylize_fixtures import quick_config
from usdsmoke.base.volume import DenseField
from usdsmoke.core.smoke.active import activate
from usdsmoke.core.steps.targets import make_targets
from usdsmoke.core.views.cameras import orbit_view
from usdsmoke.core.views.project import column_map
from usdsmoke.core.views.scene import Scene

SCENE = Scene(0.5, 0.5, 1.0, "Y", 1.0, 16)


def field_of(values: np.ndarray) -> DenseField:
    return DenseField("density", np.asarray(values, np.float32), (3, -2, 5), np.eye(4))


def test_a_turned_box_shows_the_columns_of_our_own_projection() -> None:
    generator = np.random.default_rng(0)
    values = np.zeros((14, 18, 12), np.float32)
    values[4:10, 5:13, 3:9] = puff(8)[:6, :8, :6] + 0.1 * generator.random((6, 8, 6))
    box = dense_box(field_of(values))
    smoke = activate(field_of(values), np.eye(4), torch.device("cpu"))
    room = 8
    density = torch.nn.functional.pad(box.density, (room,) * 6)
    depth, height, width = density.shape
    centre = np.array(box.low) - room + (np.array([width, height, depth]) - 1) / 2
    for azimuth, elevation, atol in ((0.0, 0.0, 1e-5), (90.0, 0.0, 1e-5), (12.0, -6.0, 0.25)):
        view = orbit_view(azimuth, elevation, "Y", centre, height, width, 1.0)
        wanted = column_map(smoke.positions, np.eye(3), view).apply(smoke.density[:, None])[..., 0]
        found = rotate_box(density[None], azimuth, elevation)[0].sum(0)
        if azimuth == 90.0 and depth != width:
            found = found[:, : wanted.shape[1]]  # a box that is not a cube loses its ends
        assert found.sum() == pytest.approx(float(wanted.sum()), rel=1e-2)
        assert torch.allclose(found, wanted, atol=atol)


def test_a_shift_by_whole_voxels_moves_every_voxel() -> None:
    density = torch.from_numpy(np.pad(puff(8), 3))
    moved = advect_box(
        density, torch.tensor([1.0, 2.0, -1.0]).view(3, 1, 1, 1).expand(3, 14, 14, 14)
    )
    wanted = torch.roll(density, (-1, 2, 1), (0, 1, 2))  # D H W
    assert torch.allclose(moved, wanted, atol=1e-6)


def test_the_inclusive_sum_is_of_first_order() -> None:
    errors = []
    for n in (64, 128, 256):
        s = (torch.arange(n, dtype=torch.float64) + 0.5) / n
        weights = inclusive_weights(((1 + s**2) * 3 / n).view(n, 1, 1))
        errors.append(abs(float(weights.sum()) - float(1 - torch.exp(torch.tensor(-4.0)))))
    assert errors[0] / errors[1] == pytest.approx(2, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(2, rel=0.1)


@pytest.mark.parametrize("step", ["shape", "colour"])
def test_the_baseline_s_own_loss_falls(step: str) -> None:
    config = quick_config(views={"pool": 3, "image_size": 16})
    box: DenseBox = dense_box(field_of(puff(12)))
    targets = make_targets([random_style()], SCENE, config, torch.device("cpu"))
    judge, losses = targets.at(1, grey=step == "shape"), []

    def noted(*arguments: object) -> torch.Tensor:
        loss = judge(*arguments)  # type: ignore[arg-type]
        losses.append(float(loss.detach()))
        return loss

    if step == "shape":
        states = [state() for state in baseline_shape(box, lambda _: noted, SCENE, config, (0, 6))]  # type: ignore[arg-type, return-value]
        assert states[-1].shape == box.density.shape and not states[-1].equal(box.density)
    else:
        states = list(baseline_colour(box, noted, torch.full((3,), 0.5), SCENE, config, 6))  # type: ignore[arg-type]
        assert states[-1].min() >= 0 and states[-1].max() <= 1
    assert len(states) == 6 and len(losses) >= 6 * 9
    assert np.mean(losses[5 * 9 : 6 * 9]) < 0.97 * np.mean(losses[:9])

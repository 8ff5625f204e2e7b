"""One frame through both steps with every loss and control of the optimiser."""

import numpy as np
import pytest

from tests.fixtures.smoke_fixtures import frame_of, puff
from tests.fixtures.stylize_fixtures import by_voxel, quick_config, run_core
from usdsmoke.core.sequence.stylize import StylizedFrame
from usdsmoke.core.style import losses

DENSITY = puff(12)
FRAME = frame_of(DENSITY)
WEIGHTS = [
    {"statistic": "gram"},
    {"histogram": 1.0},
    {"content": 1.0},
    {"laplacian": 10.0},
    {"photorealism": 10.0},
    {"total_variation": 1.0},
]


@pytest.mark.parametrize("weights", WEIGHTS, ids=lambda weights: next(iter(weights)))
def test_every_loss_counts_in_both_steps(weights):
    """From the same start it leads elsewhere than the plain style does."""
    plain, other = (
        run_core([FRAME], quick_config(losses=w, shape={"iterations": [3]}))[0]
        for w in ({}, weights)
    )
    for result in (plain, other):
        assert np.isfinite(result.emission.values).all() and result.emission.values.any()
    assert by_voxel(plain.density) != by_voxel(other.density)
    assert by_voxel(plain.emission) != by_voxel(other.emission)
    for step in ("shape", "colour"):
        assert plain.report.steps[step].loss != other.report.steps[step].loss


def moved(weights: dict[str, float]) -> float:
    """How much density the shape step changes, as a share of all."""
    config = quick_config(
        losses=weights,
        shape={"iterations": [20], "learning_rate": 0.06},
        optimize={"steps": ["shape"], "threads": 1},
    )
    found, source = by_voxel(run_core([FRAME], config)[0].density), by_voxel(FRAME.density)
    voxels = found.keys() | source.keys()
    change = sum(abs(found.get(v, (0.0,))[0] - source.get(v, (0.0,))[0]) for v in voxels)
    return change / float(DENSITY.sum())


def test_what_is_kept_of_the_smoke_s_own_picture_holds_the_smoke_in_place():
    free = moved({})
    assert free > 0.02
    assert moved({"content": 100.0}) < 0.1 * free
    assert moved({"laplacian": 1e5}) < 0.1 * free
    assert moved({"photorealism": 1e5}) < 0.6 * free  # free to be any affine function of itself


def test_content_pictures_are_not_made_when_no_loss_looks_at_them(monkeypatch):
    def refuse(*_: object) -> None:
        raise AssertionError("a content picture was made that nobody looks at")

    monkeypatch.setattr("usdsmoke.core.steps.colour._content_picture", refuse)
    monkeypatch.setattr(losses.PictureLoss, "content", refuse)
    monkeypatch.setattr(losses.StyleTarget, "content_maps", refuse)
    run_core([FRAME], quick_config(losses={"histogram": 1.0, "total_variation": 1.0}))


@pytest.mark.parametrize(("gamma", "loss", "most"), [(1e-4, 0.002, 0.01), (1e-12, 3e-4, 3e-3)])
def test_smoke_of_a_faint_gamma_goes_through_both_steps_like_the_paper_s(gamma, loss, most):
    """Its light is as faint as it is itself; shape and colours are those of the thin limit.

    A gamma of 0.3 is 0.08 off in the loss and 0.06 in the density.
    """

    def run(value: float) -> StylizedFrame:
        optics = {"gamma": value, "gamma_shape": value}
        rates = {"shape": {"learning_rate": 0.06}, "colour": {"learning_rate": 0.05}}
        config = quick_config(optics=optics, **rates).with_values({"views.elevation": 40.0})
        return run_core([FRAME], config)[0]

    limit, found = run(1e-6), run(gamma)
    assert found.report.shape.loss == pytest.approx(limit.report.shape.loss, rel=loss)
    assert found.report.colour.loss == pytest.approx(limit.report.colour.loss, rel=loss)
    one, other = by_voxel(limit.density), by_voxel(found.density)
    assert max(abs(one[v][0] - other.get(v, (0.0,))[0]) for v in one) < most
    light = found.emission.values / np.float32(gamma)
    assert np.isfinite(light).all() and 0 < light.max() <= 1.01 * found.density.values.max()

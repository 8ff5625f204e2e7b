"""The core where it does not compute on the processor: the same results, and nothing is mixed.

Without a GPU, a device that only has another name stands for one.
"""

from collections.abc import Callable
from contextlib import nullcontext

import numpy as np
import pytest
import torch

from tests.fixtures.foreign_device import FOREIGN, foreign_device
from tests.fixtures.smoke_fixtures import frame_of, puff, random_style
from tests.fixtures.stylize_fixtures import quick_config, run_core, scene_of
from usdsmoke.core.generator.network import Generator
from usdsmoke.core.sequence import frame_state
from usdsmoke.core.sequence.frame_state import make_context, open_frame
from usdsmoke.core.training.canvas import Canvas

FRAMES = [frame_of(puff(8, seed), seed + 1.0) for seed in range(2)]
STYLE = random_style()
CONFIG = quick_config(
    shape={"iterations": [1, 1]},
    colour={"iterations": [1, 1]},
    features={"layers": ["oriented1"]},
    views={"pool": 1, "image_size": 16},
)
SCENE = scene_of(FRAMES, CONFIG)

Elsewhere = Callable[[Callable[[], list[np.ndarray]]], list[np.ndarray]]


@pytest.fixture(
    params=[
        FOREIGN,
        pytest.param(
            torch.device("cuda"),
            marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device"),
        ),
    ],
    ids=str,
)
def elsewhere(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Elsewhere:
    """What a computation gives on another device."""

    def run(compute: Callable[[], list[np.ndarray]]) -> list[np.ndarray]:
        monkeypatch.setattr(frame_state, "choose_device", lambda config: request.param)
        with foreign_device() if request.param == FOREIGN else nullcontext():
            return compute()

    return run


def assert_about_equal(found: list[np.ndarray], expected: list[np.ndarray]) -> None:
    """Sums of single precision are taken in another order, which an optimiser's steps magnify."""
    for values, wanted in zip(found, expected, strict=True):
        assert np.linalg.norm(values - wanted) <= 0.01 * np.linalg.norm(wanted)


@pytest.mark.parametrize("step", ["shape", "colour"])
def test_frames_are_those_of_the_processor(step: str, elsewhere: Elsewhere) -> None:
    """One step at a time: colours of one iteration jump with the last bits of the density."""
    config = CONFIG.replace(optimize=CONFIG.optimize.replace(steps=(step,)))

    def compute() -> list[np.ndarray]:
        found = run_core(FRAMES, config, SCENE, [STYLE])
        return [f.values for one in found for f in (one.density, one.emission) if f is not None]

    expected = compute()
    assert_about_equal(elsewhere(compute), expected)


def test_a_network_and_its_gradients_are_those_of_the_processor(elsewhere: Elsewhere) -> None:
    def compute() -> list[np.ndarray]:
        context = make_context([STYLE], SCENE, CONFIG, None, 24.0, None, 0)
        canvas = Canvas(open_frame(FRAMES[0], context).colour_problem(), 0, 1)
        generator = Generator.new(torch.tensor([0.2, 0.5, 0.7], device=context.device), 3)
        leaves = [values.requires_grad_() for values in generator.parameters.values()]
        colours = canvas.paint(generator, 0)
        slopes = torch.autograd.grad(canvas.loss(colours, 0), leaves)
        return [values.detach().cpu().numpy() for values in (colours, *slopes)]

    expected = compute()
    assert_about_equal(elsewhere(compute), expected)


def test_what_mixes_devices_is_found() -> None:
    with foreign_device():
        there, here = torch.ones(3, device=FOREIGN), torch.ones(3)
        with pytest.raises(RuntimeError, match="mixes devices"):
            there + here
        with pytest.raises(TypeError, match="NumPy"):
            there.numpy()
        assert (there + here.to(FOREIGN)).cpu().tolist() == [2, 2, 2]

"""The core on a device that is not the processor: nothing is mixed, and results are the same."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from tests.fixtures.foreign_device import FOREIGN, foreign_device
from tests.fixtures.smoke_fixtures import frame_of, puff, random_style
from tests.fixtures.stylize_fixtures import quick_config, run_core, scene_of
from usdsmoke.base.sections import OptimizeConfig
from usdsmoke.core.generator.network import Generator
from usdsmoke.core.sequence import frame_state
from usdsmoke.core.sequence.frame_state import make_context, open_frame
from usdsmoke.core.smoke.tasks import share_among
from usdsmoke.core.training.canvas import Canvas

FRAMES = [frame_of(puff(8, seed), seed + 1.0) for seed in range(2)]
STYLE = random_style()
CONFIG = quick_config(
    shape={"iterations": [1, 1]}, colour={"iterations": [1, 1]}, features={"layers": ["oriented1"]}
)
SCENE = scene_of(FRAMES, CONFIG)


def elsewhere(monkeypatch: pytest.MonkeyPatch, compute: Callable[[], object]) -> object:
    """What a computation gives on ``FOREIGN``."""

    def choose(config: OptimizeConfig) -> torch.device:
        share_among(1)
        return FOREIGN

    monkeypatch.setattr(frame_state, "choose_device", choose)
    with foreign_device():
        return compute()


def test_frames_are_those_of_the_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    def compute() -> list[np.ndarray]:
        found = run_core(FRAMES, CONFIG, SCENE, [STYLE])
        fields = [field for one in found for field in (one.density, one.emission)]
        return [field.values for field in fields if field is not None]

    expected = compute()
    for found, wanted in zip(elsewhere(monkeypatch, compute), expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=2e-3, atol=1e-4)


def test_a_network_and_its_gradients_are_those_of_the_processor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def compute() -> list[np.ndarray]:
        context = make_context([STYLE], SCENE, CONFIG, None, 24.0, None, 0)
        canvas = Canvas(open_frame(FRAMES[0], context).colour_problem(), 0, 1)
        generator = Generator.new(torch.tensor([0.2, 0.5, 0.7], device=context.device), 3)
        leaves = [values.requires_grad_() for values in generator.parameters.values()]
        colours = canvas.paint(generator, 0)
        slopes = torch.autograd.grad(canvas.loss(colours, 0), leaves)
        return [values.detach().cpu().numpy() for values in (colours, *slopes)]

    expected = compute()
    for found, wanted in zip(elsewhere(monkeypatch, compute), expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=2e-3, atol=1e-4)


def test_what_mixes_devices_is_found() -> None:
    with foreign_device():
        there, here = torch.ones(3, device=FOREIGN), torch.ones(3)
        with pytest.raises(RuntimeError, match="mixes devices"):
            there + here
        with pytest.raises(TypeError, match="NumPy"):
            there.numpy()
        assert (there + here.to(FOREIGN)).cpu().tolist() == [2, 2, 2]

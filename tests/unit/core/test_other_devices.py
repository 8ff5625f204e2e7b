"""The core where it does not compute on the processor: the same results, and nothing is mixed.

Without a GPU, a device that only has another name stands for one.
"""

from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.fixtures.foreign_device import FOREIGN, NoReplay, foreign_device
from tests.fixtures.smoke_fixtures import frame_of, puff, random_style
from tests.fixtures.stylize_fixtures import quick_config, run_core, scene_of
from usdsmoke.config.look_sections import LossesConfig
from usdsmoke.core.features import convolve
from usdsmoke.core.features.network import EmbeddedFeatures, Network
from usdsmoke.core.features.vgg19 import Vgg19Features
from usdsmoke.core.generator.network import Generator
from usdsmoke.core.sequence import frame_state
from usdsmoke.core.sequence.coarse import coarse_frames
from usdsmoke.core.sequence.frame_state import make_context, open_frame
from usdsmoke.core.sequence.start_files import load_start, save_start
from usdsmoke.core.sequence.stylize import WindowStart, stylize_window
from usdsmoke.core.smoke import replay
from usdsmoke.core.smoke.replay import enlarged
from usdsmoke.core.style.losses import StyleTarget
from usdsmoke.core.style.patches import StylePatches, patch_shares
from usdsmoke.core.style.quantiles import quantile_distance, quantile_table, random_directions
from usdsmoke.core.style.sliced import sliced_distance
from usdsmoke.core.training.canvas import Canvas

FRAMES = [frame_of(puff(8, seed), seed + 1.0) for seed in range(2)]
STYLE = random_style()
CONFIG = quick_config(
    shape={"iterations": [1, 1]},
    colour={"iterations": [1, 1]},
    features={"layers": ["oriented1"]},
    views={"pool": 1, "image_size": 16},
    optimize={"device": "cpu"},
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
def device(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> torch.device:
    """Where it is not the processor that computes. Neither rounds, and pictures stay as they are.

    The processor's slopes in bfloat16 are off by half a percent, cuDNN's convolutions by less.
    """
    monkeypatch.setattr(convolve, "multiplies_bfloat16", lambda: False)
    monkeypatch.setattr(torch.backends.cudnn, "enabled", False)  # as ``choose_device`` does
    monkeypatch.setattr(replay, "SIDE", 1)
    return request.param


@pytest.fixture
def elsewhere(device: torch.device, monkeypatch: pytest.MonkeyPatch) -> Elsewhere:
    """What a computation gives on another device."""

    def run(compute: Callable[[], list[np.ndarray]]) -> list[np.ndarray]:
        monkeypatch.setattr(frame_state, "choose_device", lambda config: device)
        with foreign_device() if device == FOREIGN else nullcontext():
            return compute()

    return run


def assert_about_equal(found: list[np.ndarray], expected: list[np.ndarray]) -> None:
    """Sums of single precision are taken in another order, which an optimiser's steps magnify."""
    for values, wanted in zip(found, expected, strict=True):
        assert np.linalg.norm(values - wanted) <= 1e-3 * np.linalg.norm(wanted)


@pytest.mark.parametrize("step", ["shape", "colour"])
def test_frames_are_those_of_the_processor(step: str, elsewhere: Elsewhere) -> None:
    """One step at a time: colours of one iteration jump with the last bits of the density."""
    config = CONFIG.replace(optimize=CONFIG.optimize.replace(steps=(step,)))

    def compute() -> list[np.ndarray]:
        found = run_core(FRAMES, config, SCENE, [STYLE])
        return [f.values for one in found for f in (one.density, one.emission) if f is not None]

    expected = compute()
    assert_about_equal(elsewhere(compute), expected)


@pytest.mark.parametrize("step", ["shape", "colour"])
def test_windows_behind_a_coarse_step_are_those_of_the_processor(
    step: str, elsewhere: Elsewhere, tmp_path: Path
) -> None:
    """Its starts come from files, on the processor."""
    config = CONFIG.replace(
        optimize=CONFIG.optimize.replace(steps=(step,)),
        windows=CONFIG.windows.replace(shared_octaves=1),
    )
    starts = {}
    for start in coarse_frames(FRAMES, [STYLE], SCENE, config):
        file_path = tmp_path / f"{start.time_code}.npz"
        save_start(start, file_path)
        starts[start.time_code] = load_start(file_path)

    def compute() -> list[np.ndarray]:
        window = WindowStart(coarse=starts.get)
        found = list(stylize_window(FRAMES, [STYLE], SCENE, config, start=window))
        return [f.values for one in found for f in (one.density, one.emission) if f is not None]

    expected = compute()
    assert_about_equal(elsewhere(compute), expected)


def test_enlarged_pictures_end_where_the_processor_does(
    elsewhere: Elsewhere, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their slopes differ by some percent (decision 067), where a descent ends hardly does.

    Two runs have the same bits.
    """
    config = CONFIG.replace(
        optimize=CONFIG.optimize.replace(steps=("colour",)),
        colour=CONFIG.colour.replace(iterations=(8, 8)),
        # of which the second octave has more than the first, so that their losses do not compare
        losses=CONFIG.losses.replace(local_contrast=0.0),
        features=CONFIG.features.replace(layers=("oriented1", "learned2")),
        views=CONFIG.views.replace(image_size=40, elevation=40.0),
    )
    frames = [frame_of(puff(40, 1), 1.0)]

    def compute() -> list[np.ndarray]:
        (found,) = run_core(frames, config, scene_of(frames, config), [STYLE])
        assert found.report.colour is not None and found.emission is not None
        return [np.array(found.report.colour.loss), found.emission.values]

    expected, _ = compute()
    monkeypatch.setattr(replay, "SIDE", 64)
    (found, colours), (again, same) = elsewhere(compute), elsewhere(compute)
    assert found[-1] == pytest.approx(expected[-1], rel=0.02)
    assert expected[-1] < 0.8 * expected[0]
    assert np.array_equal(found, again) and np.array_equal(colours, same)


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


@pytest.mark.parametrize("features", [3, 24])
@pytest.mark.parametrize("n", [200, 3000])
def test_statistics_are_those_of_the_processor(
    n: int, features: int, elsewhere: Elsewhere, device: torch.device
) -> None:
    """Where samples have no weight, the processor leaves them out."""
    source = torch.Generator().manual_seed(1)
    values = torch.randn(features, n, generator=source)
    weights = (torch.rand(n, generator=source) - 0.4).clamp_min(0)
    values[:, weights == 0] *= 100
    style = torch.randn(features, 400, generator=source)
    axes = random_directions(features, 8, 0, style)

    def measure(where: torch.device, weights: torch.Tensor) -> list[np.ndarray]:
        leaf = values.to(where).requires_grad_()
        own, other, along = (x.to(where) for x in (weights, style, axes))
        distances = (
            sliced_distance(leaf, own, along, quantile_table(along @ other)),
            quantile_distance(leaf, own, quantile_table(other)),
        )
        slopes = [
            torch.autograd.grad(distance, leaf, retain_graph=True)[0] for distance in distances
        ]
        return [one.detach().cpu().numpy() for one in (*distances, *slopes)]

    for some in (weights, torch.zeros(n)):
        expected = measure(torch.device("cpu"), some)
        found = elsewhere(partial(measure, device, some))
        for values_there, wanted in zip(found, expected, strict=True):
            assert np.linalg.norm(values_there - wanted) <= 1e-4 * np.linalg.norm(wanted)
    assert all(np.all(one == 0) for one in expected)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_patches_are_those_of_the_processor(
    share: float, elsewhere: Elsewhere, device: torch.device
) -> None:
    """Where there is little smoke, the processor leaves them out."""
    source = torch.Generator().manual_seed(1)
    picture, style = (torch.rand(60, 50, 3, generator=source) for _ in range(2))
    guide = torch.linspace(-1, 1, 50).expand(60, 50).add(2 * share - 1).clamp(0, 1)

    def measure(where: torch.device) -> list[np.ndarray]:
        leaf, number = picture.to(where).requires_grad_(), torch.tensor(1).to(where)
        draw = 1 if where.type == "cpu" else number
        loss = StylePatches(style.to(where)).loss(leaf, patch_shares(guide).to(where), draw)
        slope = torch.autograd.grad(loss, leaf)[0]
        return [one.detach().cpu().numpy() for one in (loss, slope)]

    expected = measure(torch.device("cpu"))
    assert_about_equal(elsewhere(partial(measure, device)), expected)
    assert bool(expected[1].any()) == (share > 0)


def vgg19(style: torch.Tensor) -> Vgg19Features:
    """Of the right shape, without a file."""
    source = torch.Generator().manual_seed(0)
    shapes = {"relu1_1": (3, 64), "relu1_2": (64, 64), "relu2_1": (64, 128)}
    weights = {
        name: (torch.randn(n_out, n_in, 3, 3, generator=source) / 20, torch.zeros(n_out))
        for name, (n_in, n_out) in shapes.items()
    }
    return Vgg19Features(weights).to(style)


@pytest.mark.parametrize("make", [EmbeddedFeatures, vgg19])
@pytest.mark.parametrize("statistic", ["sliced_wasserstein", "gram"])
def test_what_is_recorded_waits_for_no_number(
    make: Callable[[torch.Tensor], Network],
    statistic: str,
    device: torch.device,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A GPU can record a style's loss: nothing in it is read, or moved from the processor.

    Its pictures are enlarged, which changes nothing where they end in background. One recording
    serves pictures in turn.
    """
    monkeypatch.setattr(replay, "SIDE", 64)
    config, style = LossesConfig(histogram=1.0, statistic=statistic), torch.tensor(STYLE)
    pictures, guide = torch.full((3, 56, 56, 3), 0.4), torch.zeros(56, 56)
    source = torch.Generator().manual_seed(0)
    pictures[:2, 20:36, 20:36] = torch.rand(2, 16, 16, 3, generator=source)
    pictures[2], guide[20:36, 20:36] = pictures[0], 0.9
    names = ["relu1_1", "relu2_1"] if make is vgg19 else ["oriented1", "learned0", "learned2"]

    def losses_on(where: torch.device) -> list[np.ndarray]:
        like = style.to(where)
        target = StyleTarget(
            like, make(like), dict.fromkeys(names, 1.0), config, patches=StylePatches(like)
        )
        found = []
        for picture in pictures:
            leaf = picture.to(where).requires_grad_()
            loss = target.loss(leaf, guide.to(where), 5)
            found += [loss.detach(), torch.autograd.grad(loss, leaf)[0]]
        return [one.cpu().numpy() for one in found]

    expected = losses_on(torch.device("cpu"))
    with foreign_device() if device == FOREIGN else nullcontext():
        found = losses_on(device)
    assert_about_equal(found, expected)
    assert np.array_equal(found[0], found[4]) and np.array_equal(found[1], found[5])
    assert not np.array_equal(found[0], found[2])


@pytest.mark.parametrize(
    "wait",
    [
        lambda values: float(values[0]),
        lambda values: values.nonzero(),
        lambda values: values[values > 0],
        lambda values: values.cpu(),
        lambda values: values.tolist(),
        lambda values: values + values.new_tensor([1.0, 2.0]),
        lambda values: values + torch.tensor([1.0, 2.0], device=FOREIGN),
        lambda values: torch.equal(values, values),
    ],
)
def test_what_waits_in_a_recording_is_found(wait: Callable[[torch.Tensor], object]) -> None:
    """Also in the slope's part."""
    told = []

    class Waiting(torch.autograd.Function):
        @staticmethod
        def forward(ctx, values):
            return values.sum()

        @staticmethod
        def backward(ctx, upstream):
            if told:
                wait(upstream.expand(2).clone())
            return upstream.expand(2)

    with foreign_device():
        values = torch.tensor([1.0, 2.0], device=FOREIGN)
        recorded = NoReplay(Waiting.apply, values)
        told.append(True)
        with pytest.raises(RuntimeError, match="waits"):
            recorded(values)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_a_loss_is_recorded_after_all_others_are_freed() -> None:
    """As from one window to the next."""
    values = torch.tensor([1.0, 2.0], device="cuda", requires_grad=True)
    for power in (2, 3):
        recorded = replay.Replay(lambda x, power=power: (x**power).sum(), values)
        (slope,) = torch.autograd.grad(recorded(values), values)
        assert torch.equal(slope, power * values.detach() ** (power - 1))
        del recorded


def test_an_enlarged_picture_has_the_slope_of_its_repeated_border(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(replay, "SIDE", 8)
    picture = torch.rand(5, 7, 3, dtype=torch.float64, requires_grad=True)
    wide, guide = enlarged(picture, torch.ones(5, 7))
    assert wide.shape == (8, 8, 3) and guide.shape == (8, 8) and guide.sum() == 35
    assert torch.equal(wide[5:, :7], picture[4:].expand(3, 7, 3))
    assert torch.equal(wide[:5, 7], picture[:, 6])
    assert torch.autograd.gradcheck(lambda p: enlarged(p, torch.ones(5, 7))[0], picture)


def test_what_mixes_devices_is_found() -> None:
    with foreign_device():
        there, here = torch.ones(3, device=FOREIGN), torch.ones(3)
        with pytest.raises(RuntimeError, match="mixes devices"):
            there + here
        with pytest.raises(TypeError, match="NumPy"):
            there.numpy()
        assert (there + here.to(FOREIGN)).cpu().tolist() == [2, 2, 2]

"""Areas of a style image: with marks, and not dark."""

import numpy as np
import pytest
import torch
from torch import Tensor

from usdsmoke.base.errors import ShapeError
from usdsmoke.config.look_sections import LossesConfig
from usdsmoke.config.settings import Config
from usdsmoke.core.steps.targets import make_targets
from usdsmoke.core.style.losses import StyleTarget
from usdsmoke.core.style.patches import StylePatches
from usdsmoke.core.style.style_areas import LONGEST, MOST, marked_areas
from usdsmoke.core.style.style_image import match_grey
from usdsmoke.core.views.scene import Scene

SIDE = 96  # pixels; areas are Gaussians of 4 of them
SCENE = Scene(0.6, 0.3, 1.0, "Y", 1.0, SIDE)


def marks(low: float = 0.4, high: float = 0.9, seed: int = 0, side: int = SIDE) -> np.ndarray:
    """Squares of two pixels."""
    found = np.random.default_rng(seed).uniform(low, high, (side // 2, side // 2, 3))
    return found.repeat(2, 0).repeat(2, 1).astype(np.float32)


def with_band(band: np.ndarray | float, width: int = SIDE // 4) -> np.ndarray:
    """Marks, with a band of something else to the left."""
    style = marks()
    style[:, :width] = band if isinstance(band, float) else band[:, :width]
    return style


class Pixels:
    """A network whose feature map is the picture itself."""

    def __call__(self, picture: Tensor, wanted: frozenset[str]) -> dict[str, Tensor]:
        return dict.fromkeys(wanted, picture.permute(2, 0, 1)[None])


def test_dark_areas_are_left_out() -> None:
    kept = marked_areas(with_band(marks(0.0, 0.3)))
    assert not kept[:, :16].any() and kept[:, 32:].all()


def test_areas_without_marks_are_left_out() -> None:
    kept = marked_areas(with_band(0.7))
    assert not kept[:, :12].any() and kept[:, 32:].all()


def test_dark_areas_with_bright_marks_are_kept() -> None:
    dark = marks(0.0, 0.1)
    dark[marks(0.0, 1.0, seed=1)[..., 0] > 0.65] = 1.0
    assert dark.max(axis=2).mean() < 0.45
    assert marked_areas(with_band(dark)).all()


@pytest.mark.parametrize("value", [0.0, 0.1, 1.0])
def test_an_even_style_is_kept(value: float) -> None:
    assert marked_areas(np.full((40, 30, 3), value, np.float32)).all()


def test_a_dark_style_stays_dark() -> None:
    """The darkest third is left out, of areas that differ."""
    style = marks(0.0, 0.2) + np.linspace(0, 0.3, SIDE, dtype=np.float32)[:, None, None]
    kept = marked_areas(style)
    assert 1 - kept.mean() == pytest.approx(MOST, abs=0.02)
    assert kept[-20:].all() and not kept[:10].any()


def test_flat_areas_go_before_dark_ones() -> None:
    style = marks()
    style[:, :30], style[:, -30:] = 0.7, marks(0.0, 0.3)[:, -30:]
    kept = marked_areas(style)
    assert not kept[:, :12].any()
    assert 1 - kept.mean() < MOST + 0.01


@pytest.mark.parametrize("noise", [0.0, 1 / 255])
@pytest.mark.parametrize("side", [SIDE, 300, 481])
def test_graphics_of_even_colours_are_kept(side: int, noise: float) -> None:
    """Though most of their areas are without marks, and one of the colours is dark."""
    style = np.empty((side, side, 3), np.float32)
    style[:, : side // 2], style[:, side // 2 :] = [0.3, 0.1, 0.05], [0.95, 0.85, 0.65]
    style += np.random.default_rng(0).uniform(-noise, noise, style.shape)
    assert marked_areas(style).mean() > 0.98


def test_marks_of_equal_light_are_marks() -> None:
    band = marks()
    light = band @ np.float32([0.2126, 0.7152, 0.0722])
    band += (0.6 - light)[..., None]  # as bright everywhere
    assert marked_areas(with_band(band.clip(0, 1))).all()


def test_fine_marks_of_a_large_image_are_marks() -> None:
    """Reduced or not: dark areas with bright marks of two pixels stay."""
    for side in (1024, 1030, 1600):
        style = marks(side=side)
        dark = np.zeros_like(style)
        dark[marks(0.0, 1.0, seed=1, side=side)[..., 0] > 0.65] = 1.0
        style[:, : side // 4] = dark[:, : side // 4]
        assert marked_areas(style).all()


def test_a_slope_has_no_marks() -> None:
    """It is kept where nothing has marks."""
    slope = np.linspace(0.6, 1, SIDE, dtype=np.float32)
    slope = np.broadcast_to(slope[:, None, None], (SIDE, SIDE, 3))
    assert marked_areas(slope).all()
    kept = marked_areas(with_band(slope))
    assert not kept[:, :12].any() and kept[:, 32:].all()


def test_mirrored_styles_have_mirrored_areas() -> None:
    style = with_band(marks(0.0, 0.3))
    for axis in (0, 1):
        assert np.array_equal(
            marked_areas(np.flip(style, axis)), np.flip(marked_areas(style), axis)
        )


def test_a_larger_image_has_the_same_areas() -> None:
    style = with_band(marks(0.0, 0.3))
    times = -(-2 * LONGEST // SIDE)
    kept = marked_areas(style.repeat(times, 0).repeat(times, 1)[:-1])
    assert kept.shape == (SIDE * times - 1, SIDE * times)
    small = marked_areas(style).repeat(times, 0).repeat(times, 1)[:-1]
    assert (kept != small).mean() < 0.03


@pytest.mark.parametrize("shape", [(4, 4), (4, 4, 4), (0, 4, 3)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ShapeError):
        marked_areas(np.zeros(shape, np.float32))


@pytest.mark.parametrize("statistic", ["gram", "sliced_wasserstein"])
def test_a_target_with_alpha_is_that_of_the_part(statistic: str) -> None:
    style, picture = torch.from_numpy(with_band(0.7)), torch.from_numpy(marks(seed=3))
    losses = LossesConfig(statistic=statistic, histogram=0.5)
    alpha = torch.zeros(SIDE, SIDE, 1)
    alpha[:, SIDE // 2 :] = 1.0

    def loss(pixels: Tensor) -> float:
        patches = StylePatches(pixels)
        target = StyleTarget(pixels, Pixels(), {"fine": 1.0}, losses, patches=patches)
        return target.loss(picture, None).item()

    part = loss(style[:, SIDE // 2 :])
    assert loss(torch.cat([style, alpha], 2)) == pytest.approx(part, rel=1e-6)
    assert loss(style) != pytest.approx(part, rel=0.02)


def test_areas_smaller_than_a_pixel_leave_the_whole_style() -> None:
    style, picture = torch.from_numpy(marks()), torch.from_numpy(marks(seed=3))
    for alpha in (torch.ones(SIDE, SIDE, 1), torch.zeros(SIDE, SIDE, 1)):
        target = StyleTarget(torch.cat([style, alpha], 2), Pixels(), {"fine": 1.0})
        assert target.loss(style, None).item() < 0.1 < target.loss(picture * 0.5, None).item()


def test_grey_levels_are_matched_in_the_areas() -> None:
    style = torch.from_numpy(with_band(0.0))
    alpha = torch.ones(SIDE, SIDE, 1)
    alpha[:, : SIDE // 4] = 0.0
    grey = match_grey(torch.cat([style, alpha], 2), 0.5, 0.2)
    part = match_grey(style[:, SIDE // 4 :], 0.5, 0.2)
    assert torch.equal(grey[..., 3:], alpha)
    assert torch.allclose(grey[:, SIDE // 4 :, :3], part, atol=1e-6)


def test_colours_of_a_style_are_those_of_its_areas() -> None:
    style, cpu = with_band(marks(0.0, 0.3)), torch.device("cpu")
    whole_image = Config(style={"areas": "all"})
    marked = make_targets([style], SCENE, Config(), cpu)
    whole = make_targets([style], SCENE, whole_image, cpu)
    chosen = make_targets([style[marked_areas(style)][None]], SCENE, whole_image, cpu)
    assert marked.value == pytest.approx(chosen.value) and marked.value > whole.value
    assert torch.allclose(marked.background, chosen.background, atol=1e-6)
    assert marked.colours[1] == pytest.approx(chosen.colours[1])
    assert marked.brightness == pytest.approx(chosen.brightness)
    darkest = torch.full((1, 3), 0.1)
    assert torch.allclose(whole.hues.nearest(darkest), darkest, atol=0.05)


@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize("factor", [1, 2])
def test_pictures_are_compared_with_the_areas(factor: int, grey: bool) -> None:
    """The loss of a picture of the marks alone is less than with the whole image.

    Patches are left out: to other noise, noise is no nearer than to the flat band.
    """
    style, cpu = with_band(marks(0.0, 0.3)), torch.device("cpu")
    picture = torch.from_numpy(marks(seed=1))[::factor, ::factor].contiguous()
    picture = match_grey(picture, SCENE.grey_mean, SCENE.grey_deviation) if grey else picture
    guide = torch.ones(picture.shape[:2])

    def loss(areas: str) -> float:
        config = Config(style={"areas": areas}, losses={"nearest": 0.0})
        return make_targets([style], SCENE, config, cpu).at(factor, grey)(picture, guide).item()

    assert loss("marked") < 0.95 * loss("all")


def test_colours_at_full_size_are_those_of_the_areas() -> None:
    style, cpu = with_band(np.float32([0.3, 0.0, 0.0]) + 0 * marks()), torch.device("cpu")
    marked, whole = (
        make_targets([style], SCENE, Config(style={"areas": areas}), cpu)
        for areas in ("marked", "all")
    )
    assert marked.colours[1] < 0.8 * whole.colours[1]
    assert marked.shown == pytest.approx(1, abs=0.02)

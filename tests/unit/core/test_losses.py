"""Gram matrices, the style loss and total variation."""

import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

from tests.fixtures.smoke_fixtures import random_style
from usdsmoke.config.look_sections import LossesConfig
from usdsmoke.core.features.definition import default_layers
from usdsmoke.core.features.network import EmbeddedFeatures
from usdsmoke.core.style.losses import StyleTarget, gram_matrix, total_variation

DOUBLE = torch.float64
GRAM = LossesConfig(statistic="gram")


def random(*shape: int, seed: int = 0, dtype: torch.dtype = DOUBLE) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


class Pixels:
    """A network whose feature maps are the picture itself, full size and halved; counts calls."""

    def __init__(self) -> None:
        self.asked: list[frozenset[str]] = []

    def __call__(self, picture: Tensor, wanted: frozenset[str]) -> dict[str, Tensor]:
        self.asked.append(wanted)
        maps = {"fine": picture.permute(2, 0, 1)[None]}
        maps["coarse"] = torch.nn.functional.avg_pool2d(maps["fine"], 2)
        return {name: maps[name] for name in wanted}


def test_gram_matrix_is_the_mean_outer_product_of_the_features():
    maps = random(1, 4, 6, 5)
    columns = maps[0].reshape(4, 30)
    wanted = sum(torch.outer(column, column) for column in columns.T) / 30
    assert torch.allclose(gram_matrix(maps), wanted, atol=1e-14)


@pytest.mark.parametrize("guided", [False, True])
def test_gram_matrix_is_symmetric_and_positive_semidefinite(guided):
    gram = gram_matrix(random(1, 9, 3, 2) - 0.5, random(6, 4, seed=1) if guided else None)
    assert torch.allclose(gram, gram.T, atol=1e-15)
    assert torch.linalg.eigvalsh(gram).min().item() > -1e-14


def test_gram_matrix_is_blind_to_the_order_of_pixels():
    maps, guide = random(1, 5, 4, 6), random(4, 6, seed=1)
    order = torch.randperm(24, generator=torch.Generator().manual_seed(2))
    shuffled = maps.flatten(2)[..., order].view(1, 5, 4, 6)
    found = gram_matrix(shuffled, guide.flatten()[order].view(4, 6))
    assert torch.allclose(found, gram_matrix(maps, guide), atol=1e-14)


def test_a_masked_region_and_a_whole_image_of_the_same_texture_compare():
    """The guide's area and height drop out, and what lies beyond it has no say."""
    texture = random(1, 3, 4, 4).repeat(1, 1, 4, 4)
    spoiled = texture.clone()
    spoiled[..., 8:] = 1e3
    guide = torch.zeros(16, 16, dtype=DOUBLE)
    guide[:, :8] = 0.7
    assert torch.allclose(gram_matrix(spoiled, guide), gram_matrix(texture), atol=1e-12)


def test_the_guide_is_averaged_to_the_size_of_the_maps():
    maps, guide = random(1, 3, 4, 6), random(8, 12, seed=1)
    small = guide.view(4, 2, 6, 2).mean(dim=(1, 3))
    assert torch.allclose(gram_matrix(maps, guide), gram_matrix(maps, small), atol=1e-14)


def test_an_empty_guide_gives_zeros_and_a_finite_gradient():
    maps = random(1, 3, 4, 4).requires_grad_()
    gram = gram_matrix(maps, torch.zeros(4, 4, dtype=DOUBLE))
    (gradient,) = torch.autograd.grad(gram.sum(), maps)
    assert not gram.any() and not gradient.any()


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_sums_beyond_65504_stay_finite(dtype):
    maps = torch.full((1, 2, 64, 64), 200.0, dtype=dtype)
    gram = gram_matrix(maps, torch.ones(64, 64))
    assert gram.dtype == torch.float32
    assert gram.flatten().tolist() == pytest.approx([4e4] * 4, rel=1e-3)
    style, picture = (torch.full((64, 64, 3), value, dtype=dtype) for value in (200.0, 100.0))
    for losses in (GRAM, LossesConfig()):
        target = StyleTarget(style, Pixels(), {"fine": 1.0}, losses)
        assert torch.isfinite(target.loss(picture, None))


def test_gram_gradients_agree_with_finite_differences():
    guide = random(4, 6, seed=1)
    assert gradcheck(lambda maps: gram_matrix(maps, guide), random(1, 3, 2, 3).requires_grad_())


@pytest.mark.parametrize("guided", [False, True])
def test_the_gram_distance_is_that_of_scaled_maps_with_a_channel_of_ones(guided):
    """Value and gradient, by the matrices themselves."""
    style, picture = random(12, 10, 3) - 0.4, (random(9, 8, 3, seed=1) - 0.3).requires_grad_()
    guide = random(9, 8, seed=2) if guided else None
    scale = 1 / (style.square().mean(dim=(0, 1)).sqrt() + 1e-3)

    def gram(pixels: Tensor, guide: Tensor | None) -> Tensor:
        maps = (pixels * scale).permute(2, 0, 1)[None]
        return gram_matrix(torch.cat([maps, torch.ones_like(maps[:, :1])], dim=1), guide)

    wanted = (gram(picture, guide) - gram(style, None)).norm() / gram(style, None).norm()
    found = StyleTarget(style, Pixels(), {"fine": 1.0}, GRAM).loss(picture, guide)
    assert found.item() == pytest.approx(wanted.item(), rel=1e-6)
    gradients = [torch.autograd.grad(loss, picture)[0] for loss in (found, wanted)]
    assert torch.allclose(*gradients, rtol=1e-6)


def test_total_variation_of_a_step_and_of_one_pixel():
    picture = torch.zeros(3, 4, 1)
    picture[:, 2:] = 2.0  # three pairs differ by 2, of 9 across and 8 down
    assert total_variation(picture).item() == pytest.approx(6 / 17)
    assert total_variation(torch.ones(1, 1, 3)).item() == 0.0


def test_total_variation_gradients_agree_with_finite_differences():
    assert gradcheck(total_variation, random(3, 4, 2).requires_grad_())
    flat = torch.ones(3, 3, 1, requires_grad=True)
    (gradient,) = torch.autograd.grad(total_variation(flat), flat)
    assert not gradient.any()


def test_style_loss_of_the_style_itself_is_zero_and_of_others_is_not():
    style = torch.from_numpy(random_style(32, 40))
    names = EmbeddedFeatures.names
    target = StyleTarget(style, EmbeddedFeatures(style), dict.fromkeys(names, 1.0), GRAM)
    assert 0 <= target.loss(style, None).item() < 1e-3
    assert target.loss(style.flip(2), None).item() > 0.1  # other colours
    smooth = style.mean(dim=(0, 1)).expand_as(style).contiguous()
    assert target.loss(smooth, None).item() > 0.1  # no texture


def test_style_loss_is_smaller_for_the_same_texture_elsewhere_than_for_another():
    style = torch.from_numpy(random_style(32, 40))
    layers = dict.fromkeys(default_layers(), 1.0)
    target = StyleTarget(style, EmbeddedFeatures(style), layers, GRAM)
    same = torch.roll(style, 7, dims=1)
    other = torch.from_numpy(random_style(32, 40).transpose(1, 0, 2).copy())  # turned stripes
    assert target.loss(same, None).item() < 0.2 * target.loss(other, None).item()


def test_style_loss_adds_the_layers_by_their_weights():
    style, picture = random(8, 8, 3), random(8, 8, 3, seed=1)

    def loss(**layers: float) -> float:
        return StyleTarget(style, Pixels(), layers).loss(picture, None).item()

    assert loss(fine=2.0, coarse=0.5) == pytest.approx(2 * loss(fine=1.0) + 0.5 * loss(coarse=1.0))
    assert loss(fine=1e12) == pytest.approx(1e12 * loss(fine=1.0))


def test_layers_of_weight_zero_are_not_asked_for():
    network = Pixels()
    target = StyleTarget(random(8, 8, 3), network, {"fine": 1.0, "coarse": 0.0})
    target.loss(random(8, 8, 3, seed=1), None)
    assert network.asked == [frozenset({"fine"})] * 2


def test_style_loss_gradients_agree_with_finite_differences():
    """Through both halves of the embedded network, the guide and the Gram matrices."""
    style = random(16, 16, 3)
    names = dict.fromkeys(EmbeddedFeatures.names, 1.0)
    target = StyleTarget(style, EmbeddedFeatures(style), names, GRAM)
    picture, guide = random(7, 6, 3, seed=1).requires_grad_(), random(7, 6, seed=2)
    assert gradcheck(lambda p: target.loss(p, guide), picture, eps=1e-7, atol=1e-4, rtol=1e-3)

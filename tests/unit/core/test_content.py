"""What all distances from a content promise, and the distance of features."""

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd import gradcheck

from usdsmoke.base.errors import ShapeError
from usdsmoke.core.style.content import content_distance, laplacian_distance, photorealism_distance

DOUBLE = torch.float64
PICTURES = [laplacian_distance, photorealism_distance]


def random(*shape: int, seed: int = 0, dtype: torch.dtype = DOUBLE) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def smooth(height: int, width: int, seed: int = 0) -> Tensor:
    """Slow waves, as pale smoke has them, [H W 3]."""
    y, x = torch.meshgrid(
        torch.arange(height, dtype=DOUBLE), torch.arange(width, dtype=DOUBLE), indexing="ij"
    )
    p = random(3, 3, seed=seed)
    return torch.stack([0.5 + 0.4 * torch.sin((a * x + b * y) / 9 + 6 * c) for a, b, c in p], -1)


def distance_of(picture: Tensor, content: Tensor, guide: Tensor | None) -> Tensor:
    """The content distance with the picture as its own feature maps."""
    maps, wanted = ({"pixels": p.permute(2, 0, 1)[None]} for p in (picture, content))
    return content_distance(maps, wanted, {"pixels": 1.0}, guide)


ALL = [distance_of, *PICTURES]


def gradient_of(distance, picture: Tensor, content: Tensor, guide: Tensor | None) -> Tensor:
    unknown = picture.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(distance(unknown, content, guide), unknown)
    return gradient


# All of them


@pytest.mark.parametrize("distance", ALL)
def test_pixels_outside_the_guide_have_no_influence_and_no_gradient(distance):
    picture, content, guide = random(9, 10, 3), random(9, 10, 3, seed=1), random(9, 10, seed=2)
    guide[:, 4:7] = 0
    wanted = distance(picture, content, guide).item()
    for spoiled in (picture, content):
        spoiled[guide == 0] = 7.0
        assert distance(picture, content, guide).item() == pytest.approx(wanted, rel=1e-12)
    gradient = gradient_of(distance, picture, content, guide)
    assert not gradient[guide == 0].any() and gradient[guide > 0].all()


@pytest.mark.parametrize("distance", ALL)
def test_an_even_guide_of_any_height_is_as_good_as_none(distance):
    picture, content = random(9, 10, 3), random(9, 10, 3, seed=1)
    wanted = distance(picture, content, None).item()
    for height in (1.0, 0.3, 1e-6):
        guide = torch.full((9, 10), height, dtype=DOUBLE)
        assert distance(picture, content, guide).item() == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize("distance", ALL)
def test_two_copies_beside_each_other_count_as_one(distance):
    """Each within a frame, wider than any window, that is outside the guide."""
    framed = [F.pad(random(3, 8, 8, seed=s), (4, 4, 4, 4)).movedim(0, 2) for s in (0, 1)]
    guide = F.pad(random(8, 8, seed=2), (4, 4, 4, 4))
    one = distance(*framed, guide).item()
    two = distance(*(torch.cat([t, t], dim=1) for t in (*framed, guide))).item()
    assert one > 0 and two == pytest.approx(one, rel=1e-12)


@pytest.mark.parametrize("distance", ALL)
def test_an_empty_guide_gives_exactly_zero_and_no_gradient(distance):
    picture, content, guide = random(5, 6, 3), random(5, 6, 3, seed=1), torch.zeros(5, 6)
    assert distance(picture, content, guide).item() == 0
    assert not gradient_of(distance, picture, content, guide).any()


@pytest.mark.parametrize("distance", ALL)
@pytest.mark.parametrize("guided", [False, True])
def test_gradients_agree_with_finite_differences(distance, guided):
    picture, content = random(5, 6, 3).requires_grad_(), random(5, 6, 3, seed=1)
    guide = random(5, 6, seed=2) if guided else None
    if guide is not None:
        guide[:2, :2] = 0
    assert gradcheck(lambda p: distance(p, content, guide), picture)


@pytest.mark.parametrize("distance", ALL)
def test_neither_the_content_nor_the_guide_has_a_gradient(distance):
    picture, content, guide = (random(*s).requires_grad_() for s in ((5, 6, 3), (5, 6, 3), (5, 6)))
    distance(picture * 0.5, content, guide).backward()
    assert picture.grad is not None and content.grad is None and guide.grad is None


@pytest.mark.parametrize("distance", ALL)
@pytest.mark.parametrize("contrast", [1.0, 1e-2])
def test_single_precision_agrees_with_double(distance, contrast):
    content = 0.5 + contrast * (smooth(24, 30) - 0.5)
    picture = content + 0.1 * contrast * (random(24, 30, 3, seed=1) - 0.5)
    content, picture = content.float(), picture.float()  # the same numbers for both
    guide = random(24, 30, seed=2).float()
    doubles = [t.double() for t in (picture, content, guide)]
    found, wanted = distance(picture, content, guide), distance(*doubles)
    assert found.item() == pytest.approx(wanted.item(), rel=1e-5)
    slope, exact = gradient_of(distance, picture, content, guide), gradient_of(distance, *doubles)
    assert (slope - exact).norm() < 1e-4 * exact.norm()


@pytest.mark.parametrize("distance", ALL)
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_halves_are_summed_in_single_precision(distance, dtype):
    picture, content = (random(40, 40, 3, seed=s).to(dtype) for s in (0, 1))
    found = distance(picture, content, torch.ones(40, 40, dtype=dtype))
    wanted = distance(picture.double(), content.double(), None).item()
    assert found.dtype == torch.float32 and found.item() == pytest.approx(wanted, rel=1e-4)


@pytest.mark.parametrize("distance", ALL)
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (2, 2), (2, 9), (3, 3), (4, 1)])
def test_small_pictures_give_finite_values_and_gradients(distance, shape):
    picture, content = random(*shape, 3), random(*shape, 3, seed=1)
    found = distance(picture, content, torch.ones(shape))
    assert torch.isfinite(found) and found >= 0
    assert torch.isfinite(gradient_of(distance, picture, content, torch.ones(shape))).all()


@pytest.mark.parametrize("distance", PICTURES)
def test_sizes_that_do_not_fit_are_refused_with_both_named(distance):
    with pytest.raises(ShapeError, match=r"\[4, 5, 3\].* \[5, 5, 3\]"):
        distance(torch.ones(4, 5, 3), torch.ones(5, 5, 3), None)
    with pytest.raises(ShapeError, match=r"guide is \[5, 4\], the picture \[4, 5, 3\]"):
        distance(torch.ones(4, 5, 3), torch.ones(4, 5, 3), torch.ones(5, 4))


# Features


def test_content_distance_is_the_direct_sum_over_layers():
    shapes = {"fine": (1, 4, 6, 8), "coarse": (1, 5, 3, 4)}
    maps = {name: random(*shape) for name, shape in shapes.items()}
    content = {name: random(*shape, seed=1) for name, shape in shapes.items()}
    guide, weights = random(6, 8, seed=2), {"fine": 0.5, "coarse": 2.0}
    small = guide.view(3, 2, 4, 2).mean(dim=(1, 3))
    wanted = 0.0
    for name, t in (("fine", guide), ("coarse", small)):
        upper = sum(
            (t * (a - b)).norm() ** 2 for a, b in zip(maps[name][0], content[name][0], strict=True)
        )
        lower = sum((t * b).norm() ** 2 for b in content[name][0])
        wanted += weights[name] * ((upper / lower + 1e-8).sqrt().item() - 1e-4)
    found = content_distance(maps, content, weights, guide).item()
    assert found == pytest.approx(wanted, rel=1e-12)


def test_content_distance_of_the_content_is_exactly_zero_and_flat():
    content = random(5, 6, 3, dtype=torch.float32)
    assert distance_of(content, content, None).item() == 0
    assert not gradient_of(distance_of, content, content, None).any()


def test_content_distance_is_relative_down_to_features_of_the_least_rms():
    content = 1 + random(1, 2, 5, 5)
    for scale in (1.0, 1e3, 1e-2):
        found = content_distance(
            {"a": 1.5 * scale * content}, {"a": scale * content}, {"a": 1}, None
        )
        assert found.item() == pytest.approx(0.5, rel=1e-3)
    flat = torch.zeros(1, 2, 5, 5, dtype=DOUBLE)
    found = content_distance({"a": flat + 5e-3}, {"a": flat}, {"a": 1.0}, None)
    assert found.item() == pytest.approx(1.0, rel=1e-3)


def test_content_layers_of_weight_zero_are_not_looked_at():
    layers = {"a": random(1, 2, 3, 3)}
    assert content_distance(layers, layers, {"a": 1.0, "absent": 0.0}, None).item() == 0
    assert content_distance({}, {}, {"absent": 0.0}, None).item() == 0


def test_content_maps_of_another_shape_are_refused_by_layer():
    with pytest.raises(ShapeError, match=r"layer relu: \[1, 2, 3, 3\]"):
        content_distance(
            {"relu": torch.ones(1, 2, 3, 3)}, {"relu": torch.ones(1, 1, 3, 3)}, {"relu": 1.0}, None
        )

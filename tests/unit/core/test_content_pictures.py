"""The distances of edges and of local colours from those of a content."""

import numpy as np
import pytest
import scipy.ndimage
import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.core.style.content import laplacian_distance, photorealism_distance

DOUBLE = torch.float64


def random(*shape: int, seed: int = 0, dtype: torch.dtype = DOUBLE) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def smooth(height: int, width: int, seed: int = 0) -> Tensor:
    """Slow waves, as pale smoke has them, [H W 3]."""
    y, x = torch.meshgrid(
        torch.arange(height, dtype=DOUBLE), torch.arange(width, dtype=DOUBLE), indexing="ij"
    )
    p = random(3, 3, seed=seed)
    return torch.stack([0.5 + 0.4 * torch.sin((a * x + b * y) / 9 + 6 * c) for a, b, c in p], -1)


def gradient_of(distance, picture: Tensor, content: Tensor, guide: Tensor | None) -> Tensor:
    unknown = picture.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(distance(unknown, content, guide), unknown)
    return gradient


# Edges


@pytest.mark.parametrize("pool", [1, 2, 4])
def test_laplacian_distance_is_scipys_laplacian_of_the_pooled_difference(pool):
    picture, content = random(8, 12, 3), random(8, 12, 3, seed=1)
    pooled = (picture - content).view(8 // pool, pool, 12 // pool, pool, 3).mean(dim=(1, 3))
    laplacians = [scipy.ndimage.laplace(plane, mode="nearest") for plane in pooled.movedim(2, 0)]
    found = laplacian_distance(picture, content, None, (pool,)).item()
    assert found == pytest.approx(np.square(laplacians).mean(), rel=1e-12)


def test_laplacian_distance_sums_over_pools():
    pair = random(8, 12, 3), random(8, 12, 3, seed=1)
    single = [laplacian_distance(*pair, None, (pool,)).item() for pool in (1, 4)]
    assert laplacian_distance(*pair, None, (1, 4)).item() == pytest.approx(sum(single), rel=1e-12)
    assert laplacian_distance(*pair, None, ()).item() == 0


def test_laplacian_distance_of_a_parabola_is_the_square_of_its_curvature():
    """The guide keeps out the border, where the picture ends in a kink."""
    x = torch.arange(40, dtype=DOUBLE)
    parabola = (0.01 * x**2)[None, :, None].expand(3, 40, 3)
    slope = torch.full((3, 40), 1.0, dtype=DOUBLE)
    whole = laplacian_distance(parabola, torch.zeros_like(parabola), slope, (1,)).item()
    ends = (0.01 * 1) ** 2 + (0.01 * (39**2 - 38**2)) ** 2
    assert whole == pytest.approx((38 * 0.02**2 + ends) / 40, rel=1e-10)


def test_laplacian_distance_is_blind_to_a_constant_under_any_guide():
    content, guide = random(10, 9, 3), random(10, 9, seed=1)
    guide[3:5] = 0
    found = laplacian_distance(content + 0.3, content, guide, (1, 2, 4))
    assert found.item() < 1e-28
    assert laplacian_distance(content, content, guide).item() == 0


def test_windows_cut_by_the_border_pool_what_is_there():
    """5 columns in windows of 4: the last window is one column wide."""
    picture = torch.zeros(4, 5, 3, dtype=DOUBLE)
    picture[:, 4] = 1.0
    found = laplacian_distance(picture, torch.zeros_like(picture), None).item()
    assert found == pytest.approx(1.0)  # two windows that differ by 1


def test_pools_shrink_to_the_picture():
    pair = random(3, 7, 3), random(3, 7, 3, seed=1)
    tall = F.avg_pool2d((pair[0] - pair[1]).permute(2, 0, 1), (3, 4), ceil_mode=True)
    step = tall[:, 0, 1] - tall[:, 0, 0]
    found = laplacian_distance(*pair, None, (4,)).item()
    assert found == pytest.approx(step.square().mean().item(), rel=1e-12)
    assert laplacian_distance(*pair, None, (100,)).item() == 0


# Local colours


def matting_laplacian(content: np.ndarray, epsilon: float) -> np.ndarray:
    """Dense, entry by entry, from the published formula; [H W x H W]."""
    height, width, _ = content.shape
    number = np.arange(height * width).reshape(height, width)
    matrix = np.zeros((height * width, height * width))
    for y in range(height - 2):
        for x in range(width - 2):
            pixels = number[y : y + 3, x : x + 3].ravel()
            colours = content.reshape(-1, 3)[pixels]
            mean, covariance = colours.mean(0), np.cov(colours.T, bias=True)
            inverse = np.linalg.inv(covariance + epsilon / 9 * np.eye(3))
            for i, first in zip(pixels, colours, strict=True):
                for j, second in zip(pixels, colours, strict=True):
                    affinity = (1 + (first - mean) @ inverse @ (second - mean)) / 9
                    matrix[i, j] += float(i == j) - affinity
    return matrix


def residual_by_least_squares(
    picture: np.ndarray, content: np.ndarray, guide: np.ndarray, epsilon: float
) -> float:
    """Window by window with NumPy's least squares, the ridge as three more equations."""
    height, width, _ = content.shape
    cost, area = 0.0, 0.0
    for y in range(height - 2):
        for x in range(width - 2):
            here = np.s_[y : y + 3, x : x + 3]
            t = guide[here].reshape(9, 1)
            rows = np.hstack([content[here].reshape(9, 3), np.ones((9, 1))]) * t
            ridge = np.eye(3, 4) * np.sqrt(epsilon * (t**2).mean())
            left = np.vstack([rows, ridge])
            right = np.vstack([picture[here].reshape(9, 3) * t, np.zeros((3, 3))])
            found = np.linalg.lstsq(left, right, rcond=None)[0]
            cost += ((left @ found - right) ** 2).sum()
            area += (t**2).sum()
    return cost / area / 3


@pytest.mark.parametrize("epsilon", [1e-1, 1e-4, 1e-7])
@pytest.mark.parametrize("kind", ["colour", "grey", "flat"])
def test_photorealism_is_the_quadratic_form_of_the_matting_laplacian(epsilon, kind):
    picture, content = random(6, 7, 3), random(6, 7, 3, seed=1)
    if kind == "grey":
        content = content[..., :1].expand(6, 7, 3).contiguous()
    if kind == "flat":
        content = torch.full_like(content, 0.3)
    matrix = matting_laplacian(content.numpy(), epsilon)
    planes = picture.reshape(42, 3).numpy()
    wanted = np.trace(planes.T @ matrix @ planes) / (4 * 5 * 9 * 3)
    found = photorealism_distance(picture, content, None, epsilon).item()
    assert found == pytest.approx(wanted, rel=1e-8)


def test_guided_photorealism_is_the_residual_of_weighted_least_squares():
    picture, content, guide = random(6, 7, 3), random(6, 7, 3, seed=1), random(6, 7, seed=2)
    guide[1:4, 2:5] = 0  # one window is left empty, others hold fewer pixels than unknowns
    wanted = residual_by_least_squares(picture.numpy(), content.numpy(), guide.numpy(), 1e-4)
    found = photorealism_distance(picture, content, guide).item()
    assert found == pytest.approx(wanted, rel=1e-9)


def test_an_affine_recolouring_costs_no_more_than_the_ridge_and_another_far_more():
    content, guide = smooth(20, 24), random(20, 24, seed=2)
    matrix, offset = random(3, 3, seed=3) - 0.5, random(3, seed=4)
    affine = content @ matrix + offset
    for epsilon in (1e-4, 1e-6, 1e-8):
        bound = epsilon * matrix.square().sum().item() / 27
        assert 0 < photorealism_distance(affine, content, guide, epsilon).item() <= bound
    other = affine + 0.2 * (random(20, 24, 3, seed=5) - 0.5)
    cost = [photorealism_distance(p, content, guide).item() for p in (affine, other)]
    assert cost[1] > 100 * cost[0]


def test_the_content_itself_costs_no_more_than_the_ridge():
    content = smooth(20, 24)
    assert photorealism_distance(content, content, None).item() <= 1e-4 / 9
    assert photorealism_distance(content, content, None, 1e-12).item() <= 1e-12 / 9


def test_a_picture_of_one_colour_and_an_unstructured_content_cost_exactly_zero():
    flat = torch.full((5, 6, 3), 0.25)
    assert photorealism_distance(flat, random(5, 6, 3).float(), None).item() == 0
    assert photorealism_distance(flat + 0.5, flat, None).item() == 0


def test_recolouring_may_differ_from_place_to_place():
    """Two halves, each recoloured its own way, beside a gap outside the guide."""
    content = random(6, 14, 3)
    picture = content.clone()
    picture[:, 8:] = 1 - 0.5 * content[:, 8:].flip(2)
    guide = torch.ones(6, 14, dtype=DOUBLE)
    guide[:, 6:8] = 0
    assert photorealism_distance(picture, content, guide, 1e-9).item() < 1e-9
    guide[:, 6:8] = 1
    assert photorealism_distance(picture, content, guide, 1e-9).item() > 1e-3


@pytest.mark.parametrize("epsilon", [1e-4, 1e-7])
def test_grey_content_stays_accurate_in_single_precision(epsilon):
    """Three equal channels leave only the ridge to hold two directions of the fit."""
    content = smooth(24, 30)[..., :1].expand(24, 30, 3).contiguous().float()
    picture = (content + 0.05 * random(24, 30, 3, seed=1)).float()
    pair = picture.double(), content.double(), None
    found = photorealism_distance(picture, content, None, epsilon).item()
    assert found == pytest.approx(photorealism_distance(*pair, epsilon).item(), rel=1e-5)
    slope = gradient_of(lambda *a: photorealism_distance(*a, epsilon), picture, content, None)
    exact = gradient_of(lambda *a: photorealism_distance(*a, epsilon), *pair)
    assert (slope - exact).norm() < 1e-4 * exact.norm()


def test_pictures_smaller_than_a_window_cost_exactly_zero():
    for shape in ((2, 9, 3), (9, 2, 3), (1, 1, 3)):
        picture, content = random(*shape), random(*shape, seed=1)
        assert photorealism_distance(picture, content, None).item() == 0
        assert not gradient_of(photorealism_distance, picture, content, None).any()


def test_a_ridge_below_rounding_still_gives_a_fit_in_single_precision():
    """Without a lower bound on its pivots the elimination divides by zero, or by less."""
    content = smooth(24, 30)[..., :1].expand(24, 30, 3).contiguous().float()
    picture = content + 0.05 * random(24, 30, 3, seed=1).float()
    flattest = photorealism_distance(picture, content, None, 1.0).item()
    for epsilon in (1e-9, 1e-12, 1e-15):
        found = photorealism_distance(picture, content, None, epsilon)
        assert 0 < found.item() <= flattest
        gradient = gradient_of(
            lambda *a, e=epsilon: photorealism_distance(*a, e), picture, content, None
        )
        assert torch.isfinite(gradient).all()

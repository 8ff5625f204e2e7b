"""Upsampling, smoothing and pyramids against closed forms and torch's own interpolation."""

import numpy as np
import pytest
import torch
from scipy import ndimage
from torch import Tensor

from usdsmoke.base.errors import ShapeError
from usdsmoke.core.fields.pyramid import expand_levels, pyramid_shapes
from usdsmoke.core.fields.resample import smooth, upsample

METHODS = ("linear", "cubic")


def random(*shape: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def centres(n: int) -> Tensor:
    return (torch.arange(n, dtype=torch.float64) + 0.5) / n


@pytest.mark.parametrize("method", METHODS)
def test_same_lattice_and_constants_come_back_unchanged(method):
    field = random(4, 5, 6, 2)
    assert torch.equal(upsample(field, (4, 5, 6), method), field)
    ones = upsample(torch.ones(3, 2, 4, dtype=torch.float64), (7, 4, 9), method)
    torch.testing.assert_close(ones, torch.ones(7, 4, 9, dtype=torch.float64), rtol=0, atol=1e-14)


def test_linear_agrees_with_torch():
    field = random(4, 5, 6)
    expected = torch.nn.functional.interpolate(
        field[None, None], size=(9, 10, 11), mode="trilinear"
    )
    found = upsample(field, (9, 10, 11), "linear")
    torch.testing.assert_close(found, expected[0, 0], rtol=0, atol=1e-14)


def test_cubic_agrees_with_pillows_kernel_in_the_plane():
    """torch's bicubic with antialias uses the kernel constant -1/2, like Pillow."""
    field = random(16, 12)
    expected = torch.nn.functional.interpolate(
        field[None, None], size=(32, 24), mode="bicubic", antialias=True
    )[0, 0]
    found = upsample(field[..., None], (32, 24, 1))[..., 0]
    inner = (slice(4, -4), slice(4, -4))
    torch.testing.assert_close(found[inner], expected[inner], rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("fine", [26, 24, 37])
def test_lattices_of_all_sizes_cover_the_same_box(method, fine):
    """A ramp across the box stays that ramp, whatever the ratio of the lattices."""
    ramp = upsample(centres(13)[:, None, None], (fine, 1, 1), method)[:, 0, 0]
    inside = (centres(fine) > 1.5 / 13) & (centres(fine) < 1 - 1.5 / 13)
    torch.testing.assert_close(ramp[inside], centres(fine)[inside], rtol=0, atol=1e-14)


def test_two_upsamplings_land_where_one_does():
    bump = torch.exp(-((centres(16)[:, None, None] - 0.4) ** 2) / 0.02)
    once = upsample(bump, (64, 1, 1))
    twice = upsample(upsample(bump, (32, 1, 1)), (64, 1, 1))
    torch.testing.assert_close(twice, once, rtol=0, atol=5e-3)


@pytest.mark.parametrize(("method", "order"), [("linear", 2.0), ("cubic", 3.0)])
def test_upsampling_error_falls_with_its_order(method, order):
    sizes, errors = (16, 32, 64), []
    for n in sizes:
        fine = 3 * n + 1
        found = upsample(torch.sin(5 * centres(n))[:, None, None], (fine, 1, 1), method)[:, 0, 0]
        error = (found - torch.sin(5 * centres(fine))).abs()
        errors.append(float(error[fine // 8 : -fine // 8].max()))
    assert -np.polyfit(np.log(sizes), np.log(errors), 1)[0] == pytest.approx(order, abs=0.2)


@pytest.mark.parametrize("method", METHODS)
def test_adjoint_is_exact(method):
    coarse = random(4, 1, 5, 2).requires_grad_()
    fine = upsample(coarse, (9, 1, 7), method)
    weights = random(*fine.shape, seed=1)
    (adjoint,) = torch.autograd.grad(fine, coarse, weights)
    difference = (fine * weights).sum() - (coarse * adjoint).sum()
    assert difference.abs().item() <= 1e-12


@pytest.mark.parametrize(
    ("shape", "n_levels", "expected"),
    [
        ((96, 51, 49), 3, [(24, 13, 13), (48, 26, 25), (96, 51, 49)]),
        ((64, 64, 1), 3, [(16, 16, 1), (32, 32, 1), (64, 64, 1)]),
        ((4, 4, 4), 9, [(2, 2, 2), (4, 4, 4)]),
        ((1, 1, 1), 3, [(1, 1, 1)]),
    ],
)
def test_pyramid_shapes(shape, n_levels, expected):
    assert pyramid_shapes(shape, n_levels) == expected


@pytest.mark.parametrize("shape", [(12, 9, 7), (12, 9, 1)])
def test_pyramid_is_the_sum_of_its_upsampled_levels(shape):
    levels = [random(*level, 3) for level in pyramid_shapes(shape, 2)]
    expected = upsample(levels[0], shape) + levels[1]
    assert torch.equal(expand_levels(levels), expected)


def test_new_pyramid_is_zero_and_reaches_every_level_with_its_gradient():
    shapes = pyramid_shapes((16, 12, 10), 3)
    levels = [torch.zeros(*shape, 3, dtype=torch.float64).requires_grad_() for shape in shapes]
    field = expand_levels(levels)
    assert field.shape == (16, 12, 10, 3) and field.dtype == torch.float64
    assert not field.any()
    field.sum().backward()
    # A constant is kept by upsampling, so each level's gradient has the sum of all fine voxels.
    for level in levels:
        assert level.grad is not None
        assert level.grad.sum().item() == pytest.approx(16 * 12 * 10 * 3, rel=1e-12)


def test_blur_agrees_with_scipy_and_does_not_mix_channels():
    field = torch.zeros(14, 12, 10, 2, dtype=torch.float64)
    field[..., 0] = random(14, 12, 10)
    found = smooth(field, (1.5, 0.0, 0.8))
    expected = ndimage.gaussian_filter(
        field[..., 0].numpy(), (1.5, 0.0, 0.8), mode="constant", truncate=4.0
    )
    np.testing.assert_allclose(found[..., 0].numpy(), expected, rtol=0, atol=1e-4)
    assert not found[..., 1].any()


def test_blur_adds_its_variance_and_keeps_the_sum():
    point = torch.zeros(61, 1, 41, dtype=torch.float64)
    point[30, 0, 20] = 1.0
    blurred = smooth(point, (3.0, 9.0, 2.0))
    assert blurred.sum().item() == pytest.approx(1.0, abs=1e-12)
    i = torch.arange(61, dtype=torch.float64) - 30
    k = torch.arange(41, dtype=torch.float64) - 20
    assert (blurred.sum(dim=(1, 2)) * i**2).sum().item() == pytest.approx(9.0, rel=2e-3)
    assert (blurred.sum(dim=(0, 1)) * k**2).sum().item() == pytest.approx(4.0, rel=2e-3)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: upsample(random(4, 4, 4), (3, 4, 4)), "at least as many voxels"),
        (lambda: upsample(random(4, 4), (8, 8, 8)), r"\[4, 4\].*\[i j k\]"),
        (lambda: upsample(random(4, 4, 4), (8, 8)), "at least as many voxels"),
        (lambda: upsample(random(4, 4, 4), (8, 8, 8), "nearest"), "'nearest'.*linear or cubic"),
        (lambda: pyramid_shapes((4, 4, 4), 0), "at least 1 level"),
        (lambda: pyramid_shapes((4, 0, 4), 2), "at least 1 voxel"),
        (lambda: smooth(random(4, 4, 4), float("nan")), "one or three numbers from 0"),
    ],
)
def test_what_does_not_fit_is_refused(call, message):
    with pytest.raises(ShapeError, match=message):
        call()

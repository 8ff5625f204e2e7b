"""Convolutions with fixed filters, against torch's own."""

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.core.features.convolve import Filters, channels_last, padded, unpadded

SIZES = [(12, 15), (11, 14), (13, 9), (7, 7)]  # even and odd ones


def drawn(n_in: int, size: int, shape: tuple[int, int], dtype: torch.dtype) -> list[Tensor]:
    """Maps, weight, bias and a gradient of the result."""
    generator = torch.Generator().manual_seed(n_in + size)
    rest = [n - size + 1 for n in shape]
    of = [(1, n_in, *shape), (6, n_in, size, size), (6,), (1, 6, *rest)]
    return [torch.randn(s, generator=generator, dtype=dtype) for s in of]


def slope(maps: Tensor, upstream: Tensor, weight: Tensor, bias: Tensor, own: bool) -> Tensor:
    leaf = maps.clone().requires_grad_(True)
    found = Filters(weight, bias)(leaf) if own else F.conv2d(leaf, weight, bias)
    return torch.autograd.grad(found, leaf, upstream)[0]


@pytest.mark.parametrize("shape", SIZES)
@pytest.mark.parametrize(("n_in", "size"), [(3, 7), (3, 5), (1, 3), (8, 3)])
def test_slopes_are_those_of_torch(n_in, size, shape):
    maps, weight, bias, upstream = drawn(n_in, size, shape, torch.float64)
    own, other = (slope(maps, upstream, weight, bias, own) for own in (True, False))
    assert own.shape == maps.shape
    assert torch.allclose(own, other, rtol=0, atol=1e-12)


@pytest.mark.parametrize("n_in", [3, 8])
def test_slopes_in_single_precision_are_off_by_thousandths_at_random(n_in):
    """A third of a per cent where the processor multiplies bfloat16, and none along the slope."""
    maps, weight, bias, upstream = drawn(n_in, 5, (60, 61), torch.float32)
    own, other = (slope(maps, upstream, weight, bias, own) for own in (True, False))
    assert own.dtype == torch.float32
    assert (own - other).norm() < 5e-3 * other.norm()
    along = float((own * other).sum() / other.square().sum())
    assert along == pytest.approx(1, abs=2e-3)


def test_values_are_not_rounded():
    maps, weight, bias, _ = drawn(3, 5, (20, 21), torch.float32)
    assert torch.equal(Filters(weight, bias)(maps), F.conv2d(maps, weight, bias))


@pytest.mark.parametrize("shape", [(6, 7), (1, 5), (2, 2), (1, 1)])
@pytest.mark.parametrize("border", [1, 3])
def test_slopes_by_padded_maps_are_gathered_at_the_border(shape, border):
    maps = torch.randn(1, 2, *shape, dtype=torch.float64, requires_grad=True)
    wide = padded(maps, border)
    upstream = torch.randn(wide.shape, dtype=torch.float64)
    (expected,) = torch.autograd.grad(wide, maps, upstream)
    assert torch.allclose(unpadded(upstream, border), expected, rtol=0, atol=1e-12)


def test_slopes_of_single_pictures_are_seen_as_channels_last():
    """Rows of pixels, as slopes come from products, leave open how far the next picture is."""
    rows = torch.arange(2 * 3 * 5.0).view(6, 5)
    maps = rows.T.view(5, 2, 3)[None]
    found = channels_last(maps)
    assert torch.equal(found, maps)
    assert found.is_contiguous(memory_format=torch.channels_last)
    assert found.data_ptr() == rows.data_ptr()
    assert torch.equal(channels_last(maps[:, 1:4]), maps[:, 1:4])

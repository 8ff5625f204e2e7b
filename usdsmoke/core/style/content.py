r"""Distances of a picture from its content picture: in features, in edges, in local colours.

Pictures are [H W 3], display-encoded. A guide T [H W] >= 0 says where the smoke is: pixels are
weighted by T^2, as in ``losses.gram_matrix``, and those of T = 0 have no influence. Every distance
is normalised by the guided area, so that a masked region and a whole picture compare, is 0 for an
empty guide, and has a gradient through the picture only.

- features: relative distance of feature maps [Gatys2016; Christen2020, eq. 2];
- edges: distance of the Laplacians of mean-pooled pictures [Li2017];
- local colours: how far each 3 x 3 window is from an affine function of the content's colours
  [Luan2017], which is the quadratic form of the matting Laplacian [Levin2008].
"""

from collections.abc import Mapping, Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.base.errors import ShapeError
from usdsmoke.core.style.quantiles import at_least_single

LEAST_RMS = 5e-3  # of a content's features; flatter ones are compared as if they had it
SMALL = 1e-8  # under the root, so that its slope at 0 is finite; 1e-4 of a relative distance
SIDE = 3  # of a window, pixels
LEAST_AREA = 1e-30  # of a guide, T^2; its inverse leaves float32 room for slopes


def content_distance(
    maps: Mapping[str, Tensor],
    content_maps: Mapping[str, Tensor],
    weights: Mapping[str, float],
    guide: Tensor | None,
) -> Tensor:
    r"""Relative distance of feature maps [Gatys2016; Christen2020, eq. 2], guided; scalar, >= 0.

    sum_l w_l |T (F - F_C)| / |T F_C| with the 2-norm over channels and pixels, rooted and relative
    so that layers have equal weight. |T F_C| is at least what features of rms 5e-3 have, and the
    root is smoothed below 1e-4, where the distance is quadratic: 0 and flat at the content itself.

    Args:
        maps: features of the picture by layer, [1 C h w].
        content_maps: those of the content.
        weights: w_l by layer; layers of weight 0 are skipped.
        guide: T, [H W], any size; averaged to the maps' size. None means 1 everywhere.

    Gradients: through ``maps``.

    Raises:
        ShapeError: a layer's two maps differ in shape.
    """
    total = next(iter(maps.values())).new_zeros(()) if maps else torch.zeros(())
    for name, weight in weights.items():
        if weight != 0:
            _check_same(f"content_distance: layer {name}", maps[name], content_maps[name])
            total = total + weight * _relative(maps[name], content_maps[name], guide)
    return total


def laplacian_distance(
    picture: Tensor, content: Tensor, guide: Tensor | None, pools: Sequence[int] = (4,)
) -> Tensor:
    r"""Distance of the Laplacians of mean-pooled pictures [Li2017], guided; scalar, >= 0.

    sum_s sum_p (sum_q min(T_p, T_q) ((d_q - d_p) - (c_q - c_p)))^2 / sum_p T_p^2, mean over
    channels, with d and c the picture and the content pooled over s x s pixels by their guided
    mean, T the guide pooled, and q the up to four neighbours of p. Under an even guide this is the
    squared difference of the 3 x 3 Laplacians with the border repeated. Blind to a constant.

    Args:
        picture: [H W C], display-encoded.
        content: the same shape.
        guide: T, [H W]. None means 1 everywhere.
        pools: s, each >= 1 pixels; at most the picture's sides. The last row and column of windows
            may be cut.

    Gradients: through ``picture``.

    Raises:
        ShapeError: the picture, the content and the guide differ in size.
    """
    _check_pictures("laplacian_distance", picture, content, guide)
    difference = _planes(picture) - _planes(content.detach())
    weight = _guide_planes(guide, difference)
    total = difference.new_zeros(())
    for pool in pools:
        size = (min(pool, difference.shape[-2]), min(pool, difference.shape[-1]))
        share = F.avg_pool2d(weight, size, ceil_mode=True)
        pooled = F.avg_pool2d(difference * weight, size, ceil_mode=True) / _positive(share)
        laplacian = _divergence(pooled, share)
        area = _positive(share.square().sum() * difference.shape[1])
        total = total + laplacian.square().sum() / area
    return total


def photorealism_distance(
    picture: Tensor, content: Tensor, guide: Tensor | None, epsilon: float = 1e-4
) -> Tensor:
    r"""How far the picture is from a locally affine recolouring of the content; scalar, >= 0.

    The photorealism term of [Luan2017]. Each 3 x 3 window k of pixels i has the residual

        J_k = min over a, b of  sum_i w_i (V_i - a . I_i - b)^2 + epsilon (mean of w) |a|^2

    for each channel V of the picture, with I the content's colours and w = T^2. The result is
    sum_k J_k / sum_ki w_i, mean over channels. Without a guide sum_k J_k = V^T L V with L the
    matting Laplacian [Levin2008], which is never built. A picture that is A I + b costs at
    most epsilon |A|^2 / 27, with |A| the Frobenius norm; one without structure costs 0.

    Args:
        picture: [H W 3], display-encoded.
        content: the same shape.
        guide: T, [H W]. None means 1 everywhere.
        epsilon: > 0, penalises steep recolouring; contents whose contrast in a
            window is below its root / 3 count as flat.

    Gradients: through ``picture``; those of the best a and b vanish, as J_k is least there.

    Raises:
        ShapeError: the picture, the content and the guide differ in size.
    """
    _check_pictures("photorealism_distance", picture, content, guide)
    planes = _planes(picture)
    if min(planes.shape[-2:]) < SIDE:
        return planes[..., :0].sum()  # of nothing: 0, and its gradient is 0
    windows, colours = _windows(planes), _windows(_planes(content.detach()))
    weight = _windows(_guide_planes(guide, planes).square())[0]
    area = weight.sum(dim=0)
    share = weight / _positive(area)
    colours, flat = _centred(colours, share), _centred(windows, share)
    with torch.no_grad():
        slope = _ridge_fit(colours, flat, share, epsilon / SIDE**2)
        steepness = epsilon / SIDE**2 * (slope.square().sum(dim=(0, 1)) * area).sum()
    residual = flat - (slope[:, :, None] * colours).sum(dim=1)
    cost = (residual.square() * weight).sum() + steepness
    return cost / _positive(area.sum() * len(flat))


def _relative(maps: Tensor, content: Tensor, guide: Tensor | None) -> Tensor:
    """|T (F - F_C)| / |T F_C| of one layer, smoothed at 0."""
    n_channels, height, width = maps.shape[1:]
    maps, content = at_least_single(maps), at_least_single(content.detach())
    difference, area = maps - content, maps.new_tensor(float(height * width))
    if guide is not None:
        small = F.adaptive_avg_pool2d(guide.detach().to(maps)[None, None], (height, width))
        difference, content, area = difference * small, content * small, small.square().sum()
    energy = torch.maximum(content.square().sum(), LEAST_RMS**2 * n_channels * area)
    squared = difference.square().sum() / _positive(energy)
    # sqrt(squared + SMALL) - sqrt(SMALL), without the cancellation.
    return squared / (torch.sqrt(squared + SMALL) + SMALL**0.5)


def _divergence(values: Tensor, weight: Tensor) -> Tensor:
    """sum_q min(T_p, T_q) (v_q - v_p) over the neighbours q of p; [1 C h w], T is [1 1 h w]."""
    across = torch.minimum(weight[..., 1:], weight[..., :-1]) * values.diff(dim=-1)
    down = torch.minimum(weight[..., 1:, :], weight[..., :-1, :]) * values.diff(dim=-2)
    return F.pad(across, (1, 1)).diff(dim=-1) + F.pad(down, (0, 0, 1, 1)).diff(dim=-2)


def _windows(planes: Tensor) -> Tensor:
    """The pixels of the 3 x 3 windows that lie within [1 C H W]; [C 9 N]."""
    return F.unfold(planes, SIDE).view(planes.shape[1], SIDE**2, -1)


def _centred(windows: Tensor, share: Tensor) -> Tensor:
    """Less the mean of each window; the second pass removes the first mean's rounding."""
    near = windows - (windows.detach() * share).sum(dim=1, keepdim=True)
    return near - (near * share).sum(dim=1, keepdim=True)


def _ridge_fit(colours: Tensor, values: Tensor, share: Tensor, ridge: float) -> Tensor:
    """The slopes a [C D N] with sum_i s_i (v_i - a . x_i)^2 + ridge |a|^2 least in each window.

    Args:
        colours: x, centred, [D 9 N].
        values: v, centred, [C 9 N].
        share: s, [9 N].
    """
    weighted = colours * share
    matrix = (weighted[:, None] * colours).sum(dim=2)  # [D D N]
    solution = (values[:, None] * weighted).sum(dim=2)  # [C D N]
    n = len(matrix)
    for i in range(n):
        matrix[i, i] += ridge
    # Elimination in order suits symmetric positive definite matrices; the ridge bounds every pivot
    # from below, which rounding could break where the content is grey.
    for j in range(n):
        matrix[j, j].clamp_(min=ridge)
        for i in range(j + 1, n):
            factor = matrix[i, j] / matrix[j, j]
            matrix[i, j:] -= factor * matrix[j, j:]
            solution[:, i] -= factor * solution[:, j]
    for j in reversed(range(n)):
        solution[:, j] /= matrix[j, j]
        for i in range(j):
            solution[:, i] -= matrix[i, j] * solution[:, j]
    return solution


def _planes(picture: Tensor) -> Tensor:
    """[H W C] as [1 C H W]."""
    return at_least_single(picture).permute(2, 0, 1)[None]


def _guide_planes(guide: Tensor | None, planes: Tensor) -> Tensor:
    """The guide as [1 1 H W] of the planes' kind; ones where there is none."""
    if guide is None:
        return torch.ones_like(planes[:, :1])
    return guide.detach().to(planes)[None, None]


def _positive(values: Tensor) -> Tensor:
    """To divide by: what is 0 comes with a numerator of 0."""
    return values.clamp_min(LEAST_AREA)


def _check_same(what: str, found: Tensor, expected: Tensor) -> None:
    if found.shape != expected.shape:
        raise ShapeError(
            f"{what}: {list(found.shape)} does not fit the content's {list(expected.shape)}. "
            "Give both the same size."
        )


def _check_pictures(what: str, picture: Tensor, content: Tensor, guide: Tensor | None) -> None:
    _check_same(f"{what}: the picture", picture, content)
    if guide is not None and guide.shape != picture.shape[:2]:
        raise ShapeError(
            f"{what}: the guide is {list(guide.shape)}, the picture {list(picture.shape)}. "
            "Give a guide [H W] of the same size."
        )

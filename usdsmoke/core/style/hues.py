"""The hues of a style at each level of light, and colours that are brought to them.

Views leave voxels hues that cancel in their pictures, and in no others: green beside red, both of
which a painting of flames has not. Where it is dark hardly anything holds a hue.
"""

import math
from functools import cached_property

import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.core.fields.sample import sample_linear
from usdsmoke.core.smoke.memory import share_rows
from usdsmoke.core.smoke.srgb import REC709_WEIGHTS, luma

LEVELS = 16  # steps of luma from 0 to 1
STEP = 0.04  # of a chroma: red less luma, blue less luma
REACH = 25  # steps to either side: all colours of [0, 1]
# chroma as times that of the style: what is seen through other smoke must hold more than is seen
SATURATIONS = (1.0, 1.25, 1.5, 1.75, 2.0)
NEAR = 0.03  # distance of chroma up to which a hue is one of the style's
CHANGED = 1 / 512  # of a colour: less is no change
CHUNK_ROWS = 2**17  # colours that are looked up at once
RARE = 1e-4  # share of all pixels: fewer are no level of light that a style has
SHARE = 0.95  # of a level's pixels, whose hues are the style's: those that are most frequent


def count_hues(pixels: Tensor) -> Tensor:
    """The share of a picture's pixels by luma and chroma, [LEVELS + 1, n, n], blurred by a step.

    A chroma that no pixel of a neighbouring luma has keeps 0: what is grey stays grey.

    Args:
        pixels: display-encoded [... 3], in [0, 1].
    """
    shape = (LEVELS + 1, 2 * REACH + 1, 2 * REACH + 1)
    place = _places(pixels.reshape(-1, 3)).round().long()
    flat = (place[:, 0] * shape[1] + place[:, 1]) * shape[2] + place[:, 2]
    counts = torch.bincount(flat, minlength=shape[0] * shape[1] * shape[2])
    shares = (counts.double() / len(place)).view(1, 1, *shape)
    by_luma = _blurred(shares, 0)
    return torch.where(by_luma > 0, _blurred(_blurred(by_luma, 1), 2), 0.0)[0, 0]


def _blurred(shares: Tensor, axis: int) -> Tensor:
    """Shares [1 1 L n n] blurred by a step along luma (0), red less luma (1) or blue less luma."""
    kernel = shares.new_tensor([0.25, 0.5, 0.25]).view([3 if a == axis else 1 for a in range(3)])
    return F.conv3d(shares, kernel[None, None], padding=[int(a == axis) for a in range(3)])


class Hues:
    """The hues of one or several styles.

    Args:
        shares: of pixels by luma and chroma, see ``count_hues``.
    """

    def __init__(self, shares: Tensor) -> None:
        self._shares = shares

    def nearest(self, colours: Tensor, before: Tensor | None = None) -> Tensor:
        """Colours [N 3] with chroma that the styles have at their luma, which stays.

        What is farther than ``NEAR`` from the nearest such chroma is brought up to there. Styles of
        grey alone leave no chroma. A luma that the styles have nowhere, such as one brighter than
        all of them, takes the chroma of the nearest one that they have.

        Args:
            colours: display-encoded, >= 0; one channel may get brighter.
            before: [N 3]; colours that have hardly changed since then stay.
        """
        found = colours.clone(memory_format=torch.contiguous_format)
        self.bring(found, before)
        return found

    def bring(self, colours: Tensor, before: Tensor | None = None, limit: float = math.inf) -> None:
        """``nearest`` in place, where colours change up to a limit; the others are not touched."""
        table, is_far, near = self._table.to(colours), self._is_far.to(colours.device), self._near

        def bring_part(part: slice) -> None:
            far = _far_of(colours[part], is_far)
            here = colours[part].index_select(0, far)
            if before is not None:
                changed = ((here - before[part].index_select(0, far)).abs() > CHANGED).any(dim=1)
                far, here = far[changed], here[changed]
            if len(far):
                colours[part].index_copy_(0, far, _brought(here, table, near).clamp_max_(limit))

        share_rows(bring_part, len(colours), CHUNK_ROWS, colours.device)

    @cached_property
    def _near(self) -> float:
        """How far from a hue of the styles colours may be."""
        has_hue = self._shares.sum(0) > 0
        has_hue[REACH, REACH] = False  # grey
        return NEAR if has_hue.any() else 0.0

    @cached_property
    def _is_far(self) -> Tensor:
        """Whether colours between half a step and the next ones may be far from a hue, flat.

        A mean of ways that are no longer than ``_near`` is no longer either.
        """
        shape = self._table.shape[:3]
        halves = tuple(2 * n - 1 for n in shape)
        way = F.interpolate(
            self._table.movedim(-1, 0)[None], size=halves, mode="trilinear", align_corners=True
        )[0]
        far = (way.square().sum(0) > self._near**2).float()[None]
        ahead = F.pad(far, (0, 1, 0, 1, 0, 1))  # the last nodes are by themselves
        return F.max_pool3d(ahead, 2, stride=1).flatten() > 0

    @cached_property
    def _table(self) -> Tensor:
        """The way from a luma and a chroma to the nearest one kept, [LEVELS + 1, n, n, 2]."""
        axis = STEP * torch.arange(-REACH, REACH + 1, dtype=torch.float64)
        nodes = torch.stack(torch.meshgrid(axis, axis, indexing="ij"), -1).view(-1, 2)
        had = (self._shares.sum((1, 2)) > RARE).nonzero()[:, 0].tolist()
        ways = {n: _way(nodes, self._shares[n].flatten()) for n in had}
        levels = [min(had, key=lambda near: abs(near - n)) for n in range(len(self._shares))]
        return torch.stack([ways[n] for n in levels]).view(*self._shares.shape, 2)


def _places(colours: Tensor) -> Tensor:
    """Colours [N 3] as places in the table, [N 3] in steps."""
    grey = luma(colours)
    red, blue = (REACH + (colours[:, channel] - grey) / STEP for channel in (0, 2))
    return torch.stack([LEVELS * grey, red, blue], 1)


def _far_of(colours: Tensor, is_far: Tensor) -> Tensor:
    """The rows of colours [N 3] that may be too far from a hue; see ``Hues._is_far``."""
    red, green, blue = colours.T.contiguous()
    of_red, of_green, of_blue = REC709_WEIGHTS
    grey = (of_red * red).add_(green, alpha=of_green).add_(blue, alpha=of_blue)
    n, chromas = 4 * REACH + 1, []
    for channel in (red, blue):
        chromas.append((channel - grey).mul_(2 / STEP).add_(2 * REACH).to(torch.int32))
    cell = grey.mul_(2 * LEVELS).to(torch.int32).clamp_(0, 2 * LEVELS)
    for chroma in chromas:
        cell = cell.mul_(n).add_(chroma.clamp_(0, n - 1))
    return is_far[cell].nonzero().squeeze(1)


def _brought(colours: Tensor, table: Tensor, near: float) -> Tensor:
    """Colours [N 3] with the nearest chroma that the table knows for them, up to ``near``."""
    places = _places(colours)
    way = sample_linear(table, places, boundary="nearest")
    far = way.square().sum(1, keepdim=True).sqrt().clamp_min(max(near, torch.finfo(way.dtype).tiny))
    red, blue = (STEP * (places[:, 1:] - REACH) + (1 - near / far) * way).unbind(1)
    of_red, of_green, of_blue = REC709_WEIGHTS
    green = -(of_red * red + of_blue * blue) / of_green
    return (luma(colours)[:, None] + torch.stack([red, green, blue], 1)).clamp_min(0)


def _way(nodes: Tensor, shares: Tensor) -> Tensor:
    """From the chroma [n 2] of one level's nodes to the nearest one that is kept, [n 2]."""
    total = shares.sum()
    frequent, order = shares.sort(descending=True, stable=True)
    kept = nodes[order[(frequent.cumsum(0) - frequent < SHARE * total) & (frequent > 0)]]
    kept = torch.cat([factor * kept for factor in SATURATIONS])
    return kept[torch.cdist(nodes, kept).argmin(dim=1)] - nodes

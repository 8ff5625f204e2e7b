r"""Emission and absorption along a ray, exact on every segment.

One rule serves everything: on a segment of optical depth t = gamma * d * h with constant density
and colour, the light that reaches its front is C * (1 - exp(-t)), and exp(-t) of what comes from
behind passes [Max1995]. It is second order in h and bounded for every optical depth. With r = (1 -
exp(-t)) / t a segment's share of the pixel is t * r * exp(-(sum of t before it)): voxels that share
a segment share it in proportion to their t, and an empty one divides nothing by nothing.

The paper's images are these divided by gamma [Christen2020, eqs. 8-10]: its grey integral of
d * tau is (1 - exp(-gamma * column)) / gamma, because d tau / dr = -gamma * d * tau. Multiplying by
gamma gives ordinary alpha compositing, in [0, 1] for colours in [0, 1], with no division by the
image's maximum.
"""

from collections.abc import Sequence
from typing import Any, cast

import torch
from torch import Tensor

from usdsmoke.core.smoke.memory import add_at, chunks
from usdsmoke.core.views.cameras import View

THICKEST = 1e30  # optical depth of one voxel in one pixel; sums of thicker ones overflow float32
MOST_CELLS = 2**27  # slabs times pixels: empty space between far places must not fill memory
CHUNK_CELLS = 2**19  # slabs times pixels in a chunk


def opacity(optical_depth: Tensor) -> Tensor:
    """1 - exp(-t), accurate to round-off for every t >= 0; any shape, dimensionless.

    Gradients: through ``optical_depth``; exp(-t), never NaN.
    """
    return -torch.expm1(-optical_depth)


class _AttenuationRatio(torch.autograd.Function):
    """(1 - exp(-t)) / t with the limit 1 at t = 0, in value and gradient."""

    @staticmethod
    def forward(ctx: Any, optical_depth: Tensor) -> Tensor:
        # of no depth, as of the least one, all light is attenuated by 1
        depth = optical_depth.clamp_min(torch.finfo(optical_depth.dtype).tiny).neg_()
        ratio = torch.expm1(depth).div_(depth)
        ctx.save_for_backward(optical_depth, ratio)
        return ratio

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> Tensor:
        optical_depth, ratio = ctx.saved_tensors
        small = optical_depth < 1e-2  # the quotient below cancels there
        safe = torch.where(small, torch.ones_like(optical_depth), optical_depth)
        t = torch.where(small, optical_depth, torch.zeros_like(optical_depth))
        series = -0.5 + t / 3 - t**2 / 8 + t**3 / 30 - t**4 / 144
        slope = torch.where(small, series, (torch.exp(-safe) - ratio) / safe)
        return upstream * slope


def attenuation_ratio(optical_depth: Tensor) -> Tensor:
    """(1 - exp(-t)) / t, the mean transmittance inside a segment; in (0, 1], 1 at t = 0.

    Gradients: through ``optical_depth``, finite for every t >= 0.
    """
    return cast(Tensor, _AttenuationRatio.apply(optical_depth))


def transmittance_before(optical_depth: Tensor) -> Tensor:
    """What passes all segments in front of each one: exp(-sum_{r<s} t_r), in [0, 1].

    Args:
        optical_depth: t of the segments, [S ...], front to back along the first axis, >= 0.

    Returns:
        the same shape; 1 for the foremost segment.

    Gradients: through ``optical_depth``.
    """
    # an exclusive sum: with t_s taken off the inclusive one an infinite t_s would give NaN
    before = torch.cumsum(optical_depth[:-1], dim=0)
    return torch.exp(-torch.cat([torch.zeros_like(optical_depth[:1]), before]))


class Slabs:
    """Optical depths in slabs across a view, through which light comes from behind.

    Args:
        view: gives the pixels.
        depth_range: least and largest depth of what is in the slabs, stage units.
        step: thickness of a slab, stage units; more where slabs would fill memory.
        like: dtype and device.
        margin: empty slabs in front.
    """

    def __init__(
        self, view: View, depth_range: tuple[float, float], step: float, like: Tensor,
        margin: int = 0,
    ) -> None:  # fmt: skip
        self._n_pixels, self._nearest = view.height * view.width, depth_range[0]
        length = depth_range[1] - depth_range[0]
        self._step = max(step, length * self._n_pixels / MOST_CELLS)
        self._margin, self._last = margin, length / self._step + margin
        self._n_cells = (int(self._last) + 2) * self._n_pixels
        # and the pixels that footprints in the last ones reach beyond them
        self._cells = like.new_zeros(self._n_cells + view.width + 1)

    @property
    def values(self) -> Tensor:
        """[S P]: the optical depths that were added, then what ``light_up`` makes of them."""
        return self._cells[: self._n_cells].view(-1, self._n_pixels)

    def place(self, pixel: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
        """The first cell of points [N], int32, and the share of the slab behind it, [N]."""
        slab = ((depth - self._nearest) / self._step + self._margin).clamp_(0, self._last)
        near = torch.floor(slab).clamp_(max=int(self._last))  # what float32 rounds up is not beyond
        cell = near.to(torch.int32).mul_(self._n_pixels).add_(pixel)
        return cell, slab.sub_(near).to(self._cells)

    def add(self, cell: Tensor, far: Tensor, shifts: Sequence[int], depths: Tensor) -> None:
        """Add optical depths [4 N] to the slabs around points, ``shifts`` after their pixel."""
        behind = depths * far
        for shift, near, rest in zip(shifts, depths - behind, behind, strict=True):
            add_at(self._cells[shift:], cell, near)
            add_at(self._cells[shift + self._n_pixels :], cell, rest)

    def at(self, cell: Tensor, far: Tensor, shifts: Sequence[int]) -> Tensor:
        """The values around points in those pixels, linear between slabs, [4 N]."""
        near = far.new_empty(len(shifts), len(cell))
        behind = torch.empty_like(near)
        for number, shift in enumerate(shifts):
            torch.index_select(self._cells[shift:], 0, cell, out=near[number])
            further = self._cells[shift + self._n_pixels :]
            torch.index_select(further, 0, cell, out=behind[number])
        return near.lerp_(behind, far)

    def light_up(self, both: bool = False) -> None:
        """Replace optical depths by what a unit of each adds to the picture.

        Args:
            both: the mean of what it adds to this picture and to that from behind.
        """
        depths = self.values
        n_slabs, n_pixels = depths.shape
        for part in chunks(n_pixels, max(CHUNK_CELLS // n_slabs, 1), depths.device):
            here = depths[:, part].contiguous()
            found = _seen(here)
            depths[:, part] = (found + _seen(here.flip(0)).flip(0)) / 2 if both else found


def _seen(depths: Tensor) -> Tensor:
    return transmittance_before(depths) * attenuation_ratio(depths)

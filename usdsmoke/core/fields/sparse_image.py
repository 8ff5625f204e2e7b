"""A view's linear map from voxels to pixels, and its exact adjoint.

Each voxel has a fixed number of pixels, whose weights lie beside each other. The sums of pixels add
up entry after entry, the adjoint is a plain gather.
"""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, cast

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from usdsmoke.core.smoke.memory import chunks, share_rows, weighted_rows
from usdsmoke.core.smoke.tasks import run_tasks

SCATTERED_ROWS = 2**15  # voxels whose light is added to a picture at once, at least
MOST_SUMS = 32  # such pictures, which are in memory together
PICKED_ROWS = 2**16  # voxels whose values are picked at once


class _Pick(torch.autograd.Function):
    """Values [N C] -> those of some rows, [M C], each of which is there once."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, rows: Tensor) -> Tensor:
        ctx.rows, ctx.n_voxels, values = rows, len(values), values.contiguous()
        found = values.new_empty(len(rows), values.shape[1])

        def pick(part: slice) -> None:
            torch.index_select(values, 0, rows[part], out=found[part])

        share_rows(pick, len(rows), PICKED_ROWS, values.device)
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        return _put_back(upstream, ctx.rows, ctx.n_voxels), None


class _Splat(torch.autograd.Function):
    """Values [M C] -> picture [P C]; both sum in a fixed order, so bits are reproducible."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, image: "SparseImage") -> Tensor:
        ctx.image = image
        if values.device.type == "cpu":
            return _scattered(values.detach(), image)
        entry, by_pixel, start = image.runs
        return weighted_rows(values.detach(), entry, start, by_pixel)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        return ctx.image.gather(upstream), None


def _put_back(values: Tensor, rows: Tensor, n_voxels: int) -> Tensor:
    """[N C] with values [M C] in some rows, and 0 in all others."""
    found = values.new_zeros(n_voxels, values.shape[1])

    def put(part: slice) -> None:
        found.index_copy_(0, rows[part], values[part])

    share_rows(put, len(rows), PICKED_ROWS, values.device)
    return found


def _scattered(values: Tensor, image: "SparseImage") -> Tensor:
    """[P C], entry after entry: nothing has to be sorted first.

    A map is applied two to eight times, and sorting takes as long as that or longer. One channel
    takes no longer than sums over sorted runs on one thread, three take three times as long.
    """
    n_pixels = image.height * image.width

    def add_up(part: slice) -> Tensor:
        pixel, weight = image.pixel[part].reshape(-1), image.weight[part]
        columns = values[part].unbind(1)
        return torch.stack(
            [
                torch.bincount(pixel, (weight * column[:, None]).reshape(-1), minlength=n_pixels)
                for column in columns
            ]
        )

    n_rows = max(SCATTERED_ROWS, -(-len(image.pixel) // MOST_SUMS))
    parts = chunks(len(image.pixel), n_rows, values.device)
    found = values.new_zeros(values.shape[1], n_pixels)
    for sums in run_tasks([partial(add_up, part) for part in parts]):
        found += sums
    return found.T.contiguous()


@dataclass(frozen=True)
class SparseImage:
    """A linear map from N voxels to H x W pixels with K pixels a voxel: four for each point in it.

    Weights of pixels outside the image are 0, but a value there that is not finite still reaches
    the picture.
    """

    height: int
    width: int
    pixel: Tensor  # [M K]
    weight: Tensor  # [M K]
    rows: Tensor | None = None  # [M], the voxels that can be seen, ascending; None: all, M = N
    n_voxels: int = 0  # N, where there are rows

    def total_weights(self) -> Tensor:
        """Of each voxel, over all pixels, [N]."""
        total = self.weight.sum(dim=1)
        if self.rows is None:
            return total
        return _put_back(total[:, None], self.rows, self.n_voxels)[:, 0]

    @cached_property
    def runs(self) -> tuple[Tensor, Tensor, Tensor]:
        """The entries with a weight, sorted by pixel: row, weight, first entry of each pixel.

        For devices on which scattered sums come in any order.
        """
        pixel, weight = self.pixel.reshape(-1), self.weight.reshape(-1)
        keep = torch.nonzero(weight).squeeze(1)
        ordered, place = torch.sort(pixel[keep], stable=True)
        order = keep[place]
        del keep, place  # each as large as all that is returned
        n_pixels = self.height * self.width
        start = torch.zeros(n_pixels, dtype=torch.int32, device=pixel.device)
        start[1:] = torch.cumsum(torch.bincount(ordered, minlength=n_pixels), 0)[:-1]
        row = torch.div(order, self.pixel.shape[1], rounding_mode="floor").to(torch.int32)
        return row, weight[order], start

    def apply(self, values: Tensor) -> Tensor:
        """Picture [H W C] of voxel values [N C]. Gradients: through ``values``, exact adjoint."""
        return self.splat(self.pick(values))

    def pick(self, values: Tensor) -> Tensor:
        """Of voxel values [N C] those that can be seen, [M C]. Gradients: through ``values``."""
        return values if self.rows is None else cast(Tensor, _Pick.apply(values, self.rows))

    def splat(self, values: Tensor) -> Tensor:
        """Picture [H W C] of the values [M C] that can be seen. Gradients: as of ``apply``."""
        flat = cast(Tensor, _Splat.apply(values, self))
        return flat.view(self.height, self.width, -1)

    def adjoint(self, picture: Tensor) -> Tensor:
        """Voxel values [N C] of a picture [H W C] or [P C]: the transpose of ``apply``."""
        found = self.gather(picture)
        return found if self.rows is None else _put_back(found, self.rows, self.n_voxels)

    def gather(self, picture: Tensor) -> Tensor:
        """Values [M C] of a picture [H W C] or [P C]: the transpose of ``splat``."""
        flat = picture.reshape(self.height * self.width, -1)
        n_entries, step = self.pixel.numel(), self.pixel.shape[1]
        start = torch.arange(0, n_entries, step, dtype=torch.int32, device=flat.device)
        return weighted_rows(flat, self.pixel.reshape(-1), start, self.weight.reshape(-1))

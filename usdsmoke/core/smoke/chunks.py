"""Long tensors worked off in pieces, so that what is made in between stays small."""

from collections.abc import Iterator

import torch

__all__ = ["PIECE", "cut"]

PIECE = 2**14  # voxels or sums at once
GPU_PIECES = 256  # times as much at once on a GPU, where every piece costs time


def cut(n: int, size: int, device: torch.device) -> Iterator[slice]:
    """Slices that make up 0 to n - 1, of ``size`` each; on a GPU of more."""
    size *= 1 if device.type == "cpu" else GPU_PIECES
    for first in range(0, n, size):
        yield slice(first, min(first + size, n))

r"""White noise as a pure function of voxel, channel and seed.

A number belongs to its voxel: it does not depend on the crop, on the order or number of the
requested voxels, on the thread count or the machine. Voxel, channel and seed are combined linearly
with odd 64-bit constants and scrambled twice by a bijection of 64-bit words: every input bit
affects every output bit [Steele2014]. Only integer arithmetic and correctly rounded sums and
products are used, so the bits are the same everywhere.
"""

import torch
from torch import Tensor

from usdsmoke.base.errors import ShapeError

# Odd, about half of the bits set; i, j, k and channel.
_STEPS = (
    -0x61C8864680B583EB,
    0x5851F42D4C957F2D,
    -0x2EF35C3C0DEDCE2B,
    0x369DEA0F31A53F85,
)
_CHUNK = 32768  # voxels at a time, so that the words stay in the processor's cache


def white_noise(ijk: Tensor, n_channels: int, seed: int) -> Tensor:
    """Independent uniform numbers in [0, 1), float32, [N C].

    Args:
        ijk: integer voxel indices, [N 3], int64; negative ones as well.
        n_channels: C, >= 1.
        seed: any integer; its lowest 64 bits are used.

    Returns:
        multiples of 2^-24; the values of a voxel do not depend on its position in ``ijk``.

    Raises:
        ShapeError: ijk or n_channels are not as above.
    """
    _check_drawing(ijk, n_channels)
    return torch.cat([_draw_uniform(part, n_channels, seed) for part in ijk.split(_CHUNK)])


def _draw_uniform(ijk: Tensor, n_channels: int, seed: int) -> Tensor:
    words = _hash(ijk, n_channels, seed)
    return _shift_right(words, 40).to(torch.float32) * 2.0**-24


def _hash(ijk: Tensor, n_channels: int, seed: int) -> Tensor:
    """64 scrambled bits for each voxel and channel, int64 [N C]."""
    key = torch.tensor(_signed(seed + 1), dtype=torch.int64, device=ijk.device)
    key = _scramble(_scramble(key))
    channels = torch.arange(n_channels, dtype=torch.int64, device=ijk.device) * _STEPS[3]
    voxels = ijk[:, 0] * _STEPS[0] + ijk[:, 1] * _STEPS[1] + ijk[:, 2] * _STEPS[2]
    return _scramble(_scramble(voxels[:, None] + channels + key) ^ key)


def _check_drawing(ijk: Tensor, n_channels: int) -> None:
    if ijk.ndim != 2 or ijk.shape[1] != 3 or ijk.dtype != torch.int64:
        raise ShapeError(
            f"voxel indices are {ijk.dtype} of shape {list(ijk.shape)}. Pass int64 of shape [N 3]."
        )
    if n_channels < 1:
        raise ShapeError(f"cannot draw noise for {n_channels} channels. Pass at least 1.")


def _scramble(words: Tensor) -> Tensor:
    """A bijection of 64-bit words; products wrap around."""
    words = (words ^ _shift_right(words, 30)) * _signed(0xBF58476D1CE4E5B9)
    words = (words ^ _shift_right(words, 27)) * _signed(0x94D049BB133111EB)
    return words ^ _shift_right(words, 31)


def _shift_right(words: Tensor, n_bits: int) -> Tensor:
    """Shifts in zeros; torch's own shift copies the sign."""
    if n_bits == 0:
        return words
    return (words >> n_bits) & ((1 << (64 - n_bits)) - 1)


def _signed(number: int) -> int:
    """The lowest 64 bits of an integer, read as int64."""
    return (number + (1 << 63)) % (1 << 64) - (1 << 63)

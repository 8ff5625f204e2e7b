"""The mask field: how strongly the style takes effect at a place."""

import numpy as np
import torch
from torch import Tensor

from usdsmoke.core.sample import sample_linear
from usdsmoke.volume import VolumeFrame

__all__ = ["EffectMask", "effect_mask"]


class EffectMask:
    """A scalar field as the share of the effect, clamped to [0, 1], anywhere in stage space.

    Args:
        frame: with a mask; it may have voxels, a box and a place of its own.
    """

    def __init__(self, frame: VolumeFrame) -> None:
        mask = frame.mask
        if mask is None or frame.mask_to_stage is None:
            raise ValueError("the frame has no mask")
        self._outside = float(np.clip(np.ravel(mask.background)[0], 0, 1))
        self._values = torch.from_numpy(np.clip(mask.values, 0, 1).astype(np.float32))
        self._low = np.asarray(mask.ijk_min, float)
        self._stage_to_index = np.linalg.inv(mask.index_to_world @ np.asarray(frame.mask_to_stage))
        #: voxels that were clamped
        self.n_clamped = int(((mask.values < 0) | (mask.values > 1)).sum())

    def at(self, positions: Tensor) -> Tensor:
        """The share at points, [N] float32; trilinear, the background's beyond the box.

        Args:
            positions: [N 3] float64, stage space.
        """
        if self._values.numel() == 0:
            return torch.full((len(positions),), self._outside, device=positions.device)
        matrix = torch.as_tensor(self._stage_to_index, device=positions.device)
        low = torch.as_tensor(self._low, device=positions.device)
        place = positions @ matrix[:3, :3] + matrix[3, :3] - low
        # far away float32 has no fractions left, nor is there anything
        room = torch.as_tensor(self._values.shape, device=place.device) + 1.0
        place = torch.minimum(place.clamp_min(-2.0), room).float()
        return sample_linear(self._values.to(place.device), place, self._outside).clamp(0, 1)


def effect_mask(frame: VolumeFrame) -> EffectMask | None:
    """The frame's mask; None when the style takes effect everywhere."""
    return EffectMask(frame) if frame.mask is not None else None

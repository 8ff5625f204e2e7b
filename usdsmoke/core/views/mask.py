"""How strongly the style takes effect at a place: the mask field, and what the camera sees."""

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.volume import VolumeFrame
from usdsmoke.core.fields.sample import sample_linear
from usdsmoke.core.views.visibility import Sight

__all__ = ["EffectMask", "effect_mask"]


class EffectMask:
    """The share of the effect, in [0, 1], anywhere in stage space: the product of both.

    Args:
        frame: its mask may have voxels, a box and a place of its own, and is clamped to [0, 1].
        sight: of the frame's camera; None sees everything.
    """

    def __init__(self, frame: VolumeFrame, sight: Sight | None = None) -> None:
        mask, self._sight, self._has_field = frame.mask, sight, frame.mask is not None
        #: voxels that were clamped
        self.n_clamped = 0
        if mask is None and sight is not None:
            return
        if mask is None or frame.mask_to_stage is None:
            raise ValueError("the frame has no mask")
        self._outside = float(np.clip(np.ravel(mask.background)[0], 0, 1))
        self._values = torch.from_numpy(np.clip(mask.values, 0, 1).astype(np.float32))
        self._low = np.asarray(mask.ijk_min, float)
        self._stage_to_index = np.linalg.inv(mask.index_to_world @ np.asarray(frame.mask_to_stage))
        self.n_clamped = int(((mask.values < 0) | (mask.values > 1)).sum())

    def at(self, positions: Tensor) -> Tensor:
        """The share at points, [N] float32; trilinear, the background's beyond the field's box.

        Args:
            positions: [N 3] float64, stage space.
        """
        if self._sight is None:
            return self._field_at(positions)
        seen = self._sight.at(positions)
        return seen * self._field_at(positions) if self._has_field else seen

    def _field_at(self, positions: Tensor) -> Tensor:
        if self._values.numel() == 0:
            return torch.full((len(positions),), self._outside, device=positions.device)
        matrix = torch.as_tensor(self._stage_to_index, device=positions.device)
        low = torch.as_tensor(self._low, device=positions.device)
        place = positions @ matrix[:3, :3] + matrix[3, :3] - low
        # far away float32 has no fractions left, nor is there anything
        room = torch.as_tensor(self._values.shape, device=place.device) + 1.0
        place = torch.minimum(place.clamp_min(-2.0), room).float()
        return sample_linear(self._values.to(place.device), place, self._outside).clamp(0, 1)


def effect_mask(frame: VolumeFrame, sight: Sight | None = None) -> EffectMask | None:
    """The frame's mask and what its camera sees; None when the style takes effect everywhere."""
    if frame.mask is None and sight is None:
        return None
    return EffectMask(frame, sight)

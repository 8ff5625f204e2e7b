"""Subdividing voxels, so that a coarse grid can carry detail that its own voxels cannot."""

import numpy as np
import torch

from usdsmoke.base.volume import DenseField
from usdsmoke.core.fields.sample import sample_linear

__all__ = ["refine_field"]


def refine_field(field: DenseField, factor: int) -> DenseField:
    """The field on voxels ``factor`` times smaller along every axis with more than one voxel.

    Trilinear between voxel centres and towards the background beyond the box, so that the integral
    over space is kept. The box grows by one source voxel on every side that is subdivided.

    Args:
        field: [i j k] or [i j k 3].
        factor: 1 gives the field back unchanged.
    """
    if factor == 1 or field.is_empty:
        return field
    shape = np.array(field.values.shape[:3])
    scale = np.where(shape > 1, factor, 1)
    pad = np.where(shape > 1, 1, 0)
    axes = [
        (torch.arange(int(n), dtype=torch.float32) + 0.5) / int(f) - 0.5 - int(p)
        for n, f, p in zip((shape + 2 * pad) * scale, scale, pad, strict=True)
    ]
    values = torch.from_numpy(np.ascontiguousarray(field.values, np.float32))
    outside = np.asarray(field.background, np.float32).reshape(-1)
    shifted = values - torch.from_numpy(outside) if values.ndim == 4 else values - float(outside[0])
    refined = torch.empty(*(len(axis) for axis in axes), *values.shape[3:], dtype=torch.float32)
    for plane, position in zip(refined, axes[0], strict=True):
        # slab by slab, so that the positions never fill memory
        grid = torch.stack(torch.meshgrid(position[None], axes[1], axes[2], indexing="ij"), -1)
        plane[:] = sample_linear(shifted, grid.reshape(-1, 3)).view(plane.shape)
    refined += torch.from_numpy(outside) if values.ndim == 4 else float(outside[0])
    old_from_new = np.diag([*(1.0 / scale), 1.0])
    old_from_new[3, :3] = 0.5 / scale - 0.5
    return DenseField(
        field.name,
        refined.numpy(),
        tuple(int(n) for n in (np.asarray(field.ijk_min) - pad) * scale),  # type: ignore[arg-type]
        old_from_new @ field.index_to_world,
        field.background,
        field.grid_class,
        field.half,
        field.metadata,
    )

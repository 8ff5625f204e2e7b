r"""A second renderer for emission and absorption, which shares no code with the optimiser's.

The optimiser splats voxels onto slabs; this one marches rays through the trilinearly interpolated
grids, as Storm and Cycles do. Pictures that look right only through the optimiser's own
projection would be found out here. Per segment of length h, with sigma and emission at its middle:

    radiance += T * emission * (1 - exp(-sigma h)) / sigma,    T *= exp(-sigma h)       [Max1995]
"""

from typing import Protocol

import numpy as np
import torch
import torch.nn.functional as F

__all__ = ["Camera", "march_rays"]


class Camera(Protocol):
    """What is read of a view; see usdsmoke.core.views.cameras.View."""

    right: np.ndarray
    up: np.ndarray
    forward: np.ndarray
    centre: np.ndarray  # the eye when there is a focal length
    height: int
    width: int
    pixel_size: float
    focal: float | None  # pixels; None is orthographic


def march_rays(
    density: np.ndarray,
    emission: np.ndarray,
    index_to_stage: np.ndarray,
    gamma_w: float,
    camera: Camera,
    steps_per_voxel: float = 2.0,
) -> tuple[np.ndarray, np.ndarray]:
    """A picture of smoke that glows and absorbs, without scattering.

    Args:
        density: [i j k], >= 0; nothing outside.
        emission: [i j k 3], radiance per stage unit of length, scene-linear.
        index_to_stage: [4 4] row vectors, from the arrays' own indices to stage space.
        gamma_w: extinction per density, 1/stage unit.
        camera: the view; rows of the picture go down.
        steps_per_voxel: segments in the length of a voxel (of the cube root of its volume).

    Returns:
        Premultiplied linear picture [H W 3] and opacity [H W], float32.
    """
    channels = np.concatenate([gamma_w * density[..., None], emission], axis=-1)
    volume = torch.from_numpy(np.ascontiguousarray(channels, dtype=np.float32)).permute(3, 0, 1, 2)
    start, direction = _rays(camera)
    near, far = _depth_range(density.shape, index_to_stage, start, direction)
    step = float(abs(np.linalg.det(index_to_stage[:3, :3]))) ** (1 / 3) / steps_per_voxel
    to_index = np.linalg.inv(index_to_stage)
    start_ijk = torch.from_numpy((start @ to_index[:3, :3] + to_index[3, :3]).astype(np.float32))
    direction_ijk = torch.from_numpy((direction @ to_index[:3, :3]).astype(np.float32))
    # grid_sample wants (k, j, i) in [-1, 1] over the voxel centres.
    half = torch.tensor([max(n - 1, 1) / 2 for n in density.shape], dtype=torch.float32)
    radiance = torch.zeros(*start.shape[:2], 3)
    passed = torch.ones(*start.shape[:2])
    for distance in np.arange(near + step / 2, far, step):
        place = ((start_ijk + float(distance) * direction_ijk) / half - 1.0).flip(-1)
        sample = F.grid_sample(volume[None], place[None, None], align_corners=True)[0, :, 0]
        depth = sample[0] * step
        shown = torch.where(
            depth > 1e-6, -torch.expm1(-depth) / depth.clamp_min(1e-6), 1 - depth / 2
        )
        radiance += (passed * shown * step)[..., None] * sample[1:].permute(1, 2, 0)
        passed *= torch.exp(-depth)
    return radiance.numpy(), (1.0 - passed).numpy()


def _rays(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Start and unit direction of every pixel's ray, [H W 3] each, stage space."""
    x = np.arange(camera.width)[None, :, None] - (camera.width - 1) / 2
    y = (camera.height - 1) / 2 - np.arange(camera.height)[:, None, None]
    across = x * camera.right + y * camera.up
    if camera.focal is None:
        start = camera.centre + camera.pixel_size * across
        return start, np.broadcast_to(camera.forward, start.shape)
    direction = across / camera.focal + camera.forward
    direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    return np.broadcast_to(camera.centre, direction.shape), direction


def _depth_range(
    shape: tuple[int, ...], index_to_stage: np.ndarray, start: np.ndarray, direction: np.ndarray
) -> tuple[float, float]:
    """Distances along the rays between which all of the box lies, a voxel of margin included."""
    ends = [(-1.0, float(n)) for n in shape]
    corners = np.stack(np.meshgrid(*ends), axis=-1).reshape(-1, 3)
    corners = corners @ index_to_stage[:3, :3] + index_to_stage[3, :3]
    rows = [0, 0, -1, -1]
    columns = [0, -1, 0, -1]
    eyes, towards = start[rows, columns], direction[rows, columns]
    if np.allclose(towards, towards[0]):  # parallel rays
        along = (corners[:, None] - eyes) @ towards[0]
        return float(along.min()), float(along.max())
    distance = np.linalg.norm(corners - eyes[0], axis=1)
    middle = np.linalg.norm(corners.mean(axis=0) - eyes[0])
    radius = np.linalg.norm(corners - corners.mean(axis=0), axis=1).max()
    return float(max(0.0, middle - radius)), float(distance.max())

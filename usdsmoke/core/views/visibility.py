"""The part of a frame's smoke that its camera sees: what is worked on at all."""

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.config import Config
from usdsmoke.base.volume import CameraSource, VolumeFrame
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.views.frustum import Frustum, frustum_of, pixel_footprint

__all__ = ["Sight", "nearest_footprint", "sight_of", "visible_part"]

ROOM = 3  # voxels of still smoke around what is seen: splines and filters look that far
STEEPEST = 1.125  # a share at the border's part t is at most this t


class Sight:
    """A frustum and how far around it smoke is kept, so that what moves has something to fetch.

    Args:
        frustum: of the frame's camera.
        room: stage units around the frustum's border.
    """

    def __init__(self, frustum: Frustum, room: float) -> None:
        self._frustum, self._room = frustum, room

    def at(self, positions: Tensor) -> Tensor:
        """The share of the effect at points, [N] float32: 1 in the picture, 0 beyond its border.

        Args:
            positions: [N 3] float64, stage space.
        """
        shares = self._frustum.shares(positions.cpu().numpy())
        return torch.from_numpy(shares.astype(np.float32)).to(positions.device)

    def seen(self, smoke: ActiveSmoke) -> ActiveSmoke:
        """The smoke that the picture or its border shows: what is painted."""
        return smoke.take(self.at(smoke.positions) > 0)

    def near(self, smoke: ActiveSmoke) -> ActiveSmoke:
        """The smoke in sight and around it: what moves, and what may come after it."""
        distances = self._frustum.distances(smoke.positions.cpu().numpy())
        return smoke.take(torch.from_numpy(distances < self._room).to(smoke.ijk.device))


def sight_of(frame: VolumeFrame, smoke: ActiveSmoke, reach: float, config: Config) -> Sight | None:
    """What a frame's camera sees of its smoke; None without a camera, or when it sees all.

    Args:
        frame: with or without a camera.
        smoke: its active voxels.
        reach: how far smoke may be moved, stage units.
        config: ``views.camera_margin``.
    """
    if frame.camera is None or len(smoke.ijk) == 0:
        return None
    frustum = frustum_of(frame.camera, config.views.camera_margin)
    positions = smoke.positions.cpu().numpy()
    shares = frustum.shares(positions)
    if (shares == 1).all():
        return None
    voxel = float(np.linalg.norm(smoke.index_to_stage[:3, :3], axis=1).max())
    # displacement fades with the share: what fetches from beyond the border must start inside it
    nearest = float(frustum.depths(positions[shares > 0]).min()) if shares.any() else 0.0
    border = frustum.border * (1.0 if frustum.is_orthographic else nearest)
    return Sight(frustum, ROOM * voxel + max(0.0, STEEPEST * reach - border))


def visible_part(smoke: ActiveSmoke, camera: CameraSource | None, config: Config) -> ActiveSmoke:
    """The voxels that the camera's picture or its border shows; all of them without a camera."""
    if camera is None or len(smoke.ijk) == 0:
        return smoke
    shares = frustum_of(camera, config.views.camera_margin).shares(smoke.positions.cpu().numpy())
    return smoke.take(torch.from_numpy(shares > 0).to(smoke.ijk.device))


def nearest_footprint(visible: ActiveSmoke, camera: CameraSource | None, config: Config) -> float:
    """What a pixel of the shot covers at the nearest visible smoke, stage units; 0 without any."""
    if camera is None or len(visible.ijk) == 0:
        return 0.0
    frustum = frustum_of(camera, config.views.camera_margin)
    depth = float(frustum.depths(visible.positions.cpu().numpy()).min())
    return pixel_footprint(camera, depth, config.views.camera_width)

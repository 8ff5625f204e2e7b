"""Where the style takes effect: the part of the smoke that a camera sees, and the user's mask."""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.frame_report import SightReport
from usdsmoke.base.volume import CameraSource, DenseField, VolumeFrame
from usdsmoke.core.fields.sample import sample_linear, share_of_flat
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.smoke.levels import bounded
from usdsmoke.core.smoke.voxels import Voxels
from usdsmoke.core.views.frustum import Frustum, frustum_of

VISIBLE_PADDING = 3  # voxels of still smoke around the visible part: splines and filters read it
_NO_BORDER = 1e-9
_CLOSE = 8.0  # voxels across the picture: fewer show no strokes
_RAYS, _SAMPLES = (16, 12), 64  # across and up the film; along a ray
_FEW = 0.05  # of the smoke's voxels: so small a mask may be one in another place or unit
STEEPEST_SHARE = 1.125  # at the fraction t of the border the share is at most this times t


class Visibility:
    """A frustum, and how far around it smoke is kept so that moving smoke has a source.

    Args:
        frustum: of the frame's camera.
        padding: stage units around the frustum's border.
    """

    def __init__(self, frustum: Frustum, padding: float) -> None:
        self._frustum, self._padding = frustum, padding

    def at(self, positions: Tensor) -> Tensor:
        """The share of the effect at points, [N] float32: 1 in the picture, 0 beyond its border.

        Args:
            positions: [N 3] float64, stage space.
        """
        shares = self._frustum.shares(positions.cpu().numpy())
        return torch.from_numpy(shares.astype(np.float32)).to(positions.device)

    def visible(self, smoke: ActiveSmoke) -> ActiveSmoke:
        """The smoke in the picture or in its border, which is painted."""
        return smoke.take(self.at(smoke.positions) > 0)

    def why_nothing(self, smoke: ActiveSmoke) -> str:
        """Why none of the smoke is visible."""
        positions = smoke.positions.cpu().numpy()
        if self._frustum.unclipped().shares(positions).any():
            near, far = self._frustum.near, self._frustum.far
            return f"outside the camera's clipping planes ({near:g} and {far:g})"
        return "outside the camera's frustum"

    def padded(self, smoke: ActiveSmoke) -> ActiveSmoke:
        """The visible smoke, which moves, and the smoke around it, which may follow."""
        distances = self._frustum.distances(smoke.positions.cpu().numpy())
        return smoke.take(torch.from_numpy(distances < self._padding).to(smoke.ijk.device))


def frame_visibility(
    frame: VolumeFrame, smoke: ActiveSmoke, max_displacement: float, margin: float
) -> Visibility | None:
    """What a frame's camera sees of its smoke; None without a camera, or if all is visible.

    Args:
        frame: with or without a camera.
        smoke: its active voxels.
        max_displacement: how far smoke may be moved, stage units.
        margin: width of the picture's soft border, as a share of the film's width.
    """
    if frame.camera is None or len(smoke.ijk) == 0:
        return None
    voxel = smoke.longest_edge
    frustum = frustum_of(frame.camera, margin, voxel)
    positions = smoke.positions.cpu().numpy()
    shares = frustum.shares(positions)
    if (shares == 1).all():
        return None
    # displacement fades with the share: only voxels inside the border read smoke from outside it
    nearest = float(frustum.depths(positions[shares > 0]).min()) if shares.any() else 0.0
    border = frustum.border * (1.0 if frustum.is_orthographic else nearest)
    border = max(border, frustum.least_border)
    beyond = max(0.0, STEEPEST_SHARE * max_displacement - border)
    return Visibility(frustum, VISIBLE_PADDING * voxel + beyond)


def sight_of(smoke: ActiveSmoke, camera: CameraSource, gamma_w: float) -> SightReport:
    """What stands between a camera and the smoke that it looks at.

    Args:
        smoke: of the whole frame, not empty.
        camera: of the frame.
        gamma_w: extinction per density, 1/stage unit.
    """
    voxels, frustum = bounded(smoke.voxels), frustum_of(camera, _NO_BORDER)
    shown = frustum.unclipped().shares(voxels.positions) * voxels.density
    total = float(shown.sum(dtype=np.float64))
    kept = float((frustum.shares(voxels.positions) * voxels.density).sum(dtype=np.float64))
    return SightReport(_close_share(voxels, frustum, gamma_w), 1 - kept / total if total else 0.0)


def _close_share(voxels: Voxels, frustum: Frustum, gamma_w: float) -> float:
    """The share of rays through the film of which smoke that is close hides more than half."""
    edge, depths = voxels.longest_edge, frustum.depths(voxels.positions)
    depth = _CLOSE * edge / float(frustum.high[0] - frustum.low[0])
    if frustum.is_orthographic:
        depth = np.inf if depth > 1 else -np.inf
    near = max(frustum.near, float(depths.min()) - edge)
    far = min(depth, frustum.far, float(depths.max()) + edge)
    if far <= near:
        return 0.0
    sides = [np.linspace(a, b, n) for a, b, n in zip(frustum.low, frustum.high, _RAYS, strict=True)]
    film = np.stack(np.meshgrid(*sides), -1).reshape(-1, 1, 2)
    step = (far - near) / _SAMPLES
    along = near + step * (np.arange(_SAMPLES)[None, :, None] + 0.5)
    across = film * (np.ones_like(along) if frustum.is_orthographic else along)
    places = np.concatenate(np.broadcast_arrays(across, along), -1)[..., :3]
    lengths = step * (1.0 if frustum.is_orthographic else np.sqrt(1 + (film**2).sum(-1)))
    densities = voxels.nearest(places.reshape(-1, 3) @ frustum.axes + frustum.eye)
    hidden = gamma_w * (densities.reshape(len(film), -1) * lengths).sum(1) > np.log(2)
    return float(hidden.mean())


class EffectMask:
    """The share of the effect, in [0, 1], anywhere in stage space: mask times visibility.

    Args:
        frame: its mask may have voxels, a box and a place of its own, and is clamped to [0, 1].
        visibility: of the frame's camera; None: everything is visible.
    """

    def __init__(self, frame: VolumeFrame, visibility: Visibility | None = None) -> None:
        mask, self._visibility, self._has_field = frame.mask, visibility, frame.mask is not None
        #: voxels that were clamped
        self.n_clamped = 0
        if mask is None and visibility is not None:
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

        Along an axis with one voxel it ends as ``share_of_flat`` says.

        Args:
            positions: [N 3] float64, stage space.
        """
        if self._visibility is None:
            return self.field_at(positions)
        visible = self._visibility.at(positions)
        return visible * self.field_at(positions) if self._has_field else visible

    def field_at(self, positions: Tensor) -> Tensor:
        """The mask alone at points, as ``at``; only where the frame has a mask."""
        if self._values.numel() == 0:
            return torch.full((len(positions),), self._outside, device=positions.device)
        matrix = torch.as_tensor(self._stage_to_index, device=positions.device)
        low = torch.as_tensor(self._low, device=positions.device)
        place = positions @ matrix[:3, :3] + matrix[3, :3] - low
        # far away float32 has no fractions left, nor is there anything
        limit = torch.as_tensor(self._values.shape, device=place.device) + 1.0
        place = torch.minimum(place.clamp_min(-2.0), limit).float()
        found = sample_linear(self._values.to(place.device), place, self._outside).clamp(0, 1)
        inside = share_of_flat(self._values.shape, place)
        return torch.lerp(torch.full_like(found, self._outside), found, inside)


def effect_mask(frame: VolumeFrame, visibility: Visibility | None = None) -> EffectMask | None:
    """The frame's mask and visibility; None when the style takes effect everywhere."""
    if frame.mask is None and visibility is None:
        return None
    return EffectMask(frame, visibility)


def changed_in_part(
    field: DenseField,
    changed: DenseField,
    smoke: ActiveSmoke,
    mask: EffectMask | None,
    strength: float,
) -> DenseField:
    """A field as far changed as the effect reaches.

    Args:
        changed: the same voxels where it reaches in full.
        smoke: its active voxels.
        mask: None: the same ``strength`` everywhere.
    """
    share = np.full(len(smoke.ijk), strength)
    if mask is not None:
        share *= mask.at(smoke.positions).cpu().numpy()
    at = tuple((smoke.ijk.cpu().numpy() - field.ijk_min).T)
    values = field.values.copy()
    values[at] = (1 - share) * values[at] + share * changed.values[at]
    return replace(field, values=values)


def mask_warnings(
    frame: VolumeFrame, mask: EffectMask | None, smoke: ActiveSmoke
) -> tuple[str, ...]:
    """What of the user's mask may be wrong: values out of range, and hardly any smoke in it.

    Args:
        mask: of the frame.
    """
    if frame.mask is None or mask is None:
        return ()
    found = list[str]()
    what = f'the mask "{frame.mask.name}" at timeCode {frame.time_code:g}'
    if mask.n_clamped:
        found.append(
            f"{mask.n_clamped} values of {what} are not between 0 and 1 and were clamped. Scale "
            "the mask to 0 to 1, or check stage.mask"
        )
    share = float(mask.field_at(smoke.positions).mean()) if len(smoke.ijk) else 0.0
    if 0 < share < _FEW:
        found.append(
            f"{what} selects {share:.2g} of the smoke's voxels. If it should be more, check the "
            "mask's place, its scale and its values"
        )
    return tuple(found)

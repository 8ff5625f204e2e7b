"""Pictures of finished fields from any camera, as the optimiser draws them."""

import math
from dataclasses import replace

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.base.volume import DenseField
from usdsmoke.core.fields.resample import refine_field
from usdsmoke.core.smoke.active import ActiveSmoke, activate
from usdsmoke.core.smoke.srgb import encode_srgb
from usdsmoke.core.views.cameras import View, orbit_view
from usdsmoke.core.views.project import colour_map
from usdsmoke.core.views.scene import fit_view

__all__ = ["display_picture", "grey_picture", "render_fields", "render_view"]

MOST_REFINEMENT = 2  # subdivisions of a voxel in a picture; beyond that it is shown blurred
MOST_PIXELS = 4  # times the picture's side, drawn before it is made smaller


def render_view(
    density: DenseField,
    emission: DenseField | None,
    to_stage: np.ndarray,
    gamma_w: float,
    up_axis: str,
    azimuth: float = 0.0,
    elevation: float = 0.0,
    image_size: int = 256,
) -> np.ndarray:
    """An orthographic picture that just holds the smoke; see ``render_fields`` for the result.

    Args:
        azimuth, elevation: degrees, see ``views.orbit_view``.
        image_size: pixels of the longer side.
    """
    smoke = activate(density, to_stage, torch.device("cpu"))
    if len(smoke.ijk) == 0:
        return np.zeros((image_size, image_size, 4), np.float32)
    tiny = orbit_view(azimuth, elevation, up_axis, np.zeros(3), 1, 1, 1e-3 * smoke.voxel_size)
    fitted = fit_view(tiny, smoke, margin=0)
    longest = max(fitted.height, fitted.width) * fitted.pixel_size
    factor = min(MOST_REFINEMENT, max(1, int(smoke.voxel_size * image_size / longest + 0.1)))
    # whole voxels a pixel: the splatted lattice does not beat with the pixels; resampled after
    voxels = max(1, int(longest / smoke.voxel_size / (MOST_PIXELS * image_size)))
    view = fit_view(replace(tiny, pixel_size=smoke.voxel_size * voxels / factor), smoke)
    picture = torch.from_numpy(render_fields(density, emission, to_stage, gamma_w, view))
    scale = image_size / max(view.height, view.width)
    size = [max(1, round(view.height * scale)), max(1, round(view.width * scale))]
    resized = F.interpolate(
        picture.permute(2, 0, 1)[None],
        size=size,
        mode="bilinear",
        antialias=True,
        align_corners=False,
    )
    return resized[0].permute(1, 2, 0).contiguous().numpy()


def render_fields(
    density: DenseField,
    emission: DenseField | None,
    to_stage: np.ndarray,
    gamma_w: float,
    view: View,
) -> np.ndarray:
    """The picture of the fields in a view.

    Voxels larger than the pixels are subdivided first, or gaps would show between them.

    Args:
        density: [i j k].
        emission: [i j k 3], C x sigma, co-registered with the density; None draws white smoke.
        to_stage: [4 4], grid world to stage.
        gamma_w: extinction per density, 1/stage unit.
        view: orthographic or perspective.

    Returns:
        [H W 4] float32: scene-linear colour premultiplied by alpha, and alpha; see
        ``display_picture``.
    """
    smoke = activate(density, to_stage, torch.device("cpu"))
    if len(smoke.ijk) == 0:
        return np.zeros((view.height, view.width, 4), np.float32)
    factor = min(MOST_REFINEMENT, math.ceil(_pixels_per_voxel(smoke, view) - 1e-3))
    if factor > 1:
        smoke = activate(refine_field(density, factor), to_stage, torch.device("cpu"))
    colours = _colours(smoke, emission, factor, gamma_w)
    image, alpha = colour_map(
        smoke.positions, smoke.density, smoke.edges, gamma_w, view, smoke.voxel_size
    )
    return torch.cat([image.apply(colours), alpha[..., None]], dim=-1).numpy()


def _colours(
    smoke: ActiveSmoke, emission: DenseField | None, factor: int, gamma_w: float
) -> Tensor:
    """Linear colours [N 3] of smoke that was refined by ``factor``; emission is not refined yet."""
    if emission is None:
        return torch.ones(len(smoke.ijk), 3)
    light = _values_at(refine_field(emission, factor), smoke.ijk)
    # interpolated C x sigma over sigma: weighted by density, so nothing bleeds in from outside
    return light.div_((gamma_w * smoke.density).clamp_min(1e-30)[:, None])


def _values_at(field: DenseField, ijk: Tensor) -> Tensor:
    """The field's values [N C] at absolute voxels [N 3]; 0 beyond its box, which may be smaller."""
    index = ijk - torch.tensor(field.ijk_min)
    inside = ((index >= 0) & (index < torch.tensor(field.values.shape[:3]))).all(dim=1)
    found = torch.zeros(len(ijk), field.values.shape[3])
    found[inside] = torch.from_numpy(field.values[tuple(index[inside].numpy().T)])
    return found


def display_picture(
    picture: np.ndarray, background: float | tuple[float, float, float] = 0.0
) -> np.ndarray:
    """A premultiplied linear picture [H W 4] over a linear background, encoded for display.

    Returns:
        [H W 3], display-encoded, in [0, 1].
    """
    behind = (1 - picture[..., 3:]) * np.asarray(background, np.float32)
    return encode_srgb(torch.from_numpy(picture[..., :3] + behind)).clamp(0, 1).numpy()


def grey_picture(picture: np.ndarray) -> np.ndarray:
    """A picture's opacity as grey level, [H W 3] in [0, 1]: the shape step's pictures."""
    return np.repeat(picture[..., 3:], 3, axis=-1)


def _pixels_per_voxel(smoke: ActiveSmoke, view: View) -> float:
    """How many pixels the longest edge of a voxel covers, at its nearest."""
    edges = [np.linalg.norm(smoke.index_to_stage[n, :3]) for n in range(3) if n != smoke.thin_axis]
    if view.focal is None:
        return float(max(edges)) / view.pixel_size
    depth = (smoke.positions.double().numpy() - view.centre) @ view.forward
    visible = depth[depth > 0]
    return float(max(edges)) * view.focal / float(visible.min()) if len(visible) else 1.0

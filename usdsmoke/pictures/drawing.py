"""Smoke as pixels: the front view, and pictures for a screen.

Previews and contact sheets are both drawn here, by rays (see ``core.views.march``).
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from usdsmoke.base.sections import ViewsConfig
from usdsmoke.base.volume import DenseField
from usdsmoke.pictures.png import encode_srgb

if TYPE_CHECKING:
    from usdsmoke.core.views.cameras import View
    from usdsmoke.core.views.march import Picture

BACKGROUND = 0.03  # linear, behind the smoke; on black the style's dark colours would be lost
GREY = 0.5  # scene-linear light of thick smoke that has no emission
_FINE = 1_000_000  # pixels, of a view that is made for its proportions
_PIXELS_PER_VOXEL = 3  # at most: smaller pixels show no more


def front_view(up_axis: str, views: ViewsConfig | None = None) -> "View":
    """The direction from the front; ``frame_points`` gives it a place and a size.

    Args:
        up_axis: "Y" or "Z".
        views: the section ``views`` of the settings; None takes the defaults.
    """
    from usdsmoke.core.views.cameras import orbit_view

    views = views or ViewsConfig()
    angles = (views.centre_azimuth, views.centre_elevation)
    return orbit_view(*angles, up_axis, np.zeros(3), 1, 1, 1.0)


def box_corners(low: np.ndarray, high: np.ndarray, index_to_stage: np.ndarray) -> np.ndarray:
    """Corners [8 3] of the first to the last voxel, stage space, with the voxels around them.

    Interpolated smoke ends at the centres of the next voxels.
    """
    choice = np.array(list(np.ndindex(2, 2, 2)), bool)
    corners: np.ndarray = np.where(choice, high + 1, low - 1)
    return corners @ index_to_stage[:3, :3] + index_to_stage[3, :3]


def draw_fields(
    density: DenseField,
    emission: DenseField | None,
    to_stage: np.ndarray,
    gamma_w: float,
    direction: "View",
    image_size: int,
) -> "Picture":
    """A picture that just holds the smoke of two fields.

    Args:
        density: [i j k].
        emission: [i j k 3], radiance per stage unit, on the same lattice; None draws grey smoke.
        to_stage: [4 4], grid world to stage.
        gamma_w: extinction per density, 1/stage unit.
        direction: from ``front_view``.
        image_size: pixels of the longer side; fewer where voxels are large.

    Raises:
        ShapeError: the fields are flattened on the stage.
    """
    from usdsmoke.core.views.cameras import frame_points
    from usdsmoke.core.views.march import march
    from usdsmoke.core.views.media import make_media

    index_to_stage = density.index_to_world @ to_stage
    filled = np.argwhere(density.values > 0)
    if len(filled) == 0:
        return march([], replace(direction, height=image_size, width=image_size))
    low, high = (np.add(density.ijk_min, side(filled, axis=0)) for side in (np.min, np.max))
    points = box_corners(low, high, index_to_stage)
    fitted = frame_points(direction, points, None, _FINE)
    longest = max(fitted.height, fitted.width)
    voxels = longest * fitted.pixel_size / np.linalg.norm(index_to_stage[:3, :3], axis=1).min()
    scale = min(image_size, np.ceil(_PIXELS_PER_VOXEL * voxels)) / longest
    height, width = (max(1, round(n * scale)) for n in (fitted.height, fitted.width))
    place = None if emission is None else to_stage
    media = make_media(density, emission, to_stage, place, gamma_w, GREY)
    return march(media, frame_points(direction, points, height, width))


def display_picture(rgba: np.ndarray, background: float = BACKGROUND) -> np.ndarray:
    """A premultiplied linear picture [H W 4] over a linear background, fit for a screen.

    Returns:
        [H W 3] float32, display-encoded, in [0, 1].
    """
    behind = (1 - rgba[..., 3:]) * np.float32(background)
    return encode_srgb(np.clip(rgba[..., :3] + behind, 0.0, 1.0))


def grey_picture(alpha: np.ndarray) -> np.ndarray:
    """Opacity [H W] as grey level, [H W 3]: what the shape step sees."""
    return np.repeat(alpha[..., None], 3, axis=-1)

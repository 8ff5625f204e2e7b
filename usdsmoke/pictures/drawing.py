"""Smoke as pixels: the front view, and pictures for a screen.

Previews and contact sheets are both drawn here, by rays (see ``core.rays.march``).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from PIL import Image

from usdsmoke.config.look_sections import ViewsConfig
from usdsmoke.core.views.cameras import View, frame_points, orbit_view
from usdsmoke.pictures.png import encode_srgb

BACKGROUND = 0.03  # linear, behind the smoke; on black the style's dark colours would be lost
GREY = 0.5  # scene-linear light of thick smoke that has no emission
_FINE = 1_000_000  # pixels, of a view that is made for its proportions


def front_view(up_axis: str, views: ViewsConfig | None = None, turn: float = 0.0) -> View:
    """The direction from the front; ``fit_views`` gives it a place and a size.

    Args:
        up_axis: "Y" or "Z".
        views: the section ``views`` of the settings; None takes the defaults.
        turn: degrees around the up axis, away from the front.
    """
    views = views or ViewsConfig()
    angles = (views.centre_azimuth + turn, views.centre_elevation)
    return orbit_view(*angles, up_axis, np.zeros(3), 1, 1, 1.0)


def box_corners(low: np.ndarray, high: np.ndarray, index_to_stage: np.ndarray) -> np.ndarray:
    """Corners [8 3] of the first to the last voxel, stage space, with the voxels around them.

    Interpolated smoke ends at the centres of the next voxels.
    """
    return _corners(low - 1, high + 1) @ index_to_stage[:3, :3] + index_to_stage[3, :3]


def box_around(points: np.ndarray) -> np.ndarray:
    """Corners [8 3] of the box along the stage's axes that holds points [N 3]."""
    return _corners(points.min(axis=0), points.max(axis=0))


def _corners(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    corners: np.ndarray = np.where(np.array(list(np.ndindex(2, 2, 2)), bool), high, low)
    return corners


def fitted_size(directions: Sequence[View], points: np.ndarray) -> tuple[float, float]:
    """Height and width in stage units of a picture that holds all points from every direction.

    Args:
        directions: from ``front_view``.
        points: [N 3], stage space.
    """
    fitted = [frame_points(direction, points, None, _FINE) for direction in directions]
    height, width = (
        max(getattr(view, side) * view.pixel_size for view in fitted)
        for side in ("height", "width")
    )
    return height, width


def fit_views(
    directions: Sequence[View], points: np.ndarray, height: int, width: int
) -> list[View]:
    """The directions as views of one size and scale, each of which holds all points.

    Args:
        directions: from ``front_view``.
        points: [N 3], stage space. Smoke keeps its middle in a turn if they are a box's corners.
        height, width: pixels.
    """
    views = [frame_points(direction, points, height, width) for direction in directions]
    pixel_size = max(view.pixel_size for view in views)
    return [replace(view, pixel_size=pixel_size) for view in views]


def enlarged(picture: np.ndarray, height: int, width: int) -> np.ndarray:
    """A picture [H W 3] in [0, 1] with other numbers of pixels, interpolated."""
    if picture.shape[:2] == (height, width):
        return picture
    bands = [Image.fromarray(np.ascontiguousarray(band)) for band in np.moveaxis(picture, -1, 0)]
    made = [band.resize((width, height), Image.Resampling.BICUBIC) for band in bands]
    return np.clip(np.stack([np.asarray(band) for band in made], axis=-1), 0.0, 1.0)


def display_picture(rgba: np.ndarray, background: float = BACKGROUND) -> np.ndarray:
    """A premultiplied linear picture [H W 4] over a linear background, fit for a screen.

    Returns:
        [H W 3] float32, display-encoded, in [0, 1].
    """
    behind = (1 - rgba[..., 3:]) * np.float32(background)
    return encode_srgb(np.clip(rgba[..., :3] + behind, 0.0, 1.0))

"""Frames side by side as an animation: in windows of several sizes, and the source."""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from usdsmoke.base.errors import ImageError
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.pictures import compose_sheet, write_webp
from usdsmoke.pictures.drawing import (
    GREY,
    box_around,
    box_corners,
    display_picture,
    enlarged,
    fit_views,
    fitted_size,
    front_view,
)

if TYPE_CHECKING:
    from usdsmoke.core.views.cameras import View
    from usdsmoke.core.views.scene import Scene

_TALL = 280  # pixels of a picture
_MILLISECONDS = 125  # a frame: three times slower than most shots

# density and, if it is painted, emission
Fields = tuple[DenseField, DenseField | None]


def draw_film(
    frames: Sequence[VolumeFrame], versions: Mapping[str, Sequence[Fields]], scene: "Scene"
) -> bytes:
    """All versions of a sequence beside each other, from the front; the source comes last.

    Args:
        frames: the sources.
        versions: results of the same frames by label.
        scene: gives the up axis and the extinction.

    Returns:
        a WebP file's bytes; none where this Pillow writes no WebP.
    """
    whole = {**versions, "source": [(frame.density, None) for frame in frames]}
    view, size = _view(frames, scene.up_axis)
    sheets = []
    for number, frame in enumerate(frames):
        row = []
        for label, fields in whole.items():
            gamma_w = scene.gamma_w_shape if fields[number][1] is None else scene.gamma_w
            picture = _draw(fields[number], frame.density_to_stage, gamma_w, view)
            row.append((label, enlarged(picture, *size)))
        sheets.append(compose_sheet(f"frame {number + 1} of {len(frames)}", [row]))
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "film.webp"
        try:
            write_webp(target, sheets, [_MILLISECONDS] * len(sheets))
        except ImageError:
            return b""
        return target.read_bytes()


def _view(frames: Sequence[VolumeFrame], up_axis: str) -> tuple["View", tuple[int, int]]:
    """One view that holds all of the smoke, a pixel a voxel; and the size that it is shown at."""
    corners, finest = [], np.inf
    for frame in frames:
        density = frame.density
        low = np.asarray(density.ijk_min)
        place = density.index_to_world @ frame.density_to_stage
        corners.append(box_corners(low, low + density.values.shape[:3] - 1, place))
        finest = min(finest, float(np.linalg.norm(place[:3, :3], axis=1).min()))
    points = box_around(np.concatenate(corners))
    direction = front_view(up_axis)
    tall, wide = fitted_size([direction], points)
    height, width = (max(1, round(side / finest)) for side in (tall, wide))
    (view,) = fit_views([direction], points, height, width)
    return view, (_TALL, max(1, round(_TALL * wide / tall)))


def _draw(fields: Fields, to_stage: np.ndarray, gamma_w: float, view: "View") -> np.ndarray:
    from usdsmoke.core.rays.march import march
    from usdsmoke.core.rays.media import make_media

    density, emission = fields
    place = None if emission is None else to_stage
    media = make_media(density, emission, to_stage, place, gamma_w, GREY)
    return display_picture(march(media, view).rgba)

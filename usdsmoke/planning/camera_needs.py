"""What a shot's camera leaves out, from headers alone: where smoke may be, not where it is."""

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from usdsmoke.base.config import Config
from usdsmoke.base.time_codes import format_time_codes
from usdsmoke.base.volume import CameraSource, FieldSource, FrameSource
from usdsmoke.core.views.frustum import frustum_of, pixel_footprint
from usdsmoke.vdb.header import GridHeader

if TYPE_CHECKING:
    from usdsmoke.planning.plan import FramePlan, VolumePlan

__all__ = ["camera_needed", "camera_omitted", "seen_share"]

_SAMPLES = 16  # points along each side of a box


def seen_share(frame: FrameSource, density: FieldSource, grid: GridHeader, config: Config) -> float:
    """The share of a density's box that the frame's camera sees, in [0, 1]; 1 without a camera.

    0 means that surely nothing is seen.

    Args:
        frame: one timeCode, perhaps with a camera.
        density: gives the grid's place on the stage.
        grid: the density's header; 1 too where it does not tell the box or the transform.
        config: ``views.camera_margin``.
    """
    camera, points = frame.camera, _box_points(density, grid)
    if camera is None or points is None:
        return 1.0
    frustum = frustum_of(camera, config.views.camera_margin)
    corners, inside = points
    if frustum.misses(corners):
        return 0.0
    return max(float((frustum.shares(inside) > 0).mean()), 1 / len(inside))


def camera_needed(config: Config, volumes: Sequence["VolumePlan"]) -> list[str]:
    """What is read of the camera, in a sentence; nothing without one."""
    if not config.views.camera:
        return []
    n_frames = sum(len(volume.frames) for volume in volumes)
    return [
        f"the camera <{config.views.camera}> at {n_frames} timeCode{'' if n_frames == 1 else 's'}: "
        "views lie around its direction"
    ]


def camera_omitted(config: Config, volumes: Sequence["VolumePlan"]) -> list[tuple[str, str]]:
    """What is left out, and why, because of the camera, or because none is named."""
    if not config.views.camera:
        reason = "none is named (views.camera): views lie around the up axis"
        return [("the shot's camera", reason)]
    omitted = []
    for volume in volumes:
        omitted += _omitted_of_volume(config, volume)
    return omitted


def _omitted_of_volume(config: Config, volume: "VolumePlan") -> list[tuple[str, str]]:
    omitted, where = [], f"of <{volume.source.prim_path}>"
    filled = [frame for frame in volume.frames if not frame.is_empty]
    outside = [frame.source.time_code for frame in filled if frame.size.seen == 0]
    if outside:
        omitted.append(
            (
                f"the effect at timeCodes {format_time_codes(outside)} {where}",
                "outside the camera's frustum",
            )
        )
    n_active = sum(frame.size.active_voxels for frame in filled)
    n_seen = sum(frame.size.active_voxels * frame.size.seen for frame in filled)
    if n_seen < n_active:
        omitted.append(
            (
                f"about {1 - n_seen / n_active:.0%} of the smoke {where}",
                "outside the camera's frustum (views.camera): the source stays as it is there",
            )
        )
    finest, pixel = _pixels(config, volume, filled)
    if finest > pixel:
        omitted.append(
            (
                f"detail finer than {finest:.3g} stage units {where}",
                "the camera does not resolve it at the smoke's distance (views.camera_width)",
            )
        )
    return omitted


def _pixels(
    config: Config, volume: "VolumePlan", frames: Sequence["FramePlan"]
) -> tuple[float, float]:
    """What a pixel covers, stage units: the camera's finest one, and one of the pictures without
    it.
    """
    finest, longest, voxels = np.inf, 0.0, []
    for frame in frames:
        density, camera = frame.source.fields[volume.source.density], frame.source.camera
        points = _box_points(density, frame.grid)
        if points is None or camera is None or frame.size.seen == 0:
            continue
        finest = min(finest, _nearest_pixel(camera, points[1], config))
        voxel, longest_side = _lengths(points[0], frame.size.box)
        voxels.append(voxel / config.grids.refine)
        longest = max(longest, longest_side)
    if not voxels:
        return 0.0, 0.0
    return finest, max(float(np.median(voxels)), longest / config.views.image_size)


def _nearest_pixel(camera: CameraSource, points: np.ndarray, config: Config) -> float:
    frustum = frustum_of(camera, config.views.camera_margin)
    seen = points[frustum.shares(points) > 0]
    depth = float(frustum.depths(seen).min()) if len(seen) else np.inf
    return pixel_footprint(camera, depth, config.views.camera_width)


def _lengths(corners: np.ndarray, box: tuple[int, int, int]) -> tuple[float, float]:
    """A voxel's size and the longest side of a box, stage units."""
    sides = np.linalg.norm(corners[[4, 2, 1]] - corners[0], axis=1)
    voxel = float(np.prod(sides / np.maximum(box, 1))) ** (1 / 3)
    return voxel, float(sides.max())


def _box_points(density: FieldSource, grid: GridHeader) -> tuple[np.ndarray, np.ndarray] | None:
    """The eight corners of the active box, and points spread in it, stage space; None if unknown.

    Voxels reach half a voxel to each side of their index.
    """
    if grid.bbox_min is None or grid.bbox_max is None or grid.index_to_world is None:
        return None
    low, high = np.array(grid.bbox_min) - 0.5, np.array(grid.bbox_max) + 0.5
    matrix = grid.index_to_world @ density.field_to_stage
    corners, inside = (
        (low + unit * (high - low)) @ matrix[:3, :3] + matrix[3, :3] for unit in _unit_points()
    )
    return corners, inside


@lru_cache(maxsize=1)
def _unit_points() -> tuple[np.ndarray, np.ndarray]:
    ends = np.array([0.0, 1.0])
    inner = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    corners, inside = (
        np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
        for axis in (ends, inner)
    )
    return corners, inside

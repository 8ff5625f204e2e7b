"""What pictures show of a box, and what a shot's camera sees of it, from VDB headers alone."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from usdsmoke.base.errors import PlanError
from usdsmoke.base.machine import available_memory_gib
from usdsmoke.base.time_codes import name_time_codes
from usdsmoke.base.volume import CameraSource, FieldSource, FrameSource
from usdsmoke.config.settings import Config
from usdsmoke.core.views.frustum import frustum_of, pixel_footprint
from usdsmoke.planning.estimate import FrameSize, estimate_run, training_seconds, visible_voxels
from usdsmoke.planning.plan import FramePlan, Omission, VolumePlan, decisive_frames
from usdsmoke.vdb.boxes import LEAST_VOXEL
from usdsmoke.vdb.header import GridHeader

MOST_REFINED = 4  # 64 times the voxels
# Visible voxels of the largest frame up to which smoke is refined automatically: with the default
# settings it takes up to one and a half times as long as a million voxels (decision 083)
_MOST_VOXELS = 1_500_000
_NO_LIMIT = 1_000_000  # parts of a voxel: more than any setting
_SAMPLES = 16  # points along each side of a box
# Pixels of a picture for one voxel from which strokes look smeared: with 192 pixels, plumes of 109
# and 111 voxels do (decision 076)
_COARSE = 4 / 3
_FEWEST = 16  # voxels: fewer have no shape that strokes could follow


def visible_share(
    frame: FrameSource, density: FieldSource, grid: GridHeader, config: Config
) -> float:
    """The share of a density's box that the frame's camera sees, in [0, 1]; 1 without a camera.

    0 means that certainly nothing is visible.

    Args:
        grid: the density's header; without a box or a transform the share is 1.
    """
    camera, points = frame.camera, _box_points(density, grid)
    if camera is None or points is None:
        return 1.0
    corners, inside = points
    frustum = frustum_of(camera, config.views.camera_margin, _longest_edge(density, grid))
    if frustum.misses(corners):
        return 0.0
    return max(float((frustum.shares(inside) > 0).mean()), 1 / len(inside))


def is_inside(frame: FrameSource, density: FieldSource, grid: GridHeader) -> bool:
    """Whether the eye of a frame's camera stands in a density's box; a parallel one has none."""
    points = _box_points(density, grid)
    if frame.camera is None or frame.camera.is_orthographic or points is None:
        return False
    corners = points[0]
    axes = corners[[4, 2, 1]] - corners[0]
    place = np.linalg.solve(axes.T, np.asarray(frame.camera.camera_to_stage)[3, :3] - corners[0])
    return bool(((place >= 0) & (place <= 1)).all())


def share_within(
    small: tuple[FieldSource, GridHeader], large: tuple[FieldSource, GridHeader]
) -> float:
    """The share of a density's box, stage space, that lies in another one's; 0 if not known."""
    points, other = _box_points(*small), _box_points(*large)
    if points is None or other is None:
        return 0.0
    corners, inside = other[0], points[1]
    axes = corners[[4, 2, 1]] - corners[0]
    if np.linalg.matrix_rank(axes) < 3:
        return 0.0
    places = np.linalg.solve(axes.T, (inside - corners[0]).T)
    return float(((places >= 0) & (places <= 1)).all(axis=0).mean())


def voxel_size(volume: VolumePlan, frame: FramePlan) -> float:
    """The size of a frame's voxels, stage units; 0 if it is not known."""
    points = _box_points(frame.source.fields[volume.source.density], frame.grid)
    return 0.0 if points is None else _lengths(points[0], frame.size.box)[0]


def detail_remarks(volume: VolumePlan) -> list[str]:
    """That a camera is too far away for strokes, or that finer voxels make them sharper."""
    config = volume.config
    if config.views.camera:
        across = _pixels_across(config, volume, volume.filled)
        if across < _FEWEST:
            return [
                f"the smoke of <{volume.source.prim_path}> is at most {across:.2g} pixels wide in "
                "the camera's picture: strokes do not show. Set a larger views.camera_width, move "
                "the camera, or unset views.camera"
            ]
    if not volume.chose_refine:
        return _joined_again(volume)
    if (parts := config.grids.parts) > 1:
        once = replace(volume, config=config.with_values({"grids.refine": 1}))
        times, _ = price_of_detail(once, parts)
        most = most_visible(volume.sizes, config)
        return [
            f"<{volume.source.prim_path}> is refined by {parts}: sharper strokes, in {times:.2g} "
            f"times the time of grids.refine=1. Its largest frame gets about {most:,} voxels"
        ]
    longest = max(map(max, computed_boxes(volume.sizes)), default=0)
    for parts in _sharper(volume.sizes, _picture_side(volume)):
        times, memory = price_of_detail(volume, parts)
        if memory <= (config.optimize.memory_limit_gib or available_memory_gib()):
            return [
                f"grids.refine={parts} sharpens strokes of <{volume.source.prim_path}>, in about "
                f"{times:.2g} times its time. It has {longest} voxels along its longest side, and "
                f"needs {memory:.1f} GiB of memory then"
            ]
    return []


def _joined_again(volume: VolumePlan) -> list[str]:
    """That refined voxels are no finer in pictures, which join those of a pixel."""
    parts, pixels = volume.config.grids.parts, _picture_side(volume)
    longest = max(map(max, computed_boxes(volume.sizes)), default=0)
    joined, joined_before = round(longest * parts / pixels), max(round(longest / pixels), 1)
    if parts == 1 or joined < parts * joined_before:
        return []
    finer = f"Set views.image_size={longest * parts}, or leave grids.refine at 1"
    is_far = pixels < volume.config.views.image_size  # the camera's picture has no more
    return [
        f"grids.refine={parts} hardly sharpens strokes of <{volume.source.prim_path}>: its longest "
        f"side has {longest * parts} voxels then, and pictures have {pixels:.0f} pixels there. "
        f"{'Leave it at 1' if is_far else finer}"
    ]


def with_refine(volume: VolumePlan) -> VolumePlan:
    """The Volume with an unset ``grids.refine`` chosen: the most that sharpens strokes and is
    affordable in all frames.

    It depends on headers and on settings that decide the result, so that machines agree. Where
    ``optics.frames`` names frames with smoke, these tell what sharpens strokes.

    Raises:
        PlanError: a value that is set makes voxels that OpenVDB cannot store.
    """
    most = _most_writable(volume)
    if (given := volume.config.grids.refine) is not None:
        if given > most:
            raise PlanError(
                f"grids.refine={given} makes the voxels of <{volume.source.prim_path}> smaller "
                f"than OpenVDB can store. Set it to {most} at most."
            )
        return volume
    measured = replace(volume, frames=tuple(decisive_frames(volume)))
    side = _picture_side(measured)
    parts = min(affordable_parts(volume.config, volume.sizes, measured.sizes, side), most)
    config = volume.config.with_values({"grids.refine": parts})
    return replace(volume, config=config, chose_refine=True)


def _most_writable(volume: VolumePlan) -> int:
    """How often voxels may be divided along each axis, to be as large as OpenVDB takes them."""
    most = _NO_LIMIT
    for frame in volume.filled:
        if (matrix := frame.grid.index_to_world) is not None:
            size, n_axes = abs(float(np.linalg.det(matrix[:3, :3]))), 3 - frame.size.box.count(1)
            most = min(most, int((size / LEAST_VOXEL) ** (1 / max(n_axes, 1))))
    return max(most, 1)


def affordable_parts(
    config: Config, sizes: Sequence[FrameSize], measured: Sequence[FrameSize], pixels: float
) -> int:
    """What an unset ``grids.refine`` becomes.

    Args:
        sizes: of all frames.
        measured: of those that tell what sharpens strokes.
        pixels: along the longest side of their smoke, at most.
    """
    for parts in _sharper(measured, pixels):
        finer = config.with_values({"grids.refine": parts})
        if most_visible(sizes, finer) <= _MOST_VOXELS:
            return parts
    return 1


def most_visible(sizes: Sequence[FrameSize], config: Config) -> int:
    """The visible voxels of the largest frame, refined."""
    return max(visible_voxels(size, config) for size in sizes)


def most_deciding(volume: VolumePlan, config: Config) -> int:
    """The same of the frames that decide what is the same in all, see ``decisive_frames``."""
    return most_visible([frame.size for frame in decisive_frames(volume)], config)


def _picture_side(volume: VolumePlan) -> float:
    """Pixels of the longest side of the smoke in a picture, at most."""
    pixels = float(volume.config.views.image_size)
    if not volume.config.views.camera:
        return pixels
    return min(pixels, _pixels_across(volume.config, volume, volume.filled))


def _sharper(sizes: Sequence[FrameSize], pixels: float) -> Iterator[int]:
    """The values of ``grids.refine`` that give finer pictures, the greatest first."""
    boxes = computed_boxes(sizes)
    longest = max(map(max, boxes), default=0)
    if not _FEWEST <= longest < pixels / _COARSE:
        return
    widest = max(math.hypot(*sorted(box)[-2:]) for box in boxes)  # of a picture of turned smoke
    for parts in range(min(math.ceil(pixels / _COARSE / longest), MOST_REFINED), 1, -1):
        if round(widest * parts / pixels) <= 1:  # else they are joined, to the size of a pixel
            yield parts


def computed_boxes(sizes: Sequence[FrameSize]) -> list[tuple[int, int, int]]:
    """The boxes of the frames that are optimised, in voxels of their files."""
    return [size.box for size in sizes if size.computed and size.visible]


def price_of_detail(volume: VolumePlan, parts: int) -> tuple[float, float]:
    """How many times the time a Volume takes with ``grids.refine``, and its memory in GiB."""
    finer = volume.config.with_values({"grids.refine": parts})
    (before, _), (after, memory) = (_cost(volume, config) for config in (volume.config, finer))
    return after / before, memory


def _cost(volume: VolumePlan, config: Config) -> tuple[float, float]:
    """Seconds and GiB of memory that a Volume takes with other settings."""
    most = most_deciding(volume, config)
    sizes = [replace(size, most_voxels=most) for size in volume.sizes]
    estimate = estimate_run(sizes, config, len(volume.styles))
    training = training_seconds(sizes, config, len(volume.styles))
    return estimate.seconds + training, estimate.memory_gib


def _pixels_across(config: Config, volume: VolumePlan, frames: Sequence[FramePlan]) -> float:
    """Pixels of the camera's picture along the smoke's longest side, at most; inf if not known."""
    finest, _ = pixel_sizes(config, volume, frames)
    if finest == 0:
        return np.inf
    points = (_box_points(f.source.fields[volume.source.density], f.grid) for f in frames)
    sides = [_lengths(found[0], (1, 1, 1))[1] for found in points if found is not None]
    return max(sides, default=np.inf) / finest


def pixel_sizes(
    config: Config, volume: VolumePlan, frames: Sequence[FramePlan]
) -> tuple[float, float]:
    """The width of a pixel, stage units: the camera's finest one, and one without a camera."""
    finest, longest, voxels = np.inf, 0.0, []
    for frame in frames:
        density, camera = frame.source.fields[volume.source.density], frame.source.camera
        points = _box_points(density, frame.grid)
        if points is None or camera is None or frame.size.visible == 0:
            continue
        finest = min(finest, _nearest_pixel(camera, points[1], config))
        voxel, longest_side = _lengths(points[0], frame.size.box)
        voxels.append(voxel / config.grids.parts)
        longest = max(longest, longest_side)
    if not voxels or not np.isfinite(finest):  # no point is seen: nothing is told of detail
        return 0.0, 0.0
    return finest, max(float(np.median(voxels)), longest / config.views.image_size)


def _nearest_pixel(camera: CameraSource, points: np.ndarray, config: Config) -> float:
    frustum = frustum_of(camera, config.views.camera_margin)
    seen = points[frustum.shares(points) > 0]
    depth = max(float(frustum.depths(seen).min()), 0.0) if len(seen) else np.inf
    return pixel_footprint(camera, depth, config.views.camera_width)


def _longest_edge(density: FieldSource, grid: GridHeader) -> float:
    """Of a voxel, stage units."""
    matrix = np.asarray(grid.index_to_world, float) @ np.asarray(density.field_to_stage, float)
    return float(np.linalg.norm(matrix[:3, :3], axis=1).max())


def _lengths(corners: np.ndarray, box: tuple[int, int, int]) -> tuple[float, float]:
    """A voxel's size and the longest side of a box, stage units."""
    sides = np.linalg.norm(corners[[4, 2, 1]] - corners[0], axis=1)
    voxel = float(np.prod(sides / np.maximum(box, 1))) ** (1 / 3)
    return voxel, float(sides.max())


def rounding(density: FieldSource, grid: GridHeader) -> float:
    """What a coordinate in stage space is rounded to, as a share of a voxel's shortest edge."""
    points = _box_points(density, grid)
    if points is None:
        return 0.0
    edges = np.linalg.norm((grid.index_to_world @ density.field_to_stage)[:3, :3], axis=1)
    return float(np.spacing(np.abs(points[0]).max()) / edges.min())


def camera_tips(volumes: Sequence[VolumePlan], cameras: Sequence[str]) -> tuple[str, ...]:
    """That a camera of the stage would give clearer marks, where views are from all sides.

    Args:
        cameras: prim paths of the stage's.
    """
    if not any(map(_may_use_camera, volumes)) or not cameras:
        return ()
    one = cameras[0] if len(cameras) == 1 else f"PATH (the stage has {len(cameras)} cameras)"
    return (
        f"--camera {one} gives clearer strokes in its picture. Other sides get softer ones, and "
        "smoke outside its frustum is not stylized",
    )


def _may_use_camera(volume: VolumePlan) -> bool:
    """Whether there is smoke that is stylized from several sides, as nobody has chosen them."""
    views = volume.config.views
    is_chosen = views.camera or views.azimuth is not None or views.elevation is not None
    is_chosen = is_chosen or views.centre_azimuth != 0 or views.centre_elevation != 0
    sizes = [size for size in volume.sizes if size.computed and size.active_voxels]
    return not is_chosen and not all(size.is_thin for size in sizes)


def invisible_parts(config: Config, volume: VolumePlan) -> list[Omission]:
    """What the camera does not see or resolve."""
    omitted, where = [], f"of <{volume.source.prim_path}>"
    filled = volume.filled
    outside = [frame for frame in filled if frame.size.visible == 0]
    if outside:
        codes = name_time_codes(frame.source.time_code for frame in outside)
        omitted.append(Omission(f"the effect at {codes} {where}", "outside the camera's frustum"))
    n_active = sum(frame.size.active_voxels for frame in filled)
    n_visible = sum(frame.size.active_voxels * frame.size.visible for frame in filled)
    if n_visible < n_active:
        omitted.append(
            Omission(
                f"about {1 - n_visible / n_active:.0%} of the smoke {where}",
                "it is outside the camera's frustum (views.camera) and is not stylized",
            )
        )
    finest, pixel = pixel_sizes(config, volume, filled)
    if finest > pixel:
        omitted.append(
            Omission(
                f"detail finer than {finest:.3g} stage units {where}",
                "the camera does not resolve it at the smoke's distance (views.camera_width)",
            )
        )
    return omitted


def unseen_warnings(volumes: Sequence[VolumePlan]) -> tuple[str, ...]:
    """A sentence for each Volume that has smoke, of which the camera certainly sees none."""
    return tuple(
        f"<{volume.source.prim_path}> is outside the picture of the camera "
        f"<{volume.config.views.camera}> at all timeCodes: nothing of it is stylized. Check where "
        "the camera looks, its clippingRange and the timeCodes, or leave views.camera out."
        for volume in volumes
        if (frames := volume.filled) and not any(frame.size.visible for frame in frames)
    )


def check_visibility(volumes: Sequence[VolumePlan]) -> None:
    """Refuse a shot whose camera sees none of its smoke.

    Raises:
        PlanError: with the camera and each Volume.
    """
    texts = unseen_warnings(volumes)
    if texts and not any(frame.size.visible for volume in volumes for frame in volume.filled):
        raise PlanError(" ".join(texts))


def _box_points(density: FieldSource, grid: GridHeader) -> tuple[np.ndarray, np.ndarray] | None:
    """The eight corners of the active box, and points spread in it, stage space; None if unknown.

    Voxels extend half a voxel to each side of their index.
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

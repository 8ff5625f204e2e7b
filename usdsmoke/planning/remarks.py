"""What a plan remarks on: nothing that is wrong, but what may surprise at the end of a run."""

import itertools
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

import numpy as np

from usdsmoke.base.errors import count_text
from usdsmoke.base.time_codes import (
    find_holes,
    format_time_code,
    name_time_codes,
    parse_frames,
    select_frames,
)
from usdsmoke.config.look_sections import ColourConfig, ViewsConfig
from usdsmoke.config.run_sections import WindowsConfig
from usdsmoke.pictures import find_style_size, refine_for_less
from usdsmoke.planning.materials import lights_remark
from usdsmoke.planning.plan import VolumePlan
from usdsmoke.planning.visibility import (
    MOST_REFINED,
    computed_boxes,
    detail_remarks,
    is_inside,
    price_of_detail,
    rounding,
    share_within,
    voxel_size,
)
from usdsmoke.planning.windows import followed_codes

# Times the default learning rate. On the example plume of 32 voxels 16 times it ends 6 % worse, 100
# times 21 % and 1000 times 134 %; the shape step's rate makes no difference (< 1 %).
EXTREME_RATE = 10.0

_HEAVY = 1000.0  # of a loss beside the style's: with as much hardly any strokes are left
_FEW_PIXELS = 32  # of a picture
_UNLIKE = 4.0  # times the usual voxel: a shot may change its resolution by a factor of 2
_FEWEST_VOXELS = 16  # along the longest side: fewer hold no marks of any size
_FEWEST_PIXELS = 16  # of a repetition of the style: fewer hold no strokes
_WITHIN = 0.5  # of a box: less is neighbours that touch
_ROUNDED = 1e-3  # of a voxel: 1e-3 changes the extinction of a puff by 3 %, 1 by 18 %
_SIZES = (1e-15, 1e15)  # of voxels, stage units: squares of smaller or larger ones leave 32 bits
_SHEARED = 0.01  # cosine between a camera's axes, and difference of their lengths


def list_remarks(volumes: Sequence[VolumePlan]) -> tuple[str, ...]:
    """Sentences about all Volumes, each once."""
    found: list[str] = []
    for volume in volumes:
        found += [
            *_holes(volume),
            *_part(volume),
            *_measured_elsewhere(volume),
            *_thickened_twice(volume),
            *_rate(volume),
            *_heavy_losses(volume),
            *detail_remarks(volume),
            *_few_pixels(volume),
            *_unlike_voxels(volume),
            *_same_names(volume),
            *_far_away(volume),
            *_extreme_voxels(volume),
            *_sheared_camera(volume),
            *_tiny_style(volume),
            *_unmoved(volume),
            *_overlap(volume),
            *_inside(volume),
        ]
        found += lights_remark(volume.config, volume)
    found += [text for a, b in itertools.combinations(volumes, 2) for text in _shared_place(a, b)]
    return tuple(dict.fromkeys(found))


def measured_remarks(volumes: Sequence[VolumePlan]) -> list[str]:
    """What is said where scenes are measured on some of the timeCodes."""
    return [text for volume in volumes for text in _part(volume)]


def fine_marks_remarks(volume: VolumePlan, styles: Sequence[np.ndarray]) -> list[str]:
    """That a style will be enlarged, because its marks are too fine for the box of the smoke.

    Args:
        styles: display-encoded images [H W 3] in [0, 1], the Volume's.
    """
    longest = _longest(volume)
    if longest < _FEWEST_VOXELS:
        return []
    config = volume.with_all_weights
    size = find_style_size(styles, longest, config)
    if size == 1:
        return []
    refine, advice = refine_for_less(styles, longest, config, size, MOST_REFINED), ""
    if refine:
        times, _ = price_of_detail(volume, refine)
        advice = f". grids.refine={refine} keeps them smaller, in about {times:.2g} times the time"
    return [
        f"the style on <{volume.source.prim_path}> becomes about {size:.2g} times as large "
        f"(style.size): its marks are finer than {longest} voxels can hold{advice}"
    ]


def style_remarks(volume: VolumePlan, scene: Mapping[str, Any]) -> list[str]:
    """That a style is enlarged, because its marks are too fine for a measured scene."""
    size, refine = scene.get("style_size", 1.0), scene.get("style_refine", 0)
    has_smoke = any(not frame.is_empty for frame in volume.frames)
    if size == 1 or not (volume.config.style.is_size_open and has_smoke):
        return []
    advice = f". For smaller marks set grids.refine={refine}: it divides voxels into {refine**3}"
    return [
        f"<{volume.source.prim_path}>: marks of the style are finer than voxels or pictures can "
        f"hold, so it is {size:.3g} times as large (style.size){advice if refine else ''}"
    ]


def measured_on_part(volume: VolumePlan) -> bool:
    """Whether extinction or a size is measured on some of a Volume's timeCodes."""
    optics = volume.config.optics
    is_bent = optics.thicken is None or (optics.thicken > 1 and optics.knee is None)
    is_open = optics.gamma is None or optics.gamma_shape is None or is_bent
    is_open = is_open or volume.config.style.is_size_open or volume.chose_refine
    is_open = is_open or volume.config.chooses_exposure
    return is_open and len(volume.frames) < len(volume.source.time_codes)


def _thickened_twice(volume: VolumePlan) -> list[str]:
    """Smoke of a look is thickened already."""
    config = volume.config
    if not config.stage.restylize or config.optics.thicken == 1:
        return []
    return [
        f"<{volume.source.prim_path}> is stylized already (stage.restylize), and what of its smoke "
        "is still thin is made more opaque once more. Set optics.thicken=1 to leave its density"
    ]


def _overlap(volume: VolumePlan) -> list[str]:
    """A larger overlap than a window can have; the default is one where windows are small."""
    windows = volume.config.windows
    is_cut = windows.overlap > windows.size and any(window.overlap for window in volume.windows)
    if not is_cut or windows.overlap == WindowsConfig().overlap:
        return []
    return [
        f"windows.overlap={windows.overlap} acts like windows.overlap={windows.size}, because a "
        f"window has {windows.size} frames. Set a larger windows.size for a longer overlap"
    ]


def _unmoved(volume: VolumePlan) -> list[str]:
    """Frames without a velocity among frames that have one."""
    if volume.config.stage.motion != "velocity":
        return []
    followed = followed_codes(volume.windows, volume.coarse_runs)
    frames = [frame for frame in volume.frames if frame.source.time_code in followed]
    filled = [frame for frame in frames if not frame.is_empty]
    still = [frame for frame in filled if frame.velocity is None]
    if not still or len(still) == len(filled):
        return []
    codes = name_time_codes(frame.source.time_code for frame in still)
    return [
        f"<{volume.source.prim_path}> has no velocity at {codes}: from there to the next frame the "
        "pattern stays in place and does not follow the smoke. Write the velocity there too"
    ]


def _holes(volume: VolumePlan) -> list[str]:
    """Missing frames of a whole sequence; a selection's are told where it is read, cuts as such."""
    if volume.config.stage.frames:
        return []
    cuts = volume.cuts if volume.config.windows.size > 1 else ()
    holes = [hole for hole in find_holes(volume.source.time_codes) if hole not in cuts]
    places = ", ".join(" and ".join(map(format_time_code, hole)) for hole in holes)
    if not places:
        return []
    return [
        f"<{volume.source.prim_path}> has no density between timeCodes {places}, which is longer "
        "than its other steps: the frame before is shown there. Add the files if they are missing"
    ]


def _part(volume: VolumePlan) -> list[str]:
    if not measured_on_part(volume):
        return []
    n_all = count_text(len(volume.source.time_codes), "timeCode")
    return [
        f"extinction and sizes of <{volume.source.prim_path}> are measured on "
        f"{len(volume.frames)} of {n_all}. Another selection looks slightly different. To keep one "
        "look, make this result longer with the same command and more --frames, or set "
        "optics.gamma, optics.gamma_shape, optics.thicken, optics.knee, style.size and "
        "grids.refine"
    ]


def _measured_elsewhere(volume: VolumePlan) -> list[str]:
    """TimeCodes of ``optics.frames`` that are not stylized, and so not measured."""
    if not volume.config.optics.frames:
        return []
    ranges, here = parse_frames(volume.config.optics.frames), volume.frames
    named, _ = select_frames(ranges, volume.source.time_codes)
    absent = sorted(set(named) - {frame.source.time_code for frame in here})
    if not absent:
        empty = [frame for frame in here if frame.source.time_code in named]
        if any(not frame.is_empty for frame in empty):
            return []
        return [
            f"optics.frames names empty frames of <{volume.source.prim_path}>: extinction and "
            "picture size are measured on the others. Name frames with smoke"
        ]
    return [
        f"optics.frames names {name_time_codes(absent)} of <{volume.source.prim_path}>, which "
        "this run does not stylize: extinction and picture size are measured on selected frames "
        "only"
    ]


def _rate(volume: VolumePlan) -> list[str]:
    """A rate that no rule of the optimiser corrects: clipped colours never blow up."""
    config, usual = volume.config, ColourConfig().learning_rate
    rate = config.colour.learning_rate
    if "colour" not in config.optimize.steps or rate <= EXTREME_RATE * usual:
        return []
    return [
        f"colour.learning_rate={rate:g} is {rate / usual:.3g} times the default: one step crosses "
        f"the whole range of colours. Set {usual:g}, or look closely at the result"
    ]


def _inside(volume: VolumePlan) -> list[str]:
    """Frames whose camera may have smoke right before it."""
    inside = [
        frame.source
        for frame in volume.frames
        if is_inside(frame.source, frame.source.fields[volume.source.density], frame.grid)
    ]
    if not inside:
        return []
    codes = name_time_codes(frame.time_code for frame in inside)
    return [
        f"the camera stands in the box of <{volume.source.prim_path}> at {codes}: smoke right "
        "before it hides the picture and is too close for strokes. Move the camera, or cut this "
        "smoke off with its near clipping plane (clippingRange)"
    ]


def _shared_place(one: VolumePlan, other: VolumePlan) -> list[str]:
    """Frames in which one Volume is in another: neither's pictures show the other one."""
    codes = []
    theirs = {frame.source.time_code: frame for frame in other.frames}
    for frame in one.frames:
        beside = theirs.get(frame.source.time_code)
        if beside is None or frame.is_empty or beside.is_empty:
            continue
        a = (frame.source.fields[one.source.density], frame.grid)
        b = (beside.source.fields[other.source.density], beside.grid)
        if max(share_within(a, b), share_within(b, a)) > _WITHIN:
            codes.append(frame.source.time_code)
    if not codes:
        return []
    return [
        f"<{one.source.prim_path}> and <{other.source.prim_path}> are in the same place at "
        f"{name_time_codes(codes)}: each is painted as if the other were not there, and may hide "
        "it. Merge their densities into one Volume to paint what is seen of both"
    ]


def _longest(volume: VolumePlan) -> int:
    """Voxels along the longest side of all frames."""
    return max(map(max, computed_boxes(volume.sizes)), default=0)


def _few_pixels(volume: VolumePlan) -> list[str]:
    """Pictures that a setting leaves hardly any pixels."""
    pixels, usual = volume.config.views.image_size, ViewsConfig().image_size
    if volume.config.views.camera or pixels >= min(_FEW_PIXELS, _longest(volume)):
        return []
    return [
        f"views.image_size={pixels} leaves pictures of <{volume.source.prim_path}> only {pixels} "
        f"pixels: hardly any strokes fit. The default is {usual}"
    ]


def _unlike_voxels(volume: VolumePlan) -> list[str]:
    """Frames whose voxels have quite another size, as after a wrong unit or scale."""
    sizes = {f.source.time_code: voxel_size(volume, f) for f in volume.filled}
    known = {code: size for code, size in sizes.items() if size > 0}
    if not known:
        return []
    usual = median(known.values())
    unlike = [code for code, size in known.items() if not 1 / _UNLIKE < size / usual < _UNLIKE]
    if not unlike:
        return []
    return [
        f"voxels of <{volume.source.prim_path}> at {name_time_codes(unlike)} are "
        f"{known[unlike[0]] / usual:.3g} times as large as usual in this shot. Extinction, pixels "
        "and motion suit the others. Check the unit of these files and the scale of the Volume "
        "there"
    ]


def _same_names(volume: VolumePlan) -> list[str]:
    """Files with several grids of the density's name, among which the stage does not choose."""
    codes = [
        frame.source.time_code
        for frame in volume.frames
        if frame.grid.name
        and frame.grid.stored_name != frame.grid.name
        and frame.source.fields[volume.source.density].grid_index is None
    ]
    if not codes:
        return []
    return [
        f"files of <{volume.source.prim_path}> have several grids named "
        f'"{volume.frames[0].grid.name}" at {name_time_codes(codes)}, and the first is read. '
        "Author the field's fieldIndex to choose, or put the others into Volumes of their own"
    ]


def _far_away(volume: VolumePlan) -> list[str]:
    """Smoke so far from the origin that its voxels' places are rounded."""
    lost = {
        frame.source.time_code: rounding(frame.source.fields[volume.source.density], frame.grid)
        for frame in volume.filled
    }
    codes = [code for code, share in lost.items() if share > _ROUNDED]
    if not codes:
        return []
    return [
        f"<{volume.source.prim_path}> is so far from the origin at {name_time_codes(codes)} that "
        f"places are rounded to {max(lost.values()):.2g} of a voxel, and pictures with them. Move "
        "it nearer to the origin"
    ]


def _extreme_voxels(volume: VolumePlan) -> list[str]:
    """Voxels whose sizes lead beyond the range of 32-bit floats."""
    sizes = {f.source.time_code: voxel_size(volume, f) for f in volume.filled}
    codes = [code for code, size in sizes.items() if size and not _SIZES[0] < size < _SIZES[1]]
    if not codes:
        return []
    return [
        f"voxels of <{volume.source.prim_path}> at {name_time_codes(codes)} are "
        f"{sizes[codes[0]]:.3g} stage units large: 32-bit floats may not hold what is computed "
        "with them. Scale the Volume, or check the unit of its files"
    ]


def _sheared_camera(volume: VolumePlan) -> list[str]:
    """Cameras whose axes are not at right angles or not of one length."""
    codes = []
    for frame in volume.frames:
        if frame.source.camera is None:
            continue
        axes = frame.source.camera.camera_to_stage[:3, :3]
        squares = axes @ axes.T / np.square(axes).sum(axis=1).max()
        if np.abs(squares / squares.max() - np.eye(3)).max() > _SHEARED:
            codes.append(frame.source.time_code)
    if not codes:
        return []
    return [
        f"the camera <{volume.config.views.camera}> is sheared or scaled unevenly at "
        f"{name_time_codes(codes)}: views are taken by a camera that is not, as USD's frustum "
        "does. Remove scales and shears from the camera and its parents"
    ]


def _tiny_style(volume: VolumePlan) -> list[str]:
    """A style that settings reduce to a few pixels."""
    style, refine = volume.config.style, volume.config.grids.parts
    pixels = min(volume.config.views.image_size, _longest(volume) * refine)
    left = pixels * (style.size or 1.0) / style.tiling
    if left >= min(_FEWEST_PIXELS, pixels):
        return []
    names = [name for name in ("size", "tiling") if getattr(style, name) not in (None, 1)]
    asked = " and ".join(f"style.{name}={getattr(style, name):g}" for name in names)
    return [
        f"{asked} reduces the style to {max(1, round(left))} of the {pixels} pixels of a picture "
        f"of <{volume.source.prim_path}>: its strokes are lost. Set a larger style.size, a smaller "
        "style.tiling, or a larger grids.refine"
    ]


def _heavy_losses(volume: VolumePlan) -> list[str]:
    """Weights beside which the style's does not count."""
    losses = volume.config.losses
    names = [*losses.BESIDE_STYLE, *["keep"] * ("shape" in volume.config.optimize.steps)]
    return [
        f"losses.{name}={getattr(losses, name):g} outweighs the style: its strokes are lost. "
        "Compare the result with the style"
        for name in names
        if getattr(losses, name) > _HEAVY * losses.style > 0
    ]

"""A preview's pictures on disk: a PNG, a contact sheet, an animation or OpenEXR layers."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TypeAlias

import numpy as np

from usdsmoke.base.naming import frame_file_names
from usdsmoke.base.time_codes import format_time_code
from usdsmoke.base.volume import StageSource
from usdsmoke.core.rays.march import Picture
from usdsmoke.core.views.cameras import View
from usdsmoke.pictures.animations import WRITERS
from usdsmoke.pictures.contact_sheet import compose_sheet
from usdsmoke.pictures.drawing import BACKGROUND, display_picture
from usdsmoke.pictures.png import encode_srgb, write_png
from usdsmoke.pictures.preview_request import PreviewRequest

LOOK, ORIGINAL = "look", "original"
_MOST_COLUMNS = 6  # of a contact sheet
_TURN_S = 4.0  # seconds of a turntable: at the rate of a film it is too fast to judge a look


@dataclass(frozen=True)
class PreviewShot:
    """One picture of a preview."""

    time_code: float
    angle: float  # degrees around the up axis from the front
    view: View
    clip: tuple[float, float] = (-np.inf, np.inf)  # nearest and farthest depth, stage units


# The label, what is seen, the picture.
Drawn: TypeAlias = Iterator[tuple[str, PreviewShot, Picture]]


def write_layers(request: PreviewRequest, codes: Sequence[float], drawn: Drawn) -> tuple[Path, ...]:
    """One OpenEXR file for each picture; their paths."""
    from usdsmoke.pictures.exr import write_exr

    files = []
    for label, shot, picture in drawn:
        stem = request.output.stem + (f".{label}" if label != LOOK else "")
        name = f"{stem}{request.output.suffix}"
        if len(codes) > 1:
            names = frame_file_names(stem, codes, request.output.suffix)
            name = dict(zip(codes, names, strict=True))[shot.time_code]
        parts = {
            "rgba": ("RGBA", picture.rgba),
            "emission": ("RGB", picture.emission),
            "alpha": ("A", picture.alpha),
            "density": ("Y", picture.depth),
        }
        facts = {
            "usdsmoke:stage": request.stage_name if label in (LOOK, ORIGINAL) else label,
            "usdsmoke:camera": request.camera or "front view",
            "usdsmoke:timeCode": format_time_code(shot.time_code),
        }
        files.append(request.output.with_name(name))
        write_exr(files[-1], parts, facts)
    return tuple(files)


def write_picture(request: PreviewRequest, drawn: Drawn, n_pictures: int) -> tuple[Path, ...]:
    """One PNG: a picture, or a contact sheet of several; its path."""
    if request.background == "none":
        ((_, _, picture),) = drawn
        write_png(request.output, _unpremultiplied(picture.rgba))
        return (request.output,)
    by_label = _displayed(request, drawn)
    if n_pictures == 1:
        write_png(request.output, by_label[LOOK][0][1])
        return (request.output,)
    captioned = {
        label: [(_caption(request, label, shot), picture) for shot, picture in shown]
        for label, shown in by_label.items()
    }
    lines = list(captioned.values())  # of one stage each
    if request.beside and len(lines[0]) < len(lines):
        lines = [list(line) for line in zip(*lines, strict=True)]  # of one frame or direction each
    starts = range(0, len(lines[0]), _MOST_COLUMNS)
    rows = [line[start : start + _MOST_COLUMNS] for start in starts for line in lines]
    what = f"{len(request.names)} stages" if request.beside else request.stage_name
    title = f"{what}, {request.camera or 'front view'}"
    if request.turntable:
        code = format_time_code(by_label[LOOK][0][0].time_code)
        title = f"{what}, timeCode {code}, around the up axis"
    write_png(request.output, compose_sheet(title, rows))
    return (request.output,)


def write_animation(
    request: PreviewRequest, milliseconds: Sequence[int], drawn: Drawn
) -> tuple[Path, ...]:
    """One animation: the original left of the look, other stages right of it; its path.

    Args:
        request: its background is not transparent.
        milliseconds: how long each picture stays, from ``durations``.
        drawn: every picture of the original before those of the look.
    """
    columns = [[picture for _, picture in shown] for shown in _displayed(request, drawn).values()]
    pictures = [np.concatenate(row, axis=1) for row in zip(*columns, strict=True)]
    WRITERS[request.output.suffix.lower()](request.output, pictures, milliseconds)
    return (request.output,)


def durations(request: PreviewRequest, codes: Sequence[float], source: StageSource) -> list[int]:
    """How long each picture of an animation stays, milliseconds.

    A frame stays until the next one's timeCode. A turntable takes ``_TURN_S``, whatever the stage's
    rate and the number of its pictures.
    """
    per_second = source.time_codes_per_second if source.time_codes_per_second > 0 else 24.0
    if request.turntable:
        gaps = [_TURN_S * per_second / request.turntable] * request.turntable
    else:
        gaps = [after - before for before, after in pairwise(codes)]
        gaps.append(gaps[-1] if gaps else source.frame_length)
    ends = [round(1000 * end / per_second) for end in np.cumsum([0.0, *gaps])]
    return [max(1, after - before) for before, after in pairwise(ends)]  # no drift by rounding


def _displayed(
    request: PreviewRequest, drawn: Drawn
) -> dict[str, list[tuple[PreviewShot, np.ndarray]]]:
    """Pictures for a screen by label, in the order of drawing."""
    behind = BACKGROUND if request.background == "grey" else 0.0
    found: dict[str, list[tuple[PreviewShot, np.ndarray]]] = {}
    for label, shot, picture in drawn:
        found.setdefault(label, []).append((shot, display_picture(picture.rgba, behind)))
    return found


def _caption(request: PreviewRequest, label: str, shot: PreviewShot) -> str:
    """What a picture shows; where there are other stages, the first one has its name too."""
    seen = f"timeCode {format_time_code(shot.time_code)}"
    if request.turntable:
        seen = f"{shot.angle:g} degrees"
    if request.beside and label == LOOK:
        label = request.names[0]
    return f"{label}, {seen}" if request.beside or request.compare else seen


def _unpremultiplied(rgba: np.ndarray) -> np.ndarray:
    """[H W 4] as PNG stores it: display-encoded colour, not premultiplied."""
    alpha = rgba[..., 3:]
    linear = np.divide(rgba[..., :3], alpha, out=np.zeros_like(rgba[..., :3]), where=alpha > 0)
    return np.concatenate([encode_srgb(np.clip(linear, 0.0, 1.0)), alpha], axis=-1)

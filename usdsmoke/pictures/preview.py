"""Pictures of a stage's smoke, as PNG or OpenEXR; the stage does not change.

docs/look.md explains what is drawn and what is not.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from usdsmoke.base.errors import ConfigError
from usdsmoke.base.naming import frame_file_names
from usdsmoke.base.time_codes import format_time_code, spread
from usdsmoke.base.volume import CameraSource
from usdsmoke.pictures.contact_sheet import compose_sheet
from usdsmoke.pictures.drawing import (
    BACKGROUND,
    display_picture,
    fit_views,
    fitted_size,
    front_view,
)
from usdsmoke.pictures.exr import write_exr
from usdsmoke.pictures.png import encode_srgb, write_png
from usdsmoke.pictures.preview_request import (
    PreviewOptions,
    PreviewRequest,
    check_pixels,
)
from usdsmoke.pictures.preview_smoke import Smoke, find_smoke
from usdsmoke.usd.stage import StageOrFile, open_original, open_stage, read_camera

if TYPE_CHECKING:
    from pxr import Usd
    from typing_extensions import Unpack

    from usdsmoke.core.views.cameras import View
    from usdsmoke.core.views.march import Picture

_LOOK, _ORIGINAL = "look", "original"
_MOST_COLUMNS = 6  # of a contact sheet

# How a timeCode is seen: the view, and nearest and farthest depth.
_Views = dict[float, tuple["View", tuple[float, float]]]


@dataclass(frozen=True)
class PreviewResult:
    """What was drawn."""

    files: tuple[Path, ...]  # one PNG, or one OpenEXR file a frame
    time_codes: tuple[float, ...]
    width: int  # of one picture
    height: int
    camera: str  # prim path; "" is the front view
    extinctions: dict[str, float]  # by Volume of the look, per density, 1/stage unit
    notes: tuple[str, ...]


def preview(
    stage: StageOrFile,
    output: str | PathLike[str],
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: "Unpack[PreviewOptions]",
) -> PreviewResult:
    """Draw a stage's Volumes, all of them in one picture, and write the picture.

    Args:
        stage: a USD file, or an open stage, which is drawn with its unsaved edits; for a look its
            root stage, ``NAME_look.usda``.
        output: ``.png`` for a screen, one picture or a contact sheet of several; ``.exr`` for
            scene-linear parts, one file a frame. An old file is replaced. The folder must exist.
        progress: called with the number of pictures done and of all.
        options: see ``PreviewRequest``.

            - camera: prim path of a Camera; empty takes a front view that just holds the smoke of
              all frames.
            - frames: timeCodes such as ``1-24``; empty takes the first, the middle and the last.
            - allow_missing: leave out requested timeCodes that do not exist.
            - compare: draw the stage without its looks as well.
            - prims: Volume prim paths; None means all.
            - width: pixels; the height follows from the camera's film or the smoke.
            - size: width and height, pixels.
            - background: of a PNG: ``grey`` (dark), ``black`` or ``none`` (transparent; one picture
              only and nothing to compare).

    Raises:
        ConfigError: an option is wrong, or two contradict each other.
        StageError, GridError, NonFiniteError, ShapeError: stage or files cannot be used.
        PlanError: a frame does not fit the machine's memory.
        WriteFailed: the output could not be written.
    """
    return _preview(PreviewRequest(stage, Path(output), **options), progress)


def _preview(request: PreviewRequest, progress: Callable[[int, int], None] | None) -> PreviewResult:
    smokes = _open(request)
    codes = smokes[_LOOK].time_codes
    codes = codes if request.frames else spread(codes)
    for smoke in smokes.values():
        for code in codes:
            smoke.check_memory(code)  # and whatever headers tell, before any file is written
    views = _views(request, smokes, codes)
    view = views[codes[0]][0]
    drawn = _draw(smokes, views, progress)
    if request.is_exr:
        files = _write_layers(request, codes, drawn)
    else:
        n_pictures = len(codes) * len(smokes)
        check_pixels(view.width, view.height, n_pictures)
        if request.background == "none" and n_pictures > 1:
            raise ConfigError(
                f"a contact sheet ({n_pictures} pictures) cannot have a transparent background. "
                "Draw one frame (--frames 12) without a comparison, or write an .exr."
            )
        files = _write_picture(request, codes, drawn, n_pictures)
    look = smokes[_LOOK]
    notes = dict.fromkeys(note for smoke in smokes.values() for note in smoke.notes)
    return PreviewResult(
        files, tuple(codes), view.width, view.height, request.camera, look.extinctions, tuple(notes)
    )


def _open(request: PreviewRequest) -> dict[str, Smoke]:
    """By label, in the order of drawing."""
    look = _find(request, open_stage(request.stage))
    if not request.compare:
        return {_LOOK: look}
    original = _find(request, open_original(request.stage))
    return {_ORIGINAL: original, _LOOK: look}


def _find(request: PreviewRequest, stage: "Usd.Stage") -> Smoke:
    return find_smoke(stage, request.prims or (), request.frames, request.allow_missing)


def _views(request: PreviewRequest, smokes: dict[str, Smoke], codes: Sequence[float]) -> _Views:
    from usdsmoke.core.views.cameras import view_of_camera

    look = smokes[_LOOK]
    if request.camera:
        views: _Views = {}
        height = width = 0
        for code in codes:
            camera = read_camera(look.stage, request.camera, code)
            if not views:  # the film may be animated; pictures of one sheet have one size
                height, width = request.pixels(_aspect(camera))
            views[code] = (view_of_camera(camera, height, width), camera.clipping_range)
        return views
    direction = front_view(look.selected.up_axis)
    points = np.concatenate([smoke.points(codes) for smoke in smokes.values()])
    if len(points) == 0:
        look.notes["there is no smoke in any of these frames"] = None
        points = np.array([[-0.5] * 3, [0.5] * 3])
    tall, wide = fitted_size([direction], points)
    (view,) = fit_views([direction], points, *request.pixels(wide / tall))
    return dict.fromkeys(codes, (view, (-np.inf, np.inf)))


def _aspect(camera: CameraSource) -> float:
    return camera.horizontal_aperture / camera.vertical_aperture


def _draw(
    smokes: dict[str, Smoke], views: _Views, progress: Callable[[int, int], None] | None
) -> Iterator[tuple[str, float, "Picture"]]:
    """One picture after the other: the label, the timeCode, what is seen."""
    from usdsmoke.core.views.march import march

    done, total = 0, len(smokes) * len(views)
    for label, smoke in smokes.items():
        for code, (view, clip) in views.items():
            picture = march(smoke.media(smoke.shown(code)), view, clip)
            done += 1
            if progress is not None:
                progress(done, total)
            yield label, code, picture


def _write_layers(
    request: PreviewRequest,
    codes: Sequence[float],
    drawn: Iterator[tuple[str, float, "Picture"]],
) -> tuple[Path, ...]:
    files = []
    for label, code, picture in drawn:
        stem = request.output.stem + (f".{_ORIGINAL}" if label == _ORIGINAL else "")
        name = f"{stem}{request.output.suffix}"
        if len(codes) > 1:
            names = frame_file_names(stem, codes, request.output.suffix)
            name = dict(zip(codes, names, strict=True))[code]
        parts = {
            "rgba": ("RGBA", picture.rgba),
            "emission": ("RGB", picture.emission),
            "alpha": ("A", picture.alpha),
            "density": ("Y", picture.depth),
        }
        facts = {
            "usdsmoke:stage": request.stage_name,
            "usdsmoke:camera": request.camera or "front view",
            "usdsmoke:timeCode": format_time_code(code),
        }
        files.append(request.output.with_name(name))
        write_exr(files[-1], parts, facts)
    return tuple(files)


def _write_picture(
    request: PreviewRequest,
    codes: Sequence[float],
    drawn: Iterator[tuple[str, float, "Picture"]],
    n_pictures: int,
) -> tuple[Path, ...]:
    if request.background == "none":
        ((_, _, picture),) = drawn
        write_png(request.output, _unpremultiplied(picture.rgba))
        return (request.output,)
    behind = BACKGROUND if request.background == "grey" else 0.0
    shown = {(label, code): display_picture(seen.rgba, behind) for label, code, seen in drawn}
    if n_pictures == 1:
        write_png(request.output, next(iter(shown.values())))
        return (request.output,)
    labels = list(dict.fromkeys(label for label, _ in shown))
    rows = []
    for start in range(0, len(codes), _MOST_COLUMNS):
        for label in labels:
            name = f"{label}, " if len(labels) > 1 else ""
            rows.append(
                [
                    (f"{name}timeCode {format_time_code(code)}", shown[label, code])
                    for code in codes[start : start + _MOST_COLUMNS]
                ]
            )
    title = f"{request.stage_name}, {request.camera or 'front view'}"
    write_png(request.output, compose_sheet(title, rows))
    return (request.output,)


def _unpremultiplied(rgba: np.ndarray) -> np.ndarray:
    """[H W 4] as PNG stores it: display-encoded colour, not premultiplied."""
    alpha = rgba[..., 3:]
    linear = np.divide(rgba[..., :3], alpha, out=np.zeros_like(rgba[..., :3]), where=alpha > 0)
    return np.concatenate([encode_srgb(np.clip(linear, 0.0, 1.0)), alpha], axis=-1)

"""Pictures of a stage's smoke, as PNG, OpenEXR or animations; the stage does not change.

docs/look.md explains what is drawn and what is not.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import attrgetter
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from usdsmoke.base.errors import ConfigError
from usdsmoke.base.time_codes import spread
from usdsmoke.base.volume import CameraSource
from usdsmoke.core.rays.march import march
from usdsmoke.core.smoke.tasks import computing_threads
from usdsmoke.core.views.cameras import view_of_camera
from usdsmoke.pictures.drawing import box_around, fit_views, fitted_size, front_view
from usdsmoke.pictures.preview_files import (
    LOOK,
    ORIGINAL,
    Drawn,
    PreviewShot,
    durations,
    write_animation,
    write_layers,
    write_picture,
)
from usdsmoke.pictures.preview_request import (
    PreviewOptions,
    PreviewRequest,
    check_pixels,
)
from usdsmoke.pictures.preview_smoke import Smoke, is_uneven
from usdsmoke.pictures.preview_volumes import find_smoke
from usdsmoke.usd.stage import StageOrFile, open_look, open_stage, read_camera

if TYPE_CHECKING:
    from pxr import Usd
    from typing_extensions import Unpack


_NARROW = 1 / 32  # shorter over longer side of a picture in which little is seen


@dataclass(frozen=True)
class PreviewResult:
    """What was drawn."""

    files: tuple[Path, ...]  # one; OpenEXR: one a frame, of each stage and of a source to compare
    time_codes: tuple[float, ...]
    width: int  # of one picture
    height: int
    camera: str  # prim path; "" is the front view
    angles: tuple[float, ...]  # degrees around the up axis from the front, one for each picture
    extinctions: dict[str, float]  # by Volume of the look, per density, 1/stage unit
    notes: tuple[str, ...]

    def __str__(self) -> str:
        more = f" and {len(self.files) - 1} more" if len(self.files) > 1 else ""
        size = f"{self.width} x {self.height} pixels"
        return "\n".join((f"{self.files[0]}{more}: {size}", *self.notes))


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
            root layer, ``NAME_look.usda``.
        output: ``.png`` for a screen, one picture or a contact sheet of several; ``.webp``,
            ``.gif`` or ``.mp4`` (needs PyAV) for an animation; ``.exr`` for scene-linear parts, one
            file a frame. An old file is replaced. The folder must exist.
        progress: called with the number of pictures done and of all.
        options: see ``PreviewRequest``.

            - camera: prim path of a Camera; empty takes a front view that just holds the smoke of
              all frames.
            - frames: timeCodes such as ``1-24``; empty takes the first, the middle and the last
              that have colours, for an animation all, and for a turntable the middle.
            - allow_missing: leave out requested timeCodes that do not exist.
            - compare: draw the stage without its looks as well.
            - prims: Volume prim paths; None means all.
            - look: a look of an asset that has several; empty draws the one that is selected.
            - beside: other stages to draw beside it, from the same directions and at its frames.
            - width: pixels; the height follows from the camera's film or the smoke.
            - size: width and height, pixels.
            - background: of all but OpenEXR: ``grey`` (dark), ``black`` or ``none`` (transparent;
              one PNG only and nothing to compare).
            - turntable: pictures of one frame, evenly around the up axis.
            - threads: CPU threads. One picture gains little from more.
            - settings: of ``stage``, as in ``stylize``, such as ``stage.density=fog``.

    Raises:
        ConfigError: an option is wrong, or two contradict each other.
        StageError, GridError, NonFiniteError, ShapeError: stage or files cannot be used.
        MissingPackage: PyAV is not installed, and the output is an MP4.
        PlanError: a frame does not fit the machine's memory.
        WriteFailed: the output could not be written.
    """
    request = PreviewRequest(stage, Path(output), **options)
    with computing_threads(request.threads):
        return _preview(request, progress)


def _preview(request: PreviewRequest, progress: Callable[[int, int], None] | None) -> PreviewResult:
    smokes = _open(request)
    look = smokes[LOOK]
    codes = _time_codes(request, look)
    for smoke in smokes.values():
        for code in codes:
            smoke.check_memory(code)  # and whatever headers tell, before any file is written
    shots = _shots(request, smokes, codes)
    view = shots[0].view
    drawn = _draw(smokes, shots, not request.is_exr, progress)
    if request.is_exr:
        files = write_layers(request, codes, drawn)
    else:
        n_pictures = len(shots) * len(smokes)
        check_pixels(view.width, view.height, n_pictures)
        if request.background == "none" and (n_pictures > 1 or request.is_animation):
            what = "an animation" if request.is_animation else f"a sheet of {n_pictures} pictures"
            raise ConfigError(
                f"{what} cannot have a transparent background. "
                "Draw one frame (--frames N) as .png without a comparison, or write an .exr."
            )
        if request.is_animation:
            files = write_animation(request, durations(request, codes, look.selected), drawn)
        else:
            files = write_picture(request, drawn, n_pictures)
    notes = dict.fromkeys(
        note for smoke in smokes.values() for note in (*smoke.notes, *smoke.left_out)
    )
    return PreviewResult(
        files, tuple(codes), view.width, view.height, request.camera, request.angles,
        look.extinctions, tuple(notes),
    )  # fmt: skip


def _time_codes(request: PreviewRequest, look: Smoke) -> list[float]:
    """The frames to draw, all of them or a few."""
    config = request.stage_config
    needs_all = bool(config.frames) and not config.allow_missing
    codes = look.readable(look.time_codes, needs_all)
    if not request.frames and (request.turntable is not None or not request.is_animation):
        codes = look.coloured(codes)  # a look may hold some frames of a shot
    if request.turntable is not None:
        if not request.frames:
            few = spread(codes)
            codes = [few[len(few) // 2]]
        if len(codes) > 1:
            raise ConfigError(
                f"--turntable shows one frame, and --frames selects {len(codes)}. Select one."
            )
    elif not request.frames and not request.is_animation:
        codes = spread(codes)
    look.note_colourless(codes)
    return codes


def _open(request: PreviewRequest) -> dict[str, Smoke]:
    """By label, in the order of drawing."""
    stage, smokes = request.stage, dict[str, Smoke]()
    shown = open_look(stage, request.look) if request.look else open_stage(stage)
    look = _find(request, shown)
    if request.compare:
        smokes[ORIGINAL] = _find(request, open_look(stage, ORIGINAL))
    smokes[LOOK] = look
    for name, other in zip(request.names[1:], request.beside, strict=True):
        smokes[name] = _find(request, open_stage(other))
    return smokes


def _find(request: PreviewRequest, stage: "Usd.Stage") -> Smoke:
    return find_smoke(stage, request.stage_config)


def _shots(
    request: PreviewRequest, smokes: dict[str, Smoke], codes: Sequence[float]
) -> list[PreviewShot]:
    """What to draw of each Smoke, all of one size, frame by frame."""
    look = smokes[LOOK]
    shots: list[PreviewShot] = []
    if request.camera:
        height = width = 0
        for code in codes:
            camera = read_camera(look.stage, request.camera, code)
            if not shots:  # the film may be animated; pictures of one sheet have one size
                height, width = request.pixels(_aspect(camera))
            view = view_of_camera(camera, height, width)
            shots.append(PreviewShot(code, 0.0, view, camera.clipping_range))
        return shots
    angles, up_axis = request.angles, look.selected.up_axis
    directions = [front_view(up_axis, turn=angle) for angle in angles]
    points = np.concatenate([smoke.points(codes) for smoke in smokes.values()])
    if len(points) == 0:
        look.notes["there is no smoke in any of these frames"] = None
        points = np.array([[-0.5] * 3, [0.5] * 3])
    if len(angles) > 1:
        points = box_around(points)  # the middle of the picture stays in its place
    tall, wide = fitted_size(directions, points)
    if min(tall, wide) < _NARROW * max(tall, wide) and len(look.selected.volumes) > 1:
        look.notes["the Volumes are far apart and small in the picture; name one with --prim"] = (
            None
        )
    views = fit_views(directions, points, *request.pixels(wide / tall))
    return [
        PreviewShot(code, angle, view)
        for code in codes
        for angle, view in zip(angles, views, strict=True)
    ]


def _aspect(camera: CameraSource) -> float:
    return camera.horizontal_aperture / camera.vertical_aperture


def _draw(
    smokes: dict[str, Smoke],
    shots: Sequence[PreviewShot],
    exposed: bool,
    progress: Callable[[int, int], None] | None,
) -> Drawn:
    """One picture after the other."""
    done, total = 0, len(smokes) * len(shots)
    for label, smoke in smokes.items():
        is_blank = True
        for code, of_frame in groupby(shots, key=attrgetter("time_code")):
            shown, media = smoke.shown(code), None
            for shot in of_frame:
                if media is None or is_uneven(shown):
                    media = smoke.media(shown, shot.view, exposed)
                is_blank = is_blank and not media
                if is_blank and label == LOOK and code == shots[-1].time_code:
                    smoke.refuse_blank({shot.time_code for shot in shots})
                picture = march(media, shot.view, shot.clip)
                done += 1
                if progress is not None:
                    progress(done, total)
                yield label, shot, picture
            del media  # before the next frame is read

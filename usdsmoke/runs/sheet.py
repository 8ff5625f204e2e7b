"""Pictures of source and result for the contact sheets, made from the files that were written."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from usdsmoke.base.machine import give_back_memory
from usdsmoke.base.naming import EMISSION
from usdsmoke.base.settings import Config
from usdsmoke.base.time_codes import format_time_code, spread
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.sequence.controls import frame_config
from usdsmoke.pictures import compose_sheet, write_png
from usdsmoke.pictures.drawing import display_picture, draw_fields, front_view, grey_picture
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan
from usdsmoke.vdb.colour_grids import absolute_emission
from usdsmoke.vdb.read import GridRequest, read_grids

_PICTURE_SIZE = 256  # pixels of the longer side: that of a cell


def sample_frames(volume: VolumePlan, count: int = 3) -> list[FramePlan]:
    """At most ``count`` frames with smoke, spread from the first to the last; in order."""
    return spread([frame for frame in volume.frames if not frame.is_empty], count)


def write_contact_sheet(
    target: Path,
    plan: Plan,
    volume: VolumePlan,
    reader: FrameReader,
    folder: Path,
    scene: Mapping[str, Any],
    styles: Sequence[np.ndarray],
) -> None:
    """Three frames of a Volume: source, stylized grey, stylized colour, beside the style images.

    Fields are read for one picture after the other, and given up before the next ones: a run's
    memory should be the work's and not this sheet's.

    Args:
        target: the PNG.
        plan: gives the stage.
        volume: what is shown.
        reader: of the source's frames.
        folder: of the result's VDB files.
        scene: the core's, as JSON values: extinction and up axis.
        styles: style images, [H W 3] display-encoded.

    Raises:
        GridError: a file cannot be read.
        WriteFailed: the picture cannot be written.
    """
    frames = sample_frames(volume)
    rows: dict[str, list[np.ndarray]] = {}
    for frame in frames:
        for name, picture in _frame_pictures(volume, frame, reader, folder, scene):
            rows.setdefault(name, []).append(picture)
            give_back_memory()
    columns = [f"timeCode {format_time_code(frame.source.time_code)}" for frame in frames]
    title = f"{volume.source.prim_path}, {Path(plan.source.file_path).name}"
    write_png(target, compose_sheet(title, columns, list(rows.items()), styles))


def _read_result(config: Config, volume: VolumePlan, file_path: Path) -> list[DenseField]:
    """Density and, after a colour step, emission; absolute, whatever the file holds."""
    names = [volume.source.density]
    if "colour" in config.optimize.steps:
        names.append(EMISSION)
    fields = read_grids(file_path, [GridRequest(name) for name in names], config.grids)
    mode = config.layer.emission_mode
    return [fields[0], *(absolute_emission(fields[0], emission, mode) for emission in fields[1:])]


def _frame_scene(
    scene: Mapping[str, Any], source: VolumeFrame, config: Config
) -> Mapping[str, Any]:
    """The scene as this frame was stylized in it."""
    own = frame_config(config, source.controls, source.time_code)
    if own is config:
        return scene
    from usdsmoke.core.views.scene import Scene, frame_scene

    return dataclasses.asdict(frame_scene(Scene(**scene), own.optics.gamma))


def _frame_pictures(
    volume: VolumePlan,
    frame: FramePlan,
    reader: FrameReader,
    folder: Path,
    scene: Mapping[str, Any],
) -> Iterator[tuple[str, np.ndarray]]:
    """Name and picture of what is shown of a frame; only what one picture needs is held."""
    config = volume.config
    source = reader.read(volume, frame)
    to_stage, seen = source.density_to_stage, _frame_scene(scene, source, config)
    picture = _picture(source.density, None, to_stage, seen, config)
    del source  # the velocity with it, unless the reader remembers it
    yield "source", picture
    result = _read_result(config, volume, folder / frame.file_name)
    yield "stylized density", _picture(result[0], None, to_stage, seen, config)
    if len(result) > 1:
        yield "stylized colour", _picture(result[0], result[1], to_stage, seen, config)


def _picture(
    density: DenseField,
    emission: DenseField | None,
    to_stage: np.ndarray,
    scene: Mapping[str, Any],
    config: Config,
) -> np.ndarray:
    gamma_w = scene["gamma_w_shape"] if emission is None else scene["gamma_w"]
    direction = front_view(scene["up_axis"], config.views)
    picture = draw_fields(density, emission, to_stage, gamma_w, direction, _PICTURE_SIZE)
    return grey_picture(picture.alpha) if emission is None else display_picture(picture.rgba)

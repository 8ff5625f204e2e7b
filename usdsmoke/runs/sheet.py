"""Contact sheets: previews of the files that a run has written."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from usdsmoke.base.machine import give_back_memory
from usdsmoke.base.naming import EMISSION, SCATTERING
from usdsmoke.base.time_codes import format_time_code, spread
from usdsmoke.base.volume import DenseField, FrameSource, Scattering
from usdsmoke.config.settings import Config
from usdsmoke.core.sequence.controls import frame_config
from usdsmoke.pictures import compose_sheet, write_png
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
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan
from usdsmoke.vdb.colour_grids import absolute_emission
from usdsmoke.vdb.header import GridHeader, read_header
from usdsmoke.vdb.read import GridRequest, find_grid, read_grids

if TYPE_CHECKING:
    from usdsmoke.core.rays.media import Medium
    from usdsmoke.core.views.cameras import View
    from usdsmoke.core.views.scene import Scene

# Where the smoke is seen from, degrees around the up axis; the first is the front.
_TURN = {0.0: "front", 30.0: "30 degrees", 90.0: "side", 180.0: "back"}
_N_FRAMES = 4  # at most, as many as the turn and a style image have places
_PIXELS_PER_VOXEL = 4  # at most: smaller pixels show no more
_DRAWN_PER_VOXEL = 1.5  # of those; the others are interpolated, as the smoke itself is
_WIDEST = 2  # times the height of a picture

_Labelled = tuple[str, np.ndarray]  # a picture and its name


def shown_frames(volume: VolumePlan) -> list[FramePlan]:
    """The frames of a contact sheet: with smoke, spread from the first to the last, in order."""
    return spread(volume.filled, _N_FRAMES)


def write_contact_sheet(
    target: Path,
    plan: Plan,
    volume: VolumePlan,
    reader: FrameReader,
    folder: Path,
    scene: "Scene",
    styles: Sequence[np.ndarray],
) -> None:
    """Frames of a Volume from the first to the last, source above result, and a turn around a
    middle one, beside the style images. The front of the turn is among the frames.

    All pictures have one scale. The fields of a picture are released before the next ones are read,
    so that the sheet does not raise the run's peak memory.

    Args:
        target: the PNG.
        plan: gives the stage.
        volume: what is shown.
        reader: of the source's frames.
        folder: of the result's VDB files.
        scene: as it was measured when the run began.
        styles: style images, [H W 3] display-encoded.

    Raises:
        GridError: a file cannot be read.
        ShapeError: the fields are flattened on the stage.
        WriteFailed: the picture cannot be written.
    """
    frames = shown_frames(volume)
    sources: list[_Labelled] = []
    results: list[_Labelled] = []
    turn: list[_Labelled] = []
    views, size = _views(volume, frames, folder, scene.up_axis) if frames else ({}, (1, 1))
    for number, frame in enumerate(frames if views else []):
        extinctions = _extinctions(scene, volume.config, frame.source)
        shown = _Shown(volume, frame, extinctions, scene.stops, size)
        name = f"timeCode {format_time_code(frame.source.time_code)}"
        sources.append((f"source, {name}", shown.source(reader, views["front"])))
        give_back_memory()
        here = views if number == (len(frames) - 1) // 2 else {"front": views["front"]}
        seen = shown.result(folder, here)
        front = seen.pop("front")
        results.append((f"result, {name}", front))
        turn += [(f"result, {name}, {side}", picture) for side, picture in seen.items()]
        give_back_memory()
    rows = [sources, results + turn] if len(results) == 1 else [sources, results, turn]
    title = f"{volume.source.prim_path}, {Path(plan.source.file_path).name}"
    write_png(target, compose_sheet(title, [row for row in rows if row], styles))


@dataclass(frozen=True)
class _Shown:
    """A frame as it is drawn."""

    volume: VolumePlan
    frame: FramePlan
    extinctions: tuple[float, float]  # of grey and of coloured smoke, per density, 1/stage unit
    stops: float  # exposure of the result's pictures
    size: tuple[int, int]  # height and width of a picture; fewer pixels may be drawn

    @property
    def scattering(self) -> Scattering:
        """What the smoke scatters, exposed as the pictures are; no lights where there are none."""
        config, lights = self.volume.config, self.frame.source.lights
        albedo = 1.0 if SCATTERING in config.painted else config.albedo  # else of the colour
        optics = config.optics
        scattering = Scattering(lights, albedo, optics.anisotropy, optics.bounces)
        return scattering.exposed(self.stops)

    def source(self, reader: FrameReader, view: "View") -> np.ndarray:
        density = reader.read(self.volume, self.frame).density
        return self._draw(self._media(density, (None, None), view), view)

    def result(self, folder: Path, views: Mapping[str, "View"]) -> dict[str, np.ndarray]:
        """Pictures of the written frame, by name of the view."""
        density, emission, colour = _read_result(self.volume, folder / self.frame.file_name)
        sides = list(views.values())
        lit_from = sides if self.scattering.is_uneven else sides[:1]
        if emission is not None:
            emission = _times(emission, 2.0**self.stops)
        media = [self._media(density, (emission, colour), view) for view in lit_from]
        del density, emission, colour
        pairs = zip(media * (len(sides) // len(media)), sides, strict=True)
        # one by one: an oblique view takes most of the time, and threads share its rays
        return {name: self._draw(*pair) for name, pair in zip(views, pairs, strict=True)}

    def _draw(self, media: Sequence["Medium"], view: "View") -> np.ndarray:
        from usdsmoke.core.rays.march import march

        return enlarged(display_picture(march(media, view).rgba), *self.size)

    def _media(
        self,
        density: DenseField,
        painted: tuple[DenseField | None, DenseField | None],
        view: "View",
    ) -> list["Medium"]:
        from usdsmoke.core.rays.media import make_media

        to_stage, emission = _to_stage(self.volume, self.frame), painted[0]
        has_colours, (grey, coloured) = painted != (None, None), self.extinctions
        gamma_w = coloured if has_colours else grey
        if has_colours and self.scattering.lights:
            from usdsmoke.core.views.lighting import lit_emission

            emission = lit_emission(density, painted, to_stage, gamma_w, self.scattering, view)
        place = None if emission is None else to_stage
        return make_media(density, emission, to_stage, place, gamma_w, GREY)


def _times(field: DenseField, factor: float) -> DenseField:
    if factor == 1:
        return field
    return dataclasses.replace(field, values=field.values * np.float32(factor))


def _views(
    volume: VolumePlan, frames: Sequence[FramePlan], folder: Path, up_axis: str
) -> tuple[dict[str, "View"], tuple[int, int]]:
    """The views by name, and height and width of a picture; the front alone where the smoke has no
    third dimension.

    The views hold the smoke of all frames, source and result, as far as headers tell where it is;
    there are none where no header tells.
    """
    corners, finest, is_flat = [], np.inf, False
    for frame in frames:
        header = read_header(folder / frame.file_name)
        result = find_grid(header, GridRequest(volume.source.density))
        for grid in (frame.grid, result):
            place = _index_to_stage(volume, frame, grid)
            if grid.bbox_min is None or grid.bbox_max is None or place is None:
                continue
            corners.append(box_corners(np.array(grid.bbox_min), np.array(grid.bbox_max), place))
            finest = min(finest, float(np.linalg.norm(place[:3, :3], axis=1).min()))
            is_flat |= 1 in (grid.box_shape or ())
    if not corners:
        return {}, (1, 1)
    turn = {0.0: _TURN[0.0]} if is_flat else _TURN
    directions = [front_view(up_axis, volume.config.views, angle) for angle in turn]
    points = box_around(np.concatenate(corners))
    tall, wide = fitted_size(directions, points)
    size = volume.config.layer.contact_sheet
    scale = min(size / tall, _WIDEST * size / wide, _PIXELS_PER_VOXEL / finest)
    drawn = min(scale, _DRAWN_PER_VOXEL / finest)
    height, width = (max(1, round(side * drawn)) for side in (tall, wide))
    views = dict(zip(turn.values(), fit_views(directions, points, height, width), strict=True))
    return views, (max(1, round(tall * scale)), max(1, round(wide * scale)))


def _to_stage(volume: VolumePlan, frame: FramePlan) -> np.ndarray:
    return frame.source.fields[volume.source.density].field_to_stage


def _index_to_stage(volume: VolumePlan, frame: FramePlan, grid: GridHeader) -> np.ndarray | None:
    if grid.index_to_world is None:
        return None
    return grid.index_to_world @ _to_stage(volume, frame)


def _read_result(
    volume: VolumePlan, file_path: Path
) -> tuple[DenseField, DenseField | None, DenseField | None]:
    """Density, emission, absolute whatever the file holds, and a painted scattering colour."""
    config = volume.config
    names = {EMISSION: EMISSION}
    if SCATTERING in config.painted:
        names[SCATTERING] = config.scatter_colours[0]
    wanted = [volume.source.density, *(names[kind] for kind in config.painted)]
    density, *painted = read_grids(file_path, [GridRequest(name) for name in wanted], config.grids)
    found = dict(zip(config.painted, painted, strict=True))
    emission = found.get(EMISSION)
    if emission is not None:
        emission = absolute_emission(density, emission, config.layer.emission_mode)
    return density, emission, found.get(SCATTERING)


def _extinctions(scene: "Scene", config: Config, frame: FrameSource) -> tuple[float, float]:
    """The extinctions of grey and of coloured smoke, as a frame was stylized."""
    own = frame_config(config, frame.controls, frame.time_code)
    if own is not config:
        from usdsmoke.core.views.scene import frame_scene

        scene = frame_scene(scene, own.optics.gamma)
    return scene.gamma_w_shape, scene.gamma_w

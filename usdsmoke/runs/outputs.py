"""From stylized fields to the files of frames, and what the look layer needs to know of them."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from usdsmoke import __version__
from usdsmoke.base.frame_report import FrameReport
from usdsmoke.base.naming import SCATTERING
from usdsmoke.base.publish import make_folders
from usdsmoke.base.record_format import hash_file
from usdsmoke.base.storage import (
    clip_to_smoke,
    round_to_half,
    storage_errors,
)
from usdsmoke.base.volume import DenseField, WrittenFrame
from usdsmoke.config.settings import Config
from usdsmoke.pictures import StyleImage
from usdsmoke.planning.plan import FramePlan, VolumePlan, WindowTask
from usdsmoke.runs.budget import PartClock
from usdsmoke.runs.delivery import empty_names, result_file
from usdsmoke.runs.manifests import part_file_name
from usdsmoke.runs.opened import OpenRun
from usdsmoke.runs.provenance_record import frame_metadata
from usdsmoke.runs.run import Run
from usdsmoke.usd.look import StylizedVolume
from usdsmoke.vdb.boxes import field_extent, prune_fields
from usdsmoke.vdb.colour_grids import empty_colour_grids, make_colour_grids
from usdsmoke.vdb.write import write_frame

if TYPE_CHECKING:
    from usdsmoke.core.sequence.stylize import StylizedFrame


def result_fields(
    fields: Sequence[DenseField],
    velocity: Sequence[DenseField],
    others: Sequence[DenseField],
    report: FrameReport,
    config: Config,
    stops: float,
) -> tuple[list[DenseField], FrameReport]:
    """The grids of a result's file, and the frame's report with what is lost by storing them.

    Args:
        fields: density and, after a colour step, what ``Config.painted`` names.
        velocity: grids that are written beside them, clipped to the smoke if that is asked for.
        others: grids that are written beside them as they are given.
        stops: exposure, see ``Scene``.

    Returns:
        Density and colours, pruned, and the other grids that are asked for; the report.
    """
    density, *painted = kept = prune_fields(fields, config.grids.prune)
    colours = []
    if painted:
        colours = make_colour_grids(density, painted, report.extinction, config, stops)
    half = config.grids.half
    lost = storage_errors(fields, kept, half, report.errors)
    stored = round_to_half(density.values) if half else density.values
    written = int(np.count_nonzero(stored > 0))
    report = dataclasses.replace(report, errors=lost, voxels_written=written)
    if config.layer.compact_velocity:
        velocity = [clip_to_smoke(grid, density) for grid in velocity]
    return [density, *colours, *velocity, *others], report


def stored_half(config: Config, velocity: Sequence[DenseField]) -> bool | list[str]:
    """Which grids of a result's file are 16-bit floats, as ``write_frame`` takes it."""
    if config.grids.half or not config.layer.compact_velocity:
        return config.grids.half
    return [grid.name for grid in velocity]


def write_result(
    opened: OpenRun,
    task: WindowTask,
    frame: FramePlan,
    stylized: "StylizedFrame",
    source_hashes: Mapping[str, str],
    clock: PartClock,
) -> tuple[str, dict[str, Any]]:
    """Write what one window made of a frame.

    A version that is to be blended with another is a part: it keeps all of its voxels, in 32-bit
    floats, and of what is copied it holds only what moves with the density. The density's grid has
    the name of its relationship: some renderers look for the one name, some for the other.

    Returns:
        The file, relative to the run's folder, and JSON values that describe it; see
        ``manifest_entry``.

    Raises:
        WriteFailed: the operating system refused, or the file came back different.
        GridError: a field to be copied cannot be read.
    """
    run, volume, config = opened.run, task.volume, task.volume.config
    is_part, report = task.is_part(frame), stylized.report
    name = part_file_name(task.number, frame.file_name) if is_part else frame.file_name
    fields = [dataclasses.replace(stylized.density, name=volume.source.density)]
    fields += stylized.painted
    others: list[DenseField] = []
    half: bool | list[str] = False
    if volume.moves_fields or not is_part:
        others = _moved(opened.reader.read_others(volume, frame), volume, frame, stylized)
    if is_part:
        fields += others
    else:
        stops = run.scenes[task.volume_number].get("stops", 0.0)
        velocity = opened.reader.read_velocity_copy(volume, frame)
        fields, report = result_fields(fields, velocity, others, report, config, stops)
        half = stored_half(config, velocity)
    target = run.folder / name
    make_folders(target.parent)
    metadata = frame_metadata(run, volume, frame, source_hashes)
    content_hash = write_frame(target, fields, metadata, half, config.grids, clock.part)
    record = manifest_entry(volume, frame, fields[0], content_hash, source_hashes)
    with clock.part("hashing"):
        digest = hash_file(target)
    return name, {**record, "sha256": digest, "part": is_part, "report": report.to_json()}


def _moved(
    others: list[DenseField], volume: VolumePlan, frame: FramePlan, stylized: "StylizedFrame"
) -> list[DenseField]:
    """Copied fields as they go with the density."""
    if not volume.moves_fields or stylized.moved_by is None:
        return others
    from usdsmoke.core.steps.move import move_field

    place = frame.source.fields[volume.source.density].field_to_stage  # copies stand there too
    return [move_field(field, place, stylized.moved_by) for field in others]


def manifest_entry(
    volume: VolumePlan,
    frame: FramePlan,
    density: DenseField,
    content_hash: str,
    source_hashes: Mapping[str, str],
) -> dict[str, Any]:
    """What is kept of a written frame: place, hashes, and the corners of its active voxels."""
    low, high = field_extent(density) or (None, None)
    return {
        "prim_path": volume.source.prim_path,
        "time_code": frame.source.time_code,
        "content_hash": content_hash,
        "source_hashes": dict(source_hashes),
        "extent_min": low,
        "extent_max": high,
    }


def collect_volume(
    run: Run,
    volume: VolumePlan,
    scene: Mapping[str, Any],
    styles: Sequence[StyleImage],
) -> StylizedVolume:
    """What the layer has to know of one Volume's finished frames.

    When only a part of a sequence was stylized, a file with empty colours is written for the
    timeCodes that go on showing the source.

    Args:
        run: complete but for the layer.
        scene: the core's, as JSON values.

    Raises:
        WriteFailed: that file could not be written.
    """
    written, extinctions, config = [], {}, volume.config
    for frame in volume.frames:
        record = run.frames[frame.file_name]
        written.append(
            WrittenFrame(
                time_code=frame.source.time_code,
                file_path=str(result_file(run, volume, frame)),
                content_hash=record["content_hash"],
                extent_min=_triple(record["extent_min"]),
                extent_max=_triple(record["extent_max"]),
            )
        )
        extinctions[frame.source.time_code] = record["report"].get("extinction", 0.0)
    grids = {volume.source.density: volume.source.density}
    if "colour" in config.optimize.steps:
        grids |= {name: name for name in config.colour_grids}
    grids |= _copied_velocity(volume)
    grids |= {grid.name: grid.name for grid in volume.frames[0].others if grid.is_field}
    empty_file, empty_hash = ("", "")
    if "colour" in config.optimize.steps:
        empty_file, empty_hash = _write_empty(run, volume, config)
    is_lit = any(frame.source.lights for frame in volume.frames)
    return StylizedVolume(
        source=volume.source,
        frames=written,
        extinction_per_density=next(iter(extinctions.values())),
        extinction_samples=extinctions if len(set(extinctions.values())) > 1 else {},
        grids=grids,
        empty_file=empty_file,
        empty_hash=empty_hash,
        emission_mode=config.layer.emission_mode,
        albedo=config.albedo if is_lit else 0.0,
        anisotropy=config.optics.anisotropy if is_lit else 0.0,
        bounces=config.optics.bounces and is_lit,
        named_lights=volume.frames[0].source.lights if config.optics.names_lights else (),
        stops=scene.get("stops", 0.0),
        scatter_field=config.scatter_colours[0] if SCATTERING in config.painted else "",
        styles=tuple(f"{styles[place].name} {styles[place].sha256}" for place in volume.styles),
        seed=config.optimize.seed,
    )


def _copied_velocity(volume: VolumePlan) -> dict[str, str]:
    """Relationship and grid of the copied velocity, where the stage has a relationship for it."""
    velocity = volume.frames[0].copied
    if velocity is None:
        return {}
    names = volume.source.velocity
    grids = [grid.name for grid in velocity.grids]
    return dict(zip(names, grids, strict=True)) if len(names) == len(grids) else {}


def _write_empty(run: Run, volume: VolumePlan, config: Config) -> tuple[str, str]:
    """A file without a voxel, and its content hash; two empty texts when all is stylized."""
    name, place = empty_names(volume)
    if not name:
        return "", ""
    matrix = volume.frames[0].grid.index_to_world
    colours = empty_colour_grids(np.eye(4) if matrix is None else matrix, config)
    metadata = {"creator": f"usdsmoke {__version__}", "usdsmoke:run": run.run_id}
    half = config.grids.half
    content_hash = write_frame(run.folder / name, colours, metadata, half, config.grids)
    return str(run.output / place if place else run.folder / name), content_hash


def _triple(numbers: Sequence[float] | None) -> tuple[float, float, float] | None:
    return None if numbers is None else (numbers[0], numbers[1], numbers[2])

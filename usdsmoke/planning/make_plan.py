"""Makes the plan of a run from USD values and VDB headers, and checks that it fits a machine.

No voxel is read and torch is not loaded.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from usdsmoke.base.errors import ConfigError, GridError, PlanError, count_text, others_advice
from usdsmoke.base.machine import available_memory_gib, free_disk_bytes
from usdsmoke.base.naming import frame_file_names, frame_places, volume_stems
from usdsmoke.base.volume import FrameSource, StageSource, VolumeSource
from usdsmoke.config.settings import Config
from usdsmoke.core.sequence.controls import (
    are_independent,
    check_controls,
    coarse_factor,
    in_effect,
    is_computed,
    step_iterations,
    without_network,
)
from usdsmoke.planning.copied import find_copies, size_beside, unnamed_velocities, with_copies
from usdsmoke.planning.estimate import (
    CostEstimate,
    FrameSize,
    add_estimates,
    estimate_run,
    grid_size,
    voxel_edges,
)
from usdsmoke.planning.frames import (
    field_place,
    find_density,
    find_frame_mask,
    find_frame_velocity,
    is_copied,
)
from usdsmoke.planning.materials import material_warnings
from usdsmoke.planning.needs import list_needed, list_omitted
from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan, WindowTask
from usdsmoke.planning.remarks import list_remarks
from usdsmoke.planning.visibility import (
    camera_tips,
    most_deciding,
    unseen_warnings,
    visible_share,
    with_refine,
)
from usdsmoke.planning.windows import coarse_runs, find_cuts, followed_codes, split_windows
from usdsmoke.usd.inspect import grids_beside
from usdsmoke.usd.volume_settings import VolumeSettings
from usdsmoke.vdb.header import FileHeader, read_header

_DISK_RESERVE = 64 * 2**20  # bytes beside the result: layers, contact sheet, temporaries
_DISK_RESERVE_LATER = 4 * 2**20  # the same for the rest of a run that has started


def make_plan(
    source: StageSource, config: Config, settings: Sequence[VolumeSettings] | None = None
) -> Plan:
    """The plan of a stylization, from USD values and VDB headers.

    Args:
        settings: those of each Volume; None takes the run's, and one style image.

    Raises:
        GridError: a density, or the named velocity or mask, cannot be used.
        ConfigError: a frame's controls are out of range, or not one weight for each style; or
            ``layer.files`` does not give each frame a path of its own.
        LayerError: two timeCodes are too close for file names of their own.
    """
    paths = [volume.prim_path for volume in source.volumes]
    stems = volume_stems(paths, config.layer.name)
    if settings is None:
        settings = [VolumeSettings(config, (0,))] * len(stems)
    headers: dict[str, FileHeader] = {}
    volumes: list[VolumePlan] = []
    errors: list[tuple[type[GridError], str]] = []
    for volume, stem, own in zip(source.volumes, stems, settings, strict=True):
        first_index = sum(len(earlier.windows) for earlier in volumes)
        try:
            volumes.append(
                _plan_volume(volume, stem, own, headers, first_index, source.frame_length)
            )
        except GridError as error:
            errors.append((type(error), str(error)))
    if errors:
        others = others_advice([planned.source.prim_path for planned in volumes])
        kind, text = errors[0]
        raise kind(f"{text}{others}")
    volumes = _with_places(volumes, volume_stems(paths), config)
    costs = [_estimate(v, v.frames, v.overlap_frames, v.coarse_frames) for v in volumes]
    training = [volume.training_seconds for volume in volumes]
    estimate = add_estimates(costs)
    return Plan(
        source=source,
        config=config,
        volumes=tuple(volumes),
        needed=list_needed(config, volumes),
        omitted=list_omitted(source, config, volumes),
        estimate=replace(estimate, seconds=estimate.seconds + sum(training)),
        notes=(
            *list_remarks(volumes),
            *camera_tips(volumes, source.cameras),
            *filter(None, map(_pays, volumes, costs, training)),
        ),
        warnings=(*unseen_warnings(volumes), *material_warnings(volumes)),
    )


def _pays(volume: VolumePlan, cost: CostEstimate, training: float) -> str:
    """From how many frames on a network is worth its training; "" where none is trained.

    Args:
        cost: of the frames, without the training.
    """
    if not training:
        return ""
    without = replace(volume, config=without_network(volume.config))
    usual = _estimate(without, volume.frames, volume.overlap_frames, volume.coarse_frames)
    saved = (usual.seconds - cost.seconds) / len(volume.frames)
    takes = f"training it takes {training:.0f} s"
    if saved <= 0:
        return f"a network saves no time here: {takes}"
    n_frames, n_cold = math.ceil(training / saved), sum(step_iterations(without.config, "colour"))
    here = f", of which this run has {n}" if (n := len(volume.filled)) < n_frames else ""
    text = f"a network saves time from {count_text(n_frames, 'frame')} like these on{here}"
    return f"{text}: {takes} (against {n_cold} iterations from noise)"


def _with_places(
    volumes: Sequence[VolumePlan], prims: Sequence[str], config: Config
) -> list[VolumePlan]:
    """The Volumes with the paths that ``layer.files`` gives their frames.

    Args:
        prims: a name for each Volume, whatever ``layer.name`` is.
    """
    placed, owners = [], dict[str, str]()
    for volume, prim in zip(volumes, prims, strict=True):
        names = {"prim": prim, "look": config.layer.look, "name": volume.stem}
        codes = list(result_file_names(volume.source, volume.stem))
        places = frame_places(config.layer.files, names, codes)
        for place in places.values():
            other = owners.setdefault(place.casefold(), volume.source.prim_path)
            if other != volume.source.prim_path:
                raise ConfigError(
                    f"layer.files gives <{other}> and <{volume.source.prim_path}> the same file "
                    f"{place}. Put {{prim}} or {{name}} into it."
                )
        placed.append(replace(volume, places=places))
    return placed


def estimate_part(
    plan: Plan, tasks: Sequence[WindowTask], started: Collection[str] = ()
) -> CostEstimate:
    """The costs of some windows of a plan, and of the coarse step that is left.

    Args:
        tasks: the windows to do.
        started: files of the frames whose coarse start is there.
    """
    found = []
    for number, volume in enumerate(plan.volumes):
        own = [task for task in tasks if task.volume_number == number]
        codes = {code for task in own for code in task.window.time_codes}
        frames = [frame for frame in volume.frames if frame.source.time_code in codes]
        twice = [
            f for task in own for f in task.frames if f.source.time_code in task.window.overlap
        ]
        coarse = [frame for frame in volume.coarse_frames if frame.file_name not in started]
        found.append(_estimate(volume, frames, twice, coarse))
    return add_estimates(found)


def _estimate(
    volume: VolumePlan,
    frames: Sequence[FramePlan],
    twice: Sequence[FramePlan],
    coarse: Sequence[FramePlan],
) -> CostEstimate:
    first = {codes[0] for codes in volume.coarse_runs}
    estimate = estimate_run(
        [frame.size for frame in frames],
        volume.config,
        len(volume.styles),
        twice=[frame.size for frame in twice],
        coarse=[
            replace(frame.size, window_start=frame.source.time_code in first) for frame in coarse
        ],
        has_starts=bool(volume.coarse_runs) and not volume.starts_from_network,
    )
    return replace(estimate, bytes_temporary=sum(map(_decoded_bytes, frames)))


def _decoded_bytes(frame: FramePlan) -> int:
    """Of a frame's source grids as dense arrays: density, velocity and mask."""
    beside = size_beside(frame.velocity or frame.copied, frame.others).dense
    return 4 * (math.prod(frame.size.box) + math.prod(frame.size.mask_box) + beside)


def check_plan(plan: Plan, output: Path | None = None) -> None:
    """Refuse a plan that does not fit the memory or the disk.

    Args:
        output: the folder that will hold the result; None skips the check of the disk.

    Raises:
        PlanError: with the needed and the available amount.
    """
    needed = plan.estimate.memory_gib
    limit, reason = plan.config.optimize.memory_limit_gib, "optimize.memory_limit_gib"
    remedy = "raise the limit"
    if limit is None:
        limit, reason = available_memory_gib(), "free memory of this machine"
        remedy = "set optimize.memory_limit_gib if more will be free"
    if needed > limit:
        frames = [(volume, frame) for volume in plan.volumes for frame in volume.frames]
        volume, frame = max(frames, key=lambda item: item[1].size.active_voxels)
        parts = volume.config.grids.parts
        finer = f", grids.refine (it is {parts})" if parts > 1 else ""
        raise PlanError(
            f"about {needed:.1f} GiB of memory is needed, for <{volume.source.prim_path}> at "
            f"timeCode {frame.source.time_code:g} with {frame.size.active_voxels:,} voxels; only "
            f"{limit:.1f} GiB is available ({reason}). Lower views.pool, views.image_size{finer}, "
            f"or {remedy}.{_dense_hint(frame.size)}"
        )
    if output is not None:
        check_disk(output, plan.estimate.bytes_written)


def _dense_hint(size: FrameSize) -> str:
    """What to look for where the whole box is active, as in files that are written densely."""
    if size.active_voxels < math.prod(size.box):
        return ""
    return (
        " All voxels of its box are active: if many hold no smoke, make them inactive and prune "
        "the grid."
    )


def check_disk(output: Path, n_bytes: int, is_started: bool = False) -> None:
    """Refuse to write more than the disk can hold.

    Args:
        n_bytes: size of the files that are still to be written.
        is_started: True if a part of the run exists: it then needs a smaller reserve.

    Raises:
        PlanError: with the needed and the available amount.
    """
    reserve, free = _DISK_RESERVE_LATER if is_started else _DISK_RESERVE, free_disk_bytes(output)
    if n_bytes and n_bytes + reserve > free:
        raise PlanError(
            f"the result needs about {n_bytes / 1e6:,.1f} MB and a reserve of "
            f"{reserve / 1e6:,.0f} MB, but the disk of {output} has {free / 1e6:,.1f} MB free. "
            "Free some space, choose another output folder, select fewer frames or set grids.half."
        )


def result_file_names(volume: VolumeSource, stem: str) -> dict[float, str]:
    """File name by timeCode, for all timeCodes of a Volume, selected or not.

    Raises:
        LayerError: two timeCodes are too close for names of their own.
    """
    codes = sorted({*volume.time_codes, *(frame.time_code for frame in volume.frames)})
    return dict(zip(codes, frame_file_names(stem, codes), strict=True))


def _plan_volume(
    volume: VolumeSource,
    stem: str,
    own: VolumeSettings,
    headers: dict[str, FileHeader],
    first_index: int,
    frame_length: float,
) -> VolumePlan:
    config = own.config
    check_controls(volume, config, len(own.styles))
    time_codes = [frame.time_code for frame in volume.frames]
    windows = split_windows(time_codes, config.windows, first_index, frame_length)
    computed = is_computed([in_effect(config, frame.controls) for frame in volume.frames])
    alone = are_independent(config) or not any(computed)
    if alone:  # frames have nothing to carry or to blend
        windows = tuple(replace(window, overlap=(), continues=False) for window in windows)
    names = result_file_names(volume, stem)
    runs = coarse_runs(windows) if not alone and coarse_factor(config) > 1 else ()
    starts = {window.time_codes[0] for window in windows}
    followed = frozenset() if are_independent(config) else followed_codes(windows, runs)
    frames = []
    for frame in volume.frames:
        _read_headers(frame, headers)
    for frame, to_do in zip(volume.frames, computed, strict=True):
        code = frame.time_code
        place = _Place(names[code], code in starts, code in followed, to_do)
        frames.append(_plan_frame(volume, frame, place, config, headers))
    cuts = find_cuts(time_codes, frame_length)
    copies, reasons = find_copies(volume, [frame.copied for frame in frames], headers, config)
    if config.layer.copy_velocity is None:
        read = [frame.velocity for frame in frames if frame.copied is None and frame.velocity]
        reasons |= unnamed_velocities(volume, read)
    planned = with_refine(
        VolumePlan(volume, stem, tuple(frames), windows, config, own.styles, runs, cuts, reasons)
    )
    most = most_deciding(planned, planned.config)
    frames = [replace(frame, size=replace(frame.size, most_voxels=most)) for frame in frames]
    frames = [
        replace(
            frame,
            others=grids,
            size=with_copies(
                frame.size, (frame.velocity, frame.copied), grids, config, planned.moves_fields
            ),
        )
        for frame, grids in zip(frames, copies, strict=True)
    ]
    return replace(planned, frames=tuple(frames), beside=_left_beside(volume, frames[0], headers))


def _left_beside(
    volume: VolumeSource, frame: FramePlan, headers: Mapping[str, FileHeader]
) -> tuple[str, ...]:
    """The grids of the density's file that no relationship leads to and that nothing uses.

    Args:
        frame: the first one, with the grids that are copied.
    """
    used = {grid.name for grid in frame.others}
    for velocity in filter(None, (frame.velocity, frame.copied)):
        used |= {grid.name for grid in velocity.grids}
    used |= {frame.mask.grid.name} if frame.mask else set()
    header = headers[frame.source.fields[volume.density].file_path]
    return tuple(name for name in grids_beside(volume, header) if name not in used)


@dataclass(frozen=True)
class _Place:
    """A frame's place in the run."""

    file_name: str
    is_start: bool  # of a window
    is_followed: bool  # by a frame that goes on from it
    is_computed: bool


def _plan_frame(
    volume: VolumeSource,
    frame: FrameSource,
    place: _Place,
    config: Config,
    headers: Mapping[str, FileHeader],
) -> FramePlan:
    density = frame.fields[volume.density]
    grid = find_density(volume, frame, headers[density.file_path])
    velocity = find_frame_velocity(volume, frame, headers, config)
    copied = velocity if is_copied(velocity, density, config) else None
    mask = find_frame_mask(volume, frame, headers, config)
    size = FrameSize(
        *grid_size(density.file_path, grid),
        window_start=place.is_start,
        visible=visible_share(frame, density, grid, config),
        computed=place.is_computed,
        edges=voxel_edges(grid),
    )
    if size.active_voxels == 0 or not place.is_computed:
        mask = None
    if mask is not None:
        size = replace(size, mask_box=grid_size(mask.field.file_path, mask.grid)[1])
    return FramePlan(
        source=frame,
        size=size,
        grid=grid,
        velocity=velocity if place.is_followed and config.stage.motion == "velocity" else None,
        copied=copied,
        mask=mask,
        file_name=place.file_name,
    )


def _read_headers(frame: FrameSource, headers: dict[str, FileHeader]) -> None:
    for field in frame.fields.values():
        if field.file_path not in headers:
            try:
                headers[field.file_path] = read_header(field.file_path)
            except GridError as error:
                advice = "Or choose other frames with --frames."
                raise type(error)(f"{field_place(field)}: {error} {advice}") from None

"""From finished windows to a result: frames blended, layer authored, sheets drawn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from usdsmoke.base.errors import LayerError, UsdSmokeError, count_text
from usdsmoke.base.frame_report import FrameReport, OverlapReport
from usdsmoke.base.machine import give_back_memory
from usdsmoke.base.time_codes import format_time_codes
from usdsmoke.config.look_sections import MOST_STOPS
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.job import describe_request
from usdsmoke.planning.materials import opacity_remarks
from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan
from usdsmoke.planning.remarks import measured_on_part, style_remarks
from usdsmoke.runs.budget import (
    ErrorBudget,
    PartClock,
    mean_entries,
    run_budget,
    run_seconds,
)
from usdsmoke.runs.coarse import read_scene
from usdsmoke.runs.delivery import deliver_frames, result_file
from usdsmoke.runs.manifests import WindowRecord, part_file_name
from usdsmoke.runs.opened import OpenRun
from usdsmoke.runs.outputs import (
    collect_volume,
    manifest_entry,
    result_fields,
    stored_half,
)
from usdsmoke.runs.progress import RunProgress, RunProgressCallback
from usdsmoke.runs.provenance_record import (
    frame_metadata,
    keep_record,
    make_record,
    used_style_size,
)
from usdsmoke.runs.run import Run
from usdsmoke.runs.run_machine import processor_warnings
from usdsmoke.runs.sheet import write_contact_sheet
from usdsmoke.runs.train import network_text
from usdsmoke.usd.look import author_look, published_runs, result_hashes, shader_hashes
from usdsmoke.usd.schema import late_note
from usdsmoke.vdb.blend import blend_fields, blend_frames, relative_difference, tail_weights
from usdsmoke.vdb.read import GridRequest, read_grids
from usdsmoke.vdb.write import write_frame


@dataclass(frozen=True)
class StylizeResult:
    """What a run left behind."""

    root_stage: Path | None  # the stage to open; None in the mode ``layer``
    look_layer: Path
    frames: tuple[Path, ...]  # VDB files, Volume by Volume
    contact_sheets: tuple[Path, ...]  # one picture for each Volume
    plan: Plan
    warnings: tuple[str, ...]  # worth knowing, none of them fatal
    # How far a frame is from its neighbour carried along, relative to the frame: mean over all
    # frames that have one, for "displacement" and "colour"; None where no frame has.
    temporal_error: Mapping[str, float] | None = None
    # How far two windows' versions of a frame were apart before they were blended, relative to
    # their size: mean over all such frames, for "density" and "emission"; None where there is none.
    overlap_difference: Mapping[str, float] | None = None
    error_budget: ErrorBudget | None = None  # what is left of which error
    seconds: Mapping[str, float] | None = None  # by part of the work, and of "all"
    # By Volume: gamma_w, 1/stage unit per unit of density, which materials multiply density by.
    extinction: Mapping[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        opened = self.root_stage or self.look_layer
        return "\n".join((f"{opened}: {len(self.frames)} VDB files", *self.warnings))


@dataclass(frozen=True)
class _Versions:
    """A frame that two windows have computed."""

    volume: VolumePlan
    frame: FramePlan
    tail: WindowRecord
    head: WindowRecord
    weight: float  # of the tail
    stops: float  # exposure of the scene

    def part_of(self, window: WindowRecord) -> str:
        return part_file_name(window.window, self.frame.file_name)

    @property
    def reports(self) -> tuple[FrameReport, FrameReport]:
        """Of the tail's version and of the head's."""
        tail, head = (window.reports[self.part_of(window)] for window in (self.tail, self.head))
        return tail, head

    @property
    def digests(self) -> dict[str, str]:
        """Both parts, by file."""
        names = [(self.part_of(window), window) for window in (self.tail, self.head)]
        return {name: window.frames[name]["sha256"] for name, window in names}


def _collect_windows(run: Run, plan: Plan) -> list[WindowRecord]:
    """The manifests of all windows, in order.

    Raises:
        LayerError: some windows are not finished; the message lists them.
    """
    found = [run.window(task.number) for task in plan.tasks]
    missing = [number for number, record in enumerate(found) if record is None]
    if missing:
        raise LayerError(
            f"window{'' if len(missing) == 1 else 's'} {format_time_codes(map(float, missing))} of "
            f"{len(found)} (counted from 0) {'is' if len(missing) == 1 else 'are'} not finished in "
            f"{run.folder}. Run 'usdsmoke stylize ... --window K' for each of them first."
        )
    return [record for record in found if record is not None]


def assemble_run(opened: OpenRun, tell: RunProgressCallback, clock: PartClock) -> StylizeResult:
    """Blend what two windows have computed, author the layer, which makes all of it the result, and
    draw the sheets.

    Args:
        opened: the run; this process is alone in the output folder.
        tell: called for every frame that is blended, and for every sheet.

    Raises:
        LayerError: a window is not finished, or the result cannot be written.
        GridError: a file cannot be read.
    """
    run = opened.run
    windows = _collect_windows(run, opened.plan)
    with clock.part("assembling"):
        files, failures = _assemble(opened, windows, tell)
    reports = [report for window in windows for report in window.reports.values()]
    run.seconds = run_seconds(windows, reports, run.coarse().seconds, clock)
    run.finish([*files, *opened.job.sheets], opened.lock.excludes_others)
    return summarize_result(opened, failures)


def _assemble(
    opened: OpenRun, windows: Sequence[WindowRecord], tell: RunProgressCallback
) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """All of it but the run's record: the files outside its folder, and what went wrong with the
    sheets."""
    job, run = opened.job, opened.run
    _collect_frames(opened, windows, tell)
    volumes = [
        collect_volume(run, volume, scene, job.styles)
        for volume, scene in zip(job.plan.volumes, run.scenes, strict=True)
    ]
    run.error_budget = run_budget(job.plan, run.reports, run.scenes).to_json()
    source, layer = job.plan.source, job.config.layer
    results, shaders = result_hashes(volumes, run.output), shader_hashes(volumes, layer)
    record = make_record(job, run, windows, results, shaders)
    keep_record(run, record)
    delivered = deliver_frames(run, job.plan)
    files = author_look(job.stage, source, volumes, job.output, layer, record, job.earlier)
    failures = _draw_sheets(opened, tell)
    run.request = describe_request(job)  # the mode may be another one than it was begun with
    run.remove_locks()  # before the record says that nothing is left to do
    return (*files.written, *delivered), failures


def is_whole(opened: OpenRun) -> bool:
    """Whether a run is complete, and all files of its result are there, made from the parts that
    are there."""
    job, run = opened.job, opened.run
    if not run.complete or run.run_id not in published_runs(job.targets.look_layer):
        return False
    frames = [frame.file_name for volume in job.plan.volumes for frame in volume.frames]
    files = [*job.targets.written, *(run.output / name for name in run.files)]
    records = [run.finished(name) for name in frames]
    parts = [part for record in records if record for part in record.get("parts", {}).items()]
    unchanged = [run.is_unchanged(name, sha) for name, sha in parts if (run.folder / name).exists()]
    return all(records) and all(path.is_file() for path in files) and all(unchanged)


def summarize_result(opened: OpenRun, more: Sequence[str] = ()) -> StylizeResult:
    """What is in the output folder when a run is complete."""
    job, run = opened.job, opened.run
    budget, reports = ErrorBudget.from_json(run.error_budget), run.reports.values()
    return StylizeResult(
        root_stage=job.targets.root_stage,
        look_layer=job.targets.look_layer,
        frames=tuple(
            result_file(run, volume, frame)
            for volume in job.plan.volumes
            for frame in volume.frames
        ),
        contact_sheets=tuple(sheet for sheet in job.sheets if sheet.is_file()),
        plan=job.plan,
        warnings=(
            *job.plan.warnings,
            *job.earlier.notes,
            *_warnings(job.plan, run),
            *budget.warnings,
            *more,
        ),
        temporal_error=mean_entries(
            reports, lambda report: report.temporal, "colour", "displacement"
        ),
        overlap_difference=mean_entries(
            reports, lambda report: report.overlap, "density", "emission"
        ),
        error_budget=budget,
        seconds=dict(run.seconds),
        extinction={
            volume.source.prim_path: float(scene["gamma_w"])
            for volume, scene in zip(job.plan.volumes, run.scenes, strict=True)
        },
    )


def _collect_frames(
    opened: OpenRun, windows: Sequence[WindowRecord], tell: RunProgressCallback
) -> None:
    """Note every frame of the result in the run's record; blend those that two windows have."""
    run = opened.run
    versions = _versions(opened.plan, run, windows)
    kept = {name: run.frames[name] for name in versions if run.finished(name) is not None}
    run.frames = {
        name: record
        for window in windows
        for name, record in window.frames.items()
        if not record["part"]
    } | kept
    for number, (name, pair) in enumerate(versions.items()):
        if name in kept and kept[name].get("parts") == pair.digests:
            continue
        tell(RunProgress("blend", pair.frame.source.time_code, number, len(versions), 1.0))
        run.finish_frame(name, _blend(run, pair, opened.reader))
        give_back_memory()


def _versions(plan: Plan, run: Run, windows: Sequence[WindowRecord]) -> dict[str, _Versions]:
    """By file name the frames that two windows have, in order."""
    found = {}
    for task, _ in pairwise(plan.tasks):
        place, overlap = task.number, task.window.overlap
        own = len(task.window.time_codes)
        stops = run.scenes[task.volume_number].get("stops", 0.0)
        weights = zip(task.frames[own:], tail_weights(len(overlap)), strict=True)
        for frame, weight in weights:
            tail, head = windows[place], windows[place + 1]
            found[frame.file_name] = _Versions(task.volume, frame, tail, head, weight, stops)
    return found


def _blend(run: Run, pair: _Versions, reader: FrameReader) -> dict[str, Any]:
    """Write the blend of both versions of a frame; its record."""
    volume, frame, config = pair.volume, pair.frame, pair.volume.config
    names = _smoke_names(volume)
    n, moved = len(names), [grid.name for grid in frame.others if volume.moves_fields]
    versions = [
        read_grids(
            run.folder / pair.part_of(window),
            [GridRequest(name) for name in (*names, *moved)],
            config.grids,
        )
        for window in (pair.tail, pair.head)
    ]
    tail, head = versions[0][:n], versions[1][:n]
    difference = {
        name: relative_difference(one, other)
        for name, one, other in zip(("density", "emission"), tail, head, strict=False)
    }
    blended = blend_frames(tail, head, pair.weight)
    if volume.moves_fields:
        others = blend_fields(versions[0][n:], versions[1][n:], pair.weight)
    else:
        others = reader.read_others(volume, frame)
    velocity, report = reader.read_velocity_copy(volume, frame), _blended_report(pair, difference)
    fields, report = result_fields(blended, velocity, others, report, config, pair.stops)
    hashes = pair.head.frames[pair.part_of(pair.head)]["source_hashes"]
    metadata = frame_metadata(run, volume, frame, hashes)
    target = run.folder / frame.file_name
    half = stored_half(config, velocity)
    content_hash = write_frame(target, fields, metadata, half, config.grids)
    record = manifest_entry(volume, frame, fields[0], content_hash, hashes)
    return {**record, "part": False, "parts": pair.digests, "report": report.to_json()}


def _blended_report(pair: _Versions, difference: Mapping[str, float]) -> FrameReport:
    """The later window's report, with the temporal errors of both versions."""
    earlier, later = pair.reports
    temporal = later.temporal or earlier.temporal
    if earlier.temporal is not None and later.temporal is not None:
        temporal = earlier.temporal.mixed(later.temporal, pair.weight)
    numbers = (pair.tail.window, pair.head.window)
    overlap = OverlapReport(numbers, pair.weight, **difference)
    return replace(later, temporal=temporal, overlap=overlap)


def _smoke_names(volume: VolumePlan) -> list[str]:
    """The grids of density and of what is painted."""
    return [volume.source.density, *volume.config.painted]


def _measured(scene: Mapping[str, Any], volume: VolumePlan) -> str:
    """What a run of other frames of the shot would have to set for the same look."""
    voxel, steps = scene["reference_voxel_size"], volume.config.optimize.steps
    values = {"style.size": used_style_size(volume, scene), "optics.thicken": 1.0}
    values["grids.refine"] = scene.get("refine", 1)
    if "colour" in steps:
        values["optics.gamma"] = scene["gamma_w"] * voxel
    if "shape" in steps:
        values["optics.gamma_shape"] = scene["gamma_w_shape"] * voxel
    if scene.get("knee"):
        values |= {"optics.thicken": scene["thicken"], "optics.knee": scene["knee"]}
    if volume.config.chooses_exposure:
        values["optics.exposure"] = scene["stops"]
    options = " ".join(f"--set {name}={value:.6g}" for name, value in sorted(values.items()))
    return (
        f"<{volume.source.prim_path}>: opacity and stroke size were measured on these frames. "
        f"Other frames of the shot look alike in another folder with {options}"
    )


def _thickened(scene: Mapping[str, Any], volume: VolumePlan) -> str:
    """That the density is another one, where nobody has asked for it; "" where it is not."""
    if volume.config.optics.thicken is not None or not scene.get("knee"):
        return ""
    return (
        f"<{volume.source.prim_path}>: its thin smoke is up to {scene['thicken']:.3g} times as "
        "dense as in the source, so that it can be painted. optics.thicken=1 leaves it as it is"
    )


def _draw_sheets(opened: OpenRun, tell: RunProgressCallback) -> tuple[str, ...]:
    """The contact sheets; what went wrong, as the result is whole without them."""
    job, run, plan, warnings = opened.job, opened.run, opened.plan, []
    sheets = job.sheets
    for number, (sheet, volume) in enumerate(zip(sheets, plan.volumes, strict=False)):
        tell(RunProgress("picture", volume.frames[0].source.time_code, number, len(sheets), 1.0))
        try:
            scene = read_scene(run, number)
            pictures = job.pictures(volume)
            write_contact_sheet(sheet, plan, volume, opened.reader, run.folder, scene, pictures)
        except (UsdSmokeError, ImportError) as error:  # drawing is all that torch is needed for
            warnings.append(f"no contact sheet: {error}")
        except MemoryError:
            warnings.append("no contact sheet: there is too little free memory to draw it")
    return tuple(warnings)


def _with_more(names: Sequence[str]) -> str:
    return names[0] + (f" and {count_text(len(names) - 1, 'frame')} more" if names[1:] else "")


def _exposed(stops: float) -> str:
    """What is said of an exposure that the run has chosen."""
    at = f"at optics.exposure={stops:.4g}"
    if abs(stops) < MOST_STOPS:
        return f"white smoke in its light is as bright as white {at}. Expose the shot alike"
    return f"its light is too {'dim' if stops > 0 else 'bright'} even {at}. Change its brightness"


def _warnings(plan: Plan, run: Run) -> tuple[str, ...]:
    frames: dict[str, list[str]] = {}  # by warning
    for name, report in run.reports.items():
        for warning in report.warnings:
            frames.setdefault(warning, []).append(name)
    found = [f"{_with_more(names)}: {warning}" for warning, names in frames.items()]
    found += processor_warnings(run)
    found += [
        _measured(scene, volume)
        for volume, scene in zip(plan.volumes, run.scenes, strict=True)
        if measured_on_part(volume)
    ]
    found += filter(None, map(_thickened, run.scenes, plan.volumes))
    found += [
        f"<{volume.source.prim_path}>: {_exposed(scene['stops'])}"
        for volume, scene in zip(plan.volumes, run.scenes, strict=True)
        if volume.config.chooses_exposure and scene.get("stops")
    ]
    found += [
        f"the frames of <{volume.source.prim_path}> start cold: {network_text(volume)} does not "
        f"suit them. On one of them, {scene['misfit']}"
        for volume, scene in zip(plan.volumes, run.scenes, strict=True)
        if scene.get("misfit")
    ]
    found += [
        text
        for volume, scene in zip(plan.volumes, run.scenes, strict=True)
        for text in (*opacity_remarks(volume, scene["gamma_w"]), *style_remarks(volume, scene))
    ]
    codes = [frame.source.time_code for volume in plan.volumes for frame in volume.frames]
    if any(code != round(code) for code in codes):
        found.append("some timeCodes are not whole numbers, so Blender cannot import the sequence")
    return (*found, *filter(None, [late_note()]))

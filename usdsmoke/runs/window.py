"""The work itself: every frame checked, every window stylized, every frame written."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from usdsmoke.base.frame_report import FrameReport
from usdsmoke.base.json_records import read_json
from usdsmoke.base.machine import give_back_memory, usable_cpus
from usdsmoke.base.publish import make_folders, publish_file
from usdsmoke.base.storage import check_half_copy, clip_to_smoke
from usdsmoke.core.sequence.controls import (
    are_independent,
    check_storable,
    fine_octaves,
    frame_config,
)
from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan, WindowTask
from usdsmoke.runs.budget import Finding, PartClock, WindowFindings, timed_items
from usdsmoke.runs.coarse import coarse_starts, read_scene, settle_start
from usdsmoke.runs.manifests import WindowRecord
from usdsmoke.runs.opened import OpenRun, has_coarse_step
from usdsmoke.runs.outputs import write_result
from usdsmoke.runs.progress import RunProgress, RunProgressCallback, WorkMeter
from usdsmoke.runs.run import Run
from usdsmoke.runs.sheet import shown_frames

if TYPE_CHECKING:
    from usdsmoke.base.frame_report import Progress
    from usdsmoke.core.sequence.start import Carried


_FULL_FIELD = "Unset grids.half (--half), or leave the field out of layer.copy_fields."
_FULL_VELOCITY = (
    "Unset grids.half (--half) and layer.compact_velocity, or set layer.copy_velocity=false."
)
_READERS = 2  # frames that are read at once: one is decoded while another is hashed


def hash_frames(
    opened: OpenRun, tasks: Sequence[WindowTask], tell: RunProgressCallback
) -> dict[str, dict[str, str]]:
    """The content hashes of the sources of every frame, each of which is read and checked.

    Damage and NaN show here, before an hour of work and not after it. What is read stays in the
    store of ``opened.reader``, so that it is decoded once.

    Returns:
        By the result's file name the content hashes of what decides the frame's file: see
        ``FrameReader.hash_sources``.

    Raises:
        GridError, NonFiniteError: see ``FrameReader.read``.
    """
    to_do = {frame.file_name: (task.volume, frame) for task in tasks for frame in task.frames}
    hashes, pool = {}, ThreadPoolExecutor(min(_READERS, usable_cpus()))
    try:
        found = {
            name: pool.submit(opened.reader.hash_sources, *item) for name, item in to_do.items()
        }
        for number, (name, (_, frame)) in enumerate(to_do.items()):
            tell(RunProgress("check", frame.source.time_code, number, len(to_do), 0.0))
            hashes[name] = found[name].result()
    finally:
        pool.shutdown(cancel_futures=True)
    return hashes


def check_storage(opened: OpenRun, tasks: Sequence[WindowTask]) -> None:
    """Refuse 16-bit floats that cannot hold what a frame will have, before the first iteration.

    The frames are in the store already. Their scenes must be measured.

    Raises:
        ConfigError: with the frame, the largest number and the one that can be held.
    """
    for task in tasks:
        for frame in task.frames:
            _check_copies(opened, task.volume, frame)
    for task in (task for task in tasks if task.volume.config.grids.half):
        scene = read_scene(opened.run, task.volume_number)
        for frame in task.frames:
            read = opened.reader.read(task.volume, frame)
            config = frame_config(task.volume.config, read.controls, read.time_code)
            if (curve := scene.thickening) is not None:
                read = curve.of_frame(read)
            if config is not task.volume.config:
                from usdsmoke.core.views.scene import frame_scene

                gamma_w = frame_scene(scene, config.optics.gamma).gamma_w
            else:
                gamma_w = scene.gamma_w
            check_storable(read.density, read.time_code, gamma_w, config)


def _check_copies(opened: OpenRun, volume: VolumePlan, frame: FramePlan) -> None:
    """The same of the grids that are copied into a frame's file."""
    is_half, reader = volume.config.grids.half, opened.reader
    if is_half or volume.config.layer.compact_velocity:
        velocity = reader.read_velocity_copy(volume, frame)
        if volume.config.layer.compact_velocity and velocity:
            density = reader.read(volume, frame).density
            velocity = [clip_to_smoke(grid, density) for grid in velocity]
        check_half_copy(velocity, _FULL_VELOCITY)
    for grid in reader.read_others(volume, frame) if is_half else ():
        check_half_copy([grid], _FULL_FIELD)


def stylize_windows(
    opened: OpenRun,
    tasks: Sequence[WindowTask],
    source_hashes: Mapping[str, Mapping[str, str]],
    tell: RunProgressCallback,
    redo: bool = False,
) -> None:
    """Stylize windows, write their frames and, behind each window, its manifest.

    A window that another process has finished meanwhile is left as it is; one that it has begun
    goes on behind its last finished frame, with the same bits.

    Args:
        opened: the run; it has begun, and the coarse step is done.
        tell: called for every iteration and every file.
        redo: do them all, also those that are finished.

    Raises:
        UsdSmokeError: whatever the core or the writing of files raises.
    """
    warm = [bool(place) for task in tasks for place, _ in enumerate(task.frames)]
    configs = [task.volume.config for task in tasks for _ in task.frames]
    left = [n for task in tasks for n in _octaves_left(opened, task)]
    meter, done = WorkMeter(configs, warm, left), 0
    for place, task in enumerate(tasks):
        with opened.run.claim(task.number):
            if redo or opened.run.window(task.number) is None:
                codes = (frame.source.time_code for frame in task.frames)
                places = {code: done + number for number, code in enumerate(codes)}
                progress = _Counter(meter, places, len(warm), tell)
                _stylize_window(opened, task, source_hashes, progress)
            opened.run.checkpoint_path(task.number).unlink(missing_ok=True)
        for _ in task.frames:  # also where another process has done the window
            meter.finish(done)
            done += 1
        later = [frame for other in tasks[place + 1 :] for frame in other.frames]
        opened.reader.release(task.frames, [*later, *_frames_to_assemble(opened.plan)])


def _frames_to_assemble(plan: Plan) -> Iterator[FramePlan]:
    """Sources that are read after the windows: for contact sheets, and beside blended frames."""
    for volume in plan.volumes:
        yield from shown_frames(volume)
        for frame in volume.overlap_frames:
            if frame.copied is not None or (frame.others and not volume.moves_fields):
                yield frame


def _octaves_left(opened: OpenRun, task: WindowTask) -> list[int]:
    """Of each frame of a window the octaves that follow the shared coarse step; 0: all."""
    if not has_coarse_step(opened.run, task.volume_number, task.volume):
        return [0] * len(task.frames)
    shared = {code for chain in task.volume.coarse_runs for code in chain}
    n_fine = fine_octaves(task.volume.config)
    return [n_fine if frame.source.time_code in shared else 0 for frame in task.frames]


@dataclass(frozen=True)
class _Counter:
    """Tells how far a window is, as a part of the run."""

    meter: WorkMeter
    places: Mapping[float, int]  # by timeCode, among the frames of the run
    n_frames: int
    tell: RunProgressCallback

    def skip(self, frames: Iterable[FramePlan]) -> None:
        """Count frames that an earlier process has done."""
        for frame in frames:
            self.meter.finish(self.places[frame.source.time_code])

    def writing(self, time_code: float) -> None:
        frame = self.places[time_code]
        share = self.meter.finish(frame)
        self.tell(RunProgress("write", time_code, frame, self.n_frames, share))

    def found(self, time_code: float, findings: Iterable[Finding]) -> None:
        """Tell what deserves a look as soon as it is known, hours before the run ends."""
        frame, findings = self.places[time_code], tuple(findings)
        if findings:
            share = self.meter.now
            self.tell(
                RunProgress("found", time_code, frame, self.n_frames, share, findings=findings)
            )

    def core(self, state: "Progress") -> None:
        """What the core tells."""
        frame = self.places[state.time_code]
        self.tell(
            RunProgress(
                step=state.step,
                time_code=state.time_code,
                frame=frame,
                n_frames=self.n_frames,
                share=self.meter.share(state, frame),
                octave=state.octave,
                n_octaves=state.n_octaves,
                loss=state.loss,
            )
        )


def _stylize_window(
    opened: OpenRun,
    task: WindowTask,
    source_hashes: Mapping[str, Mapping[str, str]],
    progress: _Counter,
) -> None:
    """One window, from its first frame or from behind the last one that is finished."""
    from usdsmoke.core.sequence.stylize import WindowStart, stylize_window
    from usdsmoke.core.smoke.tasks import made_ahead

    job, run = opened.job, opened.run
    config, clock = settle_start(run, task.volume_number, task.volume.config), PartClock()
    record, carried = _begun(opened, task, progress)
    reports = {Path(name).name: report for name, report in record.reports.items()}
    watch = WindowFindings(task.volume, run.scenes[task.volume_number], reports)
    progress.found(task.frames[0].source.time_code, watch.of_scene())
    frames = _from(task.frames, carried)
    sources = (opened.reader.read(task.volume, frame) for frame in frames)
    to_do = frames if carried is None else frames[1:]
    progress.skip(task.frames[: len(task.frames) - len(to_do)])
    results = stylize_window(
        timed_items(clock, "reading", sources),
        job.pictures(task.volume),
        read_scene(run, task.volume_number),
        config,
        progress.core,
        job.plan.source.time_codes_per_second,
        WindowStart(coarse_starts(run, task), carried),
    )
    if are_independent(task.volume.config):  # a frame takes no longer than writing the one before
        results = made_ahead(results)
    for place, (frame, stylized) in enumerate(zip(to_do, results, strict=True)):
        progress.writing(frame.source.time_code)
        with clock.part("writing"):
            hashes = source_hashes[frame.file_name]
            name, entry = write_result(opened, task, frame, stylized, hashes, clock)
        record.frames[name] = entry
        report = FrameReport.from_json(entry["report"])
        progress.found(frame.source.time_code, watch.of_frame(frame.file_name, report))
        if stylized.carried is not None and place < len(to_do) - 1:
            with clock.part("writing"):
                _keep_checkpoint(run, _timed(record, clock), stylized.carried)
        give_back_memory()
    run.keep(_timed(record, clock))


def _begun(
    opened: OpenRun, task: WindowTask, progress: _Counter
) -> tuple[WindowRecord, "Carried | None"]:
    """What an earlier process has done of a window, and what the next frame starts from; an empty
    record and None where it begins with its first frame. A checkpoint that is of no use is told.
    """
    from usdsmoke.core.sequence.start_files import load_checkpoint
    from usdsmoke.core.smoke.device import describe_machine

    run, number = opened.run, task.number
    here = describe_machine(task.volume.config.optimize).processor
    new = WindowRecord(
        run_id=run.run_id,
        window=number,
        volume=task.volume.source.prim_path,
        time_codes=list(task.window.time_codes),
        overlap=list(task.window.overlap),
        frames={},
        seconds=0.0,
        processor=here,
    )
    if not run.checkpoint_path(number).is_file():
        return new, None
    try:
        carried, text = load_checkpoint(run.checkpoint_path(number))
        record = WindowRecord(**read_json(text))
        changed = [n for n, f in record.frames.items() if not run.is_unchanged(n, f["sha256"])]
    except (OSError, ValueError, TypeError, KeyError) as error:
        why = f"is damaged ({error})"
    else:
        if replace(record, frames={}, seconds=0.0, timings={}) == new and not changed:
            return record, carried
        why = f"is of no use: {changed[0]} has changed" if changed else "is another machine's"
    finding = Finding(
        task.volume.source.prim_path,
        "",
        f"the checkpoint of window {number} {why}",
        "The window is computed again from its first frame",
    )
    progress.found(task.frames[0].source.time_code, [finding])
    return new, None


def _from(frames: Sequence[FramePlan], carried: "Carried | None") -> Sequence[FramePlan]:
    """The frames of a window from the one that it goes on behind."""
    if carried is None:
        return frames
    codes = [frame.source.time_code for frame in frames]
    return frames[codes.index(carried.time_code) :]


def _timed(record: WindowRecord, clock: PartClock) -> WindowRecord:
    """The record with the time of this process added."""
    parts = {
        part: record.timings.get(part, 0.0) + clock.parts.get(part, 0.0)
        for part in {**record.timings, **clock.parts}
    }
    return replace(record, seconds=record.seconds + clock.total, timings=parts)


def _keep_checkpoint(run: Run, record: WindowRecord, carried: "Carried") -> None:
    """Note what a window goes on with, in one step with what is finished of it."""
    from usdsmoke.core.sequence.start_files import save_checkpoint

    target = run.checkpoint_path(record.window)
    make_folders(target.parent)
    publish_file(target, partial(save_checkpoint, carried, json.dumps(asdict(record))))

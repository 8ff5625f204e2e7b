"""The work itself: every frame checked, every window stylized, every frame written."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from usdsmoke.base.frame_report import FrameReport
from usdsmoke.base.machine import give_back_memory
from usdsmoke.base.storage import check_half
from usdsmoke.core.sequence.controls import frame_config
from usdsmoke.planning.frame_reader import hash_sources
from usdsmoke.planning.plan import FramePlan, Plan, WindowTask
from usdsmoke.runs.budget import Finding, PartClock, timed_items
from usdsmoke.runs.budget.findings import find_scene, find_written, frames_before
from usdsmoke.runs.budget.planned import PlannedVolume
from usdsmoke.runs.coarse import coarse_starts, read_scene
from usdsmoke.runs.manifests import WindowRecord
from usdsmoke.runs.opened import OpenRun
from usdsmoke.runs.outputs import write_result
from usdsmoke.runs.progress import RunProgress, RunProgressCallback, WorkMeter
from usdsmoke.runs.sheet import sample_frames

if TYPE_CHECKING:
    from usdsmoke.base.frame_report import Progress


def hash_frames(
    opened: OpenRun, tasks: Sequence[WindowTask], tell: RunProgressCallback
) -> dict[str, dict[str, str]]:
    """The content hashes of the sources of every frame, each of which is read and checked.

    Damage and NaN show here, before an hour of work and not after it. What is read stays in the
    store of ``opened.reader``, so that it is decoded once.

    Returns:
        By the result's file name the content hashes of what decides the frame: ``density``, and
        ``mask`` and ``velocity`` where they are read.

    Raises:
        GridError, NonFiniteError: see ``FrameReader.read``.
    """
    to_do = {frame.file_name: (task.volume, frame) for task in tasks for frame in task.frames}
    hashes = {}
    for number, (name, (volume, frame)) in enumerate(to_do.items()):
        tell(RunProgress("check", frame.source.time_code, number, len(to_do), 0.0))
        hashes[name] = hash_sources(opened.reader.read(volume, frame))
    return hashes


def check_storage(opened: OpenRun, tasks: Sequence[WindowTask]) -> None:
    """Refuse 16-bit floats that cannot hold what a frame will have, before the first iteration.

    The frames are in the store already. Their scenes must be measured.

    Raises:
        ConfigError: with the frame, the largest number and the one that can be held.
    """
    for task in tasks:
        if not task.volume.config.grids.half:
            continue
        scene = opened.run.scenes[task.volume_number]
        for frame in task.frames:
            read = opened.reader.read(task.volume, frame)
            config = frame_config(task.volume.config, read.controls, read.time_code)
            gamma_w = scene["gamma_w"]
            if config is not task.volume.config and config.optics.gamma is not None:
                gamma_w = config.optics.gamma / scene["reference_voxel_size"]
            check_half(read.density, read.time_code, gamma_w, config)


def stylize_windows(
    opened: OpenRun,
    tasks: Sequence[WindowTask],
    source_hashes: Mapping[str, Mapping[str, str]],
    tell: RunProgressCallback,
    redo: bool = False,
) -> None:
    """Stylize windows, write their frames and, behind each window, its manifest.

    A window that another process has finished meanwhile is left as it is.

    Args:
        opened: the run; it has begun, and the coarse step is done.
        tell: called for every iteration and every file.
        redo: do them all, also those that are finished.

    Raises:
        UsdSmokeError: whatever the core or the writing of files raises.
    """
    warm = [bool(place) for task in tasks for place, _ in enumerate(task.frames)]
    configs = [task.volume.config for task in tasks for _ in task.frames]
    meter, done = WorkMeter(configs, warm), 0
    tell = _never_back(tell)
    for place, task in enumerate(tasks):
        with opened.run.claim(task.number):
            if redo or opened.run.window(task.number) is None:
                progress = _Counter(meter, done, len(warm), tell)
                _stylize_window(opened, task, source_hashes, progress)
        done += len(task.frames)
        later = [frame for other in tasks[place + 1 :] for frame in other.frames]
        opened.reader.release(task.frames, [*later, *_frames_to_assemble(opened.plan)])


def _frames_to_assemble(plan: Plan) -> Iterator[FramePlan]:
    """Sources that are read after the windows: for contact sheets, and beside blended frames."""
    for volume in plan.volumes:
        yield from sample_frames(volume)
        for frame in volume.overlap_frames:
            if frame.copied is not None or (frame.others and not volume.moves_fields):
                yield frame


def _never_back(tell: RunProgressCallback) -> RunProgressCallback:
    """The share never falls, also where the core goes over its frames more than once."""
    furthest = 0.0

    def report(state: RunProgress) -> None:
        nonlocal furthest
        furthest = max(furthest, state.share)
        tell(replace(state, share=furthest))

    return report


@dataclass(frozen=True)
class _Counter:
    """The core counts frames within a window; the run counts all of them."""

    meter: WorkMeter
    first: int
    n_frames: int
    tell: RunProgressCallback

    def writing(self, time_code: float, place: int) -> None:
        frame = self.first + place
        share = self.meter.share_before(frame + 1)
        self.tell(RunProgress("write", time_code, frame, self.n_frames, share))

    def found(self, time_code: float, place: int, findings: Iterable[Finding]) -> None:
        """Tell what deserves a look as soon as it is known, hours before the run ends."""
        frame, findings = self.first + place, tuple(findings)
        if findings:
            share = self.meter.share_before(frame)
            self.tell(
                RunProgress("found", time_code, frame, self.n_frames, share, findings=findings)
            )

    def translate(self) -> Callable[["Progress"], None]:
        def report(state: "Progress") -> None:
            frame = self.first + state.frame
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

        return report


def _stylize_window(
    opened: OpenRun,
    task: WindowTask,
    source_hashes: Mapping[str, Mapping[str, str]],
    progress: _Counter,
) -> None:
    from usdsmoke.core.sequence.stylize import stylize_window
    from usdsmoke.core.smoke.device import describe_machine

    job, run = opened.job, opened.run
    config, clock = task.volume.config, PartClock()
    scene, before = run.scenes[task.volume_number], frames_before(task.volume)
    progress.found(
        task.frames[0].source.time_code, 0, find_scene(PlannedVolume(task.volume, (), scene))
    )
    sources = (opened.reader.read(task.volume, frame) for frame in task.frames)
    results = stylize_window(
        timed_items(clock, "reading", sources),
        job.pictures(task.volume),
        read_scene(run, task.volume_number),
        config,
        progress.translate(),
        job.plan.source.time_codes_per_second,
        coarse_starts(run, task.volume, task.frames),
    )
    records, reports = {}, dict[str, FrameReport]()
    for place, (frame, stylized) in enumerate(zip(task.frames, results, strict=True)):
        progress.writing(frame.source.time_code, place)
        with clock.part("writing"):
            hashes = source_hashes[frame.file_name]
            name, record = write_result(opened, task, frame, stylized, hashes)
        records[name] = record
        reports[frame.file_name] = FrameReport.from_json(record["report"])
        told = find_written(frame.file_name, reports, before.get(frame.file_name))
        progress.found(frame.source.time_code, place, told)
        give_back_memory()
    manifest = WindowRecord(
        run_id=run.run_id,
        window=task.number,
        volume=task.volume.source.prim_path,
        time_codes=list(task.window.time_codes),
        overlap=list(task.window.overlap),
        frames=records,
        seconds=clock.total,
        timings=clock.parts,
        processor=describe_machine(config.optimize).processor,
    )
    run.keep(manifest)

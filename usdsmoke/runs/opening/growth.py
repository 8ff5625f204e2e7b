"""A look that grows: a result of some frames becomes one of more frames of the same settings.

The scenes, and with them the extinction, are those of the earlier run. Windows whose frames and
starts are the same are taken over; the others are done. The result has the bits of a run of all
frames whose ``optics.frames`` are the earlier run's.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from usdsmoke.base.publish import share_file
from usdsmoke.base.settings import Config
from usdsmoke.base.time_codes import format_time_codes
from usdsmoke.core.sequence.controls import FRAMES_AHEAD
from usdsmoke.planning.job import Job
from usdsmoke.planning.plan import Plan, VolumePlan, WindowTask
from usdsmoke.runs.identity import Identity
from usdsmoke.runs.manifests import CoarseRecord, coarse_file_name, part_file_name
from usdsmoke.runs.run import Run, find_runs
from usdsmoke.usd.look import published_runs


@dataclass(frozen=True)
class Growth:
    """A job that makes a result longer, and the run that it starts from."""

    job: Job  # measured on the frames that the earlier run was measured on
    earlier: Run
    before: Plan  # the earlier run's

    @property
    def note(self) -> str:
        """For the plan."""
        then, now = (_frames_text(plan) for plan in (self.before, self.job.plan))
        codes = self.job.config.optics.frames
        return (
            f"the look grows from the frames {then} to {now}; extinction and picture size stay "
            f"those of {codes}. Windows with the same frames and starts stay, the others are done."
        )


def find_growth(job: Job) -> Growth | None:
    """The growth that a job asks for; None where its output folder holds no result of fewer of its
    frames that is otherwise the same."""
    if job.request.force:
        return None
    asked = {
        (volume.source.prim_path, frame.source.time_code)
        for volume in job.plan.volumes
        for frame in volume.frames
    }
    published = published_runs(job.targets.look_layer)
    for run in find_runs(job.output):
        is_result = run.complete and run.run_id in published
        done = {(frame["prim_path"], frame["time_code"]) for frame in run.frames.values()}
        if not (is_result and run.look == job.config.layer.look and done < asked):
            continue
        codes = format_time_codes(sorted({code for _, code in done}))
        stage = job.config.stage.replace(frames=codes)
        before = job.with_config(job.config.replace(stage=stage))
        if before.plan.n_frames != len(done) or Identity(before).changes(run, whatever_frames=True):
            return None
        measured = run.description["settings"]["optics"].get("frames") or codes
        return Growth(_measured_on(job, measured), run, before.plan)
    return None


def take_over(growth: Growth, run: Run) -> None:
    """Bring what stays the same from the earlier run's folder into that of a run that has begun."""
    run.keep_scenes(growth.earlier.scenes)
    before = {
        (task.volume.source.prim_path, task.window.time_codes): task for task in growth.before.tasks
    }
    starts = _take_over_starts(growth, run)
    for task in growth.job.plan.tasks:
        old = before.get((task.volume.source.prim_path, task.window.time_codes))
        if old is None or not _is_same(task, old, starts):
            continue
        record = growth.earlier.window(old.number)
        if record is None:
            continue
        frames = {}
        for name, frame in record.frames.items():
            other = part_file_name(task.number, Path(name).name) if frame["part"] else name
            share_file(growth.earlier.folder / name, run.folder / other)
            frames[other] = frame
        run.keep(replace(record, run_id=run.run_id, window=task.number, frames=frames))


def _take_over_starts(growth: Growth, run: Run) -> set[str]:
    """Take over the coarse starts that stay the same; their files."""
    earlier = growth.earlier
    before = {volume.source.prim_path: volume for volume in growth.before.volumes}
    names = set()
    for volume in growth.job.plan.volumes:
        old = before.get(volume.source.prim_path)
        chains = () if old is None else old.coarse_runs
        for chain in volume.coarse_runs:
            for codes in chains:
                if codes == chain:
                    names |= _start_names(volume, codes)
                elif codes == chain[: len(codes)]:
                    names |= _start_names(volume, codes[:-FRAMES_AHEAD])
    record = earlier.coarse(names)
    if record.frames:
        for name in record.frames:
            share_file(earlier.folder / name, run.folder / name)
        run.keep(CoarseRecord(run.run_id, record.frames, record.seconds, record.processor))
    return set(record.frames)


def _start_names(volume: VolumePlan, codes: tuple[float, ...]) -> set[str]:
    frames = {frame.source.time_code: frame.file_name for frame in volume.frames}
    return {coarse_file_name(frames[code]) for code in codes}


def _is_same(task: WindowTask, old: WindowTask, starts: set[str]) -> bool:
    """Whether a window gives the same result in both runs.

    Args:
        starts: the coarse starts that are the same.
    """
    if replace(task.window, index=old.number) != old.window:
        return False
    for frame, other in zip(task.frames, old.frames, strict=True):
        if frame.file_name != other.file_name or frame.size.computed != other.size.computed:
            return False
        if task.is_part(frame) != old.is_part(other):
            return False
        has_start = _has_start(task, frame.source.time_code)
        if has_start != _has_start(old, other.source.time_code):
            return False
        if has_start and coarse_file_name(frame.file_name) not in starts:
            return False
    return True


def _has_start(task: WindowTask, code: float) -> bool:
    return any(code in chain for chain in task.volume.coarse_runs)


def _measured_on(job: Job, codes: str) -> Job:
    def settle(config: Config) -> Config:
        return config.replace(optics=config.optics.replace(frames=codes))

    volumes = tuple(replace(volume, config=settle(volume.config)) for volume in job.plan.volumes)
    plan = replace(job.plan, config=settle(job.plan.config), volumes=volumes)
    return replace(job, plan=plan)


def _frames_text(plan: Plan) -> str:
    codes: Mapping[float, None] = dict.fromkeys(
        frame.source.time_code for volume in plan.volumes for frame in volume.frames
    )
    return format_time_codes(codes)

"""A result that goes on: it gets more frames, or some source files have been written again.

The scenes, and with them the extinction, are those of the earlier run. Windows whose frames, source
files and starts are the same are taken over; the others are done, all of them if need be. The
result has the bits of a run of all frames whose ``optics.frames`` are the earlier run's; where a
frame that these name has been written again, of a run with the earlier scenes, which the job and
the record then name.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from usdsmoke.base.errors import UsdSmokeError, count_text
from usdsmoke.base.publish import share_file
from usdsmoke.base.time_codes import format_time_codes
from usdsmoke.config.settings import Config
from usdsmoke.core.sequence.controls import frames_ahead
from usdsmoke.planning.job import Job
from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan, WindowTask
from usdsmoke.runs.changes import Changes
from usdsmoke.runs.coarse import measured_frames
from usdsmoke.runs.identity import Identity, selected_frames
from usdsmoke.runs.manifests import (
    CoarseRecord,
    coarse_file_name,
    network_file_name,
    part_file_name,
)
from usdsmoke.runs.opened import has_coarse_step
from usdsmoke.runs.opening.measured import check_measured, measured_as
from usdsmoke.runs.run import Run, find_runs
from usdsmoke.usd.look import published_runs
from usdsmoke.vdb.header import read_header


@dataclass(frozen=True)
class Growth:
    """A job that a result goes on with, and the run that it starts from."""

    job: Job  # measured on the frames that the earlier run was measured on
    earlier: Run
    before: Plan  # the earlier run's
    rewritten: frozenset[str] = frozenset()  # source files with other content than it read

    @property
    def notes(self) -> Iterator[str]:
        """For the plan: what differs from the result."""
        then, now = (_frames_text(plan.tasks) for plan in (self.before, self.job.plan))
        if then != now:
            yield f"the look grows from the frames {then} to {now}"
        for volume in self.job.plan.volumes:
            if (parts := volume.config.grids.parts) > 1:
                yield f"<{volume.source.prim_path}> stays refined by {parts}"
        if self.rewritten:
            names = sorted(os.path.basename(path) for path in self.rewritten)
            more = f" and {count_text(len(names) - 1, 'more file')}" if names[1:] else ""
            has = "have" if names[1:] else "has"
            yield f"{names[0]}{more} {has} other content than when the look was made"

    @property
    def to_do(self) -> list[WindowTask]:
        """The windows that do not stay."""
        return [task for task, _, why in self._fates if why]

    @property
    def is_all_new(self) -> bool:
        """Whether every frame is read from a file with other content."""
        volumes = self.job.plan.volumes
        return all(self._is_rewritten(frame) for volume in volumes for frame in volume.frames)

    @cached_property
    def starts(self) -> set[str]:
        """The files of the coarse starts that stay the same and are there, or are not needed."""
        before = {volume.source.prim_path: volume for volume in self.before.volumes}
        names = set()
        for volume in self.job.plan.volumes:
            old = before.get(volume.source.prim_path)
            frames = {frame.source.time_code: frame for frame in volume.frames}
            for chain in volume.coarse_runs:
                for codes in () if old is None else old.coarse_runs:
                    if codes == chain[: len(codes)]:
                        same = self._same_starts(codes, chain, volume)
                        names |= {coarse_file_name(frames[code].file_name) for code in same}
        without = {
            volume.source.prim_path
            for number, volume in enumerate(self.before.volumes)
            if volume.coarse_runs and not has_coarse_step(self.earlier, number, volume)
        }
        not_needed = {
            coarse_file_name(frame.file_name)
            for volume in self.job.plan.volumes
            if volume.source.prim_path in without
            for frame in volume.frames
        }
        return not_needed | {name for name in names if (self.earlier.folder / name).is_file()}

    def _same_starts(
        self, codes: Sequence[float], chain: Sequence[float], volume: VolumePlan
    ) -> Sequence[float]:
        """The timeCodes before all that is new in a sequence, as far as starts look ahead."""
        frames = {frame.source.time_code: frame for frame in volume.frames}
        others = (n for n, code in enumerate(codes) if self._is_rewritten(frames[code]))
        end = next(others, len(codes) if len(codes) < len(chain) else None)
        if end is None:
            return codes
        ahead = frames_ahead(volume.config, (frames[code].source.controls for code in chain))
        return codes[: max(end - ahead, 0)]

    def _is_rewritten(self, frame: FramePlan) -> bool:
        return bool(frame.files & self.rewritten)

    @cached_property
    def windows(self) -> list[tuple[WindowTask, WindowTask]]:
        """The windows that stay the same, each with the earlier run's."""
        return [(task, old) for task, old, why in self._fates if old is not None and not why]

    @property
    def finished_again(self) -> dict[str, set[float]]:
        """The finished timeCodes that are computed again, by the reason."""
        done = {
            (volume.source.prim_path, frame.source.time_code)
            for volume in self.before.volumes
            for frame in volume.frames
        }
        found: dict[str, set[float]] = {}
        for task, _, why in self._fates:
            prim = task.volume.source.prim_path
            codes = {code for code in task.window.time_codes if (prim, code) in done}
            if why and codes:
                found.setdefault(why, set()).update(codes)
        return found

    @cached_property
    def _fates(self) -> list[tuple[WindowTask, WindowTask | None, str]]:
        """Every window, the earlier run's of the same frames, and why it is computed again; ""
        where it stays."""
        before = {
            (task.volume.source.prim_path, task.window.time_codes): task
            for task in self.before.tasks
        }
        fates = []
        for task in self.job.plan.tasks:
            old = before.get((task.volume.source.prim_path, task.window.time_codes))
            fates.append((task, old, self._why_again(task, old)))
        return fates

    def _why_again(self, task: WindowTask, old: WindowTask | None) -> str:
        if any(self._is_rewritten(frame) for frame in task.frames):
            return "files of their window have other content"
        if old is None:
            return "their window has other frames now"
        if why := _difference(task, old, self.starts):
            return why
        if not self._is_there(old) or (self.rewritten and not self._has_copies(task)):
            return "files of the earlier run are gone, or hold other grids"
        return ""

    def _is_there(self, old: WindowTask) -> bool:
        names = [
            part_file_name(old.number, frame.file_name) if old.is_part(frame) else frame.file_name
            for frame in old.frames
        ]
        return all((self.earlier.folder / name).is_file() for name in names)

    def _has_copies(self, task: WindowTask) -> bool:
        """Whether the grids beside the density that a window has are those it would get now: a file
        that was written again may have fewer or more, and all frames get the same."""
        copies, left_out = {grid.name for grid in task.frames[0].others}, task.volume.not_copied
        if not copies and not left_out:
            return True
        try:
            grids = read_header(self.earlier.folder / task.frames[0].file_name).grids
        except UsdSmokeError:
            return False
        names = {grid.name for grid in grids}
        return copies <= names and not names & left_out.keys()

    @property
    def is_measured(self) -> bool:
        """Whether measuring the scenes again would give the earlier run's: no frame that they are
        measured on has other content.

        Frames without smoke are not measured, so one that was empty or is empty now may change
        which frames are.
        """
        for volume in self.job.plan.volumes:
            others = [frame for frame in volume.frames if self._is_rewritten(frame)]
            measured = {frame.file_name for frame in measured_frames(volume)}
            for frame in others:
                was = self.earlier.frames.get(frame.file_name)
                was_empty = was is not None and was["extent_min"] is None
                if frame.is_empty or was_empty or frame.file_name in measured:
                    return False
        return True


def find_growth(job: Job) -> Growth | None:
    """The growth that a job asks for.

    None where its output folder holds no result of fewer of its frames, or of all of them with
    other content in some source files, that is otherwise the same; and where every frame is read
    from a file with other content.

    Raises:
        OutputExists: the result has no smoke of a Volume that has some now.
        PlanError: this machine has too little memory for the voxels that it was begun with.
    """
    if job.request.force:
        return None
    asked = _codes(job.plan)
    published = published_runs(job.targets.look_layer)
    for run in find_runs(job.output):
        is_result = run.complete and run.run_id in published
        done = _done(run)
        if not (is_result and run.look == job.config.layer.look and done <= asked):
            continue
        before = _with_frames_of(job, run)
        if before is None:
            return None
        changes = Identity(before).changes(run, whatever_frames=True)
        if not (changes.only_files if changes else done < asked):
            return None
        check_measured(job, before.plan, run)
        recorded = run.description["settings"]["optics"].get("frames")
        measured = recorded or (_text(done) if done < asked else "")
        folder = Path(job.plan.source.file_path).parent
        files = job.plan.source.grid_files
        rewritten = frozenset(f for f in files if os.path.relpath(f, folder) in changes.files)
        growth = Growth(measured_as(job, run, measured), run, before.plan, rewritten)
        if rewritten and growth.is_all_new:
            return None
        if run.description.get("scenes") or not growth.is_measured:
            growth = replace(growth, job=replace(growth.job, scenes=tuple(run.scenes)))
        return growth
    return None


def compare_run(job: Job, run: Run) -> Changes:
    """What differs between a job and a run.

    Of other frames than the run's, what would differ of the run's own frames comes first; that the
    frames differ is no reason to refuse where all of the run's are among the job's.
    """
    changes = Identity(job).changes(run)
    if not changes.frames:
        return changes
    before = _with_frames_of(job, run)
    own = Identity(before).changes(run, whatever_frames=True) if before is not None else Changes()
    if not own:
        return changes
    if _done(run) <= _codes(job.plan):
        return own
    return replace(own, words=(*own.words, changes.words[0]), frames=True, only_files=False)


def continued(job: Job) -> Job:
    """The job of a task with the frames of the unfinished run that it is a part of.

    A stage may get more frames while tasks of a run of all frames are at work.
    """
    if job.config.stage.frames or job.request.force:
        return job
    for run in find_runs(job.output):
        frames = run.description["settings"]["stage"]["frames"]
        if run.complete or frames == selected_frames(job.plan):
            continue
        with suppress(UsdSmokeError):  # the stage does not have them any more
            before = job.with_config(_selecting(job, frames))
            if Identity(before).is_of(run):
                return before
    return job


def result_frames(job: Job, run: Run) -> str:
    """``stage.frames`` that selects the frames of a result: as it was given, if it still does."""
    given = str(run.request.get("config", {}).get("stage", {}).get("frames", ""))
    if given:
        return given
    with suppress(UsdSmokeError):  # files of other frames may be missing
        if has_frames_of(job.with_config(_selecting(job, "")), run):
            return ""
    return _text(_done(run))


def has_frames_of(job: Job, run: Run) -> bool:
    """Whether a job has the frames of a result, no more and no fewer."""
    return _codes(job.plan) == _done(run)


def _with_frames_of(job: Job, run: Run) -> Job | None:
    """The job with the frames of a run; None where the stage does not have them all."""
    done = _done(run)
    if has_frames_of(job, run):
        return job
    try:  # of these frames nothing is computed: they need no memory
        before = replace(job, fits=False).with_config(_selecting(job, _text(done)))
    except UsdSmokeError:
        return None
    return before if has_frames_of(before, run) else None


def _selecting(job: Job, frames: str) -> Config:
    return job.config.replace(stage=job.config.stage.replace(frames=frames))


def _done(run: Run) -> set[tuple[str, float]]:
    """The frames of a run, by Volume and timeCode."""
    return {(frame["prim_path"], frame["time_code"]) for frame in run.frames.values()}


def _codes(plan: Plan) -> set[tuple[str, float]]:
    return {
        (volume.source.prim_path, frame.source.time_code)
        for volume in plan.volumes
        for frame in volume.frames
    }


def _text(places: set[tuple[str, float]]) -> str:
    return format_time_codes(sorted({code for _, code in places}))


def take_over(growth: Growth, run: Run) -> None:
    """Bring what stays the same from the earlier run's folder into that of a run that has begun."""
    for number, scene in enumerate(growth.earlier.scenes):
        if scene.get("network"):
            name = network_file_name(number)
            share_file(growth.earlier.folder / name, run.folder / name)
    run.keep_scenes(growth.earlier.scenes)
    _take_over_starts(growth, run)
    for task, old in growth.windows:
        record = growth.earlier.window(old.number)
        if record is None:
            continue
        frames = {}
        for name, frame in record.frames.items():
            other = part_file_name(task.number, Path(name).name) if frame["part"] else name
            share_file(growth.earlier.folder / name, run.folder / other)
            frames[other] = frame
        run.keep(replace(record, run_id=run.run_id, window=task.number, frames=frames))


def _take_over_starts(growth: Growth, run: Run) -> None:
    earlier = growth.earlier
    record = earlier.coarse(growth.starts)
    if record.frames:
        for name in record.frames:
            share_file(earlier.folder / name, run.folder / name)
        run.keep(CoarseRecord(run.run_id, record.frames, record.seconds, record.processor))


def _difference(task: WindowTask, old: WindowTask, starts: set[str]) -> str:
    """Why a window of the same frames gives another result than before; "" where it does not.

    Args:
        starts: the coarse starts that are the same.
    """
    if replace(task.window, index=old.number) != old.window:
        return "their window shares other frames with its neighbours now"
    for frame, other in zip(task.frames, old.frames, strict=True):
        if frame.file_name != other.file_name or frame.size.computed != other.size.computed:
            return "a neighbour has another strength, or files have other names"
        if task.is_part(frame) != old.is_part(other):
            return "their window shares other frames with its neighbours now"
        has_start = _has_start(task, frame.source.time_code)
        if has_start != _has_start(old, other.source.time_code):
            return "there are several windows now, which start from a coarse step"
        if has_start and coarse_file_name(frame.file_name) not in starts:
            return "the coarse step that they start from goes on, or has other files"
    return ""


def _has_start(task: WindowTask, code: float) -> bool:
    return any(code in chain for chain in task.volume.coarse_runs)


def _frames_text(tasks: Sequence[WindowTask]) -> str:
    return format_time_codes(sorted({code for task in tasks for code in task.window.time_codes}))

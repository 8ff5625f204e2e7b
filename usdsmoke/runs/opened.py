"""A run that this process works on: what is left to do, whether it fits the disk, how far it is."""

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

from usdsmoke.base.locks import OutputLock
from usdsmoke.planning.estimate import written_bytes
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.job import Job, describe_request
from usdsmoke.planning.make_plan import check_disk
from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan, WindowTask
from usdsmoke.runs.manifests import coarse_file_name
from usdsmoke.runs.run import Run
from usdsmoke.runs.run_machine import machine_of


@dataclass
class OpenRun:
    """A run that this process works on, with what it needs for that."""

    run: Run
    job: Job  # with what the run has settled of the machine
    lock: OutputLock  # on the output folder
    redo: Collection[int] = ()  # windows that are to be done though they are finished
    task: str = ""  # the one that is done here, such as "window 3"; "": the whole run

    @cached_property
    def reader(self) -> FrameReader:
        """Of the source's frames."""
        return FrameReader(self.job.plan)

    @property
    def plan(self) -> Plan:
        """The job's."""
        return self.job.plan

    @cached_property
    def unfinished(self) -> list[WindowTask]:
        """The windows that are to be done, as the run was opened."""
        return [
            task
            for task in self.plan.tasks
            if task.number in self.redo or self.run.window(task.number) is None
        ]

    def begin(self) -> None:
        """Make the run's record, or use what another process has begun.

        Raises:
            ConfigError: the device is not there.
            WriteFailed: the operating system refused.
        """
        if self.run.has_begun or self.run.adopt():
            self.run.tidy(self.lock.excludes_others)
            return
        described = self.plan.to_dict()
        # What of the plan stays with the result: nothing that names folders of this machine.
        plan = {
            key: described[key] for key in ("windows", "needed", "omitted", "notes", "estimate")
        }
        self.run.begin(plan, describe_request(self.job), machine_of(self.job).processor)

    def check_disk(self, tasks: Collection[WindowTask], whole: bool = False) -> None:
        """Refuse tasks that do not fit the disk.

        Args:
            tasks: the windows that are to be done; none for the coarse step alone.
            whole: the result is to be assembled too.

        Raises:
            PlanError: with what is needed and what there is.
        """
        run, todo = self.run, {id(frame) for task in tasks for frame in task.frames}
        is_part = bool(tasks) and not whole
        frames = [frame for task in tasks for frame in task.frames] if is_part else None
        chains = missing_starts(run, self.plan, frames)
        starts = {id(frame) for _, _, chain in chains for frame in chain}
        n_bytes = 0
        for number, volume in enumerate(self.plan.volumes):
            twice = {id(frame) for frame in volume.overlap_frames}
            own = [task for task in tasks if task.volume_number == number]
            parts = [f.size for task in own for f in task.frames if id(f) in twice]
            once = [f for f in volume.frames if id(f) in todo - twice]
            blended = [
                f for f in volume.overlap_frames if whole and run.finished(f.file_name) is None
            ]
            coarse = [f.size for f in volume.frames if id(f) in starts]
            written = [f.size for f in (*once, *blended)]
            n_bytes += written_bytes(volume.config, written, parts, coarse)
        check_disk(self.job.output, n_bytes, not run.is_useless())

    def how_far(self) -> str:
        """How much of the run is finished, and how to continue."""
        if self.task:
            return f"stopped in {self.task}. Run the command again."
        if self.run.is_useless():
            return "stopped before the first frame was finished."
        tasks = self.plan.tasks
        done = {task.number for task in tasks if self.run.window(task.number) is not None}
        n_frames = sum(
            task.number in done or (self.run.folder / frame.file_name).is_file()
            for task in tasks
            for frame in task.frames[: len(task.window.time_codes)]  # without those of the overlap
        )
        more = " and a part of others" if self.run.has_checkpoints else ""
        return (
            f"stopped with {n_frames} of {self.plan.n_frames} frames finished, {len(done)} of "
            f"{len(tasks)} windows{more}, in {self.run.folder}. Run the same command again to "
            "continue."
        )


def missing_starts(
    run: Run, plan: Plan, requested: Collection[FramePlan] | None = None
) -> list[tuple[int, VolumePlan, tuple[FramePlan, ...]]]:
    """Volume number, Volume and frames of every sequence in which a coarse start is missing.

    Args:
        requested: the frames whose starts are checked; None: all.
    """
    names = (
        None if requested is None else {coarse_file_name(frame.file_name) for frame in requested}
    )
    record = run.coarse(names)
    to_do = []
    for number, volume in enumerate(plan.volumes):
        if not has_coarse_step(run, number, volume):
            continue
        frames = {frame.source.time_code: frame for frame in volume.frames}
        for codes in volume.coarse_runs:
            chain = tuple(frames[code] for code in codes)
            starts = {coarse_file_name(frame.file_name) for frame in chain}
            if (starts if names is None else starts & names) - record.frames.keys():
                to_do.append((number, volume, chain))
    return to_do


def has_coarse_step(run: Run, volume_number: int, volume: VolumePlan) -> bool:
    """Whether a Volume's windows share a coarse step; also where a network should have painted, but
    does not suit the smoke."""
    is_cold = bool(run.scenes and run.scenes[volume_number].get("misfit"))
    return bool(volume.coarse_runs) and (is_cold or not volume.starts_from_network)

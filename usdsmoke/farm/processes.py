"""Windows of a run as processes of this machine, side by side.

Windows do not depend on each other, and several processes with one thread each finish sooner than
one process with several threads. The result has the same bits, whatever their number.
"""

import multiprocessing
import os
import signal
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path

from usdsmoke.base.errors import ClusterError, Interrupted, PlanError, UsdSmokeError, lacks_memory
from usdsmoke.base.machine import (
    available_memory_gib,
    limit_cpus,
    seems_to_have_gpu,
    usable_cpus,
)
from usdsmoke.base.naming import find_run_files
from usdsmoke.farm.tasks import Tasks, divide_job
from usdsmoke.pipeline import (
    Request,
    StylizeResult,
    assemble,
    plan_with_notes,
    prepare,
    stylize_job,
)
from usdsmoke.planning.plan import Plan
from usdsmoke.runs.budget import PartClock
from usdsmoke.runs.progress import RunProgress, RunProgressCallback, ignore_progress

SHORT_S = 40.0  # estimated time of a run that one process does
_END_S = 20.0  # for a process to tidy up after it was stopped


def choose_jobs(plan: Plan) -> int:
    """Processes that compute a plan's windows: as many as processors and memory allow.

    A short run is done by one: every process loads torch and learns the style's features. So is a
    run on a GPU, whose memory the plan does not know.
    """
    device = plan.config.optimize.device
    on_gpu = device.startswith("cuda") or (device == "auto" and seems_to_have_gpu())
    if plan.estimate.seconds < SHORT_S or on_gpu:
        return 1
    by_memory = int(available_memory_gib() / plan.estimate.memory_gib)
    return max(1, min(len(plan.tasks), usable_cpus(), by_memory))


def with_jobs(plan: Plan, jobs: int) -> Plan:
    """The plan with a note on the processes that compute it."""
    if jobs < 2:
        return plan
    note = f"{jobs} windows are computed at once, in processes of their own (--jobs)"
    return replace(plan, notes=(*plan.notes, note))


def stylize_in_processes(
    jobs: int | None,
    request: Request,
    progress: RunProgressCallback | None = None,
    planned: Callable[[Plan], None] | None = None,
) -> StylizeResult:
    """``stylize`` with its windows computed by several processes of this machine; the same bits.

    The processes divide the machine's processors among themselves, and have a thread for each, up
    to four, unless ``optimize.threads`` says how many.

    Args:
        jobs: processes; no more are started than there are windows. None: see ``choose_jobs``; a
            single one is this process itself.
        progress: called often, with how far the run is.
        planned: called once with the plan.

    Raises:
        PlanError: the processes together need more memory than is available.
        OutputExists: a finished result is in the way.
        ClusterError: a process ended without an answer.
        UsdSmokeError: the errors of ``stylize``, also if they occur in a process.
        Interrupted: by Ctrl-C.
    """
    clock = PartClock()
    with clock.part("preparing"):
        job = prepare(request)
        found = plan_with_notes(job)
        n_processes = jobs or choose_jobs(found)
    if n_processes > 1:
        tasks = divide_job(job)
        n_processes = min(n_processes, len(tasks.windows))
    if n_processes > 1:
        _check_memory(tasks.plan, n_processes)
    if planned is not None:
        planned(with_jobs(found, n_processes))
    if n_processes < 2:
        return stylize_job(job, progress, clock)
    tell = progress or ignore_progress
    pool = _Pool(tasks, tell)
    try:
        pool.run([None], 1)
        pool.run(list(tasks.windows), n_processes)
    except KeyboardInterrupt:
        pool.end()  # what is left of a run is seen behind that
        output = Path(tasks.request.output)
        if not find_run_files(output):
            raise Interrupted(
                "stopped before anything was done. Nothing was left behind."
            ) from None
        raise Interrupted(
            f"stopped with {pool.n_done} of {len(tasks.windows)} windows finished in {output}. "
            "Run the same command again to continue."
        ) from None
    finally:
        pool.end()
    layer = tasks.plan.config.layer
    return assemble(tasks.request.output, progress, layer.look, layer.mode)


def _check_memory(plan: Plan, n_processes: int) -> None:
    needed, there = plan.estimate.memory_gib * n_processes, available_memory_gib()
    if needed > there:
        raise PlanError(
            f"{n_processes} processes need about {needed:.1f} GiB of memory ({there:.1f} GiB "
            f"available). Pass --jobs {max(int(there / plan.estimate.memory_gib), 1)}."
        )


@dataclass(frozen=True)
class _Unexpected:
    """An error of a process that usdsmoke does not know, which may not be one that can be sent."""

    text: str
    trace: str


class _Pool:
    """Processes that each do one window after another."""

    def __init__(self, tasks: Tasks, tell: RunProgressCallback) -> None:
        self.n_done = 0  # windows
        self._tasks, self._tell = tasks, tell
        self._idle: list[tuple[Connection, SpawnProcess]] = []
        self._busy: dict[Connection, tuple[int | None, SpawnProcess]] = {}
        self._before = 0.0  # share of the run that training and coarse step are
        self._shares: dict[int, float] = {}

    def run(self, windows: Sequence[int | None], n_processes: int) -> None:
        """Do windows, or the coarse step (None), with some processes; returns at the end."""
        waiting = list(windows)
        while waiting or self._busy:
            while waiting and len(self._busy) < n_processes:
                connection, process = self._idle.pop() if self._idle else self._start()
                connection.send((waiting[0], max(usable_cpus() // n_processes, 1)))
                self._busy[connection] = (waiting.pop(0), process)
            for item in wait(list(self._busy)):
                assert isinstance(item, Connection)
                self._hear(item)

    def end(self) -> None:
        """Stop all processes, and wait until they have tidied up."""
        for _, process in self._busy.values():
            if process.pid is not None and process.is_alive():
                os.kill(process.pid, signal.SIGTERM)
        everyone = [*self._idle, *((item, process) for item, (_, process) in self._busy.items())]
        for connection, _ in everyone:
            connection.close()
        for _, process in everyone:
            process.join(_END_S)
            process.kill()
        self._idle, self._busy = [], {}

    def _start(self) -> tuple[Connection, SpawnProcess]:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_work, args=(theirs, self._tasks), daemon=True)
        # A terminal's Ctrl-C goes to all processes, and this one stops the others: they do not take
        # it, also while they load their modules. Python's own helper process comes first, as its
        # start lets signals through again.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        return ours, process

    def _hear(self, connection: Connection) -> None:
        """Take one message of a process: its progress, its error, or the end of its task."""
        window, process = self._busy[connection]
        try:
            message = connection.recv()
        except (EOFError, ConnectionError):
            process.join(_END_S)
            raise ClusterError(
                f"{self._name(window)} failed: its process ended with exit code "
                f"{process.exitcode}. If memory ran out, pass fewer --jobs. Finished windows are "
                "kept: run the same command again."
            ) from None
        if isinstance(message, UsdSmokeError):
            raise message
        if isinstance(message, _Unexpected):
            error = RuntimeError(
                f"{self._name(window)} failed: {message.text}. Finished windows are kept"
            )
            error.details = message.trace  # type: ignore[attr-defined]
            raise error
        if isinstance(message, RunProgress):
            self._report(window, message)
            return
        self._idle.append((connection, self._busy.pop(connection)[1]))
        if window is not None:
            self.n_done += 1
            self._shares[window] = 1.0

    @staticmethod
    def _name(window: int | None) -> str:
        return "the coarse step" if window is None else f"window {window}"

    def _report(self, window: int | None, report: RunProgress) -> None:
        """Progress of one window as progress of the run."""
        if window is None:
            self._before = max(report.share, self._before)
            self._tell(replace(report, share=self._before))
            return
        self._shares[window] = max(report.share, self._shares.get(window, 0.0))
        done = sum(self._shares.values()) / len(self._tasks.windows)
        share = self._before + (1 - self._before) * done
        self._tell(replace(report, share=share, window=window))


def _work(connection: Connection, tasks: Tasks) -> None:
    """The life of a process: windows come in, progress goes out, then None or an error."""
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # see ``_Pool._start``
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        while True:
            window, n_cpus = connection.recv()
            limit_cpus(n_cpus)
            try:
                tasks.run(window, connection.send)
            except UsdSmokeError as error:
                connection.send(error)
            except Exception as error:
                if lacks_memory(error):
                    raise  # the process ends, and what is told is why that may be
                text = f"{type(error).__name__}: {error}"
                connection.send(_Unexpected(text, traceback.format_exc()))
            else:
                connection.send(None)
    except (EOFError, ConnectionError, KeyboardInterrupt):
        return  # the run has ended

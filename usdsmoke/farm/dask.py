"""Windows of a run as tasks of an existing Dask cluster, without a render farm.

Each task reads the inputs and writes its window into the output folder itself, so only names are
sent over the network. If a worker dies, only its current window is lost, and Dask gives it to
another worker.
"""

import asyncio
import logging
import socket
import struct
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from usdsmoke import __version__
from usdsmoke.base.errors import (
    ClusterError,
    FileUnreadable,
    Interrupted,
    UsdSmokeError,
    WriteFailed,
)
from usdsmoke.base.machine import check_packages
from usdsmoke.base.publish import make_folders, publish_file, remove_empty
from usdsmoke.farm.tasks import Tasks, divide_run
from usdsmoke.pipeline import Request, StylizeResult, assemble
from usdsmoke.planning.plan import Plan
from usdsmoke.runs.progress import RunProgress, RunProgressCallback, ignore_progress

if TYPE_CHECKING:
    from distributed import Client, Future

# distributed raises asyncio's, which is a class of its own before Python 3.11
_LATE = (TimeoutError, asyncio.TimeoutError)
_CONNECT_S = 5.0  # for the scheduler to answer
_WORKERS_S = 10.0  # for the first worker to appear
_LOST_S = 60.0  # without any worker, after which the run stops
_POLL_S = 2.0
_VISIBLE_S = 5.0  # for a new file to appear on another machine
_RETRIES = 2  # of a task that failed for a temporary reason
_LONGEST_GREETING = 2**20  # bytes; a scheduler's has about 100
_PACKAGES = ("torch", "numpy")  # their versions determine the last bits of a result
_LOUD = ("distributed", "tornado")  # loggers that print tracebacks when a connection breaks

_one_at_a_time = threading.Lock()  # threads and determinism of torch belong to the whole process


def stylize_on_cluster(
    address: str,
    request: Request,
    progress: RunProgressCallback | None = None,
    planned: Callable[[Plan], None] | None = None,
) -> StylizeResult:
    """``stylize`` with its windows computed by the workers of a Dask cluster; the same bits.

    The coarse step is one task, then every window is one; the result is assembled here. Workers
    need the same usdsmoke and see the inputs and the output folder under the same paths.

    Args:
        address: of the scheduler, ``tcp://HOST:PORT``.
        progress: called when a step or a window is finished.
        planned: called once with the plan, before the cluster is contacted.

    Raises:
        MissingPackage: distributed is not installed; the plan is not made then.
        ClusterError: the cluster cannot be reached or used, or lost its workers.
        UsdSmokeError: the errors of ``stylize``, also if they occur in a task.
        Interrupted: by Ctrl-C; workers finish their current windows.
    """
    check_packages("distributed")
    tasks = divide_run(request, planned)
    with _connected(address) as client:
        notes = _check_workers(client, tasks.request, tasks.plan)
        _compute(client, tasks, progress or ignore_progress)
    layer = tasks.plan.config.layer
    result = assemble(tasks.request.output, progress, layer.look, layer.mode)
    return replace(result, warnings=(*result.warnings, *notes))


def _compute(client: "Client", tasks: Tasks, tell: RunProgressCallback) -> None:
    """The coarse step, then all windows; the first error ends the run."""
    starts = tasks.windows
    to_do, n_done = list(starts), 0
    futures: list[Future] = []

    def begin(numbers: Sequence[int | None]) -> list["Future"]:
        with _asking():
            key = f"usdsmoke-{uuid.uuid4().hex}"
            submitted = client.map(
                _run_task, numbers, tasks=tasks,
                key=[f"{key}-{number}" for number in numbers], retries=_RETRIES,
            )  # fmt: skip
        futures.extend(submitted)
        return submitted

    try:
        for _ in _finished(client, begin([None]), ["the coarse step"]):
            tell(RunProgress("coarse", starts[to_do[0]], 0, len(to_do), 0.0))
        names = [f"window {number}" for number in to_do]
        for place in _finished(client, begin(to_do), names):
            n_done += 1
            share = n_done / len(to_do)
            tell(RunProgress("window", starts[to_do[place]], n_done - 1, len(to_do), share))
    except KeyboardInterrupt:
        raise Interrupted(
            f"stopped with {n_done} of {len(to_do)} windows finished in {tasks.request.output}. "
            "Run the same command again to continue."
        ) from None
    finally:
        with suppress(Exception):  # the scheduler may have ended
            client.cancel([future for future in futures if not future.done()])


def _run_task(window: int | None, tasks: Tasks) -> UsdSmokeError | None:
    """On a worker: one window, or the coarse step; returns an error that a retry cannot avoid."""
    with _one_at_a_time:
        try:
            tasks.run(window)
        except (WriteFailed, FileUnreadable):
            raise  # a retry may succeed: a full disk, a file server
        except UsdSmokeError as error:
            return error
    return None


def _finished(client: "Client", futures: Sequence["Future"], names: Sequence[str]) -> Iterator[int]:
    """The indices of futures as they succeed; the first error of one is raised.

    A lost scheduler and a cluster without workers are errors too.
    """
    from distributed import wait

    waiting, seen = dict(zip(futures, range(len(futures)), strict=True)), time.monotonic()
    while waiting:
        with suppress(*_LATE), _asking(limited=True):
            wait(list(waiting), timeout=_POLL_S, return_when="FIRST_COMPLETED")
        for future in [future for future in waiting if future.done()]:
            if _succeeded(future, names[waiting[future]]):
                seen = time.monotonic()
                yield waiting.pop(future)
        with _asking():
            workers = client.nthreads()
        if workers:
            seen = time.monotonic()
        elif time.monotonic() - seen > _LOST_S:
            raise _lost(f"the Dask cluster has had no workers for {_LOST_S:.0f} s")


def _succeeded(future: "Future", name: str) -> bool:
    """Raise a task's error; False if its worker died before it could report one."""
    from distributed.scheduler import KilledWorker

    try:
        with _asking(limited=True):
            failure = future.exception(timeout=_POLL_S)
            failure = failure or future.result(timeout=_POLL_S)
    except _LATE:
        return False
    if isinstance(failure, KilledWorker):
        raise _lost(
            f"{name} failed: every worker that ran it stopped (see their logs). If memory ran "
            "out, give the workers more, or lower views.pool, views.image_size or grids.refine"
        )
    if failure is not None:
        raise failure
    return True


# Workers


def _check_workers(client: "Client", request: Request, found: Plan) -> list[str]:
    """Refuse workers that would give another result or none; returns notes for the user."""
    try:
        with _asking(limited=True):
            client.wait_for_workers(1, timeout=_WORKERS_S)
    except _LATE:
        raise _no_workers() from None
    output = Path(request.output)
    made, token = make_folders(output), output / f".usdsmoke-{uuid.uuid4().hex}"
    images = [image for volume in found.volumes for image in volume.source.request.styles]
    styles: Any = request.style
    try:
        publish_file(token, lambda path: path.touch())
        with _asking():
            files = [str(token), str(request.stage), *styles, *images]
            answers = client.run(_look_around, files, on_error="return")
            n_threads = client.nthreads()
    finally:
        token.unlink(missing_ok=True)
        remove_empty(made)
    answers = {worker: answer for worker, answer in answers.items() if worker in n_threads}
    if not answers:  # all workers have ended meanwhile
        raise _no_workers()
    notes = [n for worker in sorted(answers) for n in _check_answer(worker, answers[worker])]
    several = sorted(worker for worker, threads in n_threads.items() if threads > 1)
    if several:
        notes.append(
            f"windows run one after another in a worker process, and {several[0]} has several "
            "threads. Use --nthreads 1 and more workers to distribute them more evenly."
        )
    return notes


def _look_around(files: Sequence[str]) -> dict[str, Any]:
    """On a worker: its versions, and which of some files it does not see."""
    until = time.monotonic() + _VISIBLE_S
    while (missing := [f for f in files if not Path(f).is_file()]) and time.monotonic() < until:
        time.sleep(0.1)
    packages = {name: _package_version(name) for name in _PACKAGES}
    return {"version": __version__, "packages": packages, "missing": missing}


def _check_answer(worker: str, answer: Any) -> list[str]:
    """Refuse a worker of another version, or on another file system.

    Args:
        worker: its address.
        answer: of ``_look_around`` there, or an exception.
    """
    if isinstance(answer, BaseException):
        raise ClusterError(
            f"the worker {worker} cannot load usdsmoke {__version__} "
            f"({type(answer).__name__}: {answer}). Install this version there."
        )
    if answer["version"] != __version__:
        raise ClusterError(
            f"the worker {worker} has usdsmoke {answer['version']}, this machine {__version__}. "
            "Install the same version on both."
        )
    if answer["missing"]:
        raise ClusterError(
            f"the worker {worker} does not see {answer['missing'][0]}. Put the inputs and the "
            "output folder on a file system that all machines see under the same path."
        )
    return [
        f"the worker {worker} has {name} {there}, this machine {_package_version(name)}: "
        "their results may differ in the last bits"
        for name, there in answer["packages"].items()
        if there != _package_version(name)
    ]


def _package_version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"


# The connection


@contextmanager
def _connected(address: str) -> "Iterator[Client]":
    """A client of the scheduler at an address; an error within seconds if there is none."""
    from distributed import Client

    _check_greeting(address)
    with _quiet():
        try:
            client = Client(address, timeout=_CONNECT_S, set_as_default=False)
        except Exception as error:
            raise _no_scheduler(address, " ".join(str(error).split())[:200]) from None
        # Exceptions that were not fetched would be printed later, at garbage collection.
        loop = getattr(client.loop, "asyncio_loop", None)
        if loop is not None:
            loop.set_exception_handler(lambda loop, context: None)
        try:
            with client.as_current():
                yield client
        finally:
            with suppress(Exception):  # the scheduler may have ended
                client.close(timeout=_CONNECT_S)


def _check_greeting(address: str) -> None:
    """Refuse an address without a scheduler.

    Dask itself interprets the first eight bytes of any server as a length and reserves that much
    memory, or waits for them forever. A scheduler sends its greeting first.
    """
    protocol, separator, place = address.partition("://")
    host, _, port = place.rpartition(":")
    if not separator:
        raise ClusterError(f"the cluster {address!r} has no protocol. Give tcp://HOST:PORT.")
    if protocol != "tcp":
        return  # with TLS the client speaks first; Dask knows the other protocols
    try:
        with socket.create_connection((host.strip("[]"), int(port)), _CONNECT_S) as connection:
            connection.settimeout(_CONNECT_S)
            head = connection.recv(8, socket.MSG_WAITALL)
    except (OSError, ValueError, OverflowError) as error:
        raise _no_scheduler(address, str(error)) from None
    if len(head) < 8 or not 0 < struct.unpack("<Q", head)[0] < _LONGEST_GREETING:
        raise _no_scheduler(address, "something else answers there")


@contextmanager
def _asking(limited: bool = False) -> Iterator[None]:
    """Turn every error between this process and the scheduler into a lost connection.

    For calls of the client only: errors of tasks and of this program have their own classes.

    Args:
        limited: the call has a time limit of its own, and may raise TimeoutError.
    """
    try:
        yield
    except (Exception, asyncio.CancelledError) as error:
        if limited and isinstance(error, _LATE):
            raise
        raise _lost("the Dask scheduler has ended or dropped the run") from None


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the tracebacks that Dask logs when a connection breaks; the error is enough."""
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in _LOUD]
    loggers = [logger for logger in map(logging.getLogger, names) if not logger.disabled]
    for logger in loggers:
        logger.disabled = True
    try:
        yield
    finally:
        for logger in loggers:
            logger.disabled = False


def _lost(what: str) -> ClusterError:
    return ClusterError(f"{what}. Finished windows are kept: run the same command again.")


def _no_scheduler(address: str, reason: str) -> ClusterError:
    return ClusterError(
        f"no Dask scheduler answers at {address} ({reason}). Start one with 'dask scheduler', or "
        "check host, port and firewall."
    )


def _no_workers() -> ClusterError:
    return ClusterError(
        "the Dask scheduler has no workers. Start some with 'dask worker --nthreads 1 ADDRESS'."
    )

"""Windows of a run as tasks of an existing Dask cluster, for those without a render farm.

Every task is what a queue would call: it reads the inputs and writes its window into the output
folder by itself, so nothing but names travels over the network, and a worker that dies takes only
the window with it that it was at. The scheduler gives that window to another worker.
"""

import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from usdsmoke.base.config import Config
from usdsmoke.base.errors import (
    ClusterError,
    FileUnreadable,
    Interrupted,
    UsdSmokeError,
    WriteFailed,
)
from usdsmoke.base.given_settings import (
    FilePath,
    Settings,
    Styles,
    explicit_values,
    resolve_settings,
    style_paths,
)
from usdsmoke.base.publish import make_folders, remove_empty
from usdsmoke.farm.dask_check import check_answer, look_around
from usdsmoke.farm.dask_connection import asking, connected, lost
from usdsmoke.pipeline import (
    StylizeResult,
    assemble,
    plan_stylize,
    run_coarse,
    run_window,
)
from usdsmoke.planning.job import Job, prepare_job
from usdsmoke.planning.plan import Plan
from usdsmoke.runs.begin import frames_again
from usdsmoke.runs.machine import settle_threads
from usdsmoke.runs.progress import RunProgress, RunProgressCallback

if TYPE_CHECKING:
    from distributed import Client, Future

__all__ = ["TaskRequest", "stylize_on_cluster"]

_WORKERS_S = 10.0  # for the first worker to appear
_LOST_S = 60.0  # without any worker, after which the run is given up
_POLL_S = 2.0
_RETRIES = 2  # of a task that failed for a reason that may pass

_one_at_a_time = threading.Lock()  # threads and determinism of torch belong to the whole process


@dataclass(frozen=True)
class TaskRequest:
    """What a worker needs to know; paths are absolute and the same on all machines."""

    stage: str
    styles: tuple[str, ...]
    output: str
    config: Config
    explicit: frozenset[str] = frozenset()
    force: bool = False
    again: frozenset[int] = frozenset()  # windows of a result that are to be made once more, alone


def stylize_on_cluster(
    address: str,
    stage: FilePath,
    style: Styles,
    output: FilePath,
    config: Settings = None,
    settings: Mapping[str, Any] | Sequence[str] = (),
    force: bool = False,
    progress: RunProgressCallback | None = None,
    planned: Callable[[Plan], None] | None = None,
) -> StylizeResult:
    """``stylize`` with its windows computed by the workers of a Dask cluster; the same bits.

    The coarse step is one task, then every window is one; the result is assembled here. Workers
    need the same usdsmoke and see the inputs and the output folder under the same paths. A task
    uses ``optimize.threads`` threads, or as many as the run was begun with, or as a plain run here.

    Args:
        address: of the scheduler, ``tcp://HOST:PORT``.
        stage: as in ``stylize``, like those that follow it.
        style: one image file or several; None where every Volume's prim brings its own.
        output: the folder of the result.
        config: settings.
        settings: further ones, stronger than ``config``.
        force: give up what the folder holds of other settings; a result stays whole until the new
            one is there.
        progress: called when a step or a window is finished.
        planned: called once with the plan, before the cluster is asked.

    Raises:
        ClusterError: the cluster cannot be reached or used, or lost its workers.
        UsdSmokeError: what ``stylize`` raises; a task's own error is raised here.
        Interrupted: by Ctrl-C; workers end the windows they are at.
    """
    styles = style_paths(style)
    resolved, explicit = resolve_settings(config, settings)
    plan = plan_stylize(stage, styles, output, config, settings, fits=False)
    if planned is not None:
        planned(plan)
    request = TaskRequest(
        stage=str(Path(stage).absolute()),
        styles=tuple(str(Path(image).absolute()) for image in styles),
        output=str(Path(output).absolute()),
        config=settle_threads(Path(output), resolved, force),  # as here
        explicit=explicit,
        force=force,
    )
    if not force and resolved.stage.frames:
        request, plan = _frames_again(request, plan)
    with connected(address) as client:
        notes = _check_workers(client, request, plan)
        _compute(client, request, plan, progress or (lambda report: None))
    layer = plan.config.layer
    result = assemble(output, progress, layer.look, layer.mode)
    return replace(result, warnings=(*result.warnings, *notes))


def _frames_again(request: TaskRequest, plan: Plan) -> tuple[TaskRequest, Plan]:
    """The whole result's request and plan, where some of its frames are to be made once more."""

    def prepare(config: Config) -> Job:
        return prepare_job(
            request.stage, request.styles, Path(request.output), config, False, request.explicit
        )

    found = frames_again(prepare(plan.config), prepare)
    if found is None:
        return request, plan
    whole, _, numbers = found
    return replace(request, config=whole.config, again=frozenset(numbers)), whole.plan


def _check_workers(client: "Client", request: TaskRequest, plan: Plan) -> list[str]:
    """Refuse workers that would give another result or none; what is worth knowing otherwise."""
    try:
        with asking(limited=True):
            client.wait_for_workers(1, timeout=_WORKERS_S)
    except TimeoutError:
        raise _no_workers() from None
    made = make_folders(Path(request.output))
    token = uuid.uuid4().hex
    token_path = Path(request.output) / f".usdsmoke-{token}"
    try:
        _write_token(token_path, token)
        asked_for = [image for volume in plan.volumes for image in volume.source.request.styles]
        files = [request.stage, *request.styles, *asked_for]
        with asking():
            answers = client.run(look_around, str(token_path), files, on_error="return")
            n_threads = client.nthreads()
    finally:
        token_path.unlink(missing_ok=True)
        remove_empty(made)
    answers = {worker: answer for worker, answer in answers.items() if worker in n_threads}
    if not answers:  # those that are gone meanwhile have nothing to say
        raise _no_workers()
    notes = []
    for worker, answer in sorted(answers.items()):
        notes += check_answer(worker, answer, token, request.output)
    several = sorted(worker for worker, threads in n_threads.items() if threads > 1)
    if several:
        notes.append(
            f"windows run one after another in a worker process, and {several[0]} has several "
            "threads; with --nthreads 1 and more workers they are shared out more evenly"
        )
    return notes


def _compute(client: "Client", request: TaskRequest, plan: Plan, tell: RunProgressCallback) -> None:
    """The coarse step, then all windows; the first error ends the run."""
    windows = [window for volume in plan.volumes for window in volume.windows]
    starts = {window.index: min(window.time_codes) for window in windows}
    to_do = sorted(request.again or starts)
    n_done = 0
    key = f"usdsmoke-{uuid.uuid4().hex}"
    futures: list[Future] = []

    def begin(window: int | None, name: str) -> "Future":
        with asking():
            future = client.submit(
                _run_task, request, window, key=f"{key}-{name}", retries=_RETRIES
            )
        futures.append(future)
        return future

    try:
        for _ in _completed(client, {begin(None, "coarse"): "the coarse step"}):
            tell(RunProgress("coarse", starts[to_do[0]], 0, len(to_do), 0.0))
        numbers = {begin(number, str(number)): number for number in to_do}
        names = {future: f"window {number}" for future, number in numbers.items()}
        for future in _completed(client, names):
            n_done += 1
            share = n_done / len(to_do)
            tell(RunProgress("window", starts[numbers[future]], n_done - 1, len(to_do), share))
    except KeyboardInterrupt:
        raise Interrupted(
            f"stopped with {n_done} of {len(to_do)} windows finished in {request.output}; "
            "run the same command again to continue"
        ) from None
    finally:
        with suppress(Exception):  # there may be nobody left to be told
            client.cancel([future for future in futures if not future.done()])


def _run_task(request: TaskRequest, window: int | None) -> UsdSmokeError | None:
    """On a worker: one window, or the coarse step; the error that no other try would mend."""
    config = request.config
    settings = explicit_values(config, request.explicit)
    files = (request.stage, request.styles, request.output)
    with _one_at_a_time:
        try:
            if window is None:
                run_coarse(*files, config, settings, force=request.force)
            else:
                run_window(*files, window, config, settings, again=window in request.again)
        except (WriteFailed, FileUnreadable):
            raise  # a file server may be well again the next time
        except UsdSmokeError as error:
            return error
    return None


def _completed(client: "Client", futures: "Mapping[Future, str]") -> "Iterator[Future]":
    """Futures of tasks, named, as these succeed; the first error of one is raised.

    The scheduler's silence and a cluster without workers are errors.
    """
    from distributed import wait

    waiting = set(futures)
    seen = time.monotonic()
    while waiting:
        done: set[Future] = set()
        with suppress(TimeoutError), asking(limited=True):
            done, waiting = wait(waiting, timeout=_POLL_S, return_when="FIRST_COMPLETED")
        known = {future for future in done if _take_outcome(future, futures[future])}
        waiting |= done - known  # their worker died with what they had to say
        yield from known
        with asking():
            workers = client.nthreads()
        if workers or known:
            seen = time.monotonic()
        elif time.monotonic() - seen > _LOST_S:
            raise lost(f"the Dask cluster has had no workers for {_LOST_S:.0f} s")


def _take_outcome(future: "Future", what: str) -> bool:
    """Raise what went wrong in a task; whether its outcome was to be had."""
    from distributed.scheduler import KilledWorker

    try:
        with asking(limited=True):
            failure = future.exception(timeout=_POLL_S)
            refusal = failure or future.result(timeout=_POLL_S)
    except TimeoutError:
        return False
    if isinstance(failure, KilledWorker):
        raise lost(
            f"{what} was given up: every worker that took it died; their logs say why, and often "
            "it is memory: give workers more, or lower views.pool, views.image_size or grids.refine"
        )
    if refusal is not None:
        raise refusal
    return True


def _no_workers() -> ClusterError:
    return ClusterError(
        "the Dask scheduler has no workers; start some with 'dask worker --nthreads 1 ADDRESS'"
    )


def _write_token(token_path: Path, token: str) -> None:
    try:
        token_path.write_text(token, encoding="utf-8")
    except OSError as error:
        raise WriteFailed(
            f"cannot write to {token_path.parent}: {error.strerror or error}; "
            "choose an output folder that may be written to"
        ) from None

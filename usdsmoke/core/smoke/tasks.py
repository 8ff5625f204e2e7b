"""Work shared among threads, with the same bits for any number of them.

torch's own threads split sums, which then round differently for each number of threads. Here work
is split into tasks whose number and order do not depend on the threads; one thread computes a task,
and results are combined in the order of the tasks. torch's own threads are switched off.

This file does not load torch: a preview shares its rays without it.
"""

import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from typing import Any, TypeVar

# seconds until a thread in Python code lets another one go on, which Python sets to 0.005: a thread
# that is done with a product waits that long for the next (decision 028)
SWITCH_INTERVAL = 2e-4

Result = TypeVar("Result")

_here = threading.local()  # .busy: this thread is computing a task, and does not share it again
_helpers: ThreadPoolExecutor | None = None
_helpers_know_torch = False
_n_threads = 1


def share_among(n_threads: int) -> None:
    """Set the number of threads that tasks of this process are shared among; at least 1.

    With more than one, Python's threads take turns more often from then on (``SWITCH_INTERVAL``).
    """
    global _helpers, _n_threads
    _switch_off_torchs_own()
    if n_threads > 1:
        sys.setswitchinterval(min(sys.getswitchinterval(), SWITCH_INTERVAL))
    if n_threads != _n_threads:
        _helpers = None  # they end by themselves; another thread may be handing them a task
    _n_threads = n_threads


@contextmanager
def computing_threads(count: int) -> Iterator[None]:
    """Compute with a number of threads, and afterwards with as many as before.

    Where torch computes, it is loaded before this is called.

    Args:
        count: at least 1.
    """
    before, torch = n_sharing(), _loaded_torch()
    before_of_torch = None if torch is None else torch.get_num_threads()
    interval = sys.getswitchinterval()
    share_among(count)
    try:
        yield
    finally:
        share_among(before)
        sys.setswitchinterval(interval)
        if torch is not None:
            torch.set_num_threads(before_of_torch)


def n_sharing() -> int:
    """The number of threads that tasks of this process are shared among."""
    return _n_threads


def run_tasks(tasks: Sequence[Callable[[], Result]]) -> list[Result]:
    """What the tasks return, in their order.

    A task is run in this thread or another, with gradients enabled as they are here. It must not
    write what another one reads or writes. Tasks inside a task are run one after the other.

    Raises:
        Exception: that of the first task that failed.
    """
    n_helpers = min(_n_threads, len(tasks)) - 1
    if n_helpers < 1 or getattr(_here, "busy", False):
        return [task() for task in tasks]
    results: dict[int, Result] = {}
    waiting, gradients_as_here = iter(range(len(tasks))), _gradients_as_here()

    def work() -> None:
        _here.busy = True
        try:
            with gradients_as_here():
                for number in waiting:  # every number goes to one thread alone
                    results[number] = tasks[number]()
        finally:
            _here.busy = False
            deque(waiting, maxlen=0)  # after an error nothing more is begun

    others = [_executor().submit(work) for _ in range(n_helpers)]
    try:
        work()
    finally:
        # waits for those that have begun; all tasks are taken, so the others are not needed
        errors = [None if other.cancel() else other.exception() for other in others]
    for error in errors:
        if error is not None:
            raise error
    return [results[number] for number in range(len(tasks))]


def run_beside(first: Callable[[], Result], second: Callable[[], Result]) -> tuple[Result, Result]:
    """What both return, as ``run_tasks``, but tasks inside the first one are shared.

    Another thread computes the second one, and then takes part in the first. If none is free, this
    thread computes it after the first.

    Raises:
        Exception: that of ``first``; if it has none, that of ``second``, once ``first`` has ended.
    """
    if _n_threads < 2 or getattr(_here, "busy", False):
        return first(), second()
    gradients_as_here = _gradients_as_here()

    def work() -> Result:
        _here.busy = True
        try:
            with gradients_as_here():
                return second()
        finally:
            _here.busy = False

    other = _executor().submit(work)
    try:
        found = first()
    finally:
        is_left = other.cancel()
        if not is_left:
            other.exception()  # waits
    return found, second() if is_left else other.result()


def _gradients_as_here() -> Callable[[], AbstractContextManager[Any]]:
    """Makes a context for another thread, in which gradients are enabled as they are here."""
    torch = _loaded_torch()
    return (
        nullcontext if torch is None else partial(torch.set_grad_enabled, torch.is_grad_enabled())
    )


def run_slices(work: Callable[[slice], None], n: int, size: int) -> None:
    """``work(part)`` for the slices that make up 0 to n - 1, ``size`` each, see ``run_tasks``."""
    run_tasks([partial(work, slice(k, min(k + size, n))) for k in range(0, n, size)])


def made_ahead(items: Iterator[Result]) -> Iterator[Result]:
    """The same items, none of which is None. Another thread makes the next one meanwhile."""
    with ThreadPoolExecutor(1, "usdsmoke", _switch_off_torchs_own) as ahead:
        waiting = ahead.submit(next, items, None)
        while (item := waiting.result()) is not None:
            waiting = ahead.submit(next, items, None)
            yield item


def _executor() -> ThreadPoolExecutor:
    global _helpers, _helpers_know_torch
    helpers = _helpers
    if helpers is None or (_loaded_torch() is not None and not _helpers_know_torch):
        _helpers_know_torch = _loaded_torch() is not None
        helpers = _helpers = ThreadPoolExecutor(
            max(_n_threads - 1, 1), "usdsmoke", initializer=_switch_off_torchs_own
        )
    return helpers


def _loaded_torch() -> Any:
    """The module, or None as long as nothing has loaded it."""
    return sys.modules.get("torch")


def _switch_off_torchs_own() -> None:
    """In this thread."""
    if (torch := _loaded_torch()) is not None:
        torch.set_num_threads(1)


def _forget_helpers() -> None:
    global _helpers
    _helpers = None


# the threads of a process do not live on in its forks
os.register_at_fork(after_in_child=_forget_helpers)

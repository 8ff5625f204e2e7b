"""The worker process of ``usdsmoke.vdb.child`` as a fork: no new interpreter a case.

It is ``usdsmoke.vdb.worker`` with its requests, limits and endings; only its start differs.
"""

import os
import sys
import tempfile
import time
import traceback
from subprocess import TimeoutExpired
from typing import IO

from usdsmoke.vdb import child, worker

__all__ = ["fork_workers"]

_FAILED = 70
_PAUSE_S = 0.001


def fork_workers() -> None:
    """Have this process and its forks fork their workers, where they have no other threads."""
    vars(child)["_Worker"] = _ForkedWorker


class _ForkedWorker(child._Worker):
    """The same pipes to a fork; a new interpreter where threads would not survive it."""

    def __init__(self) -> None:
        if len(os.listdir("/proc/self/task")) > 1:
            super().__init__()
            return
        self.messages: IO[bytes] = tempfile.TemporaryFile()
        requests, answers = os.pipe(), os.pipe()
        mine = (requests[1], answers[0])
        self.process = _Fork((requests[0], answers[1], self.messages.fileno()), mine)  # type: ignore[assignment]
        self.requests = os.fdopen(mine[0], "wb", 0)
        self.answers = os.fdopen(mine[1], "rb", 0)


class _Fork:
    """What ``child`` uses of a ``subprocess.Popen``."""

    def __init__(self, streams: tuple[int, int, int], not_its: tuple[int, int]) -> None:
        self.returncode: int | None = None
        self._pid = os.fork()
        if self._pid == 0:
            _be_worker(streams, not_its)
        os.close(streams[0])
        os.close(streams[1])

    def poll(self) -> int | None:
        if self.returncode is None:
            pid, status = os.waitpid(self._pid, os.WNOHANG)
            self.returncode = os.waitstatus_to_exitcode(status) if pid else None
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        end = None if timeout is None else time.monotonic() + timeout
        while (code := self.poll()) is None:
            if end is not None and time.monotonic() > end:
                raise TimeoutExpired("worker", timeout or 0.0)
            time.sleep(_PAUSE_S)
        return code

    def kill(self) -> None:
        if self.poll() is None:
            os.kill(self._pid, 9)


def _be_worker(streams: tuple[int, int, int], not_its: tuple[int, int]) -> None:
    """The fork's whole life."""
    code = _FAILED
    try:
        for handle in not_its:
            os.close(handle)
        for number, handle in enumerate(streams):
            os.dup2(handle, number)
        sys.stdin = open(0, encoding="utf-8", closefd=False)
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)
        code = worker.main()
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)

"""Processes of usdsmoke that begin at once, can be killed with all they have started, and watched.

Importing torch, USD and OpenVDB takes longer than a tiny run. ``warm_up`` imports them once; every
process is then a fork that calls the command line. So are the processes that touch VDB files:
forks of the fork, in the same process group. Their disk is slow: whatever puts a file in its place
or takes it away waits first, so that a kill is as likely between two such steps as during work.
Linux only.
"""

import ctypes
import io
import os
import pickle
import signal
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

__all__ = ["Process", "Watch", "call_apart", "command_line", "usdsmoke_apart", "warm_up"]

_SET_CHILD_SUBREAPER = 36  # of prctl(2): orphans come to this process, which can wait for them
_FAILED = 70
_DISK_S = 0.01  # before every change of a folder


def warm_up() -> None:
    """Import all that a run needs; afterwards forks of this process start without loading anything.

    Nothing is computed here, neither by torch nor by USD: their threads would not survive a fork.
    """
    import torch

    from usdsmoke.vdb import child, worker
    from usdsmoke.vdb.binding import find_binding

    find_binding()
    torch.set_num_threads(1)
    vars(child)["_run"] = _run_forked
    # torch's address space and processor time are in the forks; a name that is gone is an error
    vars(worker)[worker._set_limits.__name__] = lambda n_bytes, cpu_seconds: None
    for name in ("fsync", "replace", "link", "unlink", "rmdir"):
        setattr(os, name, _slowed(getattr(os, name)))
    ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def command_line(arguments: list[str]) -> Callable[[], int]:
    """What ``usdsmoke`` with these arguments does, for a fork of a warm process."""

    def call() -> int:
        from usdsmoke.ui.cli.main import main

        return main(arguments)

    return call


def usdsmoke_apart(arguments: list[str]) -> Callable[[], int]:
    """The same in a new interpreter, with nothing loaded and nothing replaced."""

    def call() -> int:
        os.execv(sys.executable, [sys.executable, "-m", "usdsmoke", *arguments])

    return call


class Process:
    """A fork in a process group of its own.

    Args:
        action: what it does; returns its exit code.
        log: the file that gets what it prints.
    """

    def __init__(self, action: Callable[[], int], log: Path) -> None:
        self.log = log
        log.touch()  # it is read even if the fork is killed before it has opened it
        self.code: int | None = None
        self.memory_mib = 0.0  # the most that it or one of its children had, once it has ended
        self.cpu_seconds = 0.0  # of it and its children, likewise
        self.pid = os.fork()
        if self.pid == 0:
            _be_child(action, log)
        try:
            os.setpgid(self.pid, self.pid)
        except (PermissionError, ProcessLookupError):
            pass  # it was quicker

    def poll(self) -> int | None:
        """Its exit code; None while it runs."""
        if self.code is None:
            pid, status, usage = os.wait4(self.pid, os.WNOHANG)
            if pid:
                self.code = os.waitstatus_to_exitcode(status)
                self.memory_mib = usage.ru_maxrss / 1024
                self.cpu_seconds = usage.ru_utime + usage.ru_stime
        return self.code

    def kill(self) -> None:
        """SIGKILL to it and to all that it has started; returns when none of them is left."""
        try:
            os.killpg(self.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        while True:
            try:
                pid, status = os.waitpid(-self.pid, 0)
            except ChildProcessError:
                return
            if pid == self.pid:
                self.code = os.waitstatus_to_exitcode(status)

    def step(self) -> str:
        """What it was last heard to begin, from the progress that it prints."""
        for line in reversed(self.log.read_text(errors="replace").splitlines()):
            words = line.split()
            if len(words) > 1 and words[0].endswith("%") and words[0][:-1].isdigit():
                return words[1]
        return "start"


class Watch:
    """Sees files come into a folder, half-written ones too.

    Args:
        folder: need not exist yet.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._known: set[tuple[str, int]] = set()
        self.count = 0
        self.look()
        self.count = 0

    def look(self) -> int:
        """How many files have come since the beginning."""
        stack = [str(self._folder)]
        while stack:
            try:
                entries = list(os.scandir(stack.pop()))
            except OSError:
                continue  # not there yet, or gone
            for entry in entries:
                key = (entry.name, entry.inode())
                if entry.is_dir(follow_symlinks=False):
                    stack.append(entry.path)
                elif key not in self._known:
                    self._known.add(key)
                    self.count += 1
        return self.count


def call_apart(function: Callable[..., Any], *arguments: Any, scratch: Path) -> Any:
    """A function's result, computed in a fork: this process stays free of threads.

    Raises:
        RuntimeError: the function raised; with its traceback.
    """
    answer, log = scratch / "answer.pickle", scratch / "answer.log"

    def work() -> int:
        answer.write_bytes(pickle.dumps(function(*arguments)))
        return 0

    process = Process(work, log)
    while process.poll() is None:
        time.sleep(0.002)
    if process.code != 0:
        raise RuntimeError(log.read_text())
    return pickle.loads(answer.read_bytes())


def _slowed(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same after a moment."""

    def call(*arguments: Any, **options: Any) -> Any:
        if "dir_fd" not in options:  # somebody's temporary folder
            time.sleep(_DISK_S)
        return function(*arguments, **options)

    return call


def _be_child(action: Callable[[], int], log: Path) -> None:
    """The fork's whole life."""
    code = _FAILED
    try:
        os.setpgid(0, 0)
        handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
        for stream in (1, 2):
            os.dup2(handle, stream)
        sys.stdout = io.TextIOWrapper(io.FileIO(1, "w", closefd=False), line_buffering=True)
        sys.stderr = io.TextIOWrapper(io.FileIO(2, "w", closefd=False), line_buffering=True)
        code = action()
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _run_forked(folder: str, config: Any, reader: str) -> None:
    """In the place of ``usdsmoke.vdb.child._run``: a fork a request, not a new interpreter."""
    from usdsmoke.vdb import worker
    from usdsmoke.vdb.child import ChildFailure

    pid = os.fork()
    if pid == 0:
        code = _FAILED
        try:
            worker.answer_request(Path(folder))
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    if code != 0:
        raise ChildFailure(f"OpenVDB's process ended with code {code}")

"""The caller's side of the process that touches VDB files: start it, ask it, limit it.

OpenVDB trusts what it reads: a damaged file can abort the process or make it take all memory. So
this process opens no file with OpenVDB. (OpenEXR and OpenUSD do too: style images and crate files
use the same process.) A worker process does it under a limit of address space
and of time, and hands arrays over through files in a private folder.

One worker serves all requests of a process, one after the other. It is replaced after a failure,
and when its memory has grown. It ends when its parent ends, even if the parent is killed.
"""

import atexit
import errno
import fcntl
import json
import os
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import IO, Any

import numpy as np

from usdsmoke.base import errors
from usdsmoke.base.machine import python_command
from usdsmoke.config.run_sections import GridsConfig

_GIB = 2**30
_PATIENCE = 10  # wall-clock seconds per CPU second: disks and other processes are slow
_STDERR_TAIL = 400  # bytes of the worker's last output that a message quotes
_PREFIX = "usdsmoke-"  # of folders for temporary files
_HELD = "held"  # a file in them, locked as long as their process lives
_STALE = 600.0  # seconds after which a folder that no process holds is removed
_FAREWELL = 10.0  # seconds that a worker has to end when asked to
_PACKAGE_PARENT = str(Path(__file__).resolve().parents[2])


class ChildFailure(Exception):
    """The worker gave no answer; the text says why. Its callers turn it into a named error."""

    lacks_memory = False


def run_child(
    request: Mapping[str, Any], arrays: Sequence[np.ndarray], config: GridsConfig
) -> tuple[Any, list[np.ndarray]]:
    """Send a request to ``usdsmoke.vdb.worker``, starting it if needed. Threads take turns.

    Args:
        request: JSON values; ``action`` names one of the worker's functions, or
            ``package.module:function``; ``reader`` the library, for messages (OpenVDB).
        arrays: handed over with it, in this order.
        config: ``memory_limit_gib`` and ``time_limit_s`` apply to this request.

    Returns:
        The answer's JSON values and the arrays that came with it.

    Raises:
        ChildFailure: the worker was stopped by a limit, crashed, or OpenVDB refused.
        UsdSmokeError: the named error that the worker answered with.
        PlanError: the worker cannot be started.
        WriteFailed: the folder for temporary files is full or may not be written to.
    """
    limits = {
        "memory_limit_bytes": int(config.memory_limit_gib * _GIB),
        "cpu_limit_s": config.time_limit_s,
    }
    try:
        _sweep(tempfile.gettempdir())
        with _private_folder() as folder:
            for n, array in enumerate(arrays):
                np.save(Path(folder) / f"in{n}.npy", array, allow_pickle=False)
            text = json.dumps({**request, **limits})
            (Path(folder) / "request.json").write_text(text, encoding="utf-8")
            _run(folder, config, request.get("reader", "OpenVDB"))
            answer = _answer(folder)
            files = [Path(folder) / f"out{n}.npy" for n in range(answer["n_arrays"])]
            return answer["answer"], [np.load(file, allow_pickle=False) for file in files]
    except OSError as error:
        advice = "Free some space there or set TMPDIR to another folder."
        if resource.getrlimit(resource.RLIMIT_FSIZE)[0] != resource.RLIM_INFINITY:
            advice = "Raise the limit on the size of files (ulimit -f), or free some space there."
        raise errors.WriteFailed(
            f"cannot hand grids over in {tempfile.gettempdir()}: {error.strerror or error}. "
            f"{advice}"
        ) from error


def end_worker() -> None:
    """End this process's worker, if there is one. The next request starts another."""
    global _worker
    with _turn:
        worker, _worker = _worker, None
        if worker is not None:
            worker.end()


class _Worker:
    """A running ``usdsmoke.vdb.worker`` and the pipes to it."""

    def __init__(self) -> None:
        self.messages: IO[bytes] = tempfile.TemporaryFile()  # a file: they cannot fill memory
        try:
            self.process = subprocess.Popen(
                python_command("from usdsmoke.vdb.worker import main; sys.exit(main())"),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self.messages,
                env=_environment(),
                bufsize=0,
            )
        except OSError as error:
            self.messages.close()
            raise errors.PlanError(
                f"cannot start the process that reads VDB files: {error.strerror or error} "
                f"({sys.executable}). Check that this Python can be run, and the limits on "
                "processes and memory (ulimit -a)."
            ) from error
        assert self.process.stdin is not None and self.process.stdout is not None
        self.requests, self.answers = self.process.stdin, self.process.stdout

    def ask(self, folder: str, seconds: float) -> bool:
        """Have the request in a folder answered there; whether the worker takes another one.

        Raises:
            ChildFailure: it ended, or did not answer within ``seconds`` by the clock.
            OSError: it could not write its answer.
        """
        self.messages.seek(0)
        self.messages.truncate()
        with suppress(BrokenPipeError):  # it has ended, which the empty answer shows
            self.requests.write(json.dumps(folder).encode() + b"\n")
        waiting = select.poll()
        waiting.register(self.answers, select.POLLIN)
        if not waiting.poll(1000 * seconds):
            raise ChildFailure(f"it took longer than {seconds:.3g} s and was stopped")
        word = self.answers.read(16)
        if word == b"full\n":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if word:
            return word == b"next\n"
        raise _Ended(self.wait(_FAREWELL))

    def last_words(self) -> str:
        """The last line that the worker printed."""
        size = self.messages.seek(0, os.SEEK_END)
        self.messages.seek(max(0, size - _STDERR_TAIL))
        lines = self.messages.read().decode("utf-8", errors="replace").strip().splitlines()
        return lines[-1].strip() if lines else ""

    def end(self, patience: float = _FAREWELL) -> None:
        """Let it end, or make it end."""
        try:
            self.requests.close()
            self.wait(patience)
        finally:  # Ctrl-C may end the waiting
            self.wait(0.0)
            self.forget()

    def wait(self, patience: float) -> int:
        """Its return code; it is killed when it does not end within ``patience`` seconds."""
        try:
            return self.process.wait(patience)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()

    def forget(self) -> None:
        """Close this process's ends of the pipes."""
        for stream in (self.requests, self.answers, self.messages):
            stream.close()


class _Ended(Exception):
    """The worker ended without an answer; with its return code."""


_worker: _Worker | None = None
_turn = threading.RLock()
atexit.register(end_worker)


def _forget_parents_worker() -> None:
    """In a fork: the worker and its turn belong to the parent."""
    global _worker, _turn
    if _worker is not None:
        _worker.forget()
        _worker.process.returncode = 0  # nothing to wait for
    _worker, _turn = None, threading.RLock()


os.register_at_fork(after_in_child=_forget_parents_worker)


def _run(folder: str, config: GridsConfig, reader: str) -> None:
    """Have the request in a folder answered there.

    Raises:
        ChildFailure: there is no answer.
    """
    global _worker
    with _turn:
        if _worker is not None and _worker.process.poll() is not None:
            end_worker()  # somebody has killed it while it had nothing to do
        if _worker is None:
            # Ctrl-C is for the parent, which ends the worker; it waits until the worker is known,
            # so that no pipe or process is left without an owner.
            with _interrupts_held():
                _worker = _Worker()
        worker, goes_on, patience = _worker, False, 0.0
        try:
            goes_on = worker.ask(folder, _PATIENCE * config.time_limit_s)
            patience = _FAREWELL
        except _Ended as ended:
            raise ChildFailure(
                _ending(ended.args[0], worker.last_words(), config, reader)
            ) from None
        finally:
            if not goes_on:
                _worker = None
                worker.end(patience)


def _ending(return_code: int, last_words: str, config: GridsConfig, reader: str) -> str:
    """Why a worker ended."""
    if return_code == -signal.SIGPROF:
        return f"it took more than {config.time_limit_s:.3g} s of CPU time and was stopped"
    if return_code < 0:
        try:
            ending = f"{reader} ended with {signal.Signals(-return_code).name}"
        except ValueError:
            ending = f"{reader} ended with signal {-return_code}"
    else:
        ending = f"{reader}'s process ended with code {return_code}"
    return f"{ending} ({last_words})" if last_words else ending


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Processes that are started meanwhile never get Ctrl-C; this one gets it afterwards."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _environment() -> dict[str, str]:
    """This process's own, with its search path, one thread each, and nothing loaded late."""
    # no hooks of editable installations, which are no folders
    folders = [entry for entry in sys.path if os.path.isabs(entry) or os.path.isdir(entry)]
    search = [_PACKAGE_PARENT, *(os.path.abspath(entry) for entry in folders if entry)]
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(search),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "MALLOC_ARENA_MAX": "2",  # every arena reserves address space, which is what is limited
        "OPENVDB_DISABLE_DELAYED_LOAD": "1",
    }


@contextmanager
def _private_folder() -> Iterator[str]:
    """A folder that is removed on exit; ``_sweep`` removes it if the process is killed before."""
    with (
        tempfile.TemporaryDirectory(prefix=_PREFIX) as folder,
        open(Path(folder) / _HELD, "wb") as held,
    ):
        with suppress(OSError):  # a file system without locks: only its age protects it then
            fcntl.flock(held, fcntl.LOCK_EX)
        yield folder


@lru_cache(maxsize=4)
def _sweep(folder: str) -> None:
    """Remove what killed processes left in a folder for temporary files; once per process."""
    for path in Path(folder).glob(f"{_PREFIX}*/{_HELD}"):
        with suppress(OSError):  # another user's, or already removed
            if time.time() - path.stat().st_mtime < _STALE:
                continue
            with open(path, "rb") as held:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(path.parent, ignore_errors=True)


def _answer(folder: str) -> dict[str, Any]:
    answer: dict[str, Any] = json.loads((Path(folder) / "answer.json").read_text(encoding="utf-8"))
    if "not_handed_over" in answer:
        raise OSError(answer["not_handed_over"])  # as if it had happened here
    if "failure" in answer:
        failure = ChildFailure(answer["failure"])
        failure.lacks_memory = answer.get("lacks_memory", False)
        raise failure
    if "error" in answer:
        raise getattr(errors, answer["error"])(answer["message"])
    return answer

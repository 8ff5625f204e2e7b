"""The parent's side of the process that touches VDB files: start it, limit it, understand its end.

OpenVDB trusts what it reads: a damaged file can abort the process or make it take all memory. So
no file is opened by OpenVDB in this process. A child does it under a limit of address space and of
time, and hands arrays over through files in a private folder.
"""

import fcntl
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from usdsmoke.base import errors
from usdsmoke.base.config import GridsConfig

__all__ = ["ChildFailure", "run_child"]

_GIB = 2**30
_PATIENCE = 10  # seconds by the clock for each of the processor: disks and neighbours are slow
_OUT_OF_TIME = getattr(signal, "SIGXCPU", 0)  # Windows has no such signal
_STDERR_TAIL = 400  # bytes of the child's last words that a message quotes
_PREFIX = "usdsmoke-"  # of folders for temporary files
_HELD = "held"  # a file in them, locked as long as their process lives
_STALE = 600.0  # seconds after which a folder that nobody holds is swept away
_PACKAGE_PARENT = str(Path(__file__).resolve().parents[2])


class ChildFailure(Exception):
    """The child gave no answer; the text says why. Its callers turn it into a named error."""


def run_child(
    request: Mapping[str, Any], arrays: Sequence[np.ndarray], config: GridsConfig
) -> tuple[Any, list[np.ndarray]]:
    """What ``usdsmoke.vdb.worker`` answers to a request.

    Args:
        request: JSON values; ``action`` names one of the worker's functions.
        arrays: handed over with it, in this order.
        config: ``memory_limit_gib`` and ``time_limit_s`` hold for the child.

    Returns:
        The answer's JSON values and the arrays that came with it.

    Raises:
        ChildFailure: the child was stopped by a limit, crashed, or OpenVDB refused.
        UsdSmokeError: the named error that the child answered with.
        WriteFailed: the folder for temporary files is full or may not be written to.
    """
    try:
        _sweep(tempfile.gettempdir())
        with _private_folder() as folder:
            for n, array in enumerate(arrays):
                np.save(Path(folder) / f"in{n}.npy", array, allow_pickle=False)
            limits = {
                "folder": folder,
                "memory_limit_bytes": int(config.memory_limit_gib * _GIB),
                "cpu_limit_s": math.ceil(config.time_limit_s),
            }
            _run(json.dumps({**request, **limits}), folder, config)
            answer = _answer(folder)
            return answer["answer"], _arrays(folder, answer["n_arrays"])
    except OSError as error:
        raise errors.WriteFailed(
            f"cannot hand grids over in {tempfile.gettempdir()}: {error.strerror or error}; "
            "free some space there or set TMPDIR to another folder"
        ) from error


@contextmanager
def _private_folder() -> Iterator[str]:
    """A folder that goes when it is left; ``_sweep`` finds it if the process is killed before."""
    with (
        tempfile.TemporaryDirectory(prefix=_PREFIX) as folder,
        open(Path(folder) / _HELD, "wb") as held,
    ):
        with suppress(OSError):  # a file system without locks: only its age protects it then
            fcntl.flock(held, fcntl.LOCK_EX)
        yield folder


@lru_cache(maxsize=4)
def _sweep(folder: str) -> None:
    """Remove what killed processes left in a folder for temporary files; once a process."""
    for path in Path(folder).glob(f"{_PREFIX}*/{_HELD}"):
        with suppress(OSError):  # somebody else's, or gone meanwhile
            if time.time() - path.stat().st_mtime < _STALE:
                continue
            with open(path, "rb") as held:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(path.parent, ignore_errors=True)


def _run(request: str, folder: str, config: GridsConfig) -> None:
    """Run the child to its end; its messages go to a file, so that they cannot fill memory."""
    with open(Path(folder) / "stderr", "wb+") as messages:
        try:
            ended = subprocess.run(
                [sys.executable, "-P", "-m", "usdsmoke.vdb.worker"],
                input=request.encode(),
                stdout=subprocess.DEVNULL,
                stderr=messages,
                env=_environment(),
                timeout=_PATIENCE * config.time_limit_s,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise ChildFailure(
                f"it took longer than {_PATIENCE * config.time_limit_s:.3g} s and was given up"
            ) from None
        if ended.returncode == -_OUT_OF_TIME:
            raise ChildFailure(
                f"it took more than {config.time_limit_s:.3g} s of the processor and was given up"
            )
        if ended.returncode != 0:
            messages.seek(0)
            raise ChildFailure(_last_words(ended.returncode, messages.read()))


def _environment() -> dict[str, str]:
    """This process's own, with its search path, one thread each, and nothing loaded late."""
    search = [_PACKAGE_PARENT, *(entry for entry in sys.path if entry)]
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(search),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "MALLOC_ARENA_MAX": "2",  # every arena reserves address space, which is what is limited
        "OPENVDB_DISABLE_DELAYED_LOAD": "1",
    }


def _last_words(return_code: int, messages: bytes) -> str:
    if return_code < 0:
        try:
            ending = f"OpenVDB ended with {signal.Signals(-return_code).name}"
        except ValueError:
            ending = f"OpenVDB ended with signal {-return_code}"
    else:
        ending = f"OpenVDB's process ended with code {return_code}"
    lines = messages[-_STDERR_TAIL:].decode("utf-8", errors="replace").strip().splitlines()
    return f"{ending} ({lines[-1].strip()})" if lines else ending


def _answer(folder: str) -> dict[str, Any]:
    answer: dict[str, Any] = json.loads((Path(folder) / "answer.json").read_text(encoding="utf-8"))
    if "failure" in answer:
        raise ChildFailure(answer["failure"])
    if "error" in answer:
        raise getattr(errors, answer["error"])(answer["message"])
    return answer


def _arrays(folder: str, count: int) -> list[np.ndarray]:
    return [np.load(Path(folder) / f"out{n}.npy", allow_pickle=False) for n in range(count)]

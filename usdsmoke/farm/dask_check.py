"""Whether a worker of a cluster would give the same result: what it sees, and what that means."""

import time
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from usdsmoke import __version__
from usdsmoke.base.errors import ClusterError

__all__ = ["check_answer", "look_around"]

_TOKEN_S = 5.0  # for a new file to show on another machine

# Their versions decide the last bits of a result.
_PACKAGES = ("torch", "numpy")


def look_around(token_path: str, files: Sequence[str]) -> dict[str, Any]:
    """What a worker sees: its versions, a token's text, and which files are missing.

    Args:
        token_path: a file that was written just now on another machine.
        files: inputs of the run.
    """
    until = time.monotonic() + _TOKEN_S
    while not Path(token_path).is_file() and time.monotonic() < until:
        time.sleep(0.1)
    try:
        token = Path(token_path).read_text(encoding="utf-8")
    except OSError:
        token = ""
    return {
        "version": __version__,
        "packages": {name: _package_version(name) for name in _PACKAGES},
        "token": token,
        "missing": [name for name in files if not Path(name).is_file()],
    }


def check_answer(worker: str, answer: Any, token: str, output: str) -> list[str]:
    """Refuse a worker that would give another result or none; what is worth knowing otherwise.

    Args:
        worker: its address.
        answer: of ``look_around`` there, or the exception that came instead.
        token: what the token's file holds.
        output: the folder in which it stands.

    Raises:
        ClusterError: no usdsmoke or another one, another file system, inputs out of sight.
    """
    if isinstance(answer, BaseException):
        raise ClusterError(
            f"the worker {worker} cannot load usdsmoke {__version__} "
            f"({type(answer).__name__}: {answer}); install this version there"
        )
    if answer["version"] != __version__:
        raise ClusterError(
            f"the worker {worker} has usdsmoke {answer['version']} and this machine {__version__}; "
            "install the same version on both"
        )
    if answer["token"] != token:
        raise ClusterError(
            f"the worker {worker} does not see what was just written to {output}; wanted a file "
            "system that all machines share, under the same path; choose such an output folder"
        )
    if answer["missing"]:
        raise ClusterError(
            f"the worker {worker} does not see {answer['missing'][0]}; wanted the inputs on a file "
            "system that all machines share, under the same path"
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

"""``usdsmoke`` with stand-ins for the core and OpenVDB, as forks of one process.

That process has imported everything, so a run takes no second to start. It answers one request
after the other: a line of JSON with the runs to be begun at once, then a line with how they ended.

    python -m tests.forks      what ``run_forks`` starts
"""

import atexit
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path

__all__ = ["Run", "run_forks"]

PROJECT = Path(__file__).resolve().parents[1]
PATIENCE_S = 60.0

#: The step that it is killed at, 0 for none, and the arguments of ``usdsmoke``.
Run = tuple[int, Sequence[str]]


def run_forks(runs: Sequence[Run]) -> list[tuple[int, str]]:
    """Runs at once; the exit code of each, and what it wrote on stderr."""
    server = _start_server()
    assert server.stdin is not None and server.stdout is not None
    with tempfile.TemporaryDirectory() as folder:
        files = [str(Path(folder) / f"{number}.txt") for number in range(len(runs))]
        asked = [[file, step, list(words)] for file, (step, words) in zip(files, runs, strict=True)]
        server.stdin.write(json.dumps(asked) + "\n")
        server.stdin.flush()
        codes = json.loads(server.stdout.readline())
        texts = [Path(file).read_text(encoding="utf-8") for file in files]
    return list(zip(codes, texts, strict=True))


@cache
def _start_server() -> subprocess.Popen[str]:
    server = subprocess.Popen(
        [sys.executable, "-m", "tests.forks"],
        cwd=PROJECT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip

    def end() -> None:
        server.communicate()

    atexit.register(end)
    return server


def _serve() -> None:
    import usdsmoke.pipeline
    import usdsmoke.ui.cli.main  # noqa: F401
    from tests.pipeline_fixtures import FakeCore, pose

    pose(FakeCore())
    for line in sys.stdin:
        begun = [_fork(*run) for run in json.loads(line)]
        print(json.dumps([_wait(pid) for pid in begun]), flush=True)


def _fork(stderr_file: str, step: int, arguments: list[str]) -> int:
    """The id of a process that does the run and ends."""
    pid = os.fork()
    if pid:
        return pid
    code = 70  # an error that no command should end in
    try:
        for number, name in enumerate((os.devnull, os.devnull, stderr_file)):
            os.dup2(os.open(name, os.O_RDWR | os.O_CREAT), number)
        from tests.run_to_be_killed import die_at, do_run

        code = do_run(die_at(step), arguments)
    finally:
        sys.stderr.flush()
        os._exit(code)


def _wait(pid: int) -> int:
    """The exit code; that of SIGTERM for a process that has taken too long."""
    until = time.monotonic() + PATIENCE_S
    while True:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > until:
            os.kill(pid, signal.SIGTERM)
        time.sleep(0.005)


if __name__ == "__main__":
    _serve()

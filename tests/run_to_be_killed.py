"""``usdsmoke`` with stand-ins for the core and OpenVDB, and an end that can be set beforehand.

    python -m tests.run_to_be_killed 17 stylize ...

kills itself with SIGKILL in the place of the 17th step that changes the disk (syncing, renaming,
linking or removing a file); 0 lets it live. What steps there were is the last line on stderr.
"""

import os
import signal
import sys
from collections.abc import Callable
from typing import Any

from tests.pipeline_fixtures import FakeCore, pose
from usdsmoke.ui.cli.main import main


def die_at(count: int) -> list[str]:
    """Replace the functions that change the disk by ones that count; the steps as they come."""
    steps: list[str] = []

    def counted(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            if "dir_fd" not in options:  # somebody's temporary folder
                steps.append(function.__name__)
            if len(steps) == count:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*arguments, **options)

        return call

    for name in ("fsync", "replace", "link", "unlink", "rmdir"):
        setattr(os, name, counted(getattr(os, name)))
    return steps


def do_run(steps: list[str], arguments: list[str]) -> int:
    """The command; its exit code."""
    code = main(arguments)
    print(*steps, file=sys.stderr)
    return code


if __name__ == "__main__":
    pose(FakeCore())
    sys.exit(do_run(die_at(int(sys.argv[1])), sys.argv[2:]))

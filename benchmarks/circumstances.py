"""When, where and by what command a table was made, so that it can be made again."""

import datetime
import os
import platform
import subprocess
from collections.abc import Sequence

__all__ = ["circumstances"]


def circumstances(command: Sequence[str]) -> list[str]:
    """Date, commit, machine and command, as Markdown list items."""
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False
    ).stdout.strip()
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return [
        f"- Date {datetime.date.today().isoformat()}, commit {commit or 'unknown'}.",
        f"- {platform.machine()}, {len(os.sched_getaffinity(0))} cores, {memory:.0f} GiB, "
        f"Python {platform.python_version()}.",
        f"- `{' '.join(command)}`",
    ]

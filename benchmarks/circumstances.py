"""When, where and by what command a table was made, so that it can be made again."""

import datetime
import os
import platform
import subprocess
from collections.abc import Sequence
from pathlib import Path

__all__ = ["circumstances"]

# Whose changes would make another table; results and docs would not.
_CODE = ("usdsmoke", "benchmarks/*.py", "examples", "constraints.txt")


def circumstances(command: Sequence[str]) -> list[str]:
    """Date, commit, machine and command, as Markdown list items.

    The commit is marked ``-dirty`` where code differs from it. Of absolute paths in the command
    the last part alone is told: they are one machine's.
    """
    commit = _git("rev-parse", "--short", "HEAD") or "unknown"
    if _git("status", "--porcelain", "--untracked-files=no", "--", *_CODE):
        commit += "-dirty"
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    words = [f".../{Path(word).name}" if os.path.isabs(word) else word for word in command]
    return [
        f"- Date {datetime.date.today().isoformat()}, commit {commit}.",
        f"- {_processor()} ({platform.machine()}), {len(os.sched_getaffinity(0))} cores, "
        f"{memory:.0f} GiB, Python {platform.python_version()}.",
        f"- `{' '.join(words)}`",
    ]


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], capture_output=True, text=True, check=False)
    return done.stdout.strip()


def _processor() -> str:
    """The processor's name where the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "processor unknown"

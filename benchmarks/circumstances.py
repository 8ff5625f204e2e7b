"""When, where and by what command a table was made, so that it can be made again."""

import datetime
import os
import platform
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

__all__ = ["circumstances", "publish", "table_page"]

_STARTED = time.monotonic()  # nearly when the benchmark did: it imports this file
# Whose changes would make another table; results and docs would not.
_CODE = ("usdsmoke", "benchmarks/*.py", "examples", "constraints.txt")


def circumstances(command: Sequence[str]) -> list[str]:
    """Date, commit, machine, command and time taken, as Markdown list items.

    The commit is marked ``-dirty`` where code differs from it. Of absolute paths in the command
    the last part alone is told: they are one machine's.
    """
    from usdsmoke.work_precision.report import processor_name  # loads much: late, not in forks

    commit = _git("rev-parse", "--short", "HEAD") or "unknown"
    if _git("status", "--porcelain", "--untracked-files=no", "--", *_CODE):
        commit += "-dirty"
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    words = [f".../{Path(word).name}" if os.path.isabs(word) else word for word in command]
    return [
        f"- Date {datetime.date.today().isoformat()}, commit {commit}.",
        f"- {processor_name()} ({platform.machine()}), {len(os.sched_getaffinity(0))} cores, "
        f"{memory:.0f} GiB, Python {platform.python_version()}.",
        f"- `{' '.join(words)}`",
        f"- It took {(time.monotonic() - _STARTED) / 60:.1f} minutes, {_cpu_minutes():.1f} of CPU.",
    ]


def table_page(
    intro: Sequence[str], columns: Sequence[str], rows: Sequence[str], command: Sequence[str]
) -> str:
    """A Markdown page: a title and sentences, a table, and how it was made.

    Args:
        intro: lines.
        columns: their names.
        rows: lines of the table.
        command: see ``circumstances``.
    """
    head = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    return "\n".join([*intro, "", *head, *rows, "", *circumstances(command)]) + "\n"


def publish(text: str, file_path: Path | None) -> None:
    """Print a page, and write it to a file if one is named."""
    if file_path:
        file_path.write_text(text, encoding="utf-8")
    print(text)


def _cpu_minutes() -> float:
    used = os.times()
    own, of_children = used.user + used.system, used.children_user + used.children_system
    return (own + of_children) / 60


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], capture_output=True, text=True, check=False)
    return done.stdout.strip()

"""The command that measures what a scene's choices gain and cost."""

import argparse
import time
from typing import TYPE_CHECKING

from usdsmoke.ui.cli.arguments import given_settings
from usdsmoke.ui.cli.text import print_json

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID

    from usdsmoke.work_precision import ReportResult

_LINE_EVERY = 10.0  # seconds between two lines of a log


def run_report(arguments: argparse.Namespace) -> int:
    """``usdsmoke report``; the exit code."""
    from rich.console import Console
    from rich.progress import Progress

    from usdsmoke.work_precision import make_report

    settings = given_settings(arguments)
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        result = make_report(
            arguments.stage,
            arguments.style,
            arguments.output,
            settings,
            arguments.budget,
            _Teller(console, bar),
        )
    if arguments.json:
        from usdsmoke.work_precision import report_as_dict

        files = [str(file_path) for file_path in result.files]
        print_json({"page": str(result.page), "files": files, **report_as_dict(result.report)})
    else:
        print(_text(result))
    return 0


class _Teller:
    """A bar on a terminal, a line now and then elsewhere."""

    def __init__(self, console: "Console", bar: "Progress") -> None:
        self._console, self._bar = console, bar
        self._task: TaskID = bar.add_task("reading", total=1.0)
        self._last = -_LINE_EVERY

    def __call__(self, sweep: str, point: str, share: float) -> None:
        text = f"{sweep}: {point}"
        self._bar.update(self._task, description=text, completed=share)
        now = time.monotonic()
        if not self._console.is_terminal and now - self._last >= _LINE_EVERY:
            self._last = now
            self._console.print(f"{share:4.0%} {text}", markup=False, highlight=False)


def _text(result: "ReportResult") -> str:
    lines = [str(result.page)]
    for sweep in result.report.sweeps:
        lines.append(f"  {sweep.title}: {sweep.verdict}")
    for item in result.report.omissions:
        lines.append(f"  left out: {item.what}: {item.reason}")
    return "\n".join(lines)

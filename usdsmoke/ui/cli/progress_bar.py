"""Progress on stderr: a bar on a terminal, lines in a log (every ten seconds, and at the end)."""

import time
from collections.abc import Callable, Iterable
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from usdsmoke.base.time_codes import format_time_code
from usdsmoke.runs.budget import Finding, finding_texts
from usdsmoke.runs.progress import RunProgress
from usdsmoke.ui.cli.text import LINE_EVERY, format_seconds

_LEARN_FOR = 2.0  # seconds before the remaining time is shown


class ConsoleProgress:
    """Draws a bar on a terminal and writes plain lines elsewhere; called with each progress record.

    Use it as a context, so that the terminal is whole again whatever happens.

    Args:
        console: on the error stream; results never go there.
        clock: seconds, for tests.
    """

    def __init__(self, console: Console, clock: Callable[[], float] = time.monotonic) -> None:
        self._console = console
        self._clock = clock
        self._began: tuple[float, float] | None = None  # time and share at the first iteration
        self._last_line = clock()
        # by window: the step that was told last, and whether it was its last frame
        self._told_steps: dict[int | None, tuple[str, bool]] = {}
        self._told: set[tuple[str, str]] = set()  # kinds of findings
        self._bars = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:>3.0f}%"),
            TextColumn("{task.fields[left]}"),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bars.add_task("starting", total=1.0, left="")

    def __enter__(self) -> "ConsoleProgress":
        self._bars.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bars.stop()

    def __call__(self, report: RunProgress) -> None:
        """Show one record of a run."""
        if report.step == "wait":
            self.say("waiting for another usdsmoke process that writes to the output folder")
            return
        if report.findings:
            self._tell(report.findings)
            return
        now = self._clock()
        where, left = _where(report), ""
        if report.loss or report.step == "coarse":
            left = self._time_left(now, report.share)
        self._bars.update(self._task, description=where, completed=report.share, left=left)
        told = (report.step, report.frame + 1 == report.n_frames)
        is_due = told != self._told_steps.get(report.window)
        is_due = is_due or now - self._last_line >= LINE_EVERY
        if not self._console.is_terminal and is_due:
            self._last_line, self._told_steps[report.window] = now, told
            self.say(f"{report.share:4.0%} {where} {left}".rstrip())

    def say(self, message: str) -> None:
        """Write a message above the bar."""
        self._console.print(message, markup=False, highlight=False, soft_wrap=True)

    def _tell(self, findings: Iterable[Finding]) -> None:
        """Say findings of a new kind: not each frame's again."""
        for finding in findings:
            if finding.kind not in self._told:
                self._told.add(finding.kind)
                (text,) = finding_texts([finding])
                self.say(f"note: {text}")

    def _time_left(self, now: float, share: float) -> str:
        if self._began is None:
            self._began = (now, share)
        elapsed, done = now - self._began[0], share - self._began[1]
        if elapsed < _LEARN_FOR or done <= 0:
            return ""
        return f"{format_seconds(elapsed * (1 - share) / done)} left"


def _where(report: RunProgress) -> str:
    """What is being done, in a few words."""
    noun = {"window": "", "train": " iteration"}.get(report.step, " frame")
    where = f"{report.step}{noun} {report.frame + 1}/{report.n_frames}"
    if report.window is not None:
        where = f"window {report.window}: {where}"
    if report.step != "train":
        where += f" (t={format_time_code(report.time_code)})"
    if report.n_octaves:
        where += f" octave {report.octave + 1}/{report.n_octaves}"
    return where + (f" loss {report.loss:.3g}" if report.loss else "")

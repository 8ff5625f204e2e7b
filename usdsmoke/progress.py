"""How far a run is, told on the error stream: bars on a terminal, a line now and then in a log."""

import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from usdsmoke.config import Config
from usdsmoke.estimate import octave_iterations

if TYPE_CHECKING:
    from usdsmoke.core.progress import Progress as Report

__all__ = ["ConsoleProgress", "WorkMeter", "format_seconds"]

_LINE_EVERY = 10.0  # seconds between two lines of a log


class WorkMeter:
    """The share of a run that is done, counted in iterations weighted by what an octave costs.

    Args:
        config: gives steps, octaves and iterations.
    """

    def __init__(self, config: Config) -> None:
        self._scale = config.optimize.octave_scale
        self._octaves = {
            step: octave_iterations(getattr(config, step).iterations, config.optimize.iterations)
            for step in config.optimize.steps
        }

    def share(self, report: "Report") -> float | None:
        """The share of all frames that is done, 0 to 1; None for a step without iterations."""
        if report.step not in self._octaves or report.n_frames == 0:
            return None
        work = {step: sum(self._octave_work(octaves)) for step, octaves in self._octaves.items()}
        steps = list(work)
        done = sum(work[step] for step in steps[: steps.index(report.step)])
        part = min((report.iteration + 1) / max(report.n_iterations, 1), 1.0)
        within = (done + self._work_until(report.step, part)) / sum(work.values())
        return min((report.frame + within) / report.n_frames, 1.0)

    def _octave_work(self, iterations: Sequence[int]) -> list[float]:
        """Each octave's work: pixels fall with the square of the scale, and some cost is fixed."""
        last = len(iterations) - 1
        return [
            n * (0.15 + self._scale ** (-2 * (last - octave)))
            for octave, n in enumerate(iterations)
        ]

    def _work_until(self, step: str, part: float) -> float:
        """Work of a step when this part of its iterations is done, all octaves taken together."""
        iterations = self._octaves[step]
        left = part * sum(iterations)
        done = 0.0
        for n, work in zip(iterations, self._octave_work(iterations), strict=True):
            done += work * min(left / n, 1.0)
            left = max(left - n, 0.0)
        return done


class ConsoleProgress:
    """Called with each record of a run; draws a bar on a terminal, writes plain lines elsewhere.

    Use it as a context, so that the terminal is whole again whatever happens.

    Args:
        console: on the error stream; results never go there.
        config: gives steps, octaves and iterations.
        clock: seconds, for tests.
    """

    def __init__(
        self, console: Console, config: Config, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._console = console
        self._clock = clock
        self._meter = WorkMeter(config)
        self._began: tuple[float, float] | None = None  # time and share when stylizing began
        self._last_line = clock()
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

    def __call__(self, report: "Report") -> None:
        """Shows one record of a run."""
        share = self._meter.share(report)
        where = f"{report.step} frame {report.frame + 1}/{report.n_frames} (t={report.time_code:g})"
        if share is None:
            self._bars.update(self._task, description=where)
            return
        where += f" octave {report.octave + 1}/{report.n_octaves} loss {report.loss:.3g}"
        left = self._time_left(share)
        self._bars.update(self._task, description=where, completed=share, left=left)
        now = self._clock()
        if not self._console.is_terminal and now - self._last_line >= _LINE_EVERY:
            self._last_line = now
            self.say(f"{share:4.0%} {where} {left}".rstrip())

    def say(self, message: str) -> None:
        """Writes a message above the bar."""
        self._console.print(message, markup=False, highlight=False, soft_wrap=True)

    def _time_left(self, share: float) -> str:
        now = self._clock()
        if self._began is None:
            self._began = (now, share)
        elapsed, done = now - self._began[0], share - self._began[1]
        if elapsed < 2.0 or done <= 0:
            return ""
        return f"{format_seconds(elapsed * (1 - share) / done)} left"


def format_seconds(seconds: float) -> str:
    """A duration as people say it.

    >>> format_seconds(7.4), format_seconds(95), format_seconds(7260)
    ('7 s', '1 min 35 s', '2 h 1 min')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"

"""How far a run is, as a record; printing it is somebody else's business."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from usdsmoke.base.frame_report import Progress
from usdsmoke.config.settings import Config
from usdsmoke.core.sequence.controls import step_iterations
from usdsmoke.core.smoke.schedule import OCTAVE_SCALE
from usdsmoke.runs.budget import Finding

_FIXED_WORK = 0.15  # of an iteration of the finest octave, whatever the octave


@dataclass(frozen=True)
class RunProgress:
    """What is being done just now, and how much of the whole run is done."""

    # "check", "shape", "colour", "write", "picture", ...; "window": a whole one; "found": a frame
    # or scene has findings; "wait": another process is at work in the output folder
    step: str
    time_code: float
    frame: int  # 0-based, among the frames to do; of a window, among those
    n_frames: int  # that were not finished by an earlier run
    share: float  # of the run's iterations that are done, 0 to 1
    octave: int = 0  # 0-based, coarse to fine
    n_octaves: int = 0  # 0 for steps without iterations
    loss: float = 0.0
    window: int | None = None  # its number, where several processes compute windows at once
    findings: tuple[Finding, ...] = ()  # of the frame that was just written, or of the scene


RunProgressCallback = Callable[[RunProgress], None]

WAITING = RunProgress("wait", 0.0, 0, 0, 0.0)


def ignore_progress(report: RunProgress) -> None:
    """Takes the place of a progress callback that was not given."""


def share_of(tell: RunProgressCallback, first: float, last: float) -> RunProgressCallback:
    """The callback of a part of a run, which begins and ends at these shares of it."""
    return lambda report: tell(replace(report, share=first + (last - first) * report.share))


class WorkMeter:
    """The share of a run that is done, counted in iterations weighted by what an octave costs.

    Of a frame the next one's shape step comes before its colour step, so each step is counted by
    itself. The share never falls.

    Args:
        warm: for every frame to do, whether it starts from its neighbour's result.
        left: for every frame, how many octaves of each step the shared coarse step has left to it;
            0: all.
    """

    def __init__(
        self,
        config: Config | Sequence[Config],
        warm: Sequence[bool],
        left: Sequence[int] | None = None,
    ) -> None:
        configs = [config] * len(warm) if isinstance(config, Config) else config
        left = left or [0] * len(warm)
        self._work = [
            _frame_work(own, is_warm, n_left)
            for own, is_warm, n_left in zip(configs, warm, left, strict=True)
        ]
        self._done = [dict.fromkeys(work, 0.0) for work in self._work]
        self._total = sum(sum(octaves) for work in self._work for _, octaves in work.values())

    def share(self, report: Progress, frame: int) -> float:
        """The share that is done after an iteration."""
        work = self._work[frame]
        for step in list(work)[: list(work).index(report.step)]:
            self._finish(frame, step)
        iterations, weights = work[report.step]
        left = sum(iterations) * min((report.iteration + 1) / max(report.n_iterations, 1), 1.0)
        done = 0.0
        for n, weight in zip(iterations, weights, strict=True):
            part = min(left, n)
            done += weight * part / n if n else 0.0
            left -= part
        self._done[frame][report.step] = max(done, self._done[frame][report.step])
        return self.now

    def finish(self, frame: int) -> float:
        """The share that is done when a frame is, whatever was reported of it."""
        for step in self._work[frame]:
            self._finish(frame, step)
        return self.now

    @property
    def now(self) -> float:
        """The share that is done, 0 to 1."""
        if not self._total:
            return 1.0
        return min(sum(sum(done.values()) for done in self._done) / self._total, 1.0)

    def _finish(self, frame: int, step: str) -> None:
        self._done[frame][step] = sum(self._work[frame][step][1])


def _frame_work(
    config: Config, is_warm: bool, n_left: int
) -> dict[str, tuple[list[int], list[float]]]:
    """A frame's iterations by step, octave by octave, and the work of each octave.

    Pixels fall with the square of the scale, and some of the cost is fixed. What the coarse step
    has done is no iteration of the frame; colours that a network paints do not come from there.
    """
    found: dict[str, tuple[list[int], list[float]]] = {}
    for step in config.optimize.steps:
        iterations = step_iterations(config, step, is_warm)
        if n_left and not (step == "colour" and config.optimize.start):
            iterations[:-n_left] = [0] * len(iterations[:-n_left])
        work = [
            n * (_FIXED_WORK + OCTAVE_SCALE ** (-2 * (len(iterations) - 1 - octave)))
            for octave, n in enumerate(iterations)
        ]
        found[step] = (iterations, work)
    return found

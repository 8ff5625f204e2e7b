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

    Args:
        warm: for every frame to do, whether it starts from its neighbour's result.
    """

    def __init__(self, config: Config | Sequence[Config], warm: Sequence[bool]) -> None:
        configs = [config] * len(warm) if isinstance(config, Config) else config
        self._iterations = [
            _frame_iterations(own, is_warm) for own, is_warm in zip(configs, warm, strict=True)
        ]
        self._total = sum(self._frame_work(frame) for frame in range(len(warm)))

    def share(self, report: Progress, frame: int) -> float:
        """The share that is done after an iteration."""
        before = sum(self._frame_work(earlier) for earlier in range(frame))
        steps = list(self._iterations[frame])
        steps = steps[: steps.index(report.step)]
        before += sum(self._step_work(frame, step, 1.0) for step in steps)
        part = min((report.iteration + 1) / max(report.n_iterations, 1), 1.0)
        done = before + self._step_work(frame, report.step, part)
        return min(done / self._total, 1.0) if self._total else 1.0

    def share_before(self, frame: int) -> float:
        """The share that is done when a frame begins."""
        done = sum(self._frame_work(earlier) for earlier in range(frame))
        return done / self._total if self._total else 1.0

    def _frame_work(self, frame: int) -> float:
        return sum(self._step_work(frame, step, 1.0) for step in self._iterations[frame])

    def _step_work(self, frame: int, step: str, part: float) -> float:
        """Work of a step when this part of its iterations is done, all octaves taken together.

        Pixels fall with the square of the scale, and some of the cost is fixed.
        """
        iterations = self._iterations[frame][step]
        left = part * sum(iterations)
        work = 0.0
        for octave, n in enumerate(iterations):
            coarseness = len(iterations) - 1 - octave
            done = min(left, n)
            work += done * (_FIXED_WORK + OCTAVE_SCALE ** (-2 * coarseness))
            left -= done
        return work


def _frame_iterations(config: Config, is_warm: bool) -> dict[str, list[int]]:
    """A frame's iterations by step, octave by octave."""
    return {step: step_iterations(config, step, is_warm) for step in config.optimize.steps}

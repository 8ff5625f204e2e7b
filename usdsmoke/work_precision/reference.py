"""What trials are measured against: two runs that do much more than any trial."""

from dataclasses import dataclass

from usdsmoke.work_precision.case import Case
from usdsmoke.work_precision.records import LeftOut
from usdsmoke.work_precision.trial import (
    Setting,
    Trial,
    base_iterations,
    scaled,
    trial_seconds,
    untiring,
)
from usdsmoke.work_precision.unseen_loss import Outcome

EXCESS = "style loss above the reference's, as a share of the fall from start to reference"
_RUNS = 8.5  # time of both references, in configured runs
_SHARE, _POOL = 4.0, 64  # of the iterations; views
_SEEDS = (1000, 1001)  # numbers of runs: far from those of points
_LEAST = 0.1  # of the references' distance: smaller errors are drawn there


@dataclass(frozen=True)
class Reference:
    """Losses over unused views: before the step, and of the two references."""

    trial: Trial
    start: float
    losses: tuple[float, float]
    n_iterations: int

    @property
    def best(self) -> float:
        """The lower of the two losses."""
        return min(self.losses)

    @property
    def apart(self) -> float:
        """Their distance in the unit of errors. Smaller errors mean nothing."""
        return abs(self.losses[0] - self.losses[1]) / (self.start - self.best)

    def error(self, outcome: Outcome) -> float:
        """0 for the reference, 1 for the state before the step."""
        return self.of_loss(self.trial.unseen.loss(outcome))

    def of_loss(self, loss: float) -> float:
        """The error of a loss over unused views; not below a tenth of ``apart``."""
        return max((loss - self.best) / (self.start - self.best), _LEAST * self.apart, 1e-6)

    @property
    def text(self) -> str:
        """The reference in words, for the page."""
        return (
            f"two runs of {self.n_iterations} iterations ({_SHARE:g}x the configured) with {_POOL} "
            "views, without the stopping rule and with their own seeds. The loss is "
            f"{self.start:.4g} before the step and {self.losses[0]:.4g} and {self.losses[1]:.4g} "
            f"after it. The lower one is error 0; the other has error {self.apart:.2g}, which is "
            "how much runs differ by their seeds alone. Errors below this are not significant."
        )


def reference_seconds(case: Case, step: str) -> float:
    """Seconds that making the references is expected to take; 0 once they exist."""
    return 0.0 if ("reference", step) in case.cache else _RUNS * trial_seconds(case, step)


def reference_of(case: Case, step: str) -> Reference:
    """The references of a step, made once in a report.

    Raises:
        LeftOut: the step does not lower the loss.
    """
    if ("reference", step) not in case.cache:
        base, config = base_iterations(case, step), case.config
        most = untiring(config.replace(views=config.views.replace(pool=_POOL)))
        setting = Setting(scaled(base, _SHARE), most)
        trial = Trial(case, step, config)
        trial.prepare(setting)
        first, second = (trial.unseen.loss(trial.run(setting, seed)) for seed in _SEEDS)
        made = Reference(trial, trial.start(), (first, second), sum(setting.per_octave))
        case.cache["reference", step] = made
    found: Reference = case.cache["reference", step]
    if not found.best < found.start:
        raise LeftOut(
            f"the {step} step does not lower the loss of unused views: {found.start:.4g} before it "
            f"and {found.best:.4g} after {found.n_iterations} iterations"
        )
    return found

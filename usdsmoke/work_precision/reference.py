"""What trials are measured against: two runs that do much more than any of them."""

from dataclasses import dataclass, replace

from usdsmoke.work_precision.case import Case
from usdsmoke.work_precision.judge import Outcome
from usdsmoke.work_precision.records import LeftOut
from usdsmoke.work_precision.trial import (
    Setting,
    Trial,
    base_iterations,
    scaled,
    trial_seconds,
    untiring,
)

__all__ = ["EXCESS", "Reference", "reference_of", "reference_seconds"]

EXCESS = "style loss above the reference's, as a share of the fall from the start to it"
_RUNS = 8.5  # configured runs' time that both references take
_SHARE, _POOL = 4.0, 64  # of the iterations; views
_SEEDS = (1000, 1001)  # numbers of runs: far from those of points
_LEAST = 0.1  # of the distance of the references: errors below it are drawn there


@dataclass(frozen=True)
class Reference:
    """Losses over unused views of what was not stylized, and of the two references."""

    trial: Trial
    start: float
    losses: tuple[float, float]
    n_iterations: int

    @property
    def best(self) -> float:
        """The lower one of the two: no error is measured against a run that ended badly."""
        return min(self.losses)

    @property
    def apart(self) -> float:
        """How far they are apart, in the unit of errors: what no error below says anything of."""
        return abs(self.losses[0] - self.losses[1]) / (self.start - self.best)

    def error(self, outcome: Outcome) -> float:
        """0 for the reference, 1 for what was not stylized."""
        return self.of_loss(self.trial.judge.loss(outcome))

    def of_loss(self, loss: float) -> float:
        """The error of a loss over unused views; not below a tenth of ``apart``."""
        return max((loss - self.best) / (self.start - self.best), _LEAST * self.apart, 1e-6)

    @property
    def text(self) -> str:
        """What the page says of it."""
        return (
            f"two runs of {self.n_iterations} iterations ({_SHARE:g}x the configured) with {_POOL} "
            f"views, without the stopping rule and with seeds of their own. Before the step the "
            f"loss is {self.start:.4g}; they end at {self.losses[0]:.4g} and "
            f"{self.losses[1]:.4g}. The lower one is error 0; the other one has the error "
            f"{self.apart:.2g}. So much do runs differ by their seeds alone: smaller errors cannot "
            "be told from none."
        )


def reference_seconds(case: Case, step: str) -> float:
    """What making them is expected to take; nothing when they are there."""
    return 0.0 if step in case.references else _RUNS * trial_seconds(case, step)


def reference_of(case: Case, step: str) -> Reference:
    """The references of a step, made once in a report.

    Raises:
        LeftOut: the step does not lower the loss.
    """
    if step not in case.references:
        base, config = base_iterations(case, step), case.config
        most = untiring(replace(config, views=replace(config.views, pool=_POOL)))
        setting = Setting(scaled(base, _SHARE), most)
        trial = Trial(case, step, config)
        trial.prepare(setting)
        first, second = (trial.judge.loss(trial.run(setting, seed)) for seed in _SEEDS)
        found = Reference(trial, trial.start(), (first, second), sum(setting.per_octave))
        case.references[step] = found
    found = case.references[step]
    if not found.best < found.start:
        raise LeftOut(
            f"the {step} step does not lower the loss of unused views: {found.start:.4g} before it "
            f"and {found.best:.4g} after {found.n_iterations} iterations"
        )
    return found

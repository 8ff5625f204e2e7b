"""Trials: one step of the optimisation on the small frame, with the configured iterations.

They are measured against two references, runs that do much more than any trial.
"""

import time
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from usdsmoke.config.settings import Config
from usdsmoke.work_precision.case import Case
from usdsmoke.work_precision.records import LeftOut, Task
from usdsmoke.work_precision.unseen_loss import Outcome, UnseenLoss

if TYPE_CHECKING:
    from usdsmoke.core.smoke.active import ActiveSmoke
    from usdsmoke.core.steps.targets import StyleTargets
    from usdsmoke.core.views.scene import Scene


N_RUNS = 2  # of a point
_TRIALS = 20  # configured runs that the first points of all sweeps take
_WORTH = 0.75  # of the time: a smaller copy that takes more loses detail for too little
_PILOT = 10  # iterations per octave of the first short run; the second has twice as many


@dataclass(frozen=True)
class Setting:
    """How a trial differs from the configured one."""

    per_octave: tuple[int, ...]  # iterations, coarse to fine
    config: Config
    refine: int = 1  # subdivisions of a voxel
    pixels: int = 1  # voxels of the small frame along a pixel's side; 1 is the small scene's


def main_step(case: Case) -> str:
    """The step that most sweeps use: the one that takes the time."""
    return "colour" if "colour" in case.steps else case.steps[0]


def copy_text(case: Case) -> str:
    """What trials run on, in words."""
    if case.halvings == 0:
        return "the frame at its own size"
    return (
        f"the small copy of the frame (voxels {2**case.halvings} times as large along a side, "
        f"pictures of {case.small_scene.image_size} pixels instead of {case.scene.image_size})"
    )


def base_iterations(case: Case, step: str) -> tuple[int, ...]:
    """The configured iterations per octave; trials have the same."""
    from usdsmoke.core.smoke.schedule import octave_iterations

    whole = getattr(case.config, step).iterations
    return tuple(octave_iterations(whole, case.config.optimize.iterations))


def scaled(per_octave: Sequence[int], share: float) -> tuple[int, ...]:
    """Iterations per octave times a number. An octave that has iterations keeps at least one.

    >>> scaled([8, 4, 0], 0.2)
    (2, 1, 0)
    """
    return tuple(max(1, round(n * share)) if n else 0 for n in per_octave)


def untiring(config: Config) -> Config:
    """The settings without the rule that stops an octave early."""
    return config.replace(optimize=config.optimize.replace(tolerance=0.0))


def trial_seconds(case: Case, step: str) -> float:
    """Wall-clock seconds that a configured run on the small copy is expected to take.

    Two short runs tell; they also warm the machine up. If trials would take too much of the
    report's time, the small copy is made smaller first, as long as that helps.
    """
    main, known = main_step(case), case.cache.setdefault("trial seconds", {})
    if main not in known:
        wall, work = _pilot(case, main)
        while wall * _TRIALS > case.seconds / 2 and case.can_shrink:
            longest = case.longest
            case.shrink(longest // 2)
            smaller = _pilot(case, main)
            if smaller[1] > _WORTH * work:
                case.shrink(longest)
                break
            wall, work = smaller
        known[main] = wall
    if step not in known:
        known[step] = _pilot(case, step)[0]
    return float(known[step])


def need_seconds(case: Case, what: str, seconds: float) -> None:
    """Leave a sweep out that takes too long.

    Raises:
        LeftOut: ``seconds`` are more than the current sweep is allowed.
    """
    if seconds > case.allowed:
        raise LeftOut(
            f"{what} with the configured iterations take about {seconds:.0f} s on a copy of at "
            f"most {case.longest} voxels along a side, and {max(case.allowed, 0):.0f} s were left"
        )


def _pilot(case: Case, step: str) -> tuple[float, float]:
    """Wall-clock and CPU seconds of a configured run, from two short ones.

    CPU seconds depend little on other processes. On a GPU both are wall-clock seconds.
    """
    base, trial = base_iterations(case, step), Trial(case, step, case.config)
    few, more = (tuple(min(n, each) for n in base) for each in (_PILOT, 2 * _PILOT))
    first, second = (_timed(trial, pilot, case) for pilot in (few, more))
    if sum(more) == sum(few):
        return second
    rest = (sum(base) - sum(more)) / (sum(more) - sum(few))
    wall, work = (b + rest * max(b - a, 0.3 * a) for a, b in zip(first, second, strict=True))
    return wall, work


def _timed(trial: "Trial", per_octave: Sequence[int], case: Case) -> tuple[float, float]:
    setting = Setting(tuple(per_octave), untiring(case.config))
    trial.prepare(setting)
    wall, work = time.perf_counter(), time.process_time()
    trial.run(setting, 0)
    wall, work = time.perf_counter() - wall, time.process_time() - work
    return wall, wall if case.on_gpu else work


class Trial:
    """A step on the small frame, without neighbours, mask or the camera's frustum.

    Args:
        step: ``shape`` or ``colour``.
        config: of the features and losses that measure results.
    """

    def __init__(self, case: Case, step: str, config: Config) -> None:
        self._case, self._step = case, step
        self._scene = case.small_scene
        self.unseen = UnseenLoss(case, step, config)
        self._targets: dict[Hashable, StyleTargets] = {}
        self._smokes: dict[int, ActiveSmoke] = {1: case.small_smoke}

    def task(
        self,
        curve: str,
        label: str,
        setting: Setting,
        configured: bool = False,
        effort: float = 1.0,
        error: Callable[[Outcome], float] | None = None,
    ) -> Task:
        """A task that runs a setting. Its error is the unused views' loss unless one is given.

        The configured setting is run once in a report. The label says where runs stopped early.
        """
        key = f"{self._step}, {self._case.longest}: {setting}" if configured else None
        return Task(
            curve,
            label,
            partial(self.run, setting),
            error or self.unseen.loss,
            configured,
            effort,
            prepare=partial(self.prepare, setting),
            key=key,
            note=partial(_stopped, setting),
        )

    def start(self) -> float:
        """The loss before the step."""
        return self.unseen.start(self._case.small_smoke, self._case.small.density, ("refined", 1))

    def run(self, setting: Setting, run: int) -> Outcome:
        """The result of one run. Runs differ in their seed alone."""
        from usdsmoke.core.steps.colour import run_colour_step
        from usdsmoke.core.steps.targets import StepProblem

        config, per_octave = setting.config, setting.per_octave
        config = config.replace(optimize=config.optimize.replace(seed=config.optimize.seed + run))
        scene = self._scene_of(setting)
        smoke, targets = self._smoke_of(setting), self._targets_of(setting)
        if self._step == "colour":
            problem = StepProblem(smoke, targets, scene, config)
            found, ends = run_colour_step(problem, per_octave)
        else:
            found, ends = self._moved(setting, config)
        return Outcome(smoke, found, ("refined", setting.refine), config, len(per_octave), ends)

    def prepare(self, setting: Setting) -> None:
        """Make what all runs share: the style's statistics and finer voxels."""
        targets = self._targets_of(setting)
        for number, n_iterations in enumerate(setting.per_octave):
            if n_iterations:
                factor = 2 ** (len(setting.per_octave) - 1 - number)
                targets.at(factor, grey=self._step == "shape")
        self._smoke_of(setting)

    def _moved(self, setting: Setting, config: Config) -> Any:
        from usdsmoke.core.steps.move import displacement_of, move_density
        from usdsmoke.core.steps.shape import max_displacement, run_shape_step
        from usdsmoke.core.steps.targets import StepProblem

        smoke, targets = self._smoke_of(setting), self._targets_of(setting)
        scene = self._scene_of(setting)
        problem = StepProblem(smoke, targets, scene, config)
        unclamped, ends = run_shape_step(problem, setting.per_octave)
        limit, strength = max_displacement(smoke, config.shape.reach), config.optimize.strength
        displacement = displacement_of(unclamped, smoke, limit, strength=strength)
        density = self._field_of(setting)
        return move_density(density, smoke, displacement, scene, config.shape)[0], ends

    def _scene_of(self, setting: Setting) -> "Scene":
        if setting.pixels == 1 and setting.refine == 1:
            return self._scene
        n_voxels = len(self._smoke_of(setting).ijk)
        return replace(self._scene.coarser(setting.pixels / setting.refine), most_voxels=n_voxels)

    def _targets_of(self, setting: Setting) -> "StyleTargets":
        from usdsmoke.core.steps.targets import make_targets

        scene, features = self._scene_of(setting), setting.config.features
        key = (scene.image_size, features.network, tuple(features.layers))
        if key not in self._targets:
            case = self._case
            self._targets[key] = make_targets(case.styles, scene, setting.config, case.device)
        return self._targets[key]

    def _smoke_of(self, setting: Setting) -> "ActiveSmoke":
        from usdsmoke.core.smoke.active import activate

        if setting.refine not in self._smokes:
            field = self._field_of(setting)
            self._smokes[setting.refine] = activate(field, np.eye(4), self._case.device)
        return self._smokes[setting.refine]

    def _field_of(self, setting: Setting) -> Any:
        from usdsmoke.core.fields.resample import refine_field

        return refine_field(self._case.small.density, setting.refine)


def _stopped(setting: Setting, outcome: Outcome) -> str:
    """How many iterations were done, if the rule stopped an octave."""
    if not any(end.reason == "converged" for end in outcome.ends):
        return ""
    done = sum(end.iteration + 1 for end in outcome.ends)
    return f"{done} of {sum(setting.per_octave)} done"


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

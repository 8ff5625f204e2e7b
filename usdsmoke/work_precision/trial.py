"""One step of the optimisation tried on the small frame, with the configured iterations."""

import time
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from usdsmoke.base.config import Config
from usdsmoke.work_precision.case import Case
from usdsmoke.work_precision.judge import Judge, Outcome
from usdsmoke.work_precision.records import LeftOut, Task

if TYPE_CHECKING:
    from torch import Tensor

    from usdsmoke.core.smoke.active import ActiveSmoke
    from usdsmoke.core.style.targets import StyleTargets
    from usdsmoke.core.views.scene import Scene

__all__ = [
    "N_RUNS",
    "Setting",
    "Trial",
    "base_iterations",
    "copy_text",
    "main_step",
    "need_seconds",
    "scaled",
    "trial_seconds",
    "untiring",
]

N_RUNS = 2  # of a point
_TRIALS = 20  # configured runs that the first points of all sweeps of trials take
_WORTH = 0.75  # of the time: a smaller copy that takes more loses detail for too little
_PILOT = 10  # iterations an octave, and twice as many: by these the others' time is guessed


@dataclass(frozen=True)
class Setting:
    """What a trial differs in from the configured one."""

    per_octave: tuple[int, ...]  # iterations, coarse to fine
    config: Config
    refine: int = 1  # voxels are cut this many times
    pixels: int = 1  # voxels of the small frame along a pixel's side; 1 is the small scene's


def main_step(case: Case) -> str:
    """The step that sweeps about both are made with: the one that takes the time."""
    return "colour" if "colour" in case.steps else case.steps[0]


def copy_text(case: Case) -> str:
    """What trials are done on, and how it differs from the frame."""
    if case.halvings == 0:
        return "the frame at its own size"
    return (
        f"the small copy of the frame (voxels {2**case.halvings} times as large along a side, "
        f"pictures of {case.small_scene.image_size} pixels, not {case.scene.image_size})"
    )


def base_iterations(case: Case, step: str) -> tuple[int, ...]:
    """The configured iterations per octave, which are also those of a trial."""
    from usdsmoke.core.smoke.schedule import octave_iterations

    whole = getattr(case.config, step).iterations
    return tuple(octave_iterations(whole, case.config.optimize.iterations))


def scaled(per_octave: Sequence[int], share: float) -> tuple[int, ...]:
    """Iterations per octave times a number; an octave that has some keeps one at least.

    >>> scaled([8, 4, 0], 0.2)
    (2, 1, 0)
    """
    return tuple(max(1, round(n * share)) if n else 0 for n in per_octave)


def untiring(config: Config) -> Config:
    """The settings without the rule that stops an octave early."""
    return replace(config, optimize=replace(config.optimize, tolerance=0.0))


def trial_seconds(case: Case, step: str) -> float:
    """What a run with the configured settings is expected to take on the small copy, seconds of the
    clock on the wall.

    From two short runs, which also warm the machine up. Where it takes too large a part of the
    report's time, the small copy is made smaller first, as long as that helps.
    """
    main, known = main_step(case), case.trial_seconds
    if main not in known:
        taken = _guess(case, main)
        while taken.seconds * _TRIALS > case.seconds / 2 and case.can_shrink:
            longest = case.longest
            case.shrink(longest // 2)
            smaller = _guess(case, main)
            if smaller.work > _WORTH * taken.work:
                case.shrink(longest)
                break
            taken = smaller
        known[main] = taken.seconds
    if step not in known:
        known[step] = _guess(case, step).seconds
    return known[step]


def need_seconds(case: Case, what: str, seconds: float) -> None:
    """Leaves a sweep out that takes too long.

    Raises:
        LeftOut: ``seconds`` are more than the sweep at hand is allowed.
    """
    if seconds > case.allowed:
        raise LeftOut(
            f"{what} with the configured iterations would take about {seconds:.0f} s, even on the "
            f"copy of {case.longest} voxels at most along a side, and {max(case.allowed, 0):.0f} s "
            "were left for that"
        )


@dataclass(frozen=True)
class _Taken:
    """What a run takes."""

    seconds: float  # by the clock on the wall: that is what the report's time is measured in
    work: float  # CPU seconds, which other processes change little; on a GPU as ``seconds``


def _guess(case: Case, step: str) -> _Taken:
    base = base_iterations(case, step)
    trial, total = Trial(case, step, case.config), sum(base)
    few, more = (tuple(min(n, each) for n in base) for each in (_PILOT, 2 * _PILOT))
    first, second = (_taken(trial, pilot, case) for pilot in (few, more))
    if sum(more) == sum(few):
        return second
    rest = (total - sum(more)) / (sum(more) - sum(few))
    seconds = second.seconds + rest * max(second.seconds - first.seconds, 0.3 * first.seconds)
    work = second.work + rest * max(second.work - first.work, 0.3 * first.work)
    return _Taken(seconds, work)


def _taken(trial: "Trial", per_octave: Sequence[int], case: Case) -> _Taken:
    setting = Setting(tuple(per_octave), untiring(case.config))
    trial.prepare(setting)
    started = time.perf_counter(), time.process_time()
    trial.run(setting, 0)
    wall, cpu = time.perf_counter() - started[0], time.process_time() - started[1]
    return _Taken(wall, wall if case.on_gpu else cpu)


class Trial:
    """A step on the small frame, from its own start, without neighbours, mask or camera's frustum.

    Args:
        case: gives frame, scene and styles.
        step: ``shape`` or ``colour``.
        config: of the features and losses that results are judged by.
    """

    def __init__(self, case: Case, step: str, config: Config) -> None:
        self._case, self._step = case, step
        self._scene = case.small_scene
        self.judge = Judge(case, step, config)
        self._targets: dict[Any, StyleTargets] = {}
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
        """A task that runs a setting; its error is the loss unless another one is given.

        The configured one is done once in a report. The label tells where runs stopped early.
        """
        return Task(
            curve, label, partial(self.run, setting), error or self.judge.loss, None, configured,
            effort, prepare=partial(self.prepare, setting),
            key=self._key(setting) if configured else None,
            note=partial(_stopped, setting), trace=_trace,
        )  # fmt: skip

    def start(self) -> float:
        """The loss before anything is done."""
        return self.judge.start(self._case.small_smoke, self._case.small.density, ("refined", 1))

    def run(self, setting: Setting, run: int) -> Outcome:
        """The result of one run. Runs differ in their seed alone."""
        from usdsmoke.core.steps.colour import run_colour_step

        config, per_octave = setting.config, setting.per_octave
        config = replace(config, optimize=replace(config.optimize, seed=config.optimize.seed + run))
        scene = self._scene_of(setting)
        smoke, targets = self._smoke_of(setting), self._targets_of(setting)
        if self._step == "colour":
            found, ends = run_colour_step(smoke, None, targets, scene, config, per_octave)
        else:
            found, ends = self._moved(setting, config)
        return Outcome(smoke, found, ("refined", setting.refine), config, len(per_octave), ends)

    def prepare(self, setting: Setting) -> None:
        """Makes what is the same for all runs: the style's statistics and finer voxels."""
        targets = self._targets_of(setting)
        for number in range(len(setting.per_octave)):
            if setting.per_octave[number]:
                factor = 2 ** (len(setting.per_octave) - 1 - number)
                targets.at(factor, grey=self._step == "shape")
        self._smoke_of(setting)

    def pictures(self, outcome: Outcome) -> list["Tensor"]:
        """See ``Judge.pictures``."""
        return self.judge.pictures(outcome)

    def _moved(self, setting: Setting, config: Config) -> Any:
        from usdsmoke.core.fields.potential import Displacement, hold
        from usdsmoke.core.steps.move import move_density
        from usdsmoke.core.steps.shape import longest_move, run_shape_step

        smoke, targets = self._smoke_of(setting), self._targets_of(setting)
        scene = self._scene_of(setting)
        free, ends = run_shape_step(smoke, None, targets, scene, config, setting.per_octave)
        lattice, cap = free.lattice, longest_move(smoke, config)
        held = lattice.to_stage(hold(lattice.from_stage(free.values), cap, None))
        displacement = Displacement(held, lattice)
        return move_density(self._field_of(setting), smoke, displacement, config)[0], ends

    def _key(self, setting: Setting) -> Hashable:
        return f"{self._step}, {self._case.longest}: {setting}"

    def _scene_of(self, setting: Setting) -> "Scene":
        if setting.pixels == 1 and setting.refine == 1:
            return self._scene
        scale = setting.pixels / setting.refine
        return replace(
            self._scene,
            pixel_size=self._scene.pixel_size * scale,
            image_size=max(1, round(self._scene.image_size / scale)),
        )

    def _targets_of(self, setting: Setting) -> "StyleTargets":
        from usdsmoke.core.style.targets import StyleTargets

        scene, features = self._scene_of(setting), setting.config.features
        key = (scene.image_size, features.network, tuple(features.layers))
        if key not in self._targets:
            case = self._case
            self._targets[key] = StyleTargets(case.styles, scene, setting.config, case.device)
        return self._targets[key]

    def _smoke_of(self, setting: Setting) -> "ActiveSmoke":
        from usdsmoke.core.smoke.active import activate

        if setting.refine not in self._smokes:
            field = self._field_of(setting)
            self._smokes[setting.refine] = activate(field, np.eye(4), self._case.device)
        return self._smokes[setting.refine]

    def _field_of(self, setting: Setting) -> Any:
        from usdsmoke.core.fields.refine import refine_field

        return refine_field(self._case.small.density, setting.refine)


def _stopped(setting: Setting, outcome: Outcome) -> str:
    """How many iterations were done, where the rule stopped an octave."""
    if not any(end.reason == "converged" for end in outcome.ends):
        return ""
    done = sum(end.iteration + 1 for end in outcome.ends)
    return f"{done} of {sum(setting.per_octave)} done"


def _trace(outcome: Outcome) -> Hashable:
    """The loss of every iteration: no two paths share it."""
    return tuple(end.losses for end in outcome.ends)

"""A sweep over what a frame's colours start from: noise, the neighbour, a network."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from usdsmoke.core.generator.definition import N_ITERATIONS
from usdsmoke.core.smoke.schedule import network_iterations, warm_iterations
from usdsmoke.planning.estimate import FrameSize, training_seconds
from usdsmoke.work_precision.case import Case
from usdsmoke.work_precision.engine import Sweep
from usdsmoke.work_precision.records import Plan, Task
from usdsmoke.work_precision.trial import (
    EXCESS,
    N_RUNS,
    Setting,
    base_iterations,
    copy_text,
    need_seconds,
    reference_of,
    reference_seconds,
    scaled,
    trial_seconds,
)
from usdsmoke.work_precision.unseen_loss import Outcome
from usdsmoke.work_precision.windows import small_frames, transit_between

if TYPE_CHECKING:
    from torch import Tensor

    from usdsmoke.core.generator.network import Generator
    from usdsmoke.core.sequence.transit import Transit
    from usdsmoke.core.steps.optimize import Minimum
    from usdsmoke.core.steps.targets import StepProblem

_N_FRAMES = 8  # the measured one among them
_COLD = (1.0, 0.5, 0.25, 0.125)  # of the iterations
_AFTER = (0, 8, 16, 32)  # iterations


def _applies(case: Case) -> str:
    if not case.config.optimize.trains:
        return "optimize.start is not network"
    return "losses.style is 0: nothing is optimised" if case.config.losses.style == 0 else ""


def _plan(case: Case) -> Plan:
    base = base_iterations(case, "colour")
    seconds, rate = _expected_seconds(case), trial_seconds(case, "colour")
    need_seconds(
        case,
        "a network, two references and three points",
        seconds + reference_seconds(case, "colour") + 2 * N_RUNS * rate,
    )
    reference, started = reference_of(case, "colour"), time.monotonic()
    starts = _Starts.of(case)
    learned = time.monotonic() - started
    trial, whole = reference.trial, sum(base)
    tasks = [
        trial.task(
            "noise", f"{sum(own)} iterations", Setting(own, case.config), share == 1.0, share,
            reference.error,
        )
        for share in _COLD
        for own in [scaled(base, share)]
    ]  # fmt: skip
    n_voxels = len(starts.problem.smoke.ijk)
    for count in _AFTER:
        label = f"network + {count}" if count else "network"
        iterations = network_iterations((*[0] * (len(base) - 1), count), n_voxels)
        run = partial(starts.after_network, iterations)
        effort = count / whole + 0.02
        tasks.append(Task("network", label, run, reference.error, effort=effort))
    if starts.before is not None:
        warm = tuple(warm_iterations(base, case.config.windows.warm_iterations))
        run = partial(starts.after_neighbour, warm)
        label = f"neighbour + {sum(warm)}"
        effort = 2 * sum(warm) / whole
        tasks.append(Task("neighbour", label, run, reference.error, effort=effort))
    where = f"{starts.n_seen} other frames" if starts.n_seen else "the frame itself"
    return Plan(
        tasks,
        EXCESS,
        f"The colour step on {copy_text(case)}. The network was trained on {where} in "
        f"{learned:.0f} s, which is not in the times of its points. Iterations after it are those "
        "of the finest octave; of a large copy, three of four are of the octave before.",
        reference.text,
        uncertain=reference.apart,
        n_runs=N_RUNS,
        rate=rate,
    )


def _expected_seconds(case: Case) -> float:
    """Of the training, on the small copy."""
    low, high = case.small_smoke.box
    shape = [int(n) for n in high - low + 1]
    size = FrameSize(len(case.small_smoke.ijk), (shape[0], shape[1], shape[2]))
    return training_seconds([size], case.config, len(case.styles))


@dataclass(frozen=True)
class _Starts:
    """The measured frame with a network and a neighbour that it can start from."""

    problem: "StepProblem"
    generator: "Generator"
    n_seen: int  # other frames that the network was trained on; 0: the frame itself
    # The frame before, its colours, and the way from there; None where nothing is carried.
    before: tuple["StepProblem", "Tensor", "Transit"] | None

    @classmethod
    def of(cls, case: Case) -> "_Starts":
        """Train the network, and optimise the frame before."""
        from usdsmoke.core.smoke.active import ActiveSmoke, activate
        from usdsmoke.core.steps.colour import run_colour_step
        from usdsmoke.core.steps.targets import StepProblem, make_targets
        from usdsmoke.core.training.train import train_generator

        targets = make_targets(case.styles, case.small_scene, case.config, case.device)

        def problem_of(smoke: ActiveSmoke) -> StepProblem:
            return StepProblem(smoke, targets, case.small_scene, case.config)

        frames = small_frames(case, _N_FRAMES)
        smokes = [activate(frame.density, np.eye(4), case.device) for frame in frames]
        codes = [frame.time_code for frame in frames]
        place = codes.index(case.frame.time_code)
        others = [problem_of(s) for number, s in enumerate(smokes) if number != place]
        problem = problem_of(case.small_smoke)
        *seen, held_out = others or [problem]
        trained = train_generator(seen or [held_out], held_out, N_ITERATIONS, lambda state: None)
        before = None
        if place > 0 and frames[place - 1].velocity is not None:
            earlier = problem_of(smokes[place - 1])
            colours, _ = run_colour_step(earlier, base_iterations(case, "colour"))
            before = earlier, colours, transit_between(case, *frames[place - 1 : place + 1])
        return cls(problem, trained.generator, len(others), before)

    def after_network(self, per_octave: Sequence[int], run: int) -> Outcome:
        """The network's colours, and iterations after it."""
        from usdsmoke.core.steps.behind import refine_painted

        problem = self._seeded(run)
        seed = problem.config.optimize.seed
        painted = self.generator.paint(problem.smoke, problem.scene.gamma_w, seed)
        found, ends, _ = refine_painted(problem, per_octave, painted)
        return self._outcome(problem, per_octave, found, ends)

    def after_neighbour(self, per_octave: Sequence[int], run: int) -> Outcome:
        """The colours of the frame before, carried along, and iterations after that."""
        from usdsmoke.core.sequence.start import start_colours
        from usdsmoke.core.steps.colour import run_colour_step

        assert self.before is not None
        problem, (earlier, colours, way) = self._seeded(run), self.before
        seed = problem.config.optimize.seed
        carried = start_colours((earlier.smoke, colours), None, way, problem.smoke, seed)
        assert carried is not None
        found, ends = run_colour_step(problem, per_octave, carried, warm=True)
        return self._outcome(problem, per_octave, found, ends)

    def _seeded(self, run: int) -> "StepProblem":
        config = self.problem.config
        optimize = config.optimize.replace(seed=config.optimize.seed + run)
        return replace(self.problem, config=config.replace(optimize=optimize))

    def _outcome(
        self, problem: "StepProblem", per_octave: Sequence[int], found: "Tensor",
        ends: Sequence["Minimum"],
    ) -> Outcome:  # fmt: skip
        place = ("refined", 1)
        return Outcome(problem.smoke, found, place, problem.config, len(per_octave), ends)


ONE_PASS = Sweep("one_pass", "What colours start from", _applies, _plan)

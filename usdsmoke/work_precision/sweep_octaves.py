"""Octaves and the finest resolution: how coarse to begin, how fine to end."""

from usdsmoke.work_precision.case import Case
from usdsmoke.work_precision.engine import Sweep
from usdsmoke.work_precision.records import Plan
from usdsmoke.work_precision.reference import EXCESS, reference_of, reference_seconds
from usdsmoke.work_precision.trial import (
    N_RUNS,
    Setting,
    base_iterations,
    copy_text,
    main_step,
    need_seconds,
    trial_seconds,
)

__all__ = ["SWEEP"]

_MOST_OCTAVES = 5
_LEAST_PIXELS = 16  # of a picture
_COARSER, _FINER = 0.8, 3.0  # time of half and of twice the resolution


def _applies(case: Case) -> str:
    return "losses.style is 0: nothing is optimised" if case.config.losses.style == 0 else ""


def _plan(case: Case) -> Plan:
    step = main_step(case)
    seconds = trial_seconds(case, step)
    need_seconds(
        case,
        "references and three points",
        reference_seconds(case, step) + 3 * N_RUNS * seconds,
    )
    reference = reference_of(case, step)
    base, config, trial = base_iterations(case, step), case.config, reference.trial
    size, total = case.small_scene.image_size, sum(base)
    settings = [("octaves", _octaves_text(base), Setting(base, config), 1.0)]
    for n in sorted(
        {1, 2, len(base) - 1, len(base) + 1} - {0, len(base)}, key=lambda n: abs(n - len(base))
    ):
        if n <= _MOST_OCTAVES:
            even = tuple(max(1, total // n) for _ in range(n))
            effort = _effort(even) / _effort(base)
            settings.append(("octaves", _octaves_text(even), Setting(even, config), effort))
    if size // 2 >= _LEAST_PIXELS:
        coarser = Setting(base, config, pixels=2)
        label = f"pictures of {round(size / 2)} pixels"
        settings.insert(2, ("finest resolution", label, coarser, _COARSER))
    finer = Setting(base, config, refine=2)
    label = f"pictures of {2 * size} pixels, grids.refine=2"
    settings.append(("finest resolution", label, finer, _FINER))
    return Plan(
        [
            trial.task(curve, label, setting, number == 0, effort, reference.error)
            for number, (curve, label, setting, effort) in enumerate(settings)
        ],
        EXCESS,
        f"The {step} step on {copy_text(case)} with {total} iterations, as configured, "
        "in other octaves and at other resolutions: half and twice these pictures stand for "
        f"half and twice views.image_size. All are judged in pictures of {size} pixels over "
        "views that no run has used; detail finer than that is seen blurred.",
        f"{reference.text} Both have the configured octaves.",
        uncertain=reference.apart,
        n_runs=N_RUNS,
        rate=seconds,
    )


def _octaves_text(per_octave: tuple[int, ...]) -> str:
    noun = "octave" if len(per_octave) == 1 else "octaves"
    return f"{len(per_octave)} {noun} ({', '.join(map(str, per_octave))})"


def _effort(per_octave: tuple[int, ...]) -> float:
    """Small pictures take nearly as long as large ones: the network's calls count."""
    return sum(n * (1.0 + 0.5 * 4.0 ** (k + 1 - len(per_octave))) for k, n in enumerate(per_octave))


SWEEP = Sweep("octaves", "Octaves and finest resolution", 3.0, _applies, _plan)

"""Octaves and the finest resolution: how coarse to begin, how fine to end."""

from dataclasses import replace

from usdsmoke.report.case import Case
from usdsmoke.report.engine import Sweep
from usdsmoke.report.records import Plan
from usdsmoke.report.sweep_iterations import scaled
from usdsmoke.report.trial import JUDGED, Setting, Trial, base_iterations, main_step

__all__ = ["SWEEP"]

_MOST_OCTAVES = 5
_REFERENCE_SHARE = 3.0


def _applies(case: Case) -> str:
    return "losses.style is 0: nothing is optimised" if case.config.losses.style == 0 else ""


def _plan(case: Case) -> Plan:
    step = main_step(case)
    base = base_iterations(case, step)
    config, trial = case.config, Trial(case, step, case.config)
    total = sum(base)
    tasks = [trial.task("octaves", _octaves_text(base), Setting(base, config), True, 1.0)]
    for n in range(1, min(len(base) + 1, _MOST_OCTAVES) + 1):
        if n != len(base):
            even = tuple(max(1, total // n) for _ in range(n))
            effort = _effort(even) / _effort(base)
            setting = Setting(even, config)
            tasks.append(trial.task("octaves", _octaves_text(even), setting, False, effort))
    size = case.small_scene.image_size
    for pixels in (2, 3):
        if size // pixels >= 16:
            label = f"views.image_size {round(size / pixels)}"
            setting = Setting(base, config, pixels=pixels)
            tasks.append(trial.task("finest resolution", label, setting, False, pixels**-2.0))
    setting = Setting(base, config, refine=2)
    label = f"views.image_size {2 * size}, grids.refine=2"
    tasks.append(trial.task("finest resolution", label, setting, False, 6.0))
    longer = scaled(base, _REFERENCE_SHARE)
    never = replace(config, optimize=replace(config.optimize, tolerance=0.0))
    floor = trial.judge(trial.run(Setting(longer, never), 0))
    return Plan(
        tasks,
        JUDGED,
        f"The {step} step on the small copy of the frame, whose pictures are {size} pixels large "
        "as configured. Results are judged at that size, whatever they were optimised at, so "
        "detail finer than a pixel of it gains nothing here.",
        f"a run of {sum(longer)} iterations ({_REFERENCE_SHARE:g}x) in the configured octaves, "
        f"which ends at {floor:.4g} (dashed line).",
        floor=floor,
    )


def _octaves_text(per_octave: tuple[int, ...]) -> str:
    noun = "octave" if len(per_octave) == 1 else "octaves"
    return f"{len(per_octave)} {noun} ({', '.join(map(str, per_octave))})"


def _effort(per_octave: tuple[int, ...]) -> float:
    return sum(n * (0.2 + 4.0 ** (k + 1 - len(per_octave))) for k, n in enumerate(per_octave))


SWEEP = Sweep("octaves", "Octaves and finest resolution", 2.0, _applies, _plan)

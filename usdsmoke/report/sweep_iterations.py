"""Iterations and the stopping rule: what more of them gain."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from usdsmoke.config import Config
from usdsmoke.report.case import Case
from usdsmoke.report.engine import Sweep
from usdsmoke.report.records import Plan, Task
from usdsmoke.report.trial import JUDGED, Setting, Trial, base_iterations, untiring

__all__ = ["SWEEPS", "scaled"]

_SHARES = (1.0, 0.5, 2.0, 0.25)
_TOLERANCES = (5e-2, 1e-2, 5e-4)
_REFERENCE_SHARE = 4.0


def scaled(per_octave: Sequence[int], share: float) -> tuple[int, ...]:
    """Iterations per octave times a number; an octave that has some keeps one at least.

    >>> scaled([8, 4, 0], 0.2)
    (2, 1, 0)
    """
    return tuple(max(1, round(n * share)) if n else 0 for n in per_octave)


def _applies(step: str, case: Case) -> str:
    if step not in case.steps:
        return f"optimize.steps has no {step}"
    if case.config.losses.style == 0:
        return "losses.style is 0: nothing is optimised"
    return ""


def _plan(step: str, case: Case) -> Plan:
    base = base_iterations(case, step)
    trial, config = Trial(case, step, case.config), case.config
    rule = config.optimize.tolerance

    def task(curve: str, label: str, share: float, own: Config, configured: bool) -> Task:
        setting = Setting(scaled(base, share), own)
        return trial.task(curve, label, setting, configured, share)

    by_number = [
        task(
            "iterations, never stopped early",
            f"{sum(scaled(base, share))} iterations ({share:g}x)",
            share,
            untiring(config),
            share == 1.0 and rule == 0,
        )
        for share in _SHARES
    ]
    rules = [rule, *(value for value in _TOLERANCES if value != rule)] if rule else _TOLERANCES
    by_rule = [
        task(
            "stopping rule",
            f"optimize.tolerance={value:g}",
            1.0,
            replace(config, optimize=replace(config.optimize, tolerance=value)),
            value == rule,
        )
        for value in rules
    ]
    first = by_rule[:1] if rule else []
    longer = Setting(scaled(base, _REFERENCE_SHARE), untiring(config))
    floor = trial.judge(trial.run(longer, 0))
    return Plan(
        [*first, *by_number, *by_rule[len(first) :]],
        JUDGED,
        f"The {step} step alone on the small copy of the frame; {sum(base)} iterations are what is "
        "configured here. Every run has a seed of its own, so loss and time both spread.",
        f"a run of {sum(longer.per_octave)} iterations ({_REFERENCE_SHARE:g}x) that never stops "
        f"early, which ends at {floor:.4g} (dashed line).",
        floor=floor,
    )


SWEEPS = tuple(
    Sweep(
        f"iterations_{step}",
        f"Iterations and stopping rule, {step} step",
        3.0,
        partial(_applies, step),
        partial(_plan, step),
    )
    for step in ("colour", "shape")
)

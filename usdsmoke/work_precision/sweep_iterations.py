"""Number of iterations and the rule that stops early: style loss against time."""

from dataclasses import replace
from functools import partial

from usdsmoke.base.config import Config
from usdsmoke.work_precision.case import Case
from usdsmoke.work_precision.engine import Sweep
from usdsmoke.work_precision.records import Plan, Task
from usdsmoke.work_precision.reference import EXCESS, reference_of, reference_seconds
from usdsmoke.work_precision.trial import (
    N_RUNS,
    Setting,
    base_iterations,
    copy_text,
    need_seconds,
    scaled,
    trial_seconds,
)

__all__ = ["SWEEPS"]

_SHARES = (0.5, 2.0, 0.25)
_TOLERANCES = (5e-2, 1e-2, 0.0)
_LEAST = 1.75  # configured runs that the first three points take, each once


def _applies(step: str, case: Case) -> str:
    if step not in case.steps:
        return f"optimize.steps has no {step}"
    if case.config.losses.style == 0:
        return "losses.style is 0: nothing is optimised"
    return ""


def _plan(step: str, case: Case) -> Plan:
    seconds = trial_seconds(case, step)
    needed = reference_seconds(case, step) + _LEAST * N_RUNS * seconds
    need_seconds(case, "two references and three points", needed)
    reference = reference_of(case, step)
    base, config = base_iterations(case, step), case.config
    trial, rule = reference.trial, config.optimize.tolerance

    def task(curve: str, label: str, share: float, own: Config, effort: float = 0.0) -> Task:
        setting, chosen = Setting(scaled(base, share), own), share == 1.0 and own is config
        return trial.task(curve, label, setting, chosen, effort or share, reference.error)

    by_number = [
        task("iterations", f"{sum(scaled(base, share))} iterations ({share:g}x)", share, config)
        for share in (1.0, *_SHARES)
    ]
    by_rule = [
        task(
            "stopping rule",
            f"optimize.tolerance={value:g}" if value else "no rule (optimize.tolerance=0)",
            1.0,
            replace(config, optimize=replace(config.optimize, tolerance=value)),
            1.0,
        )
        for value in _TOLERANCES
        if value != rule
    ]
    tasks = [by_number[0], by_number[1], by_rule[0], by_number[2], *by_rule[1:], by_number[3]]
    stops = (
        f"stops an octave early by optimize.tolerance={rule:g}, where it gains too little; labels "
        "tell how many iterations were done where that happened"
        if rule
        else "never stops early"
    )
    return Plan(
        tasks,
        EXCESS,
        f"The {step} step alone on {copy_text(case)}, {sum(base)} iterations as "
        f"configured; the configured run {stops}. Results are judged by the loss over views that "
        "no run has used. Runs have seeds of their own, so loss and time both spread; points that "
        "went through the same iterations share their times.",
        reference.text,
        uncertain=reference.apart,
        n_runs=N_RUNS,
        rate=seconds,
    )


SWEEPS = tuple(
    Sweep(
        f"iterations_{step}",
        f"Iterations and stopping rule, {step} step",
        weight,
        partial(_applies, step),
        partial(_plan, step),
    )
    for step, weight in (("colour", 8.0), ("shape", 4.0))
)

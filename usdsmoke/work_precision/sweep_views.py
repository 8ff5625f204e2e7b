"""Number of views: how many there are to draw from, and how many an iteration looks at."""

from dataclasses import replace

from usdsmoke.work_precision.case import Case
from usdsmoke.work_precision.engine import Sweep
from usdsmoke.work_precision.records import Plan
from usdsmoke.work_precision.reference import EXCESS, reference_of, reference_seconds
from usdsmoke.work_precision.trial import (
    N_RUNS,
    Setting,
    Trial,
    base_iterations,
    copy_text,
    main_step,
    need_seconds,
    scaled,
    trial_seconds,
)

__all__ = ["SWEEPS"]

_POOLS, _COUNTS = (1, 4, 64, 32), (2, 4)


def _applies(case: Case) -> str:
    if case.config.losses.style == 0:
        return "losses.style is 0: nothing is optimised"
    if case.small_smoke.thin_axis is not None:
        return "the smoke is one voxel thick and is seen from one side only"
    return ""


def _plan_pool(case: Case) -> Plan:
    step, config = main_step(case), case.config
    seconds, base = trial_seconds(case, step), base_iterations(case, step)
    need_seconds(case, "three points", 3 * N_RUNS * seconds)
    trial, tasks = Trial(case, step, config), []
    pool = config.views.pool
    for n in (pool, *(n for n in _POOLS if n != pool)):
        own = config if n == pool else replace(config, views=replace(config.views, pool=n))
        setting, error = Setting(base, own), trial.judge.gap
        tasks.append(
            trial.task("views to draw from", f"views.pool={n}", setting, n == pool, 1.0, error)
        )
    return Plan(
        tasks,
        "style loss of views that no run has used: how far from that of the pool's own views",
        f"The {step} step on {copy_text(case)} with {sum(base)} iterations, as "
        "configured. Few views to draw from fit their own pictures, and others less: the error is "
        "what a run tells as “unseen views” at its end, over more views.",
        "0, a result that looks as good from everywhere. Views differ among themselves, so the "
        "measure does not come to 0: a pool of 64 views, where it was measured, tells how near it "
        "does, and the standard error over the views counts as its uncertainty.",
        chance=trial.judge.chance,
        n_runs=N_RUNS,
        rate=seconds,
    )


def _plan_count(case: Case) -> Plan:
    step, config = main_step(case), case.config
    seconds, base = trial_seconds(case, step), base_iterations(case, step)
    need_seconds(
        case, "references and three points", reference_seconds(case, step) + 3 * N_RUNS * seconds
    )
    reference, views = reference_of(case, step), config.views
    trial, name = reference.trial, f"views.count={views.count}, as configured"
    first = trial.task("views an iteration", name, Setting(base, config), True, 1.0)
    tasks = [replace(first, error=reference.error)]
    for count in (1, *_COUNTS):
        if count == views.count:
            continue
        own = replace(config, views=replace(views, count=count))
        fewer = scaled(base, views.count / count)
        label = f"views.count={count}, {sum(fewer)} iterations: as many pictures"
        setting = Setting(fewer, own)
        tasks.append(trial.task("views an iteration", label, setting, False, 1.0, reference.error))
    return Plan(
        tasks,
        EXCESS,
        f"The {step} step on {copy_text(case)}. More views an iteration tell the "
        "direction better; with as many pictures in all there are fewer iterations.",
        reference.text,
        uncertain=reference.apart,
        n_runs=N_RUNS,
        rate=seconds,
    )


SWEEPS = (
    Sweep("views", "Number of views", 3.0, _applies, _plan_pool),
    Sweep("views_count", "Views an iteration", 2.0, _applies, _plan_count),
)

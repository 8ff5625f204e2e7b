"""Number of views: how many there are to draw from, and how many an iteration looks at."""

from dataclasses import replace

from usdsmoke.report.case import Case
from usdsmoke.report.engine import Sweep
from usdsmoke.report.records import Plan
from usdsmoke.report.sweep_iterations import scaled
from usdsmoke.report.trial import (
    JUDGED,
    Setting,
    Trial,
    base_iterations,
    main_step,
    untiring,
)

__all__ = ["SWEEP"]

_POOLS, _COUNTS = (1, 4, 32), (2, 4)
_REFERENCE_SHARE = 3.0


def _applies(case: Case) -> str:
    if case.config.losses.style == 0:
        return "losses.style is 0: nothing is optimised"
    if case.small_smoke.thin_axis is not None:
        return "the smoke is one voxel thick and is seen from one side only"
    return ""


def _plan(case: Case) -> Plan:
    step, config = main_step(case), case.config
    base = base_iterations(case, step)
    trial, views = Trial(case, step, config), config.views
    tasks = []
    for pool in (views.pool, *(n for n in _POOLS if n != views.pool)):
        own = replace(config, views=replace(views, pool=pool))
        label = f"views.pool={pool}"
        setting = Setting(base, own)
        tasks.append(trial.task("views to draw from", label, setting, pool == views.pool))
    for count in _COUNTS:
        if count == views.count:
            continue
        own = replace(config, views=replace(views, count=count))
        fewer = scaled(base, views.count / count)
        for per_octave, text in ((fewer, "the same pictures"), (base, "the same iterations")):
            label = f"views.count={count}, {text}"
            effort = sum(per_octave) * count / (sum(base) * views.count)
            setting = Setting(per_octave, own)
            tasks.append(trial.task(f"views an iteration, {text}", label, setting, False, effort))
    longer = scaled(base, _REFERENCE_SHARE)
    most = replace(untiring(config), views=replace(views, pool=64))
    floor = trial.judge(trial.run(Setting(longer, most), 0))
    return Plan(
        tasks,
        JUDGED,
        f"The {step} step on the small copy of the frame with {sum(base)} iterations. Fewer views "
        "to draw from are sooner prepared and fit their own pictures better, and others worse.",
        f"a run of {sum(longer)} iterations with 64 views, which ends at {floor:.4g} (dashed "
        "line).",
        floor=floor,
    )


SWEEP = Sweep("views", "Number of views", 2.0, _applies, _plan)

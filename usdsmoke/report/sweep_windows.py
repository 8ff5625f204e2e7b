"""Window size: what frames cost that start from their neighbours, and how well they follow."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from usdsmoke.config import Config
from usdsmoke.report.case import Case
from usdsmoke.report.engine import Sweep
from usdsmoke.report.records import Plan, Task
from usdsmoke.report.sweep_backtrace import NO_VELOCITY, ONE_FRAME
from usdsmoke.report.sweep_iterations import scaled
from usdsmoke.report.trial import base_iterations
from usdsmoke.volume import VolumeFrame

if TYPE_CHECKING:
    from torch import Tensor

    from usdsmoke.core.smoke import ActiveSmoke
    from usdsmoke.core.stylize import StylizedFrame

__all__ = ["SWEEP"]


def _applies(case: Case) -> str:
    if len(case.neighbours) < 2:
        return ONE_FRAME
    if case.config.losses.style == 0:
        return "losses.style is 0: nothing is optimised"
    if case.config.stage.motion == "estimate":
        return ""
    if case.frame.velocity is None or case.frame.velocity.is_empty:
        return NO_VELOCITY
    return ""


def _plan(case: Case) -> Plan:
    frames = _frames(case)
    config, n = _config(case), len(frames)
    chosen = min(case.config.windows.size, n)
    tasks = [
        Task(
            "window size",
            f"windows of {size}" if size > 1 else "single frames",
            partial(lambda size, run: _stylized(case, frames, config, size, run), size),
            partial(_temporal_error, case, frames),
            None,
            size == chosen,
            1 + (n / size - 1) / n,
        )
        for size in sorted({1, 2, 3, n, chosen}, key=lambda size: (size != chosen, size))
        if size <= n
    ]
    return Plan(
        tasks,
        "temporal error (mean over neighbouring frames)",
        f"{n} frames of the small copy, from timeCode {frames[0].time_code:g} on, in windows of "
        "different size, with half the iterations of other trials, without overlap and without the "
        "coarse step that windows share. Time is "
        f"that of all {n} frames. The temporal error is the difference of a frame from the one "
        "before it, carried along by the velocity, over the smoke, borders of windows included.",
        "0, a pattern that moves with the smoke exactly.",
        n_runs=2,
    )


def _frames(case: Case) -> list[VolumeFrame]:
    """The neighbouring frames, small, with the velocity that carries each to the next."""
    from usdsmoke.core.motion import estimate_velocity

    frames = [case.shrunk(case.reader.read(case.volume, plan)) for plan in case.neighbours]
    if case.config.stage.motion != "estimate":
        return frames
    rate = case.job.plan.source.time_codes_per_second
    moving = []
    for frame, later in pairwise(frames):
        seconds = (later.time_code - frame.time_code) / rate
        velocity = estimate_velocity(frame, later, seconds, device=case.device)
        moving.append(replace(frame, velocity=velocity, velocity_to_stage=later.density_to_stage))
    return [*moving, replace(frames[-1], velocity=None, velocity_to_stage=None)]


def _config(case: Case) -> Config:
    """The settings with half the iterations of a trial; motion is that of the frames."""
    config = replace(case.config, grids=replace(case.config.grids, refine=1))
    config = replace(config, stage=replace(config.stage, motion="velocity"))
    config = replace(config, optimize=replace(config.optimize, iterations=None))
    for step in case.steps:
        own = replace(
            getattr(config, step), iterations=list(scaled(base_iterations(case, step), 0.5))
        )
        config = replace(config, **{step: own})
    return config


def _stylized(
    case: Case, frames: Sequence[VolumeFrame], config: Config, size: int, run: int
) -> list["StylizedFrame"]:
    from usdsmoke.core.stylize import stylize_window

    config = replace(config, optimize=replace(config.optimize, seed=config.optimize.seed + run))
    rate = case.job.plan.source.time_codes_per_second
    found: list[StylizedFrame] = []
    for first in range(0, len(frames), size):
        window = frames[first : first + size]
        found += stylize_window(window, case.styles, case.small_scene, config, None, rate)
    return found


def _temporal_error(
    case: Case, frames: Sequence[VolumeFrame], found: Sequence["StylizedFrame"]
) -> float:
    from usdsmoke.core.coherence import colour_error

    rate = case.job.plan.source.time_codes_per_second
    painted = [_painted(case, *pair) for pair in zip(frames, found, strict=True)]
    errors = []
    for number in range(1, len(painted)):
        seconds = (frames[number].time_code - frames[number - 1].time_code) / rate
        errors.append(
            colour_error(painted[number - 1], *painted[number], frames[number - 1], seconds)
        )
    return float(np.mean(errors))


def _painted(
    case: Case, source: VolumeFrame, found: "StylizedFrame"
) -> tuple["ActiveSmoke", "Tensor"]:
    """A frame's smoke and its display-encoded colours [N 3].

    Without a colour step: how much its density was changed, as a share of the largest [N 1].
    """
    import torch

    from usdsmoke.core.smoke import activate
    from usdsmoke.core.style import encode_srgb

    density = found.density if found.emission is not None else _union(source, found)
    smoke = activate(density, source.density_to_stage, case.device)
    place = tuple((smoke.ijk.cpu().numpy() - np.asarray(density.ijk_min)).T)
    if found.emission is not None:
        light = torch.from_numpy(found.emission.values[place]).to(smoke.density)
        linear = light / (case.small_scene.gamma_w * smoke.density)[:, None]
        return smoke, encode_srgb(linear).clamp(0, 1)
    before, after = (_values_at(field, smoke) for field in (source.density, found.density))
    change = torch.from_numpy((after - before) / max(float(source.density.values.max()), 1e-30))
    return smoke, change[:, None].to(smoke.density)


def _union(source: VolumeFrame, found: "StylizedFrame") -> Any:
    """A field that is above 0 wherever there is smoke before or after."""
    low = np.minimum(source.density.ijk_min, found.density.ijk_min)
    fields = (source.density, found.density)
    high = np.max([np.add(f.ijk_min, f.values.shape) for f in fields], axis=0)
    values = np.zeros(tuple(high - low), np.float32)
    for item in fields:
        start = np.subtract(item.ijk_min, low)
        i, j, k = (slice(a, a + n) for a, n in zip(start, item.values.shape, strict=True))
        values[i, j, k] = np.maximum(values[i, j, k], item.values)
    first = (int(low[0]), int(low[1]), int(low[2]))
    return replace(found.density, values=values, ijk_min=first)


def _values_at(field: Any, smoke: "ActiveSmoke") -> np.ndarray:
    index = smoke.ijk.cpu().numpy() - np.asarray(field.ijk_min)
    inside = ((index >= 0) & (index < field.values.shape)).all(axis=1)
    values = np.zeros(len(index), np.float32)
    values[inside] = field.values[tuple(index[inside].T)]
    return values


SWEEP = Sweep("windows", "Window size", 2.5, _applies, _plan)

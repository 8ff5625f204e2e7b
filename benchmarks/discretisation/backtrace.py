"""Order and sub-steps of the back-trace that carries results from frame to frame."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from usdsmoke.base.errors import ShapeError
from usdsmoke.work_precision import Plan, Sweep, Task
from usdsmoke.work_precision.case import Case

if TYPE_CHECKING:
    from torch import Tensor

__all__ = ["NO_VELOCITY", "ONE_FRAME", "SWEEP", "time_step"]

ONE_FRAME = "one frame: nothing is carried from frame to frame"
NO_VELOCITY = "the Volume has no velocity that is read: nothing is carried from frame to frame"
_ORDERS = {1: "Euler, order 1", 2: "mid-point, order 2 (ours)", 4: "Runge-Kutta, order 4"}
_SUBSTEPS = (1, 2, 4, 8, 16)
_REFERENCE_SUBSTEPS = 48
_MOST_POINTS = 10_000


def time_step(case: Case) -> float:
    """Seconds from the frame to the one that follows it, or from the one before."""
    codes = [frame.source.time_code for frame in case.volume.frames]
    steps = np.diff(codes)
    place = min(codes.index(case.plan.source.time_code), len(steps) - 1)
    return float(steps[place] / case.job.plan.source.time_codes_per_second)


def _applies(case: Case) -> str:
    if len(case.volume.frames) < 2:
        return ONE_FRAME
    if case.frame.velocity is None or case.frame.velocity.is_empty:
        return NO_VELOCITY
    return ""


def _plan(case: Case) -> Plan:
    from benchmarks.transport_baselines import trace as backtrace
    from usdsmoke.core.fields.transport import choose_substeps

    rates, places = _flow(case)
    seconds = time_step(case)
    trace = partial(backtrace, rates, places, seconds)
    exact = trace(order=4, n_substeps=_REFERENCE_SUBSTEPS)
    second = trace(order=2, n_substeps=4 * _REFERENCE_SUBSTEPS)
    chosen = choose_substeps(rates, seconds)

    def error(found: "Tensor") -> float:
        return float((found - exact).square().sum(1).mean().sqrt())

    tasks = [
        Task(
            name,
            f"{n} sub-steps" if n > 1 else "1 sub-step",
            partial(lambda order, n, run: trace(order=order, n_substeps=n), order, n),
            error,
            order == 2 and n == chosen,
            float(order * n),
        )
        for n in sorted({*_SUBSTEPS, chosen}, key=lambda n: (n != chosen, n))
        for order, name in sorted(_ORDERS.items(), key=lambda item: item[0] != 2)
    ]
    cfl = float(rates.abs().max()) * seconds
    return Plan(
        tasks,
        "error of the departure points [voxels of the velocity, rms]",
        f"{len(places):,} voxels traced back through the frame's velocity over {seconds:.4g} s; "
        f"its largest CFL number is {cfl:.2g}. The velocity is interpolated linearly, so its "
        "gradient jumps between voxels and orders above 2 are not reached where it does.",
        f"order 4 in {_REFERENCE_SUBSTEPS} sub-steps; order 2 in {4 * _REFERENCE_SUBSTEPS} differs "
        f"from it by {error(second):.1e} voxels.",
        uncertain=error(second),
        n_runs=5,
        warm_up=True,
    )


def _flow(case: Case) -> tuple["Tensor", "Tensor"]:
    """The velocity in voxels a second, and voxels of smoke in its indices; float64."""
    import torch

    velocity, place = case.frame.velocity, case.frame.velocity_to_stage
    if velocity is None or place is None:
        raise ShapeError("a frame without a velocity has no flow; wanted one with it")
    to_stage = velocity.index_to_world @ np.asarray(place, float)
    to_index = np.linalg.inv(to_stage)
    positions = case.smoke.positions.cpu().numpy()
    positions = positions[:: -(-len(positions) // _MOST_POINTS)]
    places = positions @ to_index[:3, :3] + to_index[3, :3] - np.asarray(velocity.ijk_min)
    rates = velocity.values.astype(float) @ np.linalg.inv(velocity.index_to_world[:3, :3])
    return torch.from_numpy(rates), torch.from_numpy(places)


SWEEP = Sweep("backtrace", "Back-trace: order and sub-steps", _applies, _plan)

"""Interpolation of the transport that moves the density: the frame given a quarter turn."""

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from usdsmoke.base.volume import DenseField
from usdsmoke.work_precision import Plan, Sweep, Task
from usdsmoke.work_precision.case import Case

if TYPE_CHECKING:
    from torch import Tensor

    from benchmarks.transport_baselines import Scheme

__all__ = ["SWEEP", "Turn"]

_STEPS = 6  # of the quarter turn; MacCormack's inverse wants steps that turn little
_FACTORS = (1.0, 0.5, 2.0)  # of the resolution
_MOST_VOXELS = 1_500_000
_EFFORT = {"linear": 1.0, "maccormack": 16.0, "cubic": 5.0}  # relative, measured
_CURVES: tuple[tuple[str, "Scheme", bool], ...] = (
    ("linear", "linear", True),
    ("maccormack", "maccormack", True),
    ("cubic", "cubic", True),
    ("maccormack without limiter", "maccormack", False),
    ("cubic without limiter", "cubic", False),
)


@dataclass(frozen=True)
class Turn:
    """A box of smoke [I J K], square in the plane of two axes, that is turned in it."""

    box: "Tensor"
    displacement: "Tensor"  # of one step, [I J K 3], index units
    plane: tuple[int, int]

    @classmethod
    def of(cls, values: np.ndarray, n_steps: int) -> "Turn":
        """Smoke with room to turn in, and one of the steps that make a quarter turn.

        Args:
            values: [i j k]; its two longest axes are turned.
            n_steps: that the quarter turn is made in.
        """
        import torch

        from usdsmoke.core.fields.sample import voxel_positions

        a, b = sorted(int(axis) for axis in np.argsort(values.shape, kind="stable")[-2:])
        room = math.ceil(math.hypot(values.shape[a], values.shape[b])) + 4
        pads = [(0, 0)] * 3
        for axis in (a, b):
            before = (room - values.shape[axis]) // 2
            pads[axis] = (before, room - values.shape[axis] - before)
        box = torch.from_numpy(np.pad(values, pads).astype(np.float32))
        offset = voxel_positions(box.shape, box) - (torch.tensor(box.shape) - 1) / 2
        angle = math.pi / 2 / n_steps
        u = torch.zeros_like(offset)
        cos, sin = math.cos(angle), math.sin(angle)
        u[:, a] = offset[:, a] - (cos * offset[:, a] + sin * offset[:, b])
        u[:, b] = offset[:, b] - (cos * offset[:, b] - sin * offset[:, a])
        return cls(box, u.view(*box.shape, 3), (a, b))

    def turned(self, scheme: "Scheme", limiter: bool, n_steps: int) -> "Tensor":
        """The box after so many steps."""
        from benchmarks.transport_baselines import warp

        moved = self.box
        for _ in range(n_steps):
            moved = warp(moved, self.displacement, scheme=scheme, limiter=limiter)
        return moved

    def error(self, moved: "Tensor") -> float:
        """Sum of the differences from a quarter turn, which only renames voxels, of its own sum."""
        import torch

        exact = torch.rot90(self.box, 1, self.plane)
        return float((moved - exact).abs().sum() / exact.abs().sum())


def _applies(case: Case) -> str:
    if "shape" not in case.steps:
        return "optimize.steps has no shape: no density is moved"
    return ""


def _plan(case: Case) -> Plan:
    turns = {
        factor: Turn.of(_values(case, factor), _STEPS)
        for factor in _FACTORS
        if case.small.density.values.size * factor**3 * 2 <= _MOST_VOXELS or factor <= 1
    }
    scheme = case.config.shape.interpolation
    curves = sorted(_CURVES, key=lambda curve: curve[0] != scheme)
    tasks = [
        Task(
            curve,
            f"voxels of {1 / factor:g}",
            partial(lambda t, s, limited, run: t.turned(s, limited, _STEPS), turn, own, limited),
            turn.error,
            own == scheme and limited and factor == 1.0,
            turn.box.numel() / 1e5 * _EFFORT[own],
        )
        for factor, turn in turns.items()
        for curve, own, limited in curves
    ]
    return Plan(
        tasks,
        "relative error after a quarter turn (sum of differences)",
        f"The frame's smoke is given a quarter turn about its middle in {_STEPS} steps. The shape "
        f"step moves it once, so its own error is some {_STEPS} times less; which scheme is "
        "better, and what it costs, is the same.",
        "the smoke with its voxels renamed, which is what a quarter turn comes to: exact, and no "
        "method is needed to know it.",
        n_runs=3,
    )


def _values(case: Case, factor: float) -> np.ndarray:
    """The small frame's density on voxels ``1 / factor`` times as large."""
    from usdsmoke.core.fields.resample import refine_field

    if factor >= 1:
        return np.clip(refine_field(case.small.density, int(factor)).values, 0, None)
    return _merged(case.small.density)


def _merged(density: DenseField) -> np.ndarray:
    pads = [(0, n % 2 if n > 1 else 0) for n in density.values.shape]
    values = np.pad(np.clip(density.values, 0, None), pads)
    for axis in range(3):
        if values.shape[axis] > 1:
            halves = np.stack(np.split(values, values.shape[axis] // 2, axis=axis))
            values = np.moveaxis(halves.mean(axis=axis + 1), 0, axis)
    return values


SWEEP = Sweep("interpolation", "Interpolation of the transport", _applies, _plan)

"""The velocity estimated from densities against the one that moved the example plume.

    python -m benchmarks.estimated_motion [--resolution 64] [--steps 18 33 48]

Prints the tables of benchmarks/results/estimated_motion.md. Errors are of the way that a voxel's
smoke came in one frame,
in voxels, weighted with its density; angles are between the estimated and the true way. The
residual |d_t - T(d_(t-1))| / |d_t| says how well a velocity carries the density: with the truth it
is what the source adds and what one linear look-up blurs. About a minute on one core.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch

from benchmarks.control_scenes import FRAMES_PER_SECOND, frame_of, load_example
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.fields.sample import sample_linear, voxel_positions
from usdsmoke.core.sequence.motion import estimate_velocity
from usdsmoke.core.sequence.transit import Transit

__all__ = ["Step", "compare", "follow_shifts", "main", "simulate"]

SECONDS = 1.0 / FRAMES_PER_SECOND


@dataclass(frozen=True)
class Step:
    """One simulated frame and the one before it."""

    number: int
    before: np.ndarray  # [i j k] density
    after: np.ndarray  # [i j k] density
    flow: np.ndarray  # [i j k 3] what moved the one to the other, stage units per second
    stored_before: np.ndarray  # [i j k 3] the velocity that stands in the earlier frame's file
    stored_after: np.ndarray  # [i j k 3] and in the later one's


def simulate(resolution: int, numbers: list[int]) -> Iterator[Step]:
    """Frames of the example plume, with the velocity that its density was moved by."""
    module = load_example("plume", "solver")
    solver = module.SmokeSolver(resolution, module.PlumeSettings())
    flows: list[np.ndarray] = []
    advect = solver._advect

    def remember_and_advect(dt: float) -> None:
        flows[:] = [solver.velocity.copy()]
        advect(dt)

    solver._advect = remember_and_advect
    for number in range(1, max(numbers) + 1):
        before, stored = solver.density, solver.velocity.copy()
        solver.step(SECONDS)
        if number in numbers:
            yield Step(number, before, solver.density, flows[0], stored, solver.velocity.copy())


def compare(step: Step) -> list[str]:
    """Rows of the table for one step, one per velocity."""
    before, after = (frame_of(density) for density in (step.before, step.after))
    start = time.process_time()
    estimate = estimate_velocity(before, after, SECONDS)
    seconds = time.process_time() - start
    matrix = after.density.index_to_world
    kinds = {
        "none": None,
        "estimated": estimate,
        "in the file of t": _field(step.stored_after, matrix),
        "in the file of t - 1": _field(step.stored_before, matrix),
        "true": _field(step.flow, matrix),
    }
    truth = _ways(after, kinds["true"])
    rows = []
    for name, velocity in kinds.items():
        ways = _ways(after, velocity)
        cost = f"{seconds:.2f}" if velocity is estimate else ""
        rows.append(f"| {step.number} | {name} | {_row(before, after, ways, truth)} | {cost} |")
    return rows


def follow_shifts(density: np.ndarray, shifts: list[int]) -> list[str]:
    """Rows on how far the smoke may jump as a whole: along i, by some numbers of voxels."""
    rows = []
    before = frame_of(density)
    for shift in shifts:
        field = replace(before.density, ijk_min=(shift, 0, 0))
        after = replace(before, density=field)
        ways = _ways(after, estimate_velocity(before, after, SECONDS))
        weights = torch.from_numpy(density).double().reshape(-1) / float(density.sum())
        errors = (ways - torch.tensor([float(shift), 0.0, 0.0])).square().sum(dim=1)
        error = float((weights * errors).sum().sqrt())
        rows.append(f"| {shift} | {error:.2f} | {error / shift:.0%} |")
    return rows


def _field(values: np.ndarray, matrix: np.ndarray) -> DenseField:
    return DenseField("vel", values.astype(np.float32), (0, 0, 0), matrix)


def _ways(frame: VolumeFrame, velocity: DenseField | None) -> torch.Tensor:
    """How far the smoke of every voxel came, [N 3] in voxels."""
    matrix = torch.from_numpy(frame.density.index_to_world)
    like = torch.zeros((), dtype=torch.float64)
    voxels = voxel_positions(frame.density.values.shape, like)
    voxels += torch.tensor(frame.density.ijk_min)
    places = voxels @ matrix[:3, :3] + matrix[3, :3]
    moving = VolumeFrame(1.0, frame.density, np.eye(4), velocity, np.eye(4))
    back = torch.linalg.inv(matrix[:3, :3])
    return (places - Transit(moving, SECONDS).origins(places)) @ back


def _row(before: VolumeFrame, after: VolumeFrame, ways: torch.Tensor, truth: torch.Tensor) -> str:
    density = torch.from_numpy(after.density.values).double()
    weights = density.reshape(-1) / density.sum()

    def rms(vectors: torch.Tensor) -> float:
        return float((weights * vectors.square().sum(dim=1)).sum().sqrt())

    error, length = rms(ways - truth), rms(truth)
    lengths = ways.norm(dim=1) * truth.norm(dim=1)
    cosines = ((ways * truth).sum(dim=1) / lengths.clamp(min=1e-12)).clamp(-1.0, 1.0)
    angle = float((weights * torch.rad2deg(cosines.acos())).sum())
    where = voxel_positions(after.density.values.shape, density) - ways
    earlier = torch.from_numpy(before.density.values).double()
    moved = sample_linear(earlier, where).reshape(density.shape)
    residual = float((density - moved).norm() / density.norm())
    angle_text = f"{angle:.0f}°" if bool(ways.any()) else "-"
    return f"{length:.2f} | {error:.2f} | {error / length:.0%} | {angle_text} | {residual:.3f}"


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--resolution", type=int, default=64, help="voxels across the plume's box")
    parser.add_argument(
        "--steps", type=int, nargs="+", default=[18, 33, 48], help="simulation steps to look at"
    )
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    print("| step | velocity | true way, rms | error, rms | relative | angle | residual | CPU s |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for step in simulate(options.resolution, options.steps):
        print("\n".join(compare(step)), flush=True)
    print("\n| jump, voxels | error, rms | relative |\n| --- | --- | --- |")
    print("\n".join(follow_shifts(step.after, [1, 3, 5, 7, 10, 15, 21, 31])))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

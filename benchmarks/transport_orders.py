"""Prints the tables of benchmarks/results/transport_orders.md: errors, orders, mass, speed.

    python -m benchmarks.transport_orders [--fine] [--skip-speed]

About two minutes on one core; --fine adds the runs on 256 x 256 voxels, two minutes more.
"""

import argparse
import math
import time
from collections.abc import Callable, Sequence
from itertools import pairwise

import torch
from torch import Tensor

from benchmarks.transport_baselines import Scheme, advect, cell_bounds, warp
from tests.numerics.transport_problems import (
    Outcome,
    periodic_gaussian,
    rotation_error,
    single_vortex,
    sphere_reversal,
    swirl_warp,
    window_and_back,
    zalesak_disk,
)
from usdsmoke.core.fields.displacement import (
    clamp_displacement,
    from_potential,
    from_stream,
    smooth_mask,
)
from usdsmoke.core.fields.resample import smooth
from usdsmoke.core.fields.sample import sample_cubic, sample_linear, voxel_positions
from usdsmoke.core.fields.transport import correct_mass
from usdsmoke.core.smoke.noise import white_noise

__all__ = ["main"]

RUNS: tuple[tuple[str, Scheme, bool], ...] = (
    ("linear", "linear", False),
    ("MacCormack", "maccormack", False),
    ("MacCormack, limited", "maccormack", True),
    ("cubic", "cubic", False),
    ("cubic, limited", "cubic", True),
)
SCHEMES = tuple((name, scheme) for name, scheme, limited in RUNS if not limited)


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A Markdown table."""
    print(f"\n{title}\n\n| {' | '.join(header)} |\n|{'---|' * len(header)}")
    for row in rows:
        print(f"| {' | '.join(row)} |")


def last_order(sizes: Sequence[int], errors: Sequence[float]) -> str:
    """Observed order over the last refinement."""
    (n, m), (a, b) = list(pairwise(sizes))[-1], list(pairwise(errors))[-1]
    return f"{math.log(a / b) / math.log(m / n):.2f}"


def print_vortex(sizes: Sequence[int]) -> None:
    """Single-vortex reversal."""
    rows = []
    for name, scheme, limiter in RUNS:
        outcomes = [single_vortex(n, scheme, limiter) for n in sizes]
        rows.append([f"{name}, CFL 1", *vortex_row(sizes, outcomes)])
    outcomes = [single_vortex(n, "cubic", False, cfl=4.0) for n in sizes]
    rows.append(["cubic, CFL 4", *vortex_row(sizes, outcomes)])
    header = ["scheme", *[f"L1 {n}²" for n in sizes], "order L1 (L∞)", "peak", "mass error"]
    print_table("Single-vortex reversal, RK4", header, rows)


def vortex_row(sizes: Sequence[int], outcomes: Sequence[Outcome]) -> list[str]:
    """L1 at every size, orders of the last step, peak and mass error at the last size."""
    l1, lmax = ([getattr(o, key) for o in outcomes] for key in ("l1", "lmax"))
    orders = f"{last_order(sizes, l1)} ({last_order(sizes, lmax)})"
    return [
        *[f"{e:.2e}" for e in l1],
        orders,
        f"{outcomes[-1].high:.3f}",
        f"{outcomes[-1].mass:.0e}",
    ]


def print_disk() -> None:
    """Zalesak's disk."""
    rows = []
    for name, scheme, limiter in RUNS:
        o = zalesak_disk(scheme, limiter)
        span = f"{o.low:.2f}, {o.high:.2f}"
        rows.append([name, f"{o.relative_l1:.3f}", f"{o.mass:+.1%}", span, f"{o.area:+.1%}"])
    header = ["scheme", "L1 / area", "mass", "min, max", "area above 1/2"]
    print_table("Zalesak's disk, one turn in 628 steps, RK4", header, rows)


def print_orders() -> None:
    """Observed orders of schemes, single warps and back-traces."""
    cases: list[tuple[str, tuple[int, ...], Callable[[int, Scheme], float]]] = [
        ("periodic Gaussian", (32, 64, 128), lambda n, s: periodic_gaussian(n, s).l1),
        ("sphere reversal, 3-D", (16, 24, 32), lambda n, s: sphere_reversal(n, s).l1),
        ("one warp", (64, 96, 128), lambda n, s: swirl_warp(n, s).l1),
    ]
    rows = []
    for name, scheme in SCHEMES:
        row = [name]
        for _, sizes, error in cases:
            errors = [error(n, scheme) for n in sizes]
            row.append(f"{errors[-1]:.1e} ({last_order(sizes, errors)})")
        rows.append(row)
    header = ["scheme", *[f"{name}, {sizes[-1]}" for name, sizes, _ in cases]]
    print_table("L1 error (order of the last refinement)", header, rows)
    steps = (8, 16, 32, 64)
    rows = []
    for order in (1, 2, 4):
        errors = [rotation_error(order, n) for n in steps]
        rows.append([str(order), *[f"{e:.1e}" for e in errors], last_order(steps, errors)])
    header = ["order", *[f"{n} sub-steps" for n in steps], "observed"]
    print_table(
        "Back-trace through two radians, error in voxels at 7 to 9 from the axis", header, rows
    )


def print_windows() -> None:
    """Loss of a way out and back against its length."""
    lengths = (1, 2, 4, 8)
    rows = []
    for name, scheme in SCHEMES:
        errors = [window_and_back(n, scheme).relative_l1 for n in lengths]
        rows.append([f"{name}, limited", *[f"{e:.1e}" for e in errors]])
    header = ["scheme", *[f"W = {n}" for n in lengths]]
    print_table("W frames forwards and W back, relative L1", header, rows)


def make_cloud(side: int) -> tuple[Tensor, Tensor]:
    """A lumpy ball of smoke and its voxel indices."""
    ijk = voxel_positions((side,) * 3, torch.empty(0)).long()
    lumps = smooth(white_noise(ijk, 1, 0).reshape(side, side, side), 2.0)
    away = (ijk - (side - 1) / 2).float().norm(dim=1).reshape(lumps.shape)
    return torch.relu(lumps - 0.45) * (away < 0.36 * side), ijk


def print_mass() -> None:
    """What one capped warp does to the mass before it is corrected."""
    side, cap = 64, 5.0
    density, ijk = make_cloud(side)
    noise = smooth(white_noise(ijk, 4, 1).reshape(side, side, side, 4) - 0.5, 4.0)
    noise = noise / noise.std() * 60.0
    mask = smooth_mask(density, 3.0)
    spacing = (1.0, 1.0, 1.0)
    displacements = {
        "stream function": from_stream(noise[..., :3], spacing),
        "stream function, faded before the curl": from_stream(
            noise[..., :3] * mask[..., None], spacing
        ),
        "potential": from_potential(noise[..., 3], spacing),
    }
    rows = []
    for name, raw in displacements.items():
        capped = clamp_displacement(raw, cap)
        if "before" not in name:
            capped = capped * mask[..., None]
        row = [name, f"{capped.norm(dim=-1)[density > 0].mean():.1f}"]
        for _, scheme in SCHEMES:
            _, error = correct_mass(warp(density, capped, scheme), density)
            row.append(f"{error:+.1%}")
        rows.append(row)
    header = ["displacement", "mean length", *[name for name, _ in SCHEMES]]
    print_table("Mass error of one warp, capped at 5 voxels, before correction", header, rows)


def best_time(action: Callable[[], object], n_runs: int = 5) -> float:
    """Least CPU time of some runs, milliseconds: unlike wall time it bears a busy machine."""
    times = []
    for _ in range(n_runs):
        start = time.process_time()
        action()
        times.append(time.process_time() - start)
    return 1e3 * min(times)


def print_speed() -> None:
    """CPU time at a million voxels, float32."""
    side = 100
    values = make_cloud(side)[0]
    velocity = smooth(torch.randn(side, side, side, 3), 3.0) * 10
    positions = voxel_positions(values.shape, values) - velocity.reshape(-1, 3)

    def both(action: Callable[[Tensor, Tensor], Tensor], second: Tensor, values_too: bool) -> float:
        def run() -> None:
            first = values.clone().requires_grad_(values_too)
            action(first, second.clone().requires_grad_()).sum().backward()

        return best_time(run)

    def row(name: str, action: Callable[[Tensor, Tensor], Tensor], second: Tensor) -> list[str]:
        times = [best_time(lambda: action(values, second))]
        times += [both(action, second, values_too) for values_too in (False, True)]
        return [name, *[f"{t:.0f}" for t in times]]

    rows = [
        row("sample_linear", sample_linear, positions),
        row("sample_cubic", sample_cubic, positions),
        ["cell_bounds", f"{best_time(lambda: cell_bounds(values, positions)):.0f}", "", ""],
    ]
    for name, scheme in SCHEMES:
        rows.append(row(f"warp, {name}", lambda v, u, s=scheme: warp(v, u, s), velocity))
        rows.append(
            row(
                f"advect, {name}, RK2",
                lambda v, u, s=scheme: advect(v, u, 1.0, s),
                velocity,
            )
        )
    header = ["10⁶ voxels, float32, CPU ms", "forward", "+ gradient of motion", "+ of both"]
    print_table("Speed on one thread", header, rows)


def main() -> None:
    """Prints all tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--fine", action="store_true", help="also run the vortex on 256 x 256")
    parser.add_argument("--skip-speed", action="store_true", help="leave out the table of speeds")
    options = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    print_vortex((64, 128, 256) if options.fine else (64, 128))
    print_disk()
    print_orders()
    print_windows()
    print_mass()
    if not options.skip_speed:
        print_speed()


if __name__ == "__main__":
    main()

"""What an iteration costs from 32^3 to 256^3 voxels and from 1 % to 100 % of smoke.

    python -m benchmarks.scaling [--quick] [--report FILE]

Series of both steps, at full resolution, one view an iteration, pictures of 64 pixels: more
and more smoke in one box; the same number of voxels with smoke in larger and larger boxes; boxes
of 10 % smoke of all sizes. Then the network's share of an iteration at 128^3 with 10 %, a voxel a
pixel. Every case runs in a process of its own, on one thread; with a GPU once more there. Prints
the tables and writes them to --report, benchmarks/results/scaling.md, and as JSON beside it.
"""

import argparse
import dataclasses
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.circumstances import circumstances
from benchmarks.scaling_cases import Case, Cost, measure_case, measure_peak
from usdsmoke.config.resolve import resolve_config

__all__ = ["fit_exponent", "list_cases", "main", "render_report"]

STEPS = ("shape", "colour")
SHARES = (0.01, 0.03, 0.1, 0.3, 1.0)
FIXED = 20000  # voxels with smoke, in boxes of all sizes
NETWORK_MARK = 0.6
MOST_EXPONENTS = {"active": 1.15, "box": 0.1}  # linear in the voxels; no growth with the box

Costs = dict[str, list[tuple[Case, Cost]]]


@dataclasses.dataclass(frozen=True)
class Made:
    """How a series was made: runs of single series may be put together in one report."""

    circumstances: list[str]
    peak_gflops: float  # of a large convolution, in the same run


def list_cases(quick: bool = False, device: str = "cpu") -> dict[str, list[Case]]:
    """The cases by series; ``quick`` has small boxes alone."""
    side, sides = (24, (32, 40)) if quick else (128, (32, 64, 128, 256))
    shares, n = (SHARES[2:4], 3) if quick else (SHARES, 10)

    def case(
        step: str, side: int, share: float = 0.0, layout: str = "scattered", **more: int
    ) -> Case:
        options = {"iterations": n, "image_size": 64, **more}
        return Case(step, side, share, layout, device=device, **options)

    spread = [n for n in sides if n**3 > FIXED]
    return {
        "active": [case(step, side, share) for step in STEPS for share in shares],
        "padded": [case(step, n, layout="padded") for step in STEPS for n in sides],
        "spread": [
            case(step, n, FIXED / n**3) for step in STEPS for n in spread
        ],
        "volume": [case(step, n, 0.1, "plume") for step in STEPS for n in sides],
        "network": [
            case(step, side, 0.1, layout, image_size=side, views=views)
            for layout in ("plume", "scattered") for step in STEPS for views in (1, 9)
        ],
    }  # fmt: skip


def fit_exponent(sizes: Sequence[float], seconds: Sequence[float]) -> float:
    """Slope of log seconds over log size, least squares."""
    return float(np.polyfit(np.log(sizes), np.log(np.maximum(seconds, 1e-9)), 1)[0])


def measure_in_child(case: Case) -> Cost:
    """Run a case in a fresh process.

    Raises:
        RuntimeError: it failed; its own message went to stderr.
    """
    asked = json.dumps(dataclasses.asdict(case))
    command = [sys.executable, "-m", "benchmarks.scaling", "--case", asked]
    variables = {**os.environ, "OMP_WAIT_POLICY": "PASSIVE", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, env=variables)
    if done.returncode:
        raise RuntimeError(f"the case ended with {done.returncode}: {asked}")
    print(f"{asked} {done.stdout.strip()}", file=sys.stderr, flush=True)
    return Cost(**json.loads(done.stdout))


def render_report(costs: Costs, made: Mapping[str, Made]) -> str:
    """All tables in Markdown; a series that is not ``made`` is left out."""
    lines = ["# Cost against size", "", *(__doc__ or "").split("\n\n", 2)[2].splitlines(), ""]
    lines += [
        "Seconds are CPU seconds of an iteration (wall seconds on a GPU), the median of the second",
        "half of ten: in the first, the views' maps are made. Volume: all but the network, which",
        "is timed on its own, gradient included. Set-up: up to the first iteration, one view's map",
        "included. GiB: the process's peak above what is resident after a tiny run; it holds the",
        "dense arrays that smoke is read into, and all views' maps.",
        "",
        "Where a pixel holds several voxels, blocks of voxels are optimised (decision 034), so the",
        "cost of an iteration stops growing with the voxels.",
        "",
    ]
    titles = {
        "active": "## More smoke in one box",
        "padded": "## The same smoke in larger boxes",
        "spread": f"## {FIXED} voxels of smoke spread over larger boxes",
        "volume": "## Boxes of all sizes, a plume that fills 10 %",
        "network": "## The network's share, a voxel a pixel",
    }
    for series, title in titles.items():
        if series in made:
            table = _table(costs[series], made[series].peak_gflops)
            lines += [title, "", *_verdicts(series, costs[series]), *table, ""]
    lines += [
        "## Left out",
        "",
        "- 256^3 with more than 10 % of smoke: 16.8 million voxels take more memory for the maps",
        "  of four views than this machine has to spare; the series above says what they cost.",
        "- Set-up and the end of an octave of the shape step: boxes around the smoke are filled",
        "  once, and once a result is moved; the seconds of set-up and the peak hold that.",
        "",
        "Convolution peak on one thread, GFLOP/s: "
        + ", ".join(f"{made[name].peak_gflops:.0f} ({name})" for name in titles if name in made)
        + ".",
        "",
    ]  # fmt: skip
    for text in dict.fromkeys("\n".join(made[name].circumstances) for name in made):
        names = [name for name in made if "\n".join(made[name].circumstances) == text]
        lines += [f"Made ({', '.join(names)}):", "", text, ""]
    return "\n".join(lines)


def _table(found: Sequence[tuple[Case, Cost]], peak: float) -> list[str]:
    head = (
        "| step | smoke | box | voxels | pixels | views | device | s | volume s | network s "
        "| share | GFLOP/s | of peak | set-up s | GiB |"
    )
    rows = [head, "|" + "---|" * 15]
    for case, cost in found:
        speed = cost.network_gflop / cost.network_s
        of_peak = f"{speed / peak:.0%}" if case.device == "cpu" else ""
        cells = [
            case.step, case.layout, f"{case.side}^3", cost.voxels, case.image_size, case.views,
            case.device, f"{cost.seconds:.4f}", f"{cost.volume_s:.4f}", f"{cost.network_s:.4f}",
            f"{cost.share:.0%}", f"{speed:.1f}", of_peak, f"{cost.set_up_s:.2f}",
            f"{cost.peak_gib:.2f}",
        ]  # fmt: skip
        rows.append("| " + " | ".join(map(str, cells)) + " |")
    return rows


def _verdicts(series: str, found: Sequence[tuple[Case, Cost]]) -> list[str]:
    """Fitted exponents and marks, a list item for each step."""
    if series == "network":
        return [*_network_verdicts(found), ""]
    lines = []
    for step in STEPS:
        of_step = [(case, cost) for case, cost in found if case.step == step]
        if len(of_step) < 2:
            continue
        volume = [cost.volume_s for _, cost in of_step]
        if series in ("active", "volume"):
            sizes: list[float] = [cost.voxels for _, cost in of_step]
            most = MOST_EXPONENTS["active"]
            found_slope = fit_exponent(sizes[-3:], volume[-3:])
            met = "met" if found_slope <= most else "missed"
            lines.append(
                f"- {step}: volume part ~ voxels^{fit_exponent(sizes, volume):.2f}; over the last "
                f"three sizes ^{found_slope:.2f} (mark at most {most}: {met})."
            )
            continue
        sizes = [case.side**3 for case, _ in of_step]
        slope = fit_exponent(sizes, volume)
        most = MOST_EXPONENTS["box"]
        met = "met" if slope <= most else "missed"
        lines.append(f"- {step}: volume part ~ box^{slope:.2f} (mark at most {most}: {met}).")
    return [*lines, ""]


def _network_verdicts(found: Sequence[tuple[Case, Cost]]) -> list[str]:
    lines = []
    layouts = dict.fromkeys(case.layout for case, _ in found)
    for layout in layouts:
        for views in (1, 9):
            chosen = [pair for pair in found if (pair[0].layout, pair[0].views) == (layout, views)]
            if not chosen:
                continue
            rounds = [_finest_iterations(case.step) for case, _ in chosen]
            pairs = list(zip(rounds, (cost for _, cost in chosen), strict=True))
            share = sum(n * c.network_s for n, c in pairs) / sum(n * c.seconds for n, c in pairs)
            met, ends = (
                "met" if share >= NETWORK_MARK else "missed",
                zip(rounds, chosen, strict=True),
            )
            lines.append(
                f"- {layout}, {views} view{'' if views == 1 else 's'} an iteration: {share:.0%} of "
                f"{' and '.join(f'{n} iterations of {c.step}' for n, (c, _) in ends)} (mark "
                f"{NETWORK_MARK:.0%}: {met})."
            )
    return lines


def _finest_iterations(step: str) -> int:
    """The default number of iterations of a step at full resolution."""
    return int(getattr(resolve_config(), step).iterations[-1])


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="small boxes, few cases")
    parser.add_argument("--series", nargs="+", help="only these; others stay as they are")
    parser.add_argument("--report", type=Path, default=Path("benchmarks/results/scaling.md"))
    parser.add_argument("--case", help=argparse.SUPPRESS)  # of a child process, JSON
    options = parser.parse_args(arguments)
    if options.case:
        cost = measure_case(Case(**json.loads(options.case)))
        print(json.dumps(dataclasses.asdict(cost)))
        return 0
    words = ["python -m benchmarks.scaling", *(sys.argv[1:] if arguments is None else arguments)]
    costs, made = _read(options.report.with_suffix(".json")) if options.series else ({}, {})
    peaks: dict[str, float] = {}
    for series in options.series or list_cases():
        costs[series], peaks[series] = _measure_series(series, options.quick)
        now = circumstances(words)
        made |= {name: Made(now, peak) for name, peak in peaks.items()}
        _write(options.report, costs, made)  # after every series, for they take minutes
    print(options.report.read_text(encoding="utf-8"))
    return 0


def _measure_series(series: str, quick: bool) -> tuple[list[tuple[Case, Cost]], float]:
    """On the CPU and, if there is one, a GPU; and the speed of a convolution before and after."""
    import torch

    devices = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
    before = measure_peak()
    cases = [case for device in devices for case in list_cases(quick, device)[series]]
    found = [(case, measure_in_child(case)) for case in cases]
    return found, (before + measure_peak()) / 2


def _write(file_path: Path, costs: Costs, made: Mapping[str, Made]) -> None:
    """The report, and everything that it is made from as JSON."""
    file_path.parent.mkdir(parents=True, exist_ok=True)
    file_path.write_text(render_report(costs, made), encoding="utf-8")
    values = {
        series: {
            **dataclasses.asdict(made[series]),
            "rows": [[dataclasses.asdict(case), dataclasses.asdict(cost)] for case, cost in found],
        }
        for series, found in costs.items()
    }
    text = json.dumps(values, indent=1) + "\n"
    file_path.with_suffix(".json").write_text(text, encoding="utf-8")


def _read(json_file: Path) -> tuple[Costs, dict[str, Made]]:
    """What an earlier run has written; nothing where there is none."""
    values = json.loads(json_file.read_text(encoding="utf-8")) if json_file.is_file() else {}
    made = {name: Made(v["circumstances"], v["peak_gflops"]) for name, v in values.items()}
    return {
        name: [(Case(**case), Cost(**cost)) for case, cost in v["rows"]]
        for name, v in values.items()
    }, made


if __name__ == "__main__":
    sys.exit(main())

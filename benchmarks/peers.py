"""What an iteration of the shape step costs beside the public reference code.

    python -m benchmarks.peers [--iterations 8] [--quick]

The work is that of a measurement of the reference code [Kim2019] on CPU, see
``benchmarks.shape_cost``. Every case runs in a process of its own. Prints the table and writes it
to --report, benchmarks/results/peers.md.
"""

import argparse
import dataclasses
import json
import os
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np

from benchmarks.circumstances import circumstances
from benchmarks.shape_cost import Case, Cost, measure_case

__all__ = ["list_cases", "main", "measure_in_child", "render_report"]

REFERENCE_CPU = {1: 1.590, 9: 12.983}  # CPU seconds an iteration, by number of views
REFERENCE_PEAK = {1: 1.30, 9: 1.26}  # GiB
REFERENCE_BASE = 0.6  # GiB of it are TensorFlow and the network, loaded
MOST_CPU, MOST_GIB, LEAST_NETWORK = 1.298, 0.33, 0.5  # marks for nine views on one thread


def measure_in_child(case: Case) -> Cost:
    """Run a case in a fresh process.

    Raises:
        RuntimeError: it failed; its own message went to stderr.
    """
    asked = json.dumps(dataclasses.asdict(case))
    print(f"benchmarks.peers: {asked}", file=sys.stderr, flush=True)
    command = [sys.executable, "-m", "benchmarks.peers", "--case", asked]
    # as the pipeline has it: threads that wait do not spin, which would count as CPU seconds
    variables = {"OMP_WAIT_POLICY": "PASSIVE", **os.environ}
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, env=variables)
    if done.returncode:
        raise RuntimeError(f"the case ended with {done.returncode}: {asked}")
    found = json.loads(done.stdout)
    return Cost(**{**found, "box": tuple(found["box"])})


def list_cases(n_iterations: int, quick: bool = False) -> list[Case]:
    """All cases; ``quick`` leaves only the embedded features on one thread."""
    features = ["embedded"] if quick else ["embedded", "vgg19"]
    cases = [Case(f, v, 1, True, n_iterations) for f in features for v in (9, 1)]
    cases += [Case("embedded", v, 1, False, n_iterations) for v in (9, 1)]
    if quick:
        return cases
    cases += [Case(f, 9, 0, True, n_iterations) for f in features]
    plume = Case("embedded", 9, 1, True, n_iterations, scattered=True)
    return [*cases, plume, dataclasses.replace(plume, network=False)]


def render_report(costs: dict[Case, Cost], arguments: Sequence[str]) -> str:
    """The table in Markdown."""
    lines = [
        *_introduction(costs),
        "| smoke | features | views | threads | CPU s | reference | ratio | wall s | network "
        "| GiB | reference | ratio | set-up CPU s | end CPU s | base GiB |",
        "|" + "---|" * 15,
    ]
    lines += [_row(case, cost, costs) for case, cost in costs.items() if case.network]
    return "\n".join([*lines, "", *_circumstances(arguments)]) + "\n"


def _row(case: Case, cost: Cost, costs: dict[Case, Cost]) -> str:
    without = costs.get(dataclasses.replace(case, features="embedded", network=False))
    cpu, gib = REFERENCE_CPU[case.views], REFERENCE_PEAK[case.views] - REFERENCE_BASE
    cells = [
        "scattered" if case.scattered else "plume",
        case.features,
        case.views,
        case.threads or "all",
        f"{cost.cpu_s:.3f}",
        f"{cpu:.2f}",
        f"{cost.cpu_s / cpu:.3f}",
        f"{cost.wall_s:.3f}",
        f"{1 - without.cpu_s / cost.cpu_s:.0%}" if without else "",
        f"{cost.whole_peak_gib:.2f} ({cost.peak_gib:.2f})",
        f"{gib:.2f}",
        f"{cost.whole_peak_gib / gib:.2f}",
        f"{cost.set_up_cpu_s:.1f}",
        f"{cost.finish_cpu_s:.1f}",
        f"{cost.base_gib:.2f}",
    ]
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def _introduction(costs: dict[Case, Cost]) -> list[str]:
    case, cost = next(iter(costs.items()))
    wide = next((cost for case, cost in costs.items() if case.scattered), cost)
    shape, box, wide_box = (
        " x ".join(map(str, sizes)) for sizes in (case.shape, cost.box, wide.box)
    )
    work = f"""One frame of {shape} voxels, {cost.voxels} of which
    ({cost.voxels / np.prod(case.shape):.1%}) hold smoke: a lumpy plume in a box of {box};
    "scattered" is as much smoke in one of {wide_box}. Displacement by a potential, full resolution
    alone, a pixel a voxel, {case.iterations} iterations. Seconds are those of an iteration: the
    mean of all but the first. "Network" is the share of the CPU seconds that goes when the style
    loss of a picture is replaced by its mean. VGG-19 has random parameters, to relu3_1. GiB: the
    process's peak (in brackets: up to the last iteration) less the base, which is what is resident
    after the imports and one iteration on 8 x 12 x 8 voxels with the same network."""
    reference = f"""Reference: the code of [Kim2019] (byungsook/neural-flow-style, branch tnst)
    under TensorFlow 2.15 on two CPU cores, smoke of the same box and share, `field_type=field`,
    w_field 1, GoogLeNet to mixed4b on pictures of the whole box, MacCormack in every iteration
    (here linear look-ups, and a cubic spline at the end); its peak of {REFERENCE_PEAK[9]:.2f} GiB
    (one view: {REFERENCE_PEAK[1]:.2f}) less about {REFERENCE_BASE} GiB of TensorFlow and network.
    Its smoke was another, and the machine may have been: ratios are good to their first digit."""
    title = "# The shape step beside the public reference code"
    filled = (textwrap.fill(" ".join(text.split()), 88) for text in (work, reference))
    return [title, "", *(line for text in filled for line in (text, ""))]


def _circumstances(arguments: Sequence[str]) -> list[str]:
    load = f"- torch {version('torch')}; load average at the end {os.getloadavg()[0]:.1f}."
    return [*circumstances(["python -m benchmarks.peers", *arguments]), load]


def _missed_marks(costs: dict[Case, Cost]) -> list[str]:
    """What nine views of the plume on one thread do not reach, with both numbers."""
    missed = []
    for case, cost in costs.items():
        if case.views != 9 or case.threads != 1 or not case.network or case.scattered:
            continue
        if cost.cpu_s > MOST_CPU:
            missed.append(f"{case.features}: {cost.cpu_s:.3f} CPU s, wanted at most {MOST_CPU}")
        if cost.whole_peak_gib > MOST_GIB:
            gib = cost.whole_peak_gib
            missed.append(f"{case.features}: {gib:.2f} GiB, wanted at most {MOST_GIB}")
        without = costs.get(dataclasses.replace(case, features="embedded", network=False))
        share = 1 - without.cpu_s / cost.cpu_s if without else 1.0
        if share <= LEAST_NETWORK:
            missed.append(f"{case.features}: network {share:.0%}, wanted above {LEAST_NETWORK:.0%}")
    return missed


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--iterations", type=int, default=8, help="of each case, 3 or more")
    parser.add_argument("--quick", action="store_true", help="embedded features, one thread")
    parser.add_argument("--report", type=Path, default=Path("benchmarks/results/peers.md"))
    parser.add_argument("--case", help=argparse.SUPPRESS)  # of a child process, JSON
    options = parser.parse_args(arguments)
    if options.case:
        asked = json.loads(options.case)
        cost = measure_case(Case(**{**asked, "shape": tuple(asked["shape"])}))
        print(json.dumps(dataclasses.asdict(cost)))
        return 0
    costs = {case: measure_in_child(case) for case in list_cases(options.iterations, options.quick)}
    report = render_report(costs, arguments if arguments is not None else sys.argv[1:])
    options.report.write_text(report, encoding="utf-8")
    print(report)
    for missed in _missed_marks(costs):
        print(f"missed: {missed}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""``python -m benchmarks.discretisation``; see the package."""

import argparse

from benchmarks.discretisation import backtrace, interpolation, precision, projection, quadrature
from usdsmoke.work_precision import make_report

SWEEPS = tuple(
    module.SWEEP for module in (projection, quadrature, interpolation, backtrace, precision)
)


def main() -> None:
    """Write the page and print its verdicts."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.discretisation")
    parser.add_argument("stage")
    parser.add_argument("--style", action="append", required=True)
    parser.add_argument("-o", "--output", required=True)
    parser.add_argument("--budget", type=float, default=120.0, help="seconds")
    arguments = parser.parse_args()
    result = make_report(
        arguments.stage,
        arguments.style,
        arguments.output,
        seconds=arguments.budget,
        sweeps=SWEEPS,
    )
    print(result.page)
    for sweep in result.report.sweeps:
        print(f"  {sweep.title}: {sweep.verdict}")
    for item in result.report.omissions:
        print(f"  left out: {item.what}: {item.reason}")


if __name__ == "__main__":
    main()

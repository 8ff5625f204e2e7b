"""Shows what optics.thicken does to the real plume, whose upper half is thin.

    python -m benchmarks.thin_smoke STYLE [STYLE ...] [--data ../shared/data] [--picture FILE]

Every style stylizes the plume with each value, all else by default. A row of the picture is a
style; it has the front and the back of each value, in the order of VALUES. Prints the mass of each
result beside that of the source.
"""

import argparse
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.plume_looks import Comparison
from benchmarks.stages import PLUME_FILE
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.runs.assemble import StylizeResult
from usdsmoke.vdb.read import GridRequest, read_grids

__all__ = ["VALUES", "main"]

VALUES = (1, 10, 30)


def _mass(file_path: Path) -> float:
    (density,) = read_grids(str(file_path), [GridRequest("density")], GridsConfig())
    return float(density.values.sum(dtype=np.float64))


_source_mass = cache(_mass)


def tell_mass(style: Path, value: str, result: StylizeResult, data: Path) -> None:
    """Print a result's share of the source's mass."""
    mass = _mass(result.frames[0]) / _source_mass(data / PLUME_FILE)
    print(f"{style.stem}, optics.thicken={value}: {mass:.2f} of the mass", flush=True)


def main() -> None:
    """Runs the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--picture", type=Path, help="file of the picture")
    variants = {str(value): [f"optics.thicken={value}"] for value in VALUES}
    Comparison("thin_smoke", variants, turn=2, size=(256, 384), width=1200).run(parser, tell_mass)


if __name__ == "__main__":
    main()

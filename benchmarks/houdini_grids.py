"""Stylizes three Houdini grids of one name, told apart by fieldIndex, and shows them together.

    python -m benchmarks.houdini_grids STYLE [--data ../shared/data] [--out out/bench/houdini]

The grids are 11 to 22 voxels wide, too coarse for a stroke, so their voxels are subdivided
(``grids.refine``). Writes docs/pictures/houdini_grids.png from the run's own contact sheets.
"""

import argparse
import time
from pathlib import Path

import usdsmoke
from benchmarks.plume_looks import join_pictures, stack_rows

__all__ = ["main"]

PICTURE = Path("docs/pictures/houdini_grids.png")
WIDTH = 1200  # pixels of the picture


def main() -> None:
    """Runs the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("style", help="style image")
    parser.add_argument("--data", default="../shared/data", help="real volumes")
    parser.add_argument("--out", default="out/bench/houdini", help="folder to write into")
    parser.add_argument("--refine", type=int, default=8, help="subdivisions of a voxel")
    arguments = parser.parse_args()
    began = time.perf_counter()
    result = usdsmoke.stylize(
        Path(arguments.data) / "arnold-usd" / "test_2315.usda",
        style=arguments.style,
        output=arguments.out,
        settings=[f"grids.refine={arguments.refine}"],
        force=True,
    )
    rows = [join_pictures([sheet], WIDTH) for sheet in sorted(result.contact_sheets)]
    stack_rows(rows).save(PICTURE)
    seconds = time.perf_counter() - began
    print(f"{len(result.frames)} grids in {seconds:.0f} s: {result.root_stage}, {PICTURE}")


if __name__ == "__main__":
    main()

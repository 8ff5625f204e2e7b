"""Stylizes three Houdini grids of one name, told apart by fieldIndex, and shows them together.

    python -m benchmarks.houdini_grids STYLE [--data ../shared/data] [--out out/bench/houdini]

The grids are 11 to 22 voxels wide, too coarse for a stroke, so their voxels are subdivided
(``grids.refine``). Writes docs/pictures/houdini_grids.png from the run's own contact sheets.
"""

import argparse
import time
from pathlib import Path

from PIL import Image

import usdsmoke

__all__ = ["join_pictures", "main", "stack_pictures"]

PICTURE = Path("docs/pictures/houdini_grids.png")
WIDTH = 1200  # pixels of the picture


def join_pictures(file_paths: list[Path], width: int) -> Image.Image:
    """The pictures beside each other, scaled to a common width of ``width`` pixels."""
    pictures = [Image.open(file_path).convert("RGB") for file_path in file_paths]
    joined = Image.new(
        "RGB", (sum(p.width for p in pictures), max(p.height for p in pictures)), (24, 24, 26)
    )
    left = 0
    for picture in pictures:
        joined.paste(picture, (left, 0))
        left += picture.width
    return joined.resize((width, round(joined.height * width / joined.width)), Image.LANCZOS)


def stack_pictures(file_paths: list[Path], width: int) -> Image.Image:
    """The pictures below each other, each scaled to a width of ``width`` pixels."""
    found = [Image.open(file_path).convert("RGB") for file_path in file_paths]
    rows = [p.resize((width, round(p.height * width / p.width)), Image.LANCZOS) for p in found]
    stack = Image.new("RGB", (width, sum(row.height for row in rows)))
    top = 0
    for row in rows:
        stack.paste(row, (0, top))
        top += row.height
    return stack


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
    stack_pictures(sorted(result.contact_sheets), WIDTH).save(PICTURE)
    seconds = time.perf_counter() - began
    print(f"{len(result.frames)} grids in {seconds:.0f} s: {result.root_stage}, {PICTURE}")


if __name__ == "__main__":
    main()

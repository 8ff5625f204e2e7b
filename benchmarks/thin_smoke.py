"""Shows what optics.thicken does to the real plume, whose upper half is thin.

    python -m benchmarks.thin_smoke STYLE [STYLE ...] [--data ../shared/data] [--picture FILE]

Every style stylizes the plume with each value, all else by default. A row of the picture is a
style; it has the front and the back of each value, in the order of VALUES. Prints the mass of each
result beside that of the source.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageSequence

import usdsmoke
from benchmarks.houdini_grids import join_pictures
from benchmarks.stages import PLUME_FILE, find_stages
from usdsmoke.base.sections import GridsConfig
from usdsmoke.vdb.read import GridRequest, read_grids

__all__ = ["VALUES", "main"]

VALUES = (1, 10, 30)
SIZE = (256, 384)  # pixels of a picture
WIDTH = 1200  # pixels of a row


def _mass(file_path: Path | str) -> float:
    (density,) = read_grids(str(file_path), [GridRequest("density")], GridsConfig())
    return float(density.values.sum(dtype=np.float64))


def _sides(stage: Path, file_path: Path) -> list[Path]:
    """Pictures of the front and of the back."""
    usdsmoke.preview(stage, file_path, turntable=2, size=SIZE, background="black")
    found = []
    with Image.open(file_path) as turn:
        for number, picture in enumerate(ImageSequence.Iterator(turn)):
            found.append(file_path.with_name(f"{file_path.stem}_{number}.png"))
            picture.convert("RGB").save(found[-1])
    return found


def main() -> None:
    """Runs the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("styles", nargs="+", type=Path, help="style images")
    parser.add_argument("--data", default="../shared/data", type=Path, help="real volumes")
    parser.add_argument("--out", default="out/bench/thin_smoke", type=Path, help="folder for looks")
    parser.add_argument("--picture", type=Path, help="file of the picture")
    arguments = parser.parse_args()
    try:
        stage = find_stages(arguments.data, arguments.out)["real_plume"]
    except FileNotFoundError as error:
        sys.exit(f"benchmarks.thin_smoke: {error}")
    source, rows = _mass(arguments.data / PLUME_FILE), []
    for style in arguments.styles:
        pictures = []
        for value in VALUES:
            name = f"{style.stem}_{value}"
            result = usdsmoke.stylize(
                stage, style=style, output=arguments.out / name, force=True,
                settings=[f"optics.thicken={value}", "layer.contact_sheet=0"],
            )  # fmt: skip
            mass = _mass(result.frames[0]) / source
            print(f"{style.stem}, optics.thicken={value}: {mass:.2f} of the mass", flush=True)
            pictures += _sides(result.root_stage, arguments.out / f"{name}.webp")
        rows.append(join_pictures(pictures, WIDTH))
    if arguments.picture:
        whole = Image.new("RGB", (WIDTH, sum(row.height for row in rows)))
        top = 0
        for row in rows:
            whole.paste(row, (0, top))
            top += row.height
        whole.save(arguments.picture, quality=85, method=6)
        print(arguments.picture)


if __name__ == "__main__":
    main()

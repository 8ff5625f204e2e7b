"""Shows what narrow views gain from the front, and lose from elsewhere, on the real plume.

    python -m benchmarks.seen_from STYLE [STYLE ...] [--data ../shared/data] [--picture FILE]

Every style stylizes the plume with views around the front and with views from all sides, all else
by default. A row of the picture is a style; it has the front and the side of each. Prints scores of
held-out views from the front and from all sides.
"""

import argparse
import sys
from pathlib import Path

from PIL import Image, ImageSequence
from pxr import Usd

import usdsmoke
from benchmarks.held_out import held_out_angles, read_result, read_style, score_result
from benchmarks.houdini_grids import join_pictures
from benchmarks.stages import find_stages

__all__ = ["POOLS", "main"]

POOLS = {"narrow": ["views.azimuth=12", "views.elevation=6"], "all_round": []}
ANGLES = {"front": (12.0, 6.0), "all round": (180.0, 40.0)}  # of held-out views
MEASURES = {"patch": "patches", "spectrum": "spectrum", "edges": "edges"}
N_VIEWS, IMAGE_SIZE = 4, 192
SIZE, WIDTH = (256, 480), 1024  # pixels of a picture and of a row


def _front_and_side(stage: Path, file_path: Path) -> list[Path]:
    usdsmoke.preview(stage, file_path, turntable=4, size=SIZE, background="black")
    found = []
    with Image.open(file_path) as turn:
        for number, picture in enumerate(ImageSequence.Iterator(turn)):
            if number < 2:
                found.append(file_path.with_name(f"{file_path.stem}_{number}.png"))
                picture.convert("RGB").save(found[-1])
    return found


def main() -> None:
    """Runs the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("styles", nargs="+", type=Path, help="style images")
    parser.add_argument("--data", default="../shared/data", type=Path, help="real volumes")
    parser.add_argument("--out", default="out/bench/seen_from", type=Path, help="folder for looks")
    parser.add_argument("--picture", type=Path, help="file of the picture")
    arguments = parser.parse_args()
    try:
        stage = find_stages(arguments.data, arguments.out)["real_plume"]
    except FileNotFoundError as error:
        sys.exit(f"benchmarks.seen_from: {error}")
    rows = []
    for style in arguments.styles:
        pictures = []
        for pool, settings in POOLS.items():
            made = usdsmoke.stylize(
                stage, style=style, output=arguments.out / f"{style.stem}_{pool}", force=True,
                settings=[*settings, "layer.contact_sheet=0", "style.size=1"],
            )  # fmt: skip
            result = read_result(Usd.Stage.Open(str(made.root_stage)))
            for place, ranges in ANGLES.items():
                scores, _ = score_result(
                    result, read_style(style, IMAGE_SIZE), held_out_angles(N_VIEWS, *ranges),
                    IMAGE_SIZE,
                )  # fmt: skip
                told = ", ".join(f"{MEASURES[m]} {scores[m]['mean']:.2f}" for m in MEASURES)
                print(f"{style.stem}, {pool}, seen from {place}: {told}", flush=True)
            pictures += _front_and_side(
                Path(made.root_stage), arguments.out / f"{style.stem}_{pool}.webp"
            )
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

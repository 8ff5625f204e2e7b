"""Shows what narrow views gain from the front, and lose from elsewhere, on the real plume.

    python -m benchmarks.seen_from STYLE [STYLE ...] [--data ../shared/data] [--picture FILE]

Every style, as large as the pictures, stylizes the plume with views around the front and with views
from all sides, all else by default. A row of the picture is a style; it has the front and the side
of each. Prints scores of held-out views from the front and from all sides.
"""

import argparse
from pathlib import Path

from pxr import Usd

from benchmarks.held_out import held_out_angles, read_result, read_style, score_result
from benchmarks.plume_looks import Comparison
from benchmarks.style_scores import FRONT, IMAGE_SIZE, RANGES
from usdsmoke.core.smoke.schedule import ALL_ROUND
from usdsmoke.runs.assemble import StylizeResult

__all__ = ["POOLS", "main"]

AS_LARGE = "style.size=1"  # as the style that the scores compare with
POOLS = {
    "narrow": [AS_LARGE, *FRONT],
    "all_round": [AS_LARGE],
}
ANGLES = {"front": RANGES["front"], "all round": ALL_ROUND}  # of held-out views
MEASURES = {"patch": "patches", "spectrum": "spectrum", "edges": "edges"}
N_VIEWS = 4


def tell_scores(style: Path, pool: str, made: StylizeResult, data: Path) -> None:
    """Print the scores of a look, from each place."""
    result = read_result(Usd.Stage.Open(str(made.root_stage)))
    pixels = read_style(style, IMAGE_SIZE)
    for place, ranges in ANGLES.items():
        angles = held_out_angles(N_VIEWS, *ranges)
        scores, _ = score_result(result, pixels, angles, IMAGE_SIZE)
        told = ", ".join(f"{MEASURES[m]} {scores[m]['mean']:.2f}" for m in MEASURES)
        print(f"{style.stem}, {pool}, seen from {place}: {told}", flush=True)


def main() -> None:
    """Runs the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--picture", type=Path, help="file of the picture")
    Comparison("seen_from", POOLS, turn=4, size=(256, 480), width=1024).run(parser, tell_scores)


if __name__ == "__main__":
    main()

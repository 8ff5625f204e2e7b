"""What the scores of a perfect painter are: other pictures by the hand that painted the style.

    python -m benchmarks.painted_anew out/bench/strokes_front [--seeds 8 9] [--report anew.md]

The anchor 1 of `measures.score_views` pastes pieces of the style image itself, in which exact
copies of its patches are found. A painter does not copy. So the painted styles are painted anew
from other seeds, cut to the outlines that a finished result has in the held-out views from the
front, and scored as a result is. Needs a result that `benchmarks.style_scores` has written.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from pxr import Usd

from benchmarks.circumstances import publish, table_page
from benchmarks.control_scenes import paint_styles
from benchmarks.held_out import draw_march, fit_view, held_out_angles, read_result
from benchmarks.measures import MEASURES, paste_style, score_views
from benchmarks.style_scores import IMAGE_SIZE, RANGES
from usdsmoke.config.look_sections import StyleConfig
from usdsmoke.core.style.style_image import scale_style

__all__ = ["main", "score_anew"]

STYLES = ("strokes", "waves", "petals", "mosaic")
SEED = 7  # of the example styles
COMMAND = "python -m benchmarks.painted_anew"
INTRO = (
    "# Scores of a perfect painter",
    "",
    "Closures of pictures by the program that painted the style, from other seeds, cut to the",
    "outline of the real plume. Anchor 1 has exact copies of the style, and these have none.",
)


def score_anew(
    style: np.ndarray, another: np.ndarray, masks: Sequence[np.ndarray], seed: int
) -> dict[str, float]:
    """Mean closures of pieces of another painting [h w 3] to the style, inside masks [H W]."""
    rng = np.random.default_rng(seed)
    found = score_views(style, [paste_style(another, mask, rng) for mask in masks], masks)
    return {name: float(found[name]["mean"]) for name in MEASURES}


def main(arguments: list[str] | None = None) -> int:
    """Print the table; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("result", type=Path, help="folder of a finished result")
    parser.add_argument("--seeds", type=int, nargs="+", default=[8, 9])
    parser.add_argument("--views", type=int, default=6)
    parser.add_argument("--report", type=Path, help="Markdown file for the table")
    options = parser.parse_args(arguments)
    (stage,) = options.result.glob("*_look.usda")
    result = read_result(Usd.Stage.Open(str(stage)))
    angles = held_out_angles(options.views, *RANGES["front"])
    masks = [
        draw_march(result, fit_view(result, float(a), float(e), IMAGE_SIZE))[1] for a, e in angles
    ]
    styles = _painted(SEED)
    others = {seed: _painted(seed) for seed in options.seeds}
    rows = []
    for name, style in styles.items():
        scores = [score_anew(style, others[seed][name], masks, seed) for seed in options.seeds]
        cells = [f"{np.mean([score[key] for score in scores]):.2f}" for key in MEASURES]
        rows.append(f"| {name} | {' | '.join(cells)} |")
    words = arguments if arguments is not None else sys.argv[1:]
    publish(table_page(INTRO, ["style", *MEASURES], rows, [COMMAND, *words]), options.report)
    return 0


def _painted(seed: int) -> dict[str, np.ndarray]:
    """The styles by name, at the scale of the pictures, display-encoded [h w 3]."""
    pictures = paint_styles(list(STYLES), seed=seed)
    return {
        name: scale_style(picture, IMAGE_SIZE, StyleConfig(), torch.zeros(())).numpy()
        for name, picture in pictures.items()
    }


if __name__ == "__main__":
    sys.exit(main())

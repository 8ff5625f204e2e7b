"""What each preset costs, and how near its result comes to the style on views that it never had.

    python -m benchmarks.presets out/demo/source/plume.usda out/demo/styles/strokes.png --frames 7

Runs ``usdsmoke stylize --preset NAME`` with one thread for each preset and prints a row with CPU
seconds and the style loss of colour pictures: the mean over held-out views of the written file,
always measured with the default settings. It has no unit; 0 is the style itself.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from pxr import Usd

from benchmarks.display import composite, mean_colour
from benchmarks.held_out import Result, draw_march, fit_view, held_out_angles, read_result
from benchmarks.style_scores import stylize_in_child
from usdsmoke.base.volume import VolumeFrame
from usdsmoke.config.settings import Config
from usdsmoke.core.smoke.schedule import view_ranges
from usdsmoke.core.steps.targets import make_targets
from usdsmoke.core.views.scene import measure_scene
from usdsmoke.pictures import find_style_size, read_style_image

__all__ = ["main", "unseen_loss"]

_COMPARED = ("draft", "daily", "final")  # the paper's needs VGG-19


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("stage", type=Path)
    parser.add_argument("style", type=Path)
    parser.add_argument("--frames", required=True, help="one timeCode")
    parser.add_argument("--out", type=Path, default=Path("out/presets"), help="folder of results")
    options = parser.parse_args(arguments)
    style = read_style_image(options.style).pixels
    words = [f"stage.frames={options.frames}", "optimize.threads=1"]
    print("| preset | CPU seconds | unseen loss |\n| --- | --- | --- |")
    for name in _COMPARED:
        folder = options.out / name
        more = ["--preset", name]
        _, cpu_s, _ = stylize_in_child(options.stage, options.style, folder, words, more)
        (root_stage,) = folder.glob("*_look.usda")
        result = read_result(Usd.Stage.Open(str(root_stage)), time_code=float(options.frames))
        print(f"| `{name}` | {cpu_s:.0f} | {unseen_loss(result, style):.2f} |", flush=True)
    return 0


def unseen_loss(
    result: Result,
    style: np.ndarray,
    ranges: tuple[float, float] | None = None,
    n_views: int = 6,
) -> float:
    """The mean style loss of a result's colour pictures from held-out views.

    Args:
        result: as read from its file.
        style: [H W 3], display-encoded.
        ranges: of azimuth and elevation, degrees to either side; None takes the default settings'.
        n_views: how many.
    """
    config = Config()
    frame = VolumeFrame(0.0, result.density, result.to_stage)
    optics = config.optics.replace(thicken=1.0)  # the smoke as it is
    scene = measure_scene([frame], config.views, optics, result.up_axis, 1)
    scene = replace(scene, style_size=find_style_size([style], scene.voxels, config))
    loss = make_targets([style], scene, config, torch.device("cpu")).at(1)
    found = []
    for angles in held_out_angles(n_views, *(ranges or view_ranges(config.views))):
        view = fit_view(result, *map(float, angles), config.views.image_size)
        premultiplied, alpha = draw_march(result, view)
        picture = composite(premultiplied, alpha, mean_colour(style))
        image, mask = (torch.from_numpy(np.float32(item)) for item in (picture, alpha))
        found.append(float(loss(image, mask, None, 0)))
    return float(np.mean(found))


if __name__ == "__main__":
    sys.exit(main())

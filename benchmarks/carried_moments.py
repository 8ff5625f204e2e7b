"""Adam's moments carried from octave to octave against starting each octave anew.

    python -m benchmarks.carried_moments [--resolution 40] [--seeds 2]

Prints the table of docs/decisions/007-adam-starts-anew.md: the style loss at the end of every
octave but the first, as the ratio carried / anew, for two styles, two lengths of a run and some
seeds. About two minutes on two cores.
"""

import argparse

import numpy as np

from benchmarks.control_scenes import frame_of, paint_styles, simulate_smoke
from usdsmoke.base.config import resolve_config
from usdsmoke.base.progress import Progress
from usdsmoke.base.volume import VolumeFrame
from usdsmoke.core.sequence.stylize import stylize_window
from usdsmoke.core.views.scene import measure_scene

__all__ = ["final_losses", "main"]

LENGTHS = {"short": ([20, 17, 13], [40, 40, 40]), "default": ([60, 50, 40], [120, 120, 120])}


def final_losses(
    frame: VolumeFrame, style: np.ndarray, length: str, seed: int, carry: bool
) -> dict[tuple[str, int], float]:
    """Smoothed loss at the end of each octave, by step and octave."""
    shape, colour = LENGTHS[length]
    config = resolve_config(
        {
            "views": {"image_size": 96},
            "shape": {"iterations": shape},
            "colour": {"iterations": colour},
            "optimize": {"tolerance": 0.0, "seed": seed, "carry_moments": carry},
        }
    )
    ends: dict[tuple[str, int], float] = {}

    def remember(state: Progress) -> None:
        ends[state.step, state.octave] = state.loss

    list(stylize_window([frame], [style], measure_scene([frame], config, "Y"), config, remember))
    return ends


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--resolution", type=int, default=40, help="voxels across the plume's box")
    parser.add_argument("--seeds", type=int, default=2, help="runs of each kind")
    options = parser.parse_args(arguments)
    density = simulate_smoke(options.resolution, options.resolution)["3-D"]
    frame = frame_of(density)
    print("| style | iterations | seed | shape 2 | shape 3 | colour 2 | colour 3 |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name, style in paint_styles(["strokes", "petals"]).items():
        for length in LENGTHS:
            for seed in range(options.seeds):
                carried, anew = (
                    final_losses(frame, style, length, seed, carry) for carry in (True, False)
                )
                ratios = " | ".join(
                    f"{carried[step, octave] / anew[step, octave]:.3f}"
                    for step in ("shape", "colour")
                    for octave in (1, 2)
                )
                print(f"| {name} | {length} | {seed} | {ratios} |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

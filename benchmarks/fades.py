"""Whether a shot stays coherent while its strength changes from frame to frame.

    python -m benchmarks.fades [--resolution 32] [--frames 10]

Stylizes the example plume in one window, with the strengths that a request's time samples would
give, and prints the temporal errors, which are measured at full strength; about five minutes on
one core. See benchmarks/results/fades.md.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace

from benchmarks.coherence_runs import Shot, make_shot, simulate_plume
from usdsmoke.base.volume import FrameControls
from usdsmoke.core.sequence.stylize import stylize_window

__all__ = ["STRENGTHS", "errors_of", "main"]

STYLE = "petals"
STRENGTHS: Mapping[str, Mapping[int, float]] = {  # of frames, counted from 1; of all others 1
    "1 throughout": {},
    "0 to 1 over 8 frames": {n: (n - 1) / 7 for n in range(1, 8)},
    "1, but 0 at frame 5": {5: 0.0},
    "1, but 0 at frames 4 to 6": {4: 0.0, 5: 0.0, 6: 0.0},
}


def errors_of(shot: Shot, strengths: Mapping[int, float]) -> dict[float, dict[str, float]]:
    """Temporal errors by the timeCode that a step ends at; frames that start anew have none."""
    frames = [
        replace(frame, controls=FrameControls(strength=strengths.get(number)))
        for number, frame in enumerate(shot.frames, 1)
    ]
    results = stylize_window(frames, [shot.style], shot.scene, shot.config)
    found = {result.time_code: result.report.temporal for result in results}
    return {code: vars(errors) for code, errors in found.items() if errors is not None}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--resolution", type=int, default=32, help="voxels across the plume's box")
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings")
    options = parser.parse_args(arguments)
    frames = simulate_plume(options.resolution, options.frames)
    shot = make_shot(frames, STYLE, options.settings, style_size=256)
    print("| strength | steps | displacement, mean | largest | colour, mean | largest |")
    print("|" + " --- |" * 6)
    for name, strengths in STRENGTHS.items():
        errors = errors_of(shot, strengths).values()
        cells = [name, str(len(errors))]
        for kind in ("displacement", "colour"):
            values = [error[kind] for error in errors]
            cells += [f"{sum(values) / len(values):.3f}", f"{max(values):.3f}"]
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()

"""One frame with the source's voxels and with finer ones, from all sides and through a camera.

    python -m benchmarks.clear_strokes STAGE STYLE [--frame 7] [--camera /cameras/front]
        [--out out/bench/clear] [--picture FILE]

STAGE is the demo's plume by default settings of ``examples/plume/simulate.py``. Prints the CPU time
of each, relative to the first, and draws the four looks side by side, from the front and from
behind.
"""

import argparse

import usdsmoke
from usdsmoke.work_precision.engine import cpu_seconds

__all__ = ["main"]

SIDE = (300, 384)  # pixels of a picture


def main() -> None:
    """Runs the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("stage", help="a stage with a Camera")
    parser.add_argument("style", help="style image")
    parser.add_argument("--frame", default="7", help="timeCode")
    parser.add_argument("--camera", default="/cameras/front", help="its path")
    parser.add_argument("--out", default="out/bench/clear", help="folder to write into")
    parser.add_argument("--picture", help="also draw the four looks to this PNG")
    arguments = parser.parse_args()
    own, camera = {"grids.refine": 1}, {"views.camera": arguments.camera}
    looks = {"own": own, "default": {}, "camera_own": {**own, **camera}, "camera": camera}
    roots, seconds = [], {}
    for name, settings in looks.items():
        before = cpu_seconds()
        result = usdsmoke.stylize(
            arguments.stage,
            style=arguments.style,
            output=arguments.out,
            settings={**settings, "layer.look": name, "stage.frames": arguments.frame},
            force=True,
        )
        roots.append(result.root_stage)
        seconds[name] = cpu_seconds() - before
        print(f"{name}: {seconds[name] / seconds['own']:.1f} times {seconds['own']:.0f} s")
    if arguments.picture:
        usdsmoke.preview(roots[0], arguments.picture, beside=roots[1:], turntable=2, size=SIDE)


if __name__ == "__main__":
    main()

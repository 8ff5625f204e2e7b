"""Draw the smoke of a stage: a picture, a contact sheet, and OpenEXR files for compositing.

    python examples/preview/draw_stage.py

Works on any stage with OpenVDB smoke. For a result, ``compare=True`` also draws the original.
"""

import argparse
from pathlib import Path

import usdsmoke

DEMO = Path("out/demo")


def main() -> None:
    """Read the command line and draw."""
    parser = argparse.ArgumentParser(description="Draw the smoke of a stage.")
    parser.add_argument("--stage", type=Path, default=DEMO / "source/plume.usda")
    parser.add_argument("--output", type=Path, default=Path("out/preview"))
    parser.add_argument("--width", type=int, default=128)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    for name, choice in (
        ("frame.png", {"frames": "1", "background": "none"}),  # one picture, transparent
        ("sheet.png", {}),  # first, middle and last frame
        ("layers.exr", {"frames": "1"}),  # rgba, emission, alpha, density; scene-linear
    ):
        usdsmoke.preview(options.stage, options.output / name, width=options.width, **choice)
        print(options.output / name)


if __name__ == "__main__":
    main()

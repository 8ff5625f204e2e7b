"""Inspect a stage, stylize it and check the result, all from Python.

    python examples/python_api/stylize_and_check.py

The result goes to out/python_api.
"""

import argparse
from pathlib import Path

import usdsmoke

DEMO = Path("out/demo")
SETTINGS = {
    "stage": {"frames": "1-2"},
    "views": {"image_size": 48},
    "optimize": {"iterations": 10, "seed": 3},
}


def main() -> None:
    """Read the command line, then inspect, stylize, validate and verify."""
    parser = argparse.ArgumentParser(description="Stylize a stage from Python.")
    parser.add_argument("--stage", type=Path, default=DEMO / "source/plume.usda")
    parser.add_argument("--style", type=Path, default=DEMO / "styles/strokes.png")
    parser.add_argument("--output", type=Path, default=Path("out/python_api"))
    options = parser.parse_args()

    for volume in usdsmoke.inspect(options.stage)["volumes"]:
        print(f"{volume['prim_path']}: {len(volume['frames'])} frames")

    try:
        result = usdsmoke.stylize(
            options.stage, style=options.style, output=options.output, settings=SETTINGS
        )
    except usdsmoke.UsdSmokeError as error:  # the base of all errors; the text says what to do
        raise SystemExit(f"error: {error}") from None

    for finding in usdsmoke.validate(result.root_stage):
        print(f"{finding.rule} at {finding.prim_path}: {finding.message}")
    for change in usdsmoke.verify(result.look_layer):
        print(f"{change.kind}: {change.file}")
    print(f"{len(result.frames)} frames, open {result.root_stage}")


if __name__ == "__main__":
    main()

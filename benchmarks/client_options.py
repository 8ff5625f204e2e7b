"""What the options for particular renderers look like, in the one that can be run anywhere: Cycles.

    python -m benchmarks.client_options ABSOLUTE OPTIONS --python CLIENTS_PYTHON

ABSOLUTE and OPTIONS are results of one run of ``usdsmoke stylize`` without and with
``--alias-cd --split-rgb --emission-mode perDensity``, of all frames, with a camera; CLIENTS_PYTHON
is a Python that has Blender as a module. Writes docs/pictures/client_options.png and prints how
much light every reading of the emission gives, against the absolute one, and the rms difference.
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from pxr import Usd, UsdVol

from benchmarks.display import decode_display
from usdsmoke.usd.schema import EXTINCTION_PER_DENSITY

__all__ = ["main"]

READINGS = {  # what is drawn: of which result, and how
    "emission, absolute": ("absolute", ()),
    "emission x density": ("options", ("--light", "perDensity")),
    "three float grids": ("options", ("--light", "perDensity", "--channels")),
    "Cd under a sun": ("options", ("--light", "Cd")),
}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    options = _parse(arguments)
    try:
        gamma_w = _extinction(options.absolute)
        with tempfile.TemporaryDirectory() as folder:
            pictures = [
                _draw(options, getattr(options, stage), words, gamma_w, Path(folder) / "a.png")
                for stage, words in READINGS.values()
            ]
    except (OSError, RuntimeError, ValueError) as error:
        print(f"benchmarks.client_options: {error}", file=sys.stderr)
        return 1
    first = decode_display(pictures[0])
    for name, picture in list(zip(READINGS, pictures, strict=True))[1:3]:
        light = decode_display(picture).sum() / first.sum()
        rms = float(np.sqrt(((picture - pictures[0]) ** 2).mean()))
        print(f"{name}: light x {light:.3f}, rms difference {rms:.4f} (display-encoded)")
    _sheet(pictures).save(options.out, optimize=True)
    print(f"{options.out}: {options.out.stat().st_size / 1000:.0f} kB")
    return 0


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("absolute", type=Path)
    parser.add_argument("options", type=Path)
    parser.add_argument("--python", type=Path, required=True, help="with Blender as a module")
    parser.add_argument("--frame", type=int, default=1)
    parser.add_argument("--size", type=int, default=240, help="pixels of a picture's side")
    parser.add_argument("--samples", type=int, default=256)
    parser.add_argument("--out", type=Path, default=Path("docs/pictures/client_options.png"))
    return parser.parse_args(arguments)


def _extinction(stage_file: Path) -> float:
    stage = Usd.Stage.Open(str(stage_file))
    for prim in stage.Traverse():
        if prim.IsA(UsdVol.Volume) and prim.GetAttribute(EXTINCTION_PER_DENSITY):
            return float(prim.GetAttribute(EXTINCTION_PER_DENSITY).Get())
    raise ValueError(f"{stage_file} has no Volume with {EXTINCTION_PER_DENSITY}. Give a result.")


def _draw(
    options: argparse.Namespace, stage: Path, words: Sequence[str], gamma_w: float, out: Path
) -> np.ndarray:
    """A picture of Cycles, [H W 3] display-encoded."""
    script = Path(__file__).with_name("cycles_emission.py")
    numbers = {"extinction": gamma_w, "frame": options.frame, "size": options.size}
    numbers["samples"] = options.samples
    settings = [part for key, value in numbers.items() for part in (f"--{key}", str(value))]
    command = [options.python, script, stage, out, *settings, *words]
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{script} ended with {done.returncode}:\n{done.stderr[-2000:]}")
    with Image.open(out) as image:
        return np.asarray(image.convert("RGB"), np.float32) / 255.0


def _sheet(pictures: Sequence[np.ndarray]) -> Image.Image:
    pixels = np.concatenate(pictures, axis=1)
    image = Image.fromarray(np.rint(pixels * 255.0).astype(np.uint8))
    pen, width = ImageDraw.Draw(image), image.width // len(pictures)
    for number, name in enumerate(READINGS):
        pen.text((number * width + 6, 4), name, fill="white")
    return image


if __name__ == "__main__":
    sys.exit(main())

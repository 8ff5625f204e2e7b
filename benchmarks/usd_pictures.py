"""A result on its stage, as Hydra Storm, Blender's Cycles and our own preview draw it.

    python -m benchmarks.usd_pictures --clients FOLDER --python CLIENTS_PYTHON

Makes a small plume of six frames with a camera (examples/plume), stylizes frames 2 to 5 and puts
the result together in both modes that make a stage: ``reference`` (an asset with a variant for the
look) and ``sublayer``. Of each, four pictures are drawn through the stage's camera: the look, the
look switched off, the frame before and the frame after it. Writes docs/pictures/usd_MODE.png and
prints how far the programs are from ``usdsmoke preview``.

FOLDER holds ``storm_render.py`` and ``blender_render.py``, CLIENTS_PYTHON is a Python that has
Blender as a module. Their pictures are compared as light: Storm's with its lamp taken off (the
same picture once more without emission) and its units scaled so that its extinction, the density,
is gamma_w times the density; Cycles' with absorption and emission alone.
"""

import argparse
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image, ImageDraw

import usdsmoke
from benchmarks.client_runs import GREY, ClientRuns, over_black
from benchmarks.client_stages import author_dark_stage, author_scaled_stage
from benchmarks.display import composite, decode_display, encode_display
from benchmarks.usd_picture_stages import (
    Case,
    author_shot_stage,
    author_still_stage,
    files_shown,
    make_cases,
)
from usdsmoke.base.errors import UsdSmokeError

__all__ = [
    "Difference",
    "compose_sheet",
    "draw_preview",
    "find_difference",
    "main",
    "make_sequence",
]

CAMERA, SHOT, FIRST, LAST = "/cameras/front", "shot", 2, 5
MODES = ("reference", "sublayer")
INSIDE = 0.5  # opacity above which a pixel counts as inside the smoke
ROWS = (
    "usdsmoke preview",
    "Storm, as it is (a lamp on the camera)",
    "Cycles, lit by a sun",
    "Storm, emission alone",
    "Cycles, absorption + emission",
)
_BAR = 14  # pixels of a label
_ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Difference:
    """A program's light beside our preview's, over black."""

    gain: float  # factor that fits its linear light to ours best
    rms: float  # of display-encoded values, whole picture
    largest: float
    inside: float  # rms where opacity is above INSIDE

    def as_row(self, *names: str) -> str:
        """As a line of a Markdown table."""
        numbers = (f"{self.gain:.2f}", *(f"{v:.3f}" for v in (self.rms, self.largest, self.inside)))
        return "| " + " | ".join((*names, *numbers)) + " |"


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    options = _parse(arguments)
    options.out = options.out.resolve()  # stages lead from one folder to another
    try:
        result = make_sequence(options.out)
        for mode in options.mode or MODES:
            _draw_mode(options, result, mode)
    except (OSError, RuntimeError, ValueError, UsdSmokeError) as error:
        print(f"benchmarks.usd_pictures: {error}", file=sys.stderr)
        return 1
    return 0


def make_sequence(out_folder: Path) -> Path:
    """The stylized plume, made by the commands; those that are done stay.

    Returns:
        The result's folder.

    Raises:
        RuntimeError: a command failed; with its own words.
    """
    source, styles, result = (out_folder / name for name in ("source", "styles", "look"))
    stage_file, examples = out_folder / f"{SHOT}.usda", _ROOT / "examples"
    if not stage_file.exists():
        size = ("--frames", str(LAST + 1), "--resolution", "40")
        _python(str(examples / "plume/simulate.py"), str(source), *size)
        _python(str(examples / "styles/paint.py"), str(styles))
        author_shot_stage(source / "plume.usda", stage_file, CAMERA)
    if (result / "look.usda").exists():  # an unfinished run goes on, a finished one stays
        return result
    words = ["--style", str(styles / "strokes.png")]
    words += ["--config", str(examples / "plume/config.yaml"), "--mode", MODES[0]]
    words += ["--frames", f"{FIRST}-{LAST}", "-o", str(result)]
    words += ["--set", "layer.material=none"]  # the programs' own materials are compared
    words += ["--set", "grids.refine=1"]
    _python("-m", "usdsmoke", "stylize", str(stage_file), *words)
    return result


def draw_preview(case: Case, exr_file: Path, size: int) -> tuple[np.ndarray, np.ndarray, float]:
    """What ``usdsmoke preview`` draws through the camera.

    Returns:
        Premultiplied scene-linear picture [H W 3], opacity [H W], extinction per density (1/stage
        unit) of the case's one Volume.
    """
    shown = usdsmoke.preview(
        case.stage_file, exr_file, camera=CAMERA, frames=str(case.frame), size=(size, size)
    )
    with OpenEXR.File(str(exr_file)) as image:
        rgba = np.array(image.parts[0].channels["RGBA"].pixels)
    (gamma_w,) = shown.extinctions.values()
    return rgba[..., :3], rgba[..., 3], gamma_w


def find_difference(found: np.ndarray, wanted: np.ndarray, alpha: np.ndarray) -> Difference:
    """How far linear ``found`` is from linear ``wanted`` [H W 3]; ``alpha`` [H W] is ours."""
    apart = encode_display(found) - encode_display(wanted)
    inside = apart[alpha > INSIDE]
    return Difference(
        gain=float((found * wanted).sum() / (wanted**2).sum()),
        rms=float(np.sqrt((apart**2).mean())),
        largest=float(np.abs(apart).max()),
        inside=float(np.sqrt((inside**2).mean())) if inside.size else 0.0,
    )


def compose_sheet(columns: Mapping[str, Sequence[np.ndarray]]) -> Image.Image:
    """Labelled pictures: cases side by side by name, programs below each other as in ROWS.

    Args:
        columns: for each case [H W 3] in [0, 1], display-encoded, one for each row.
    """
    size, n_rows = next(iter(columns.values()))[0].shape[0], len(ROWS)
    image = Image.new("RGB", (size * len(columns), _BAR + n_rows * (size + _BAR)), "black")
    pen = ImageDraw.Draw(image)
    for x, (title, pictures) in enumerate(columns.items()):
        pen.text((x * size + 4, 1), title, fill="white")
        for y, picture in enumerate(pictures):
            pixels = np.rint(np.clip(picture, 0.0, 1.0) * 255.0).astype(np.uint8)
            place = (x * size, 2 * _BAR + y * (size + _BAR))
            image.paste(Image.fromarray(pixels), place)
    for y, name in enumerate(ROWS):
        pen.text((4, _BAR + 1 + y * (size + _BAR)), name, fill=(255, 220, 120))
    return image


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--clients", type=Path, required=True, help="folder of the two scripts")
    parser.add_argument("--python", type=Path, required=True, help="with Blender as a module")
    parser.add_argument("--out", type=Path, default=Path("out/usd"), help="the sequence")
    parser.add_argument("--pictures", type=Path, default=Path("docs/pictures"))
    parser.add_argument("--mode", choices=MODES, action="append", help="default: both")
    parser.add_argument("--size", type=int, default=160, help="pixels of a picture's side")
    parser.add_argument("--samples", type=int, default=64, help="of Cycles")
    return parser.parse_args(arguments)


def _draw_mode(options: argparse.Namespace, result: Path, mode: str) -> None:
    folder = options.out / f"drawn_{mode}"
    folder.mkdir(exist_ok=True)
    runs = ClientRuns(
        options.clients, options.python, folder, CAMERA, options.size, options.samples
    )
    columns = {}
    for number, case in enumerate(make_cases(result, SHOT, mode, FIRST, LAST)):
        columns[f"{case.title} ({case.frame})"] = _draw_case(runs, case, mode, str(number))
    sheet = options.pictures / f"usd_{mode}.png"
    compose_sheet(columns).save(sheet, optimize=True)
    print(f"{sheet}: {sheet.stat().st_size / 1000:.0f} kB")


def _draw_case(runs: ClientRuns, case: Case, mode: str, name: str) -> list[np.ndarray]:
    """Display-encoded pictures in the order of ROWS; prints what they differ by."""
    light, alpha, gamma_w = draw_preview(case, runs.folder / f"{name}.exr", runs.size)
    still = author_still_stage(case, runs.folder / f"{name}_still.usda", gamma_w)
    storm = _storm_light(runs, still, case.frame, alpha, gamma_w)
    bare, read = runs.bare_cycles(still, f"{name}_bare", case.frame, gamma_w)
    alone = runs.bare_cycles(case.stage_file, f"{name}_sequence", case.frame, gamma_w)[1]
    named = " and ".join(files_shown(case))
    print(f"{mode}, {case.title}: gamma_w {gamma_w:.4g}; USD names {named}; of the sequence")
    print(f"Blender shows {Path(alone).name or 'nothing'}, of the still {Path(read).name}")
    for program, picture in (("Storm", storm), ("Cycles", decode_display(bare))):
        print(find_difference(picture, light, alpha).as_row(mode, case.title, program))
    return [
        composite(light, alpha, np.full(3, GREY)),
        runs.storm(case.stage_file, f"{name}_storm", case.frame),
        runs.lit_cycles(still, f"{name}_sun", case.frame, gamma_w),
        encode_display(storm),
        bare,
    ]


def _storm_light(
    runs: ClientRuns, still: Path, frame: int, alpha: np.ndarray, gamma_w: float
) -> np.ndarray:
    """The emission as Storm draws it, linear over black: its lamp off, its units scaled."""
    folder = still.parent
    dark = author_dark_stage(still, folder / f"{still.stem}_dark.usda")
    light = []
    for file in (still, dark):
        scaled = folder / f"{file.stem}_scaled.usda"
        author_scaled_stage(file, scaled, CAMERA, gamma_w, frame)
        light.append(over_black(runs.storm(scaled, scaled.stem, frame), alpha))
    return np.maximum(light[0] - light[1], 0.0) / gamma_w


def _python(*words: str) -> None:
    print("$ python", *words)
    done = subprocess.run([sys.executable, *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(
            f"{' '.join(words)} ended with {done.returncode}:\n{done.stderr[-2000:]}"
        )


if __name__ == "__main__":
    sys.exit(main())

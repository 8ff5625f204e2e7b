"""One stylized frame in Hydra Storm, in Blender's Cycles and in our own preview, side by side.

    python -m benchmarks.client_pictures STAGE --clients FOLDER --python CLIENTS_PYTHON

STAGE is a result of ``usdsmoke stylize`` with a camera whose picture is square, FOLDER holds
``storm_render.py`` and ``blender_render.py``, CLIENTS_PYTHON is a Python that has Blender as a
module. Writes docs/pictures/clients.png and prints, for every client, how bright its emission is
against our preview (1 is right) and the rms difference inside the smoke.

Both scripts light the smoke besides: Storm with a lamp on the camera, Cycles with a sun. That light
is measured by drawing each picture once more without the emission, and taken off in the lower row;
there Storm draws the stage scaled by gamma_w, for it takes the density itself as extinction.
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from pxr import Gf, Usd, UsdGeom

from benchmarks.client_runs import GREY, ClientRuns, over_black
from benchmarks.client_stages import author_dark_stage, author_scaled_stage
from benchmarks.display import composite, decode_display, encode_display
from benchmarks.held_out import Result, draw_march, read_result
from usdsmoke.base.errors import UsdSmokeError
from usdsmoke.core.views.cameras import View

__all__ = ["main"]

INSIDE = 0.5  # opacity above which pixels are compared


@dataclass(frozen=True)
class Drawn:
    """A client's picture, and the same with its own light taken off; display-encoded."""

    name: str
    picture: np.ndarray  # [H W 3]
    emission: np.ndarray  # [H W 3], linear, over black


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    options = _parse(arguments)
    try:
        stage = Usd.Stage.Open(str(options.stage))
        result = read_result(stage, options.volume, options.frame)
        view = _camera_view(stage, options.camera, options.frame, options.size)
        linear, alpha = draw_march(result, view)
        preview = composite(linear, alpha, np.full(3, GREY))
        with tempfile.TemporaryDirectory() as folder:
            drawn = _draw_clients(options, result, view, Path(folder))
    except (OSError, RuntimeError, ValueError, UsdSmokeError) as error:
        print(f"benchmarks.client_pictures: {error}", file=sys.stderr)
        return 1
    print(f"gamma_w {result.gamma_w:.4g} per stage unit")
    for client in drawn:
        gain, rms = compare(client.emission, linear, alpha > INSIDE)
        print(f"{client.name}: emission x {gain:.3f}, rms difference {rms:.3f} (display-encoded)")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    shown = [Drawn("usdsmoke", preview, linear), *drawn[1:]]  # Storm's light below: scaled
    _sheet(shown).save(options.out, optimize=True)
    print(f"{options.out}: {options.out.stat().st_size / 1000:.0f} kB")
    return 0


def compare(found: np.ndarray, wanted: np.ndarray, inside: np.ndarray) -> tuple[float, float]:
    """Best-fit brightness of linear ``found`` against ``wanted``, and rms difference encoded."""
    gain = (found[inside] * wanted[inside]).sum() / (wanted[inside] ** 2).sum()
    difference = encode_display(found)[inside] - encode_display(wanted)[inside]
    return float(gain), float(np.sqrt((difference**2).mean()))


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("stage", type=Path)
    parser.add_argument("--clients", type=Path, required=True, help="folder of the two scripts")
    parser.add_argument(
        "--python", type=Path, required=True, help="Python with Blender as a module"
    )
    parser.add_argument("--camera", default="/cameras/front", help="prim path")
    parser.add_argument("--volume", default="", help="prim path; default: the first Volume")
    parser.add_argument("--frame", type=int, default=1)
    parser.add_argument("--size", type=int, default=256, help="pixels of a picture's side")
    parser.add_argument("--samples", type=int, default=64, help="of Cycles")
    parser.add_argument("--out", type=Path, default=Path("docs/pictures/clients.png"))
    return parser.parse_args(arguments)


def _camera_view(stage: Usd.Stage, camera_path: str, frame: int, size: int) -> View:
    """The stage's camera as one of our views; both clients draw a square picture."""
    prim = UsdGeom.Camera.Get(stage, camera_path)
    if not prim:
        raise ValueError(f"no camera {camera_path} on the stage; wanted one; name it with --camera")
    camera = prim.GetCamera(Usd.TimeCode(frame))
    if abs(camera.aspectRatio - 1.0) > 1e-3:
        raise ValueError(
            f"camera {camera_path} has the aspect ratio {camera.aspectRatio:.3f}; wanted 1, for "
            "both clients draw square pictures; give it equal apertures"
        )
    axes = np.array(camera.transform)[:3, :3]
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    centre = np.array(camera.transform)[3, :3]
    parallel = camera.projection == Gf.Camera.Orthographic
    # An orthographic aperture is in tenths of a stage unit [UsdGeomCamera].
    pixel_size = camera.horizontalAperture / 10.0 / size
    focal = None if parallel else camera.focalLength / camera.horizontalAperture * size
    return View(axes[0], axes[1], -axes[2], centre, size, size, pixel_size, focal)


def _draw_clients(
    options: argparse.Namespace, result: Result, view: View, folder: Path
) -> list[Drawn]:
    gamma_w, frame, stage_file = result.gamma_w, options.frame, options.stage
    clients = ClientRuns(
        options.clients, options.python, folder, options.camera, options.size, options.samples
    )
    as_is = replace(result, gamma_w=1.0)  # Storm's extinction, whatever the look says
    alpha_as_is, alpha = draw_march(as_is, view)[1], draw_march(result, view)[1]
    dark = author_dark_stage(stage_file, folder / "dark.usda")
    storm, storm_dark = (clients.storm(file, "storm", frame) for file in (stage_file, dark))
    scaled = [
        author_scaled_stage(
            file, folder / f"{file.stem}_scaled.usda", options.camera, gamma_w, frame
        )
        for file in (stage_file, dark)
    ]
    lit, unlit = (over_black(clients.storm(file, "scaled", frame), alpha) for file in scaled)
    cycles = clients.lit_cycles(stage_file, "cycles", frame, gamma_w)
    cycles_dark = clients.lit_cycles(stage_file, "dark", frame, gamma_w, "--colour", "")
    bare, _ = clients.bare_cycles(stage_file, "bare", frame, gamma_w)
    storm_light = over_black(storm, alpha_as_is) - over_black(storm_dark, alpha_as_is)
    return [
        Drawn("Storm", storm, storm_light),
        Drawn("Storm; below, scaled", storm, (lit - unlit) / gamma_w),
        Drawn("Cycles, sun", cycles, decode_display(cycles) - decode_display(cycles_dark)),
        Drawn("Cycles, emission only", bare, decode_display(bare)),
    ]


def _sheet(drawn: Sequence[Drawn]) -> Image.Image:
    """The clients' pictures above, their emission alone below."""
    rows = [[client.picture for client in drawn], [encode_display(c.emission) for c in drawn]]
    pixels = np.concatenate([np.concatenate(row, axis=1) for row in rows], axis=0)
    image = Image.fromarray(np.rint(np.clip(pixels, 0.0, 1.0) * 255.0).astype(np.uint8))
    pen = ImageDraw.Draw(image)
    width = image.width // len(drawn)
    for number, client in enumerate(drawn):
        pen.text((number * width + 6, 4), client.name, fill="white")
        pen.text((number * width + 6, image.height // 2 + 4), "emission alone", fill="white")
    return image


if __name__ == "__main__":
    sys.exit(main())

"""One stylized frame in Hydra Storm, in Blender's Cycles and in our own preview, side by side.

    python -m benchmarks.client_pictures STAGE --clients FOLDER --python CLIENTS_PYTHON

STAGE is a result of ``usdsmoke stylize`` with a camera whose picture is square, FOLDER holds
``storm_render.py`` and ``blender_render.py``, CLIENTS_PYTHON is a Python that has Blender as a
module. Writes docs/pictures/clients.png and prints, for every client, how bright its emission is
against our preview (1 is right) and the rms difference inside the smoke.

Both scripts light the smoke besides: Storm with a lamp on the camera, Cycles with a sun. That light
is measured by drawing each picture once more without the emission, and taken off in the lower row.
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol

from benchmarks.display import decode_display, encode_display
from benchmarks.held_out import draw_march, read_result
from usdsmoke.core.views import View
from usdsmoke.errors import UsdSmokeError

__all__ = ["main"]

GREY = 0.18  # display-encoded background that the Storm script puts its picture on
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
        preview = encode_display(linear + (1.0 - alpha[..., None]) * decode_display(np.array(GREY)))
        with tempfile.TemporaryDirectory() as folder:
            drawn = [Drawn("usdsmoke", preview, linear)]
            drawn += _draw_clients(stage, options, result.gamma_w, alpha, Path(folder))
    except (OSError, RuntimeError, ValueError, UsdSmokeError) as error:
        print(f"benchmarks.client_pictures: {error}", file=sys.stderr)
        return 1
    print(f"gamma_w {result.gamma_w:.4g} per stage unit")
    for client in drawn[1:]:
        gain, rms = compare(client.emission, linear, alpha > INSIDE)
        print(f"{client.name}: emission x {gain:.3f}, rms difference {rms:.3f} (display-encoded)")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    _sheet(drawn).save(options.out, optimize=True)
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
    stage: Usd.Stage, options: argparse.Namespace, gamma_w: float, alpha: np.ndarray, folder: Path
) -> list[Drawn]:
    dark = _without_emission(stage, folder / "dark.usda")
    common = ["--camera", options.camera, "--size", str(options.size)]
    frames = ["--frames", str(options.frame)]
    gain = ["--gain", str(gamma_w), "--samples", str(options.samples)]

    def run(script: Path, file_path: Path, name: str, *words: str) -> np.ndarray:
        out = folder / f"{name}.png"
        _run([str(options.python), str(script), str(file_path), str(out), *common, *words])
        with Image.open(out) as image:
            return np.asarray(image.convert("RGB"), np.float32) / 255.0

    storm, cycles = (options.clients / f"{name}_render.py" for name in ("storm", "blender"))
    ours = Path(__file__).with_name("cycles_emission.py")
    storm_lit = run(storm, options.stage, "storm", *frames)
    storm_dark = run(storm, dark, "storm_dark", *frames)
    cycles_lit = run(cycles, options.stage, "cycles", *frames, *gain)
    cycles_dark = run(cycles, options.stage, "cycles_dark", *frames, *gain, "--colour", "")
    words = ["--frame", str(options.frame), "--samples", str(options.samples)]
    bare = run(ours, options.stage, "bare", "--extinction", str(gamma_w), *words)
    behind = (1.0 - alpha[..., None]) * GREY  # added to Storm's encoded picture by the script
    storm_emission = _light(storm_lit - behind) - _light(storm_dark - behind)
    return [
        Drawn("Storm", storm_lit, storm_emission),
        Drawn("Cycles, sun", cycles_lit, decode_display(cycles_lit) - decode_display(cycles_dark)),
        Drawn("Cycles, emission only", bare, decode_display(bare)),
    ]


def _light(encoded: np.ndarray) -> np.ndarray:
    return decode_display(np.clip(encoded, 0.0, 1.0))


def _without_emission(stage: Usd.Stage, file_path: Path) -> Path:
    """A layer over the stage in which no Volume has an emission field."""
    root = stage.GetRootLayer()
    layer = Sdf.Layer.CreateNew(str(file_path))
    layer.subLayerPaths.append(root.realPath)
    dark = Usd.Stage.Open(layer)
    for key in ("upAxis", "metersPerUnit", "timeCodesPerSecond", "framesPerSecond", "defaultPrim"):
        if stage.HasAuthoredMetadata(key):
            dark.SetMetadata(key, stage.GetMetadata(key))
    for prim in dark.Traverse():
        if prim.IsA(UsdVol.Volume):
            UsdVol.Volume(prim).BlockFieldRelationship("emission")
    layer.Save()
    return file_path


def _run(command: Sequence[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    print(*(line for line in done.stdout.splitlines() if "chroma" in line), sep="\n")
    if done.returncode:
        raise RuntimeError(f"{command[1]} ended with {done.returncode}:\n{done.stderr[-2000:]}")


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

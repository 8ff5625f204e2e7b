"""Looks in Hydra Storm and in Blender's Cycles, opened as they are, against our own preview.

    python -m benchmarks.client_pictures STAGE STYLE --clients FOLDER --python CLIENTS_PYTHON

STAGE is a source with a camera whose picture is square, such as examples/plume makes. FOLDER holds
``storm_render.py``, CLIENTS_PYTHON is a Python that has Blender 5 as a module. One frame is
stylized for each row of the table: with several extinctions, emission modes, and in centimetres
under a scale. Storm draws the material that the look brings; Blender draws the one that
examples/blender/import_look.py builds from the look's attributes. No shader is built by hand.

Prints a row for each case, and writes docs/pictures/looks.png. A difference is the root mean
square over the whole picture, display-encoded, over black.
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from pxr import Gf, Usd, UsdGeom, UsdVol

from benchmarks.client_runs import ClientRuns, over_black
from benchmarks.client_stages import author_in_centimetres
from benchmarks.display import encode_display
from benchmarks.held_out import draw_march, read_result
from usdsmoke.base.errors import UsdSmokeError
from usdsmoke.core.views.cameras import View
from usdsmoke.pipeline import stylize
from usdsmoke.vdb.header import read_header

__all__ = ["CASES", "Case", "difference", "main"]


@dataclass(frozen=True)
class Case:
    """A row of the table."""

    name: str
    gamma_w: float | None = None  # extinction per density, 1/stage unit; None: chosen by the run
    settings: tuple[str, ...] = ()
    in_centimetres: bool = False


CASES = (
    Case("metres"),
    Case("metres, gamma_w 0.01", 0.01),
    Case("metres, gamma_w 0.24", 0.24),
    Case("metres, gamma_w 6", 6.0),
    Case("centimetres under scale 100", in_centimetres=True),
    Case("metres, emission per density", settings=("layer.emission_mode=perDensity",)),
)


@dataclass(frozen=True)
class Row:
    """A case as it was drawn: pictures are [H W 3], display-encoded, over black."""

    case: Case
    gamma_w: float
    preview: np.ndarray
    storm: np.ndarray
    cycles: np.ndarray

    @property
    def text(self) -> str:
        """A line of a Markdown table."""
        storm, cycles = (difference(picture, self.preview) for picture in (self.storm, self.cycles))
        return f"| {self.case.name} | {self.gamma_w:.3g} | {storm:.3f} | {cycles:.3f} |"


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    options = _parse(arguments)
    rows = []
    print("| stage | gamma_w | Storm | Cycles |\n| --- | --- | --- | --- |")
    try:
        with tempfile.TemporaryDirectory() as folder:
            for number, case in enumerate(CASES):
                rows.append(_draw(options, case, Path(folder) / str(number)))
                print(rows[-1].text, flush=True)
    except (OSError, RuntimeError, ValueError, UsdSmokeError) as error:
        print(f"benchmarks.client_pictures: {error}", file=sys.stderr)
        return 1
    options.out.parent.mkdir(parents=True, exist_ok=True)
    _sheet(rows).save(options.out, optimize=True)
    print(f"{options.out}: {options.out.stat().st_size / 1000:.0f} kB")
    return 0


def difference(found: np.ndarray, wanted: np.ndarray) -> float:
    """Root mean square over a whole picture, of values in [0, 1]."""
    return float(np.sqrt(((found - wanted) ** 2).mean()))


def _draw(options: argparse.Namespace, case: Case, folder: Path) -> Row:
    """Stylize one frame, and draw it three times."""
    folder.mkdir()
    source = options.stage
    if case.in_centimetres:
        source = author_in_centimetres(source, folder / "cm.usda")
    settings = [
        f"stage.frames={options.frame}", f"optimize.iterations={options.iterations}",
        "optimize.error_budget=false", "layer.contact_sheet=0", "grids.refine=1", *case.settings,
    ]  # fmt: skip
    if case.gamma_w is not None:
        settings.append(f"optics.gamma={case.gamma_w * _voxel_edge(source, options.frame)}")
    done = stylize(source, options.style, folder / "look", settings)
    assert done.root_stage is not None
    stage = Usd.Stage.Open(str(done.root_stage))
    result = read_result(stage, "", options.frame)
    view = _camera_view(stage, options.camera, options.frame, options.size)
    linear, alpha = draw_march(result, view)
    clients = ClientRuns(
        options.clients, options.python, folder, options.camera, options.size, options.samples
    )
    storm = over_black(clients.storm(done.root_stage, "storm", options.frame), alpha)
    cycles = clients.look_in_cycles(done.root_stage, "cycles", options.frame)
    return Row(case, result.gamma_w, encode_display(linear), encode_display(storm), cycles)


def _voxel_edge(stage_file: Path, frame: int) -> float:
    """Of the first Volume's density, stage units."""
    stage = Usd.Stage.Open(str(stage_file))
    volume = next(prim for prim in stage.Traverse() if prim.IsA(UsdVol.Volume))
    field = UsdVol.OpenVDBAsset.Get(stage, UsdVol.Volume(volume).GetFieldPath("density"))
    header = read_header(field.GetFilePathAttr().Get(frame).resolvedPath)
    grid = next(grid for grid in header.grids if grid.name == field.GetFieldNameAttr().Get(frame))
    if grid.index_to_world is None:
        raise ValueError(f"the transform of {grid.name} is not linear; give a source that has one")
    place = np.array(UsdGeom.Xformable(field).ComputeLocalToWorldTransform(frame))
    matrix = (grid.index_to_world @ place)[:3, :3]
    return float(abs(np.linalg.det(matrix)) ** (1 / 3))


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("stage", type=Path)
    parser.add_argument("style", type=Path)
    parser.add_argument("--clients", type=Path, required=True, help="folder of storm_render.py")
    parser.add_argument(
        "--python", type=Path, required=True, help="Python with Blender as a module"
    )
    parser.add_argument("--camera", default="/cameras/front", help="prim path")
    parser.add_argument("--frame", type=int, default=1)
    parser.add_argument("--iterations", type=int, default=9, help="of each step")
    parser.add_argument("--size", type=int, default=200, help="pixels of a picture's side")
    parser.add_argument("--samples", type=int, default=32, help="of Cycles")
    parser.add_argument("--out", type=Path, default=Path("docs/pictures/looks.png"))
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


def _sheet(rows: Sequence[Row]) -> Image.Image:
    """A line for each case: our preview, Storm, Cycles."""
    lines = [np.concatenate([row.preview, row.storm, row.cycles], axis=1) for row in rows]
    pixels = np.concatenate(lines, axis=0)
    image = Image.fromarray(np.rint(np.clip(pixels, 0.0, 1.0) * 255.0).astype(np.uint8))
    pen, size = ImageDraw.Draw(image), rows[0].preview.shape[0]
    for number, row in enumerate(rows):
        for column, name in enumerate((row.case.name, "Storm", "Cycles")):
            pen.text((column * size + 4, number * size + 2), name, fill="white")
    return image


if __name__ == "__main__":
    sys.exit(main())

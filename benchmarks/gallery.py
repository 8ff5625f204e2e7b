"""Rebuilds the gallery: docs/gallery.md and its pictures, six painted styles on each scene.

    python -m benchmarks.gallery [--only dabs mosaic ...] [--data ../shared/data] [--reuse]

Every style is painted by code and stylizes a 3-D frame of the example plume, a 2-D slab and, where
its file is, the real plume, with default settings. The plumes are stylized a second time with views
around the front, as far as those of a shot's camera go. The page tells CPU seconds and scores on
views that the optimiser never had. Every cell is kept in the folder --work, and taken from there
with --reuse, so that a run that was stopped goes on.
"""

import argparse
import json
import sys
import textwrap
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from benchmarks.circumstances import circumstances
from benchmarks.control_pictures import simulate_once
from benchmarks.control_scenes import load_example, paint_styles
from benchmarks.control_studio import Look, Studio
from benchmarks.display import composite
from benchmarks.equal_judge import find_scenes
from benchmarks.held_out import Result, held_out_angles, score_result
from benchmarks.splats import render_view
from benchmarks.stages import PLUME_FILE
from benchmarks.style_scores import FRONT
from usdsmoke.base.errors import UsdSmokeError
from usdsmoke.base.volume import VolumeFrame
from usdsmoke.config.look_sections import StyleConfig
from usdsmoke.config.settings import Config
from usdsmoke.core.smoke.schedule import ALL_ROUND, AROUND_CAMERA
from usdsmoke.core.style.style_image import scale_style
from usdsmoke.planning.estimate import FrameSize
from usdsmoke.planning.visibility import affordable_parts

__all__ = ["Cell", "keep_cell", "kept_cell", "main", "make_cell", "write_page"]

HEIGHT = 400  # pixels of a picture in the gallery
WIDEST = 1280  # pixels of a row
GAP = 6
GREY = np.full(3, 0.12, np.float32)  # display-encoded, behind the smoke
RESOLUTION = 56  # voxels across the box of the example plume, as in `make demo`
REAL_WIDTH = 111  # voxels across the real plume: all of them
# degrees of azimuth by kind
TURNS = {"3-D": (0.0, 90.0), "3-D front": (0.0,), "2-D": (0.0,), "real": (0.0, 90.0),
         "real front": (0.0,)}  # fmt: skip
NAMES = {"3-D": "example plume", "3-D front": "example plume, narrow views in front",
         "2-D": "2-D slab",
         "real": "real plume", "real front": "real plume, narrow views in front"}  # fmt: skip
MEASURES = {"patch": "patches", "colour": "colours", "spectrum": "spectrum", "edges": "edges"}
N_VIEWS = 6

ABOUT = (
    "Styles painted by `examples/styles/paint.py`, with default settings: voxels of the example "
    "plume (56 across) are divided by two. First row: the style; the example plume from the front "
    "and from the side; the same plume from the front, stylized with narrow views from there. "
    "Second row: a 2-D slab and, where its file is, the real plume "
    "in the same three pictures. [Cameras](stylize.md#cameras) shows what narrow views gain and "
    "lose. [Closeness to the style](quality.md) explains the scores. They are from "
    "all sides; rows with narrow views are scored from the front. Means of six views differ from "
    "those of four views of another run there, by up to 0.1. Scores of a style that is enlarged "
    "for small smoke (`mosaic` on the slab) are less certain, as its crops differ more."
)


@dataclass(frozen=True)
class Cell:
    """A style on a scene."""

    kind: str  # key of NAMES
    pictures: list[np.ndarray]  # display-encoded
    cpu_s: float
    scores: dict[str, float]


def make_cell(studio: Studio, kind: str, style: str) -> Cell:
    """Stylize, draw and score."""
    begin = time.process_time()
    look = studio.look(kind, style)
    seconds = time.process_time() - begin
    pictures = [_picture(look, azimuth) for azimuth in TURNS[kind]]
    return Cell(kind, pictures, seconds, _scores(look, studio.styles[style], kind))


def keep_cell(cell: Cell, file_path: Path) -> None:
    """Write a cell into an npz file, from which ``kept_cell`` reads it."""
    file_path.parent.mkdir(parents=True, exist_ok=True)
    told = json.dumps({"kind": cell.kind, "cpu_s": cell.cpu_s, "scores": cell.scores})
    with open(file_path, "wb") as file:
        np.savez(file, *cell.pictures, told=np.array(told))


def kept_cell(file_path: Path) -> Cell:
    """The cell in a file."""
    with np.load(file_path) as kept:
        told = json.loads(str(kept["told"]))
        pictures = [kept[f"arr_{number}"] for number in range(len(kept.files) - 1)]
    return Cell(pictures=pictures, **told)


def _picture(look: Look, azimuth: float) -> np.ndarray:
    frame, scene = look.frame, look.scene
    drawn = render_view(
        frame.density, frame.emission, np.eye(4), scene.gamma_w, scene.up_axis, azimuth, 0.0, HEIGHT
    )
    return composite(drawn[..., :3], drawn[..., 3], GREY)


def _refine(frame: VolumeFrame) -> str:
    """``grids.refine`` that a plan chooses for a frame."""
    inside = np.argwhere(frame.density.values > 0)
    box = tuple(int(n) for n in np.ptp(inside, axis=0) + 1)
    config, sizes = Config(), [FrameSize(len(inside), box, computed=True)]
    parts = affordable_parts(config, sizes, sizes, config.views.image_size)
    return f"grids.refine={parts}"


def _is_front(kind: str) -> bool:
    return kind.endswith(" front")


def _scores(look: Look, style: np.ndarray, kind: str) -> dict[str, float]:
    frame, scene = look.frame, look.scene
    assert frame.emission is not None
    result = Result(frame.density, frame.emission, np.eye(4), scene.gamma_w, scene.up_axis)
    size = min(scene.image_size, max(frame.density.values.shape))
    scaled = scale_style(style, size, StyleConfig(size=scene.style_size), torch.zeros(())).numpy()
    if kind == "2-D":
        found, _ = score_result(result, scaled, [(0.0, 0.0)], size, "splats")
    else:
        ranges = AROUND_CAMERA if _is_front(kind) else ALL_ROUND
        found, _ = score_result(result, scaled, held_out_angles(N_VIEWS, *ranges), size)
    return {name: float(found[name]["mean"]) for name in (*MEASURES, "outliers")}


def write_page(
    page: Path, rows: Mapping[str, Sequence[Cell]], styles: Mapping[str, np.ndarray], command: str
) -> None:
    """Write the page, and a picture of every row into ``pictures/gallery`` beside it.

    Args:
        page: a Markdown file.
        rows: cells by style.
        styles: display-encoded [H W 3] by name.
        command: that makes the page.
    """
    folder = page.parent / "pictures" / "gallery"
    folder.mkdir(parents=True, exist_ok=True)
    lines = [
        "# Gallery",
        "",
        *textwrap.wrap(ABOUT, 100),
        "",
    ]
    for style, cells in rows.items():
        file_name = f"{style}.webp"
        _sheet([styles[style], *(p for cell in cells for p in cell.pictures)]).save(
            folder / file_name, quality=85, method=6
        )
        lines += [f"## {style}", "", f"![{style}](pictures/gallery/{file_name})", ""]
        lines += [f"| scene | CPU s | {' | '.join(MEASURES.values())} | outliers |"]
        lines += ["| --- |" + " --- |" * (len(MEASURES) + 2)]
        for cell in cells:
            found = [f"{cell.scores[name]:.2f}" for name in MEASURES]
            told = " | ".join([*found, f"{cell.scores['outliers']:.3f}"])
            lines.append(f"| {NAMES[cell.kind]} | {cell.cpu_s:.0f} | {told} |")
        lines.append("")
    page.write_text("\n".join([*lines, *circumstances(command.split())]) + "\n", encoding="utf-8")


def _sheet(pictures: Sequence[np.ndarray]) -> Image.Image:
    """Pictures HEIGHT high in rows; the first, the style, is scaled to it."""
    first = Image.fromarray(np.rint(pictures[0] * 255.0).astype(np.uint8))
    first.thumbnail((HEIGHT, HEIGHT))
    parts = [np.asarray(first), *(np.rint(p * 255.0).astype(np.uint8) for p in pictures[1:])]
    places, left, top = [], 0, 0
    for part in parts:
        if left > 0 and left + part.shape[1] > WIDEST:
            left, top = 0, top + HEIGHT + GAP
        places.append((left, top + (HEIGHT - part.shape[0]) // 2))
        left += part.shape[1] + GAP
    width = max(x + part.shape[1] for (x, _), part in zip(places, parts, strict=True))
    sheet = Image.new("RGB", (width, top + HEIGHT), (24, 24, 26))
    for place, part in zip(places, parts, strict=True):
        sheet.paste(Image.fromarray(part), place)
    return sheet


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    names = list(load_example("styles", "paint").PAINTINGS)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=names, default=names, help="styles")
    parser.add_argument("--page", type=Path, default=Path("docs/gallery.md"))
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="real volumes")
    parser.add_argument("--work", type=Path, default=Path("out/bench/controls"))
    parser.add_argument("--threads", type=int, default=1, help="CPU threads; 0 means all")
    parser.add_argument("--reuse", action="store_true", help="cells that are there already")
    options = parser.parse_args(arguments)
    try:
        frames: dict[str, VolumeFrame] = dict(
            simulate_once(options.work, reuse=True, resolution=RESOLUTION)
        )
        if (options.data / PLUME_FILE).is_file():
            frames["real"] = find_scenes(["real_plume"], REAL_WIDTH, options.data)[0]["real_plume"]
        for kind in set(frames) & {"3-D", "real"}:
            frames[f"{kind} front"] = frames[kind]
        styles = paint_styles(options.only)
        threads = [f"optimize.threads={options.threads}"]
        settings = {
            kind: [*threads, *(FRONT if _is_front(kind) else []), _refine(frame)]
            for kind, frame in frames.items()
        }
        studio = Studio(frames, styles, settings)
        kinds = [kind for kind in TURNS if kind in frames]
        rows: dict[str, list[Cell]] = {}
        words = arguments if arguments is not None else sys.argv[1:]
        for style in options.only:
            rows[style] = []
            for kind in kinds:
                kept = options.work / f"gallery_{RESOLUTION}" / f"{style}_{kind}.npz"
                if not (options.reuse and kept.is_file()):
                    keep_cell(make_cell(studio, kind, style), kept)
                rows[style].append(cell := kept_cell(kept))
                print(f"{style}, {NAMES[kind]}: {cell.cpu_s:.0f} CPU s", file=sys.stderr)
            write_page(
                options.page, rows, styles, " ".join(["python -m benchmarks.gallery", *words])
            )
    except (OSError, ValueError, UsdSmokeError) as error:
        print(f"benchmarks.gallery: {error}", file=sys.stderr)
        return 1
    print(options.page)
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Rebuilds the pictures of the paper's controls: docs/pictures/controls_*.png.

    python -m benchmarks.control_pictures [--only gamma depth ...] [--out docs/pictures]

A 2-D and a 3-D frame are simulated, styles are painted, and every control is shown at a few values
with all else equal: gamma, the depth of the features, tiling, the colours' start, masks, and 2-D
beside 3-D. Needs no data but the repository; docs/stylize.md shows some of them.
"""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.control_scenes import frame_of, paint_styles, simulate_smoke
from benchmarks.control_studio import SIDE, Grid, Look, Panel, Studio, save_grid
from benchmarks.measures import colour_distance
from usdsmoke.base.errors import UsdSmokeError
from usdsmoke.base.volume import VolumeFrame

__all__ = ["GRIDS", "SETTINGS", "main", "simulate_once"]

STYLES = ["strokes", "waves"]
KINDS = ("2-D", "3-D")
GAMMAS = ("0.001", "0.1", "0.5", "1")
DEPTHS = (1, 2, 3, 4)
TILINGS = (1, 2, 4)
RESOLUTION, SLAB_RESOLUTION = 48, 96  # voxels along the box's width
ONE_OCTAVE = ("shape.iterations=[0,0,100]", "colour.iterations=[0,0,240]")
BEHIND = 0.1  # linear grey behind masked smoke, which is black where it is not painted
SETTINGS = {
    "2-D": ["views.image_size=192"],
    "3-D": ["views.image_size=112", "views.pool=12"],
}
# Few and small steps, 300 of 1 in 255 as in the paper's 3-D: where one starts is seen to the end.
SMALL_STEPS = (
    "colour.iterations=[100,100,100]",
    "colour.learning_rate=0.004",
    "optimize.tolerance=0",
)
FEW = ("shape.iterations=[20,20,10]", "colour.iterations=[60,60,40]")  # enough for a control
# The few settings that shape a picture, their defaults first
WORDS = {
    "style.size": ("1", "0.5", "2"),
    "optimize.strength": ("1", "0.3", "0.6"),
    "style.colour": ("1", "0", "2"),
    "colour.lift": ("0.45", "0", "0.7"),
    "optics.depth": ("30", "3", "10"),
}


def show_gamma(studio: Studio) -> Grid:
    """Grey and colour for the paper's four values of gamma."""
    rows = []
    for kind in KINDS:
        looks = [
            studio.look(kind, "waves", f"optics.gamma={g}", f"optics.gamma_shape={g}")
            for g in GAMMAS
        ]
        for name, draw in (("grey", Look.grey), ("colour", Look.colour)):
            rows.append(
                [
                    Panel(draw(look, exposed=True), f"{kind}, {name}, gamma {gamma}")
                    for look, gamma in zip(looks, GAMMAS, strict=True)
                ]
            )
    title = "optics.gamma and optics.gamma_shape; exposed so that the largest opacity is 1"
    return Grid("gamma", title, rows)


def show_depth(studio: Studio) -> Grid:
    """One depth of the features at a time, with the colour layer; the octaves blur the choice."""
    rows = []
    for kind, octaves, settings in (
        ("2-D", "finest octave alone", ONE_OCTAVE),
        ("2-D", "all octaves", ()),
        ("3-D", "finest octave alone", ONE_OCTAVE),
    ):
        row = []
        for depth in DEPTHS:
            layers = f"features.layers=[learned0,oriented{depth},learned{depth}]"
            look = studio.look(kind, "waves", layers, *settings)
            label = f"{kind}, depth {depth} (relu{depth}_1)\n{octaves}"
            row.append(Panel(look.colour(), label))
        rows.append(row)
    return Grid("depth", "features.layers = [learned0, oriented N, learned N]", rows)


def show_tiling(studio: Studio) -> Grid:
    """The style repeated once, twice and four times along each side."""
    rows = [
        [
            Panel(studio.look(kind, "waves", *_tiled(n)).colour(), f"{kind}, tiling {n}")
            for n in TILINGS
        ]
        for kind in KINDS
    ]
    rows[0].append(_style_panel(studio, "waves"))
    return Grid("tiling", "style.tiling", rows)


def show_start(studio: Studio) -> Grid:
    """Colours that start from plain density beside those that start from noise."""
    rows = []
    for kind in KINDS:
        row = []
        for name, settings in (("small steps", SMALL_STEPS), ("defaults", ())):
            for start, init in (("density", ("colour.init=density",)), ("noise", ())):
                look = studio.look(kind, "waves", *init, *settings)
                measured = _describe_colours(look, studio.styles["waves"])
                row.append(Panel(look.colour(), f"{kind}, {start}, {name}\n{measured}"))
        rows.append(row)
    return Grid("start", "colour.init: density against noise", rows)


def show_mask(studio: Studio) -> Grid:
    """The guidance mask off and on in 2-D, and a mask field in both; over grey."""
    variants = [
        ("2-D", "guidance mask off", {"guided": False}),
        ("2-D", "guidance mask on", {}),
        ("2-D", "mask field, 1 to 0", {"masked": True}),
        ("3-D", "guidance mask on", {}),
        ("3-D", "mask field, 1 to 0", {"masked": True}),
    ]
    row = []
    for kind, name, options in variants:
        look = studio.look(kind, "waves", **options)
        row.append(Panel(look.colour(background=BEHIND), f"{kind}, {name}"))
    return Grid("mask", "Guidance mask (eq. 7), and a mask field in space", [row])


def show_dimensions(studio: Studio) -> Grid:
    """3-D beside 2-D for two styles: finished, and below the grey pictures of the shape step."""
    finished: list[Panel] = []
    moved: list[Panel] = []
    for style, shown in zip(STYLES, reversed(KINDS), strict=True):
        for kind in reversed(KINDS):
            look = studio.look(kind, style)
            finished.append(Panel(look.colour(), f"{kind}, {style}"))
            moved.append(Panel(look.grey(), f"{kind}, {style}, shape step"))
        finished.append(_style_panel(studio, style))
        moved.append(Panel(studio.look(shown, style).source_grey(), f"{shown}, source"))
    return Grid("dimensions", "3-D and 2-D, default settings", [finished, moved])


def show_words(studio: Studio) -> Grid:
    """The few settings that shape a picture, at three values each."""
    rows = []
    for name, (default, *others) in WORDS.items():
        looks = {default: studio.look("3-D", "strokes", *FEW)}
        for value in others:
            looks[value] = studio.look("3-D", "strokes", *FEW, f"{name}={value}")
        ordered = sorted(looks, key=float)
        rows.append(
            [Panel(looks[value].colour(background=BEHIND), f"{name} {value}") for value in ordered]
        )
    return Grid("words", "The few settings that shape the picture", rows)


GRIDS: dict[str, Callable[[Studio], Grid]] = {
    "words": show_words,
    "gamma": show_gamma,
    "depth": show_depth,
    "tiling": show_tiling,
    "start": show_start,
    "mask": show_mask,
    "dimensions": show_dimensions,
}


def _tiled(n: int) -> tuple[str, ...]:
    """The default is not named, so that it is made only once."""
    return () if n == 1 else (f"style.tiling={n}",)


def _style_panel(studio: Studio, name: str) -> Panel:
    pixels = np.rint(studio.styles[name] * 255.0).astype(np.uint8)
    side = round(0.55 * SIDE)
    small = Image.fromarray(pixels).resize((side, side), Image.Resampling.LANCZOS)
    return Panel(np.asarray(small, np.float32) / 255.0, f"style: {name}")


def _describe_colours(look: Look, style: np.ndarray) -> str:
    """Chroma of the smoke, and how far its colours are from the style's."""
    own, inside = look.straight()
    pixels = own[inside]
    chroma = float((pixels.max(axis=1) - pixels.min(axis=1)).mean())
    return f"chroma {chroma:.2f}, distance {colour_distance(style, own, inside):.3f}"


def simulate_once(
    folder: Path, reuse: bool, resolution: int = RESOLUTION
) -> dict[str, VolumeFrame]:
    """The frames, simulated, or as they were left in ``folder`` by a run before.

    Args:
        resolution: voxels of the 3-D one along the box's width.
    """
    file_path = folder / f"smoke_{resolution}_{SLAB_RESOLUTION}.npz"
    if not (reuse and file_path.is_file()):
        print("simulating two plumes", file=sys.stderr, flush=True)
        folder.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(file_path, **simulate_smoke(resolution, SLAB_RESOLUTION))
    with np.load(file_path) as smoke:
        return {kind: frame_of(smoke[kind]) for kind in KINDS}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=list(GRIDS), default=list(GRIDS))
    parser.add_argument("--out", type=Path, default=Path("docs/pictures"))
    parser.add_argument("--work", type=Path, default=Path("out/bench/controls"))
    parser.add_argument("--reuse", action="store_true", help="the smoke of the run before")
    parser.add_argument("--threads", type=int, default=0, help="CPU threads; 0 means all")
    options = parser.parse_args(arguments)
    started = time.perf_counter()
    try:
        frames = simulate_once(options.work, options.reuse)
        threads = f"optimize.threads={options.threads}"
        settings = {kind: [*SETTINGS[kind], threads] for kind in KINDS}
        studio = Studio(frames, paint_styles(STYLES), settings)
        for name in options.only:
            file_path = save_grid(GRIDS[name](studio), options.out)
            print(f"{file_path}: {file_path.stat().st_size / 1000:.0f} kB")
    except (OSError, ValueError, UsdSmokeError) as error:
        print(f"benchmarks.control_pictures: {error}", file=sys.stderr)
        return 1
    print(f"{time.perf_counter() - started:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""The pictures of benchmarks.coherence: errors over time, frames across a border, an animation."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from benchmarks.coherence_runs import Outcome, Run, Shot
from benchmarks.splats import display_picture, render_fields
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.views.cameras import View, orbit_view
from usdsmoke.core.views.scene import fit_view

__all__ = ["draw_animation", "draw_flicker", "draw_strip"]

PAPER, INK, DIM, BAND = (24, 24, 26), (226, 226, 222), (120, 120, 118), (44, 46, 54)
Font = ImageFont.FreeTypeFont | ImageFont.ImageFont
CURVES = {"alone": (232, 132, 92), "windows": (110, 190, 232)}
NAMES = {"alone": "frames alone", "windows": "windows"}
WIDTH, HEIGHT = 880, 250  # of one plot
LEFT, RIGHT, TOP, BOTTOM = 64, 20, 40, 40
SHOWN = 7  # frames in the strip
SIDE = 150  # pixels of a panel in the strip
CROP = 0.7  # side of a panel, as a share of the smoke's width
CROP_TOP = 0.1  # where it begins, as a share of the smoke's height
GAP, LABEL = 6, 92


def draw_flicker(errors: Mapping[str, Mapping[str, np.ndarray]], windows: Run) -> Image.Image:
    """The temporal error of every step, alone and in windows, one plot a kind.

    Args:
        errors: by way of running, then by kind: one number a step.
        windows: says where windows begin and which steps blending has a hand in.
    """
    kinds = list(errors["windows"])
    sheet = Image.new("RGB", (WIDTH, HEIGHT * len(kinds)), PAPER)
    pen = ImageDraw.Draw(sheet)
    for number, kind in enumerate(kinds):
        curves = {name: found[kind] for name, found in errors.items()}
        _draw_plot(pen, number * HEIGHT, f"temporal error of {kind}", curves, windows)
    return sheet


def _draw_plot(
    pen: ImageDraw.ImageDraw, top: int, title: str, curves: Mapping[str, np.ndarray], windows: Run
) -> None:
    font, large = ImageFont.load_default(12), ImageFont.load_default(14)
    n = len(next(iter(curves.values())))
    highest = 1.15 * max(float(curve.max()) for curve in curves.values())
    low, high = top + HEIGHT - BOTTOM, top + TOP
    wide = (WIDTH - LEFT - RIGHT) / n

    def place(step: float, value: float) -> tuple[float, float]:
        return LEFT + wide * (step + 0.5), low - (low - high) * value / highest

    for step in windows.touched:
        x = LEFT + wide * step
        pen.rectangle([x, high, x + wide, low], BAND)
    for start in windows.starts:  # a step is drawn between its frames; this one leads to frame 0
        x = LEFT + wide * start
        for dash in range(high, low, 8):
            pen.line([x - wide / 2, dash, x - wide / 2, dash + 4], DIM)
    for value in _round_values(highest):
        height = place(0, value)[1]
        pen.line([LEFT, height, WIDTH - RIGHT, height], DIM if value == 0 else BAND)
        pen.text((LEFT - 8, height), f"{value:g}", DIM, font, anchor="rm")
    for step in range(0, n, max(1, n // 12)):
        pen.text((place(step, 0)[0], low + 6), f"{step + 1}-{step + 2}", DIM, font, anchor="ma")
    for name, curve in curves.items():
        points = [place(step, float(value)) for step, value in enumerate(curve)]
        pen.line(points, CURVES[name], 2)
        for x, y in points:
            pen.ellipse([x - 2, y - 2, x + 2, y + 2], CURVES[name])
    pen.text((LEFT, top + 12), title, INK, large)
    _draw_legend(pen, top + 14, curves, font)


def _draw_legend(
    pen: ImageDraw.ImageDraw, top: int, curves: Mapping[str, np.ndarray], font: Font
) -> None:
    right = WIDTH - RIGHT
    words = [(NAMES[name], CURVES[name]) for name in curves]
    for text, colour in [("dashed: a window begins; grey: blended", DIM), *reversed(words)]:
        right -= round(font.getlength(text))
        pen.text((right, top), text, colour, font)
        right -= 18


def _round_values(highest: float) -> list[float]:
    """Three to six round values from 0 to at most ``highest``."""
    for step in sorted(s * 10.0**p for p in range(-4, 2) for s in (1, 2, 5)):
        if highest / step < 6:
            return [round(step * k, 6) for k in range(int(highest / step) + 1)]
    return [0.0]


def draw_strip(runs: Mapping[str, Run], shot: Shot) -> Image.Image:
    """Consecutive frames across the first border, alone above, in windows below; one crop."""
    windows = runs["windows"]
    first = max(0, min(windows.starts[0] - 3, len(windows.outcomes) - SHOWN))
    numbers = range(first, min(first + SHOWN, len(windows.outcomes)))
    view = _close_view(windows.outcomes[numbers[-1]], shot)
    sheet = Image.new(
        "RGB", (LABEL + len(numbers) * (SIDE + GAP), 2 * (SIDE + GAP) + 26), PAPER
    )  # fmt: skip
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(13)
    for row, name in enumerate(("alone", "windows")):
        top = row * (SIDE + GAP) + GAP
        pen.text((LABEL - 10, top + SIDE / 2), NAMES[name], INK, font, anchor="rm")
        for column, number in enumerate(numbers):
            pixels = _picture(runs[name].outcomes[number], shot, view)
            sheet.paste(pixels, (LABEL + column * (SIDE + GAP), top))
    for column, number in enumerate(numbers):
        middle = LABEL + column * (SIDE + GAP) + SIDE / 2
        pen.text((middle, sheet.height - 20), _label(number, windows), INK, font, anchor="ma")
    return sheet


def draw_animation(runs: Mapping[str, Run], shot: Shot) -> list[np.ndarray]:
    """Frames alone, in windows, and the source side by side, [H W 3] in [0, 1] a frame."""
    view = _close_view(runs["windows"].outcomes[-1], shot)
    font, shown = ImageFont.load_default(13), []
    for number, frame in enumerate(shot.frames):
        sheet = Image.new("RGB", (3 * SIDE + 4 * GAP, SIDE + 2 * GAP + 22), PAPER)
        pen = ImageDraw.Draw(sheet)
        panels = {NAMES[name]: _picture(runs[name].outcomes[number], shot, view) for name in NAMES}
        panels["source"] = _drawn(frame, frame.density, None, shot, view)
        for column, (name, pixels) in enumerate(panels.items()):
            left = GAP + column * (SIDE + GAP)
            sheet.paste(pixels, (left, GAP))
            pen.text((left + SIDE / 2, SIDE + 2 * GAP), name, INK, font, anchor="ma")
        shown.append(np.asarray(sheet, np.float32) / 255)
    return shown


def _label(number: int, windows: Run) -> str:
    if number in windows.starts:
        return f"{number + 1}: window begins"
    blended = {step for step in windows.touched if step not in _before(windows)}
    return f"{number + 1}, blended" if number in blended else f"{number + 1}"


def _before(windows: Run) -> Sequence[int]:
    """Numbers of the frames before windows begin: they touch a border, but are not blended."""
    return [start - 1 for start in windows.starts]


def _close_view(outcome: Outcome, shot: Shot) -> View:
    """From the front, onto a square part of the smoke, two pixels or more a voxel."""
    voxel = outcome.still.voxel_size
    front = orbit_view(0.0, 0.0, shot.scene.up_axis, np.zeros(3), 1, 1, voxel)
    whole = fit_view(front, outcome.still, margin=0)
    width, height = whole.width * voxel, whole.height * voxel
    side = CROP * width
    middle = whole.centre + whole.up * (height / 2 - CROP_TOP * height - side / 2)
    return replace(whole, centre=middle, height=SIDE, width=SIDE, pixel_size=side / SIDE)


def _picture(outcome: Outcome, shot: Shot, view: View) -> Image.Image:
    return _drawn(outcome.source, outcome.density, outcome.emission, shot, view)


def _drawn(
    frame: VolumeFrame, density: DenseField, emission: DenseField | None, shot: Shot, view: View
) -> Image.Image:
    """Drawn at one pixel a voxel, or two, then enlarged: gaps show between coarser voxels."""
    voxel = float(density.index_to_world[0, 0]) / 2
    n = max(1, round(view.pixel_size * SIDE / voxel))
    near = replace(view, height=n, width=n, pixel_size=voxel)
    drawn = render_fields(density, emission, frame.density_to_stage, shot.scene.gamma_w, near)
    pixels = np.rint(display_picture(drawn, 0.01) * 255).astype(np.uint8)
    return Image.fromarray(pixels).resize((SIDE, SIDE), Image.Resampling.BICUBIC)

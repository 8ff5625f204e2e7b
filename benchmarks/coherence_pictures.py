"""The pictures of benchmarks.coherence: errors over time, frames across a border, an animation."""

from collections.abc import Container, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from benchmarks.coherence_runs import Run, Shot
from benchmarks.splats import display_picture, render_fields
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.smoke.active import activate
from usdsmoke.core.views.cameras import View, orbit_view
from usdsmoke.core.views.scene import fit_view

__all__ = ["draw_animation", "draw_flicker", "draw_panels", "draw_strip"]

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


def draw_flicker(
    errors: Mapping[str, Mapping[str, Mapping[int, float]]],
    starts: Sequence[int],
    touched: Container[int],
) -> Image.Image:
    """The temporal error of every step, alone and in windows, one plot a kind.

    Args:
        errors: by way of running, then by kind: by the frame that a step leads to.
        starts: frames that windows begin with.
        touched: frames that blending has changed the step to.
    """
    kinds = list(errors["windows"])
    sheet = Image.new("RGB", (WIDTH, HEIGHT * len(kinds)), PAPER)
    pen = ImageDraw.Draw(sheet)
    for number, kind in enumerate(kinds):
        curves = {name: found[kind] for name, found in errors.items()}
        _draw_plot(pen, number * HEIGHT, f"temporal error of {kind}", curves, (starts, touched))
    return sheet


def _draw_plot(
    pen: ImageDraw.ImageDraw,
    top: int,
    title: str,
    curves: Mapping[str, Mapping[int, float]],
    borders: tuple[Sequence[int], Container[int]],
) -> None:
    font, large = ImageFont.load_default(12), ImageFont.load_default(14)
    codes = sorted({code for curve in curves.values() for code in curve})
    highest = 1.15 * max(max(curve.values()) for curve in curves.values())
    low, high = top + HEIGHT - BOTTOM, top + TOP
    wide = (WIDTH - LEFT - RIGHT) / len(codes)

    def place(code: float, value: float) -> tuple[float, float]:
        return LEFT + wide * (code - codes[0] + 0.5), low - (low - high) * value / highest

    starts, touched = borders
    for code in codes:
        if code in touched:
            x = place(code - 0.5, 0)[0]
            pen.rectangle([x, high, x + wide, low], BAND)
    for start in starts:
        x = place(start, 0)[0]
        for dash in range(high, low, 8):
            pen.line([x, dash, x, dash + 4], DIM)
    for value in _round_values(highest):
        height = place(codes[0], value)[1]
        pen.line([LEFT, height, WIDTH - RIGHT, height], DIM if value == 0 else BAND)
        pen.text((LEFT - 8, height), f"{value:g}", DIM, font, anchor="rm")
    for code in codes[:: max(1, len(codes) // 12)]:
        pen.text((place(code, 0)[0], low + 6), f"{code - 1}-{code}", DIM, font, anchor="ma")
    for name, curve in curves.items():
        points = [place(code, value) for code, value in sorted(curve.items())]
        pen.line(points, CURVES[name], 2)
        for x, y in points:
            pen.ellipse([x - 2, y - 2, x + 2, y + 2], CURVES[name])
    pen.text((LEFT, top + 12), title, INK, large)
    _draw_legend(pen, top + 14, curves, font)


def _draw_legend(
    pen: ImageDraw.ImageDraw, top: int, curves: Mapping[str, Mapping[int, float]], font: Font
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


def draw_strip(
    panels: Mapping[str, Mapping[int, np.ndarray]], starts: Sequence[int], touched: Container[int]
) -> Image.Image:
    """Consecutive frames across the first border, alone above, in windows below; one crop.

    Args:
        panels: of ``draw_panels`` by way of running and by frame.
        starts, touched: see ``draw_flicker``.
    """
    both = sorted(set.intersection(*(set(found) for found in panels.values())))
    codes = [code for code in both if starts[0] - 3 <= code < starts[0] - 3 + SHOWN]
    sheet = Image.new("RGB", (LABEL + len(codes) * (SIDE + GAP), 2 * (SIDE + GAP) + 26), PAPER)
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(13)
    for row, (name, found) in enumerate(panels.items()):
        top = row * (SIDE + GAP) + GAP
        pen.text((LABEL - 10, top + SIDE / 2), NAMES[name], INK, font, anchor="rm")
        for column, code in enumerate(codes):
            sheet.paste(Image.fromarray(found[code]), (LABEL + column * (SIDE + GAP), top))
    for column, code in enumerate(codes):
        text = f"{code}"
        if code in starts:
            text += ": window begins"
        elif code in touched and code + 1 in touched:  # the step from the last one is touched too
            text += ", blended"
        middle = LABEL + column * (SIDE + GAP) + SIDE / 2
        pen.text((middle, sheet.height - 20), text, INK, font, anchor="ma")
    return sheet


def draw_animation(panels: Mapping[str, Mapping[int, np.ndarray]], shot: Shot) -> list[np.ndarray]:
    """Frames side by side, alone, in windows and of the source, [H W 3] in [0, 1] a frame.

    Args:
        panels: of ``draw_panels`` by way of running and by frame; the longest piece without a gap
            that all of them have is drawn.
    """
    view = _close_view(shot)
    font, shown = ImageFont.load_default(13), []
    piece = _longest_piece(sorted(set.intersection(*(set(found) for found in panels.values()))))
    for frame in shot.frames:
        if frame.time_code not in piece:
            continue
        sheet = Image.new("RGB", (3 * SIDE + 4 * GAP, SIDE + 2 * GAP + 22), PAPER)
        pen = ImageDraw.Draw(sheet)
        drawn = {NAMES[name]: found[int(frame.time_code)] for name, found in panels.items()}
        drawn["source"] = _drawn(frame, frame.density, None, shot, view)
        for column, (name, pixels) in enumerate(drawn.items()):
            left = GAP + column * (SIDE + GAP)
            sheet.paste(Image.fromarray(pixels), (left, GAP))
            pen.text((left + SIDE / 2, SIDE + 2 * GAP), name, INK, font, anchor="ma")
        shown.append(np.asarray(sheet, np.float32) / 255)
    return shown


def _longest_piece(codes: Sequence[int]) -> list[int]:
    """The longest run of consecutive frames among those that ascend."""
    pieces: list[list[int]] = []
    for code in codes:
        if pieces and pieces[-1][-1] == code - 1:
            pieces[-1].append(code)
        else:
            pieces.append([code])
    return max(pieces, key=len)


def draw_panels(run: Run, shot: Shot) -> np.ndarray:
    """A close picture of every frame of a run, all from one view, [N SIDE SIDE 3] uint8.

    Args:
        shot: with the frame that the view is fitted to at its end.
    """
    view = _close_view(shot)
    return np.stack(
        [_drawn(item.source, item.density, item.emission, shot, view) for item in run.outcomes]
    )


def _close_view(shot: Shot) -> View:
    """From the front, onto a square part of the smoke, two pixels or more a voxel."""
    last = shot.frames[-1]
    smoke = activate(last.density, last.density_to_stage, torch.device("cpu"))
    voxel = smoke.voxel_size
    front = orbit_view(0.0, 0.0, shot.scene.up_axis, np.zeros(3), 1, 1, voxel)
    whole = fit_view(front, smoke, margin=0)
    width, height = whole.width * voxel, whole.height * voxel
    side = CROP * width
    middle = whole.centre + whole.up * (height / 2 - CROP_TOP * height - side / 2)
    return replace(whole, centre=middle, height=SIDE, width=SIDE, pixel_size=side / SIDE)


def _drawn(
    frame: VolumeFrame, density: DenseField, emission: DenseField | None, shot: Shot, view: View
) -> np.ndarray:
    """Drawn at one pixel a voxel, or two, then enlarged: gaps show between coarser voxels."""
    voxel = float(density.index_to_world[0, 0]) / 2
    n = max(1, round(view.pixel_size * SIDE / voxel))
    near = replace(view, height=n, width=n, pixel_size=voxel)
    drawn = render_fields(density, emission, frame.density_to_stage, shot.scene.gamma_w, near)
    pixels = np.rint(display_picture(drawn, 0.01) * 255).astype(np.uint8)
    return np.asarray(Image.fromarray(pixels).resize((SIDE, SIDE), Image.Resampling.BICUBIC))

"""Paint on a canvas: bristly strokes, smooth noise to steer them, layers of them along a flow."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from PIL import Image
from scipy import ndimage

__all__ = [
    "SAMPLE_STEP",
    "Brush",
    "Canvas",
    "Flow",
    "Tone",
    "paint_layer",
    "palette_colour",
    "smooth_noise",
]

SUPERSAMPLING = 2  # canvas pixels per pixel of the picture: strokes have hard edges on the canvas
SAMPLE_STEP = (
    0.6  # canvas pixels between neighbouring paint samples, below 0.7 so that none is missed
)

Flow = Callable[[np.ndarray, np.ndarray], np.ndarray]  # (x, y) in [0, 1] -> angle in radians
Tone = Callable[[np.ndarray, np.ndarray], np.ndarray]  # (x, y) in [0, 1] -> place in the palette


@dataclass(frozen=True)
class Brush:
    """Lengths are shares of the picture's side."""

    width: float
    length: float
    count: int  # strokes in this layer
    tone_jitter: float  # spread of a stroke's place in the palette, which runs from 0 to 1
    dryness: float  # 0 covers fully, 1 leaves most of the bristle gaps open at the stroke's end


class Canvas:
    """Paint (colour and thickness) on a square, in canvas pixels."""

    def __init__(self, size: int, ground: tuple[float, float, float]) -> None:
        self.side = size * SUPERSAMPLING
        self.colour = np.empty((self.side, self.side, 3), np.float32)
        self.colour[:] = ground
        self.relief = np.zeros((self.side, self.side), np.float32)

    def stroke(
        self,
        centre_line: np.ndarray,
        width: float,
        colour: np.ndarray,
        dryness: float,
        rng: np.random.Generator,
    ) -> None:
        """Lay one stroke down.

        Args:
            centre_line: positions [N 2] as (x, y) in canvas pixels, SAMPLE_STEP apart.
            width: of the brush at its broadest, in canvas pixels.
            colour: [3] in [0, 1], display-encoded.
            dryness: see Brush.
            rng: draws the bristles.
        """
        n_along = len(centre_line)
        n_across = max(int(width / SAMPLE_STEP), 3)
        along = np.linspace(0.0, 1.0, n_along)[:, None]
        across = np.linspace(-1.0, 1.0, n_across)[None, :]
        tangent = np.gradient(centre_line, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True) + 1e-9
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        # The brush lands rounded, is pressed, and is lifted to a point.
        pressure = np.sqrt(np.clip(along / 0.12, 0.0, 1.0)) * np.sqrt(
            np.clip((1.0 - along) / 0.3, 0.0, 1.0)
        )
        offset = 0.5 * width * across * np.maximum(pressure, 0.12)
        xy = centre_line[:, None, :] + offset[..., None] * normal[:, None, :]
        bristles = _bristles(n_along, n_across, width, rng)
        wet = bristles > dryness * (along**2 * 1.1 - 0.15 + 0.9 * np.abs(across) ** 6)
        column, row = np.rint(xy[..., 0]).astype(int), np.rint(xy[..., 1]).astype(int)
        wet &= (column >= 0) & (column < self.side) & (row >= 0) & (row < self.side)
        column, row, load = column[wet], row[wet], bristles[wet].astype(np.float32)
        shade = 0.80 + 0.36 * load
        self.colour[row, column] = np.clip(colour.astype(np.float32) * shade[:, None], 0.0, 1.0)
        edge = np.broadcast_to(1.0 - across**4, wet.shape)[wet]
        self.relief[row, column] = (0.45 + load) * (0.4 + 0.6 * edge)

    def picture(self) -> Image.Image:
        """The lit painting, reduced to its final size."""
        relief = ndimage.gaussian_filter(self.relief, 0.8)
        slope_y, slope_x = np.gradient(relief)
        light = np.clip(1.0 - 0.55 * (slope_x + slope_y), 0.6, 1.45)
        lit = np.clip(self.colour * light[..., None], 0.0, 1.0)
        n = self.side // SUPERSAMPLING
        small = lit.reshape(n, SUPERSAMPLING, n, SUPERSAMPLING, 3).mean(axis=(1, 3))
        return Image.fromarray(np.rint(small * 255.0).astype(np.uint8), "RGB")


def _bristles(n_along: int, n_across: int, width: float, rng: np.random.Generator) -> np.ndarray:
    """How much paint each bristle leaves, [n_along n_across] in about [0, 1]."""
    n_bristles = max(int(width / (2.2 * SUPERSAMPLING)), 3)
    n_changes = max(int(n_along * SAMPLE_STEP / (18 * SUPERSAMPLING)), 2)
    load = rng.random((n_changes, n_bristles)) * 0.45 + rng.random((1, n_bristles)) * 0.55
    zoom = (n_along / n_changes, n_across / n_bristles)
    return ndimage.zoom(load, zoom, order=1, mode="nearest", grid_mode=True)


def smooth_noise(seed: int, scale: float, octaves: int = 3) -> Tone:
    """A smooth random function of (x, y) with mean about 0 and features of size ``scale``."""
    rng = np.random.default_rng(seed)
    tables = []
    for octave in range(octaves):
        n_cells = max(int(np.ceil(1.0 / scale * 2**octave)), 1) + 4
        table = ndimage.spline_filter(rng.standard_normal((n_cells, n_cells)), mode="nearest")
        tables.append((2**octave / scale, table, 0.5**octave))

    def evaluate(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        total = np.zeros(np.broadcast(x, y).shape)
        for frequency, table, amplitude in tables:
            at = [np.asarray(y) * frequency + 1.5, np.asarray(x) * frequency + 1.5]
            total += amplitude * ndimage.map_coordinates(table, at, mode="nearest", prefilter=False)
        return total

    return evaluate


def palette_colour(palette: np.ndarray, place: float, rng: np.random.Generator) -> np.ndarray:
    """The palette colour nearest to ``place`` in [0, 1], mixed with a little of a neighbour."""
    at = np.clip(place, 0.0, 1.0) * (len(palette) - 1)
    pure = palette[int(np.rint(at))]
    neighbour = palette[int(np.clip(np.rint(at) + rng.choice([-1, 1]), 0, len(palette) - 1))]
    mix = rng.uniform(0.0, 0.25)
    return (1.0 - mix) * pure + mix * neighbour + rng.normal(0.0, 0.012, 3)


def trace_lines(starts: np.ndarray, lengths: np.ndarray, flow: Flow) -> np.ndarray:
    """Lines [N 25 2] along the flow, their middles at ``starts`` [N 2], in shares of the side."""
    n_half = 12
    halves = []
    for sign in (-1.0, 1.0):
        at, points = starts.copy(), []
        for _ in range(n_half):
            angle = flow(at[:, 0], at[:, 1])
            step = sign * lengths / (2 * n_half)
            at = at + step[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            points.append(at)
        halves.append(points)
    return np.stack([*halves[0][::-1], starts, *halves[1]], axis=1)


def resample_line(coarse: np.ndarray) -> np.ndarray:
    """The polyline [M 2] with its points about SAMPLE_STEP apart, [N 2]."""
    steps = np.linalg.norm(np.diff(coarse, axis=0), axis=1)
    places = np.linspace(0.0, len(coarse) - 1.0, max(int(steps.sum() / SAMPLE_STEP), 4))
    known = np.arange(len(coarse))
    return np.stack([np.interp(places, known, coarse[:, axis]) for axis in (0, 1)], axis=1)


def paint_layer(
    canvas: Canvas,
    brush: Brush,
    flow: Flow,
    tone: Tone,
    palette: np.ndarray,
    rng: np.random.Generator,
) -> None:
    """Cover the canvas with about ``brush.count`` strokes in random order."""
    # A jittered lattice leaves no bare patches, which independent places would.
    n_rows = int(np.ceil(np.sqrt(brush.count)))
    lattice = np.stack(np.meshgrid(np.arange(n_rows), np.arange(n_rows)), axis=-1).reshape(-1, 2)
    starts = rng.permutation((lattice + rng.random(lattice.shape)) / n_rows)
    lines = trace_lines(starts, brush.length * rng.uniform(0.6, 1.35, len(starts)), flow)
    places = tone(starts[:, 0], starts[:, 1]) + rng.normal(0.0, brush.tone_jitter, len(starts))
    for line, place in zip(lines, places, strict=True):
        width = brush.width * canvas.side * rng.uniform(0.75, 1.2)
        colour = palette_colour(palette, float(place), rng)
        canvas.stroke(resample_line(line * canvas.side), width, colour, brush.dryness, rng)

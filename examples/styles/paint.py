"""Paint the example style images: brush strokes that follow a flow, on a canvas made by code.

    python examples/styles/paint.py OUT_FOLDER [--size 512] [--seed 7] [--only strokes waves petals]

Every picture is painted the way a painter would: broad strokes first, finer ones over them, each
stroke one colour of a small palette, pulled along the flow of the picture by a brush whose bristles
carry different amounts of paint and run dry towards the end. The paint's relief is lit from the
upper left. The same size and seed always give the same pixels.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from scipy import ndimage

__all__ = ["PAINTINGS", "Brush", "Canvas", "main", "paint", "smooth_noise"]

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
    """How much paint each bristle leaves, [n_along n_across] in about [0, 1]: streaks along the stroke."""
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
    """The palette colour nearest to ``place`` in [0, 1], mixed a little, as paint never is quite clean."""
    at = np.clip(place, 0.0, 1.0) * (len(palette) - 1)
    pure = palette[int(np.rint(at))]
    neighbour = palette[int(np.clip(np.rint(at) + rng.choice([-1, 1]), 0, len(palette) - 1))]
    mix = rng.uniform(0.0, 0.25)
    return (1.0 - mix) * pure + mix * neighbour + rng.normal(0.0, 0.012, 3)


def trace_lines(starts: np.ndarray, lengths: np.ndarray, flow: Flow) -> np.ndarray:
    """Lines along the flow with their middles at ``starts`` [N 2]; [N 25 2] in shares of the side."""
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


def _colours(*codes: str) -> np.ndarray:
    return np.array([[int(code[i : i + 2], 16) / 255.0 for i in (0, 2, 4)] for code in codes])


def paint_strokes(size: int, seed: int) -> Image.Image:
    """Fire: tongues of deep red, orange and yellow that twist upwards out of the dark."""
    palette = _colours(
        "17070b", "3d0a10", "7c1011", "b8210f", "e2510e", "f58a13", "fcc630", "fff0a0"
    )
    bend, swirl = smooth_noise(seed, 0.22, 2), smooth_noise(seed + 1, 0.5, 1)
    heat = smooth_noise(seed + 2, 0.15, 2)

    def flow(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return -0.5 * np.pi + 0.75 * bend(x, 0.6 * y) + 0.5 * swirl(x, y)

    def tone(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        lick = np.sin(2.0 * np.pi * (3.2 * x + 0.35 * bend(x, 0.6 * y)) + 2.5 * swirl(x, y))
        return 0.47 + 0.30 * lick + 0.22 * heat(x, 0.45 * y)

    return _paint_flow(size, seed, palette, flow, tone)


def paint_waves(size: int, seed: int) -> Image.Image:
    """Water: whirls of blue with white crests and ochre light between them."""
    palette = _colours(
        "0b1838", "12306b", "1d4f9e", "2f7cc4", "6fb0dd", "d9ecf2", "fbf8ea", "d99a2b"
    )
    rng = np.random.default_rng(seed)
    centres = (
        np.stack(np.meshgrid(np.arange(3), np.arange(3)), -1).reshape(-1, 2) + rng.random((9, 2))
    ) / 3
    spins = rng.choice([-1.0, 1.0], 9)
    warp = smooth_noise(seed + 3, 0.3, 2)

    def stream(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        x, y = np.asarray(x)[..., None], np.asarray(y)[..., None]
        distance = np.hypot(x - centres[:, 0], y - centres[:, 1])
        return (spins * np.exp(-(distance**2) / 0.035)).sum(-1) + 0.9 * y[..., 0]

    def flow(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        h = 1e-3
        along_x = stream(x, y + h) - stream(x, y - h)
        along_y = stream(x - h, y) - stream(x + h, y)
        return np.arctan2(along_y, along_x)

    def tone(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (
            0.44
            + 0.36 * np.sin(2.0 * np.pi * 2.6 * stream(x, y) + 0.6 * warp(x, y))
            + 0.10 * warp(x, y)
        )

    return _paint_flow(size, seed, palette, flow, tone)


def _paint_flow(size: int, seed: int, palette: np.ndarray, flow: Flow, tone: Tone) -> Image.Image:
    """Three layers of strokes, broad to fine, on a ground of the darkest colour."""
    rng = np.random.default_rng(seed + 100)
    canvas = Canvas(size, tuple(palette[0]))
    for brush in (
        Brush(width=0.085, length=0.34, count=240, tone_jitter=0.05, dryness=0.3),
        Brush(width=0.055, length=0.24, count=620, tone_jitter=0.09, dryness=0.8),
        Brush(width=0.032, length=0.17, count=620, tone_jitter=0.15, dryness=0.9),
    ):
        paint_layer(canvas, brush, flow, tone, palette, rng)
    return canvas.picture()


def paint_petals(size: int, seed: int) -> Image.Image:
    """Flowers: fat petals of white, rose and blue around ochre hearts, on dark leaves."""
    rng = np.random.default_rng(seed)
    leaves = _colours("0d1f24", "143a36", "20594a", "3b7d56", "86a94c")
    petals = [
        _colours("8fb3dd", "d5e4f1", "fdfbf2"),
        _colours("1b3c8c", "3a69c4", "9bbdec"),
        _colours("a32150", "df5f86", "f9c4cd"),
    ]
    hearts = _colours("7a3f10", "d88a1c", "fbd65a")
    bend = smooth_noise(seed + 5, 0.2, 2)
    canvas = Canvas(size, tuple(leaves[0]))
    for brush in (Brush(0.07, 0.26, 260, 0.2, 0.3), Brush(0.035, 0.16, 520, 0.3, 0.8)):
        paint_layer(
            canvas,
            brush,
            lambda x, y: 2.2 * bend(x, y),
            lambda x, y: 0.35 + 0.25 * bend(y, x),
            leaves,
            rng,
        )
    n_rows = 6
    lattice = np.stack(np.meshgrid(np.arange(n_rows), np.arange(n_rows)), -1).reshape(-1, 2)
    for centre in rng.permutation((lattice + rng.uniform(0.1, 0.9, lattice.shape)) / n_rows):
        _paint_flower(canvas, centre * canvas.side, petals[rng.integers(len(petals))], hearts, rng)
    return canvas.picture()


def _paint_flower(
    canvas: Canvas,
    centre: np.ndarray,
    petals: np.ndarray,
    hearts: np.ndarray,
    rng: np.random.Generator,
) -> None:
    radius = canvas.side * rng.uniform(0.075, 0.115)
    n_petals = int(rng.integers(7, 11))
    for ring, shade in ((1.0, 0.25), (0.72, 0.8)):
        turn = rng.uniform(0.0, 2.0 * np.pi)
        for k in rng.permutation(n_petals):
            angle = turn + 2.0 * np.pi * k / n_petals
            reach = (
                np.linspace(1.0, 0.15, max(int(ring * radius / SAMPLE_STEP), 4))[:, None]
                * ring
                * radius
            )
            curl = angle + 0.25 * (reach / radius)
            line = centre + reach * np.concatenate([np.cos(curl), np.sin(curl)], axis=1)
            colour = palette_colour(petals, shade + rng.normal(0.0, 0.25), rng)
            canvas.stroke(line, 0.62 * ring * radius, colour, 0.6, rng)
    for _ in range(9):
        angle, reach = rng.uniform(0.0, 2.0 * np.pi), radius * 0.16 * np.sqrt(rng.random())
        start = centre + reach * np.array([np.cos(angle), np.sin(angle)])
        dab = (
            start
            + np.linspace(0.0, 0.22 * radius, max(int(0.22 * radius / SAMPLE_STEP), 4))[:, None]
        )
        canvas.stroke(dab, 0.16 * radius, palette_colour(hearts, rng.random(), rng), 0.4, rng)


PAINTINGS: dict[str, Callable[[int, int], Image.Image]] = {
    "strokes": paint_strokes,
    "waves": paint_waves,
    "petals": paint_petals,
}


def paint(out_folder: Path, size: int, seed: int, names: list[str]) -> list[Path]:
    """Paint the named pictures into ``out_folder`` and return their files."""
    out_folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name in names:
        file_path = out_folder / f"{name}.png"
        PAINTINGS[name](size, seed).save(file_path)
        written.append(file_path)
    return written


def main() -> None:
    """Read the command line, paint, and print what was written."""
    parser = argparse.ArgumentParser(description="Paint the example style images.")
    parser.add_argument("out_folder", type=Path)
    parser.add_argument("--size", type=int, default=512, help="pixels of a side (default 512)")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--only", nargs="+", choices=list(PAINTINGS), default=list(PAINTINGS))
    options = parser.parse_args()
    for file_path in paint(options.out_folder, options.size, options.seed, options.only):
        print(file_path)


if __name__ == "__main__":
    main()

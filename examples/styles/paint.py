"""Paint the example style images: brush strokes that follow a flow, on a canvas made by code.

    python examples/styles/paint.py OUT_FOLDER [--size 512] [--seed 7] [--only strokes waves ...]

Every picture is painted the way a painter would: broad strokes first, finer ones over them, each
stroke one colour of a small palette, pulled along the flow of the picture by a brush whose bristles
carry different amounts of paint and run dry towards the end. The paint's relief is lit from the
upper left. The same size and seed always give the same pixels.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

from brush import SAMPLE_STEP, Brush, Canvas, Flow, Tone, paint_layer, palette_colour, smooth_noise

__all__ = ["PAINTINGS", "main", "paint"]


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


def paint_dabs(size: int, seed: int) -> Image.Image:
    """Thick short dabs that fly out of a light in a corner, from cream over blue into the night."""
    palette = _colours(
        "10102c", "1a1f63", "1c3fa8", "2272cf", "35a6dd", "8fd3ea", "e9e8d2", "f6d48c"
    )
    rng = np.random.default_rng(seed + 100)
    warp = smooth_noise(seed + 8, 0.25, 2)

    def flow(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.arctan2(y - 0.9, x - 0.75) + 0.35 * warp(x, y)

    def tone(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 0.95 - 0.85 * np.hypot(x - 0.75, y - 0.9) + 0.10 * warp(y, x)

    canvas = Canvas(size, tuple(palette[0]))
    for brush in (
        Brush(width=0.07, length=0.16, count=500, tone_jitter=0.10, dryness=0.2),
        Brush(width=0.042, length=0.11, count=1100, tone_jitter=0.16, dryness=0.5),
        Brush(width=0.026, length=0.075, count=900, tone_jitter=0.22, dryness=0.6),
    ):
        paint_layer(canvas, brush, flow, tone, palette, rng)
    return canvas.picture()


def paint_ink(size: int, seed: int) -> Image.Image:
    """Ink on paper: grey washes, then black strokes of a dry brush that sweep in arcs, some red."""
    paper, washes = _colours("f1e9d8"), _colours("c9c2b4", "9c978e", "6c6963")
    inks = _colours("0c0c10", "1d1c22", "35343a")
    rng = np.random.default_rng(seed + 100)
    bend = smooth_noise(seed + 11, 0.35, 2)

    def flow(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 0.6 + 2.4 * bend(x, y)

    canvas = Canvas(size, tuple(paper[0]))
    layers = (
        (washes, Brush(width=0.10, length=0.40, count=55, tone_jitter=0.4, dryness=0.3)),
        (inks, Brush(width=0.055, length=0.42, count=60, tone_jitter=0.4, dryness=0.9)),
        (inks, Brush(width=0.018, length=0.26, count=110, tone_jitter=0.4, dryness=0.6)),
        (_colours("a3201c", "c43a24"), Brush(0.035, 0.10, 12, 0.4, 0.4)),
    )
    for palette, brush in layers:
        paint_layer(canvas, brush, flow, lambda x, _: 0.4 + 0.0 * x, palette, rng)
    return canvas.picture()


def paint_mosaic(size: int, seed: int) -> Image.Image:
    """Stones in dark mortar: bands of terracotta, gold, ivory and turquoise that wind around."""
    palette = _colours("15384a", "1f7d86", "5cc0ad", "f3ead0", "efc04a", "d9772b", "9b2f22")
    rng = np.random.default_rng(seed + 100)
    bend = smooth_noise(seed + 14, 0.4, 2)
    n_rows = 26
    lattice = np.stack(np.meshgrid(np.arange(-1, n_rows + 1), np.arange(-1, n_rows + 1)), -1)
    stones = (lattice.reshape(-1, 2) + 0.5 + rng.uniform(-0.28, 0.28, (lattice.size // 2, 2))) / (
        n_rows
    )
    place = 0.5 + 0.5 * np.sin(9.0 * stones[:, 1] + 3.0 * bend(stones[:, 0], stones[:, 1]))
    place += rng.normal(0.0, 0.07, len(stones))
    colours = np.stack([palette_colour(palette, float(p), rng) for p in place])
    canvas = Canvas(size, (0.10, 0.09, 0.09))
    y, x = np.mgrid[: canvas.side, : canvas.side] / canvas.side
    distance, nearest = cKDTree(stones).query(np.stack([x, y], axis=-1), k=2)
    depth = (distance[..., 1] - distance[..., 0]) * n_rows  # 0 between two stones
    inside = depth > 0.16
    canvas.colour[inside] = colours[nearest[..., 0][inside]]
    canvas.relief[inside] = 1.5 * np.minimum(depth[inside], 0.4) + 0.3
    return canvas.picture()


PAINTINGS: dict[str, Callable[[int, int], Image.Image]] = {
    "strokes": paint_strokes,
    "waves": paint_waves,
    "petals": paint_petals,
    "dabs": paint_dabs,
    "ink": paint_ink,
    "mosaic": paint_mosaic,
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

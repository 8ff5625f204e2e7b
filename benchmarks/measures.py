"""Held-out measures of style: how near a stylized picture comes to its style image.

Nothing here imports usdsmoke. One of these is aimed at: ``losses.nearest`` compares patches as wide
as those of `patch_distance`. Every function takes display-encoded pictures in [0, 1] of shape
[H W 3] and the smoke's alpha as a mask [H W]; only pixels inside the smoke count.

A bare value says little, so `score_views` puts each between two anchors made for the same view:
0 is the smoke tinted with the style's mean colour, 1 is the style itself pasted through the smoke's
mask (the mean over several random crops). Pictures and anchors stand on the same background, the
style's mean colour, so that translucent smoke mixes with nothing that the style does not have.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy import ndimage, spatial

from benchmarks.display import composite, decode_display, mean_colour

__all__ = [
    "MEASURES",
    "closure",
    "colour_distance",
    "edge_distance",
    "outlier_share",
    "paste_style",
    "patch_distance",
    "score_views",
    "spectrum_distance",
    "spectrum_root_distance",
]

PATCH = 7  # pixels along a side
SCALES = (1, 2, 4)  # area down-sampling factors
STYLE_PATCHES = 2000  # per scale, sampled
RESULT_PATCHES = 20000  # per scale, at most
DIRECTIONS = 64  # of the sliced distance
QUANTILES = 512
RINGS = 24  # of the radial spectrum, from the window's own resolution to Nyquist
CROPS = 16  # style crops whose spectra are averaged
EDGE_SCALES = (1, 2)  # area down-sampling factors at which edges are measured
FAR = 0.12  # distance in display-encoded RGB from which on a colour is none of the style's
SHADES = 9  # of every colour of the style, from black to itself, that are no outliers
PASTES = 6  # style pastes that make anchor 1
TEXTURE_FLOOR = 0.01  # standard deviation of white luminance noise that counts as no texture at all
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)


def patch_distance(style: np.ndarray, image: np.ndarray, mask: np.ndarray, seed: int = 0) -> float:
    """Mean distance of style patches to the nearest patch of the result, rms per value.

    The direction style to result asks whether the style's structures appear in the smoke, not
    whether the smoke is made of some of them. 7x7 RGB patches at 1, 1/2 and 1/4 of the size, those
    of the result wholly inside ``mask > 0.5``; scales at which no patch fits are left out. A blur
    may do well here, for a mean is near to everything: the spectrum tells.

    Returns:
        0 (every style patch is there) to about 1.

    Raises:
        ValueError: no patch fits at any scale.
    """
    _check(style, image, mask)
    distances = []
    for factor in SCALES:
        rng = np.random.default_rng([seed, factor])
        wanted = _patches(_shrink(style, factor), None)
        found = _patches(_shrink(image, factor), _shrink(mask[..., None], factor)[..., 0] > 0.5)
        if len(wanted) and len(found):
            wanted, found = _sample(wanted, STYLE_PATCHES, rng), _sample(found, RESULT_PATCHES, rng)
            distances.append(_nearest(wanted, found).mean())
    if not distances:
        raise ValueError(
            f"no {PATCH}x{PATCH} patch fits: style {style.shape[:2]}, smoke of "
            f"{int((mask > 0.5).sum())} pixels; wanted one patch of each; render the view larger"
        )
    return float(np.mean(distances))


def colour_distance(style: np.ndarray, image: np.ndarray, mask: np.ndarray) -> float:
    """Sliced Wasserstein-1 distance of the colours inside ``mask > 0.5`` to the style's.

    64 fixed directions spread evenly over the sphere; a shift of all colours by a vector of length
    d gives d / 2 in the mean.
    """
    _check(style, image, mask)
    wanted = _projected_quantiles(style.reshape(-1, 3))
    found = _projected_quantiles(image[mask > 0.5])
    return float(np.abs(wanted - found).mean())


def spectrum_distance(
    style: np.ndarray, image: np.ndarray, mask: np.ndarray, seed: int = 0
) -> float:
    """Mean square difference of the radial log power spectra of luminance inside the smoke.

    The window is the mask, eroded and feathered; its weighted mean is removed and its energy
    divided out. The style's spectrum is the mean over crops seen through the same window, so the
    window's own leakage is in both. Natural logarithms; the power of white noise of standard
    deviation 0.01 is added to both, so that what nobody sees does not decide.

    Returns:
        0 for equal spectra, 0.05 for two pieces of one painting, 2 for half its contrast, 6 for a
        blur of one pixel, 30 for a flat colour.
    """
    _check(style, image, mask)
    window, box = _window(mask)
    rng = np.random.default_rng([seed, 99])
    crops = [_crop(style, window.shape, rng) for _ in range(CROPS)]
    wanted = np.mean([_radial_power(crop @ LUMINANCE, window) for crop in crops], axis=0)
    found = _radial_power(image[box] @ LUMINANCE, window)
    floor = TEXTURE_FLOOR**2
    return float(np.mean(np.log((found + floor) / (wanted + floor)) ** 2))


def spectrum_root_distance(style: np.ndarray, image: np.ndarray, mask: np.ndarray) -> float:
    """Square root of `spectrum_distance`, in nepers: linear in the difference and so far less kind.

    A blur of one pixel keeps 0.8 of the closure in the mean square but 0.57 here.
    """
    return float(np.sqrt(spectrum_distance(style, image, mask)))


def edge_distance(style: np.ndarray, image: np.ndarray, mask: np.ndarray) -> float:
    """Wasserstein-1 distance of the sizes of luminance gradients inside ``mask > 0.5``.

    Against the style's, mean over the picture and half of its size. The closure falls for too soft
    *and* for too hard edges: blur has too many small gradients, noise too many large ones.
    """
    _check(style, image, mask)
    found = []
    for factor in EDGE_SCALES:
        inside = _shrink(mask[..., None], factor)[..., 0] > 0.5
        sizes = _gradient_sizes(_shrink(image, factor))[inside[:-1, :-1]]
        if sizes.size:
            levels = (np.arange(QUANTILES) + 0.5) / QUANTILES
            wanted = np.quantile(_gradient_sizes(_shrink(style, factor)), levels)
            found.append(np.abs(np.quantile(sizes, levels) - wanted).mean())
    return float(np.mean(found))


def outlier_share(style: np.ndarray, image: np.ndarray, mask: np.ndarray) -> float:
    """Share of the pixels inside ``mask > 0.5`` whose colour is none of the style's, in [0, 1].

    That is farther than 0.12 in display-encoded RGB from all of the style's colours and from their
    shades in the dark. Confetti has many, a blur few. No background may shine through: give the
    smoke's own colours, with the opacity divided out.
    """
    _check(style, image, mask)
    palette = np.unique(np.rint(style.reshape(-1, 3) * 32.0), axis=0) / 32.0
    shades = palette * np.linspace(0.0, 1.0, SHADES)[:, None, None]
    distance, _ = spatial.cKDTree(shades.reshape(-1, 3)).query(image[mask > 0.5])
    return float((distance > FAR).mean())


MEASURES: dict[str, Callable[[np.ndarray, np.ndarray, np.ndarray], float]] = {
    "patch": patch_distance,
    "colour": colour_distance,
    "spectrum": spectrum_distance,
    "spectrum_root": spectrum_root_distance,
    "edges": edge_distance,
}


def closure(value: float, zero: float, one: float) -> float:
    """Where ``value`` lies between its anchors: 0 at ``zero``, 1 at ``one``, above 1 beyond it.

    Raises:
        ValueError: the anchors do not differ, so nothing lies between them.
    """
    if not zero > one:
        raise ValueError(
            f"anchor 0 measures {zero:.4g} and anchor 1 {one:.4g}; wanted the tinted smoke to be "
            "the farther one; take a style with structure that this measure sees"
        )
    return (zero - value) / (zero - one)


def paste_style(style: np.ndarray, mask: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The style seen through the smoke: a random crop under the mask, over the style's mean colour.

    The crop covers the smoke's bounding box; a style smaller than that box is tiled.

    Returns:
        Display-encoded picture [H W 3].
    """
    rows, columns = _bounding_box(mask > 0.0)
    crop = _crop(style, (rows.stop - rows.start, columns.stop - columns.start), rng)
    premultiplied = np.zeros((*mask.shape, 3), dtype=np.float32)
    premultiplied[rows, columns] = decode_display(crop) * mask[rows, columns, None]
    return composite(premultiplied, mask, mean_colour(style))


def score_views(
    style: np.ndarray, images: Sequence[np.ndarray], masks: Sequence[np.ndarray], seed: int = 0
) -> dict[str, dict[str, Any]]:
    """Every measure of every view between its two anchors.

    Args:
        style: display-encoded [h w 3], at the scale at which its structures should appear.
        images: display-encoded views [H W 3], over the style's mean colour (see `composite`).
        masks: their alpha [H W] in [0, 1].
        seed: of patch samples and crops; two calls with one seed agree to the bit.

    Returns:
        By measure: ``closure``, ``value``, ``zero``, ``one`` and ``noise`` (standard deviation of
        the closure of a single paste), one number per view in each; ``mean`` and ``min`` of the
        closures. A view whose anchors are in the wrong order has no scale: its closure and noise
        are NaN, and mean and minimum are those of the other views, NaN where there is none.
    """
    if len(images) != len(masks) or not images:
        raise ValueError(
            f"{len(images)} images and {len(masks)} masks; wanted one or more, a mask for each"
        )
    rows: dict[str, list[dict[str, float]]] = {name: [] for name in MEASURES}
    for number, (image, mask) in enumerate(zip(images, masks, strict=True)):
        rng = np.random.default_rng([seed, number])
        pastes = [paste_style(style, mask, rng) for _ in range(PASTES)]
        flat = np.broadcast_to(mean_colour(style), image.shape)
        for name, measure in MEASURES.items():
            ones = [measure(style, paste, mask) for paste in pastes]
            rows[name].append(_row(measure(style, image, mask), measure(style, flat, mask), ones))
    keys = ("closure", "value", "zero", "one", "noise")
    scores: dict[str, dict[str, Any]] = {}
    for name, entries in rows.items():
        scores[name] = {key: [entry[key] for entry in entries] for key in keys}
        told = [entry["closure"] for entry in entries if not math.isnan(entry["closure"])]
        scores[name]["mean"] = float(np.mean(told)) if told else math.nan
        scores[name]["min"] = min(told, default=math.nan)
    return scores


def _row(value: float, zero: float, ones: Sequence[float]) -> dict[str, float]:
    one = float(np.mean(ones))
    if not zero > one:
        return {"closure": math.nan, "value": value, "zero": zero, "one": one, "noise": math.nan}
    noise = float(np.std([closure(single, zero, one) for single in ones]))
    reached = closure(value, zero, one)
    return {"closure": reached, "value": value, "zero": zero, "one": one, "noise": noise}


def _check(style: np.ndarray, image: np.ndarray, mask: np.ndarray) -> None:
    shapes_fit = mask.ndim == 2 and image.shape == (*mask.shape, 3)
    if not shapes_fit or style.ndim != 3 or style.shape[2] != 3:
        raise ValueError(
            f"style {style.shape}, image {image.shape}, mask {mask.shape}; "
            "wanted [h w 3], [H W 3] and [H W]"
        )
    if not (mask > 0.5).any():
        raise ValueError("no pixel of the mask is above 0.5; wanted smoke; move the view")


def _shrink(image: np.ndarray, factor: int) -> np.ndarray:
    """Area down-sampling; rows and columns that do not fill a block are cut off."""
    height, width = (size // factor for size in image.shape[:2])
    blocks = image[: height * factor, : width * factor].reshape(height, factor, width, factor, -1)
    return blocks.mean(axis=(1, 3))


def _gradient_sizes(image: np.ndarray) -> np.ndarray:
    """Of the luminance, per pixel, [H-1 W-1]: forward differences."""
    light = image @ LUMINANCE
    return np.hypot(np.diff(light, axis=1)[:-1], np.diff(light, axis=0)[:, :-1])


def _patches(image: np.ndarray, inside: np.ndarray | None) -> np.ndarray:
    """All 7x7 patches [N 147], or those whose every pixel is inside."""
    if min(image.shape[:2]) < PATCH:
        return np.zeros((0, PATCH * PATCH * 3), np.float32)
    views = np.lib.stride_tricks.sliding_window_view(image, (PATCH, PATCH, 3))[:, :, 0]
    if inside is None:
        return views.reshape(-1, PATCH * PATCH * 3).astype(np.float32)
    whole = np.lib.stride_tricks.sliding_window_view(inside, (PATCH, PATCH)).all(axis=(2, 3))
    return views[whole].reshape(-1, PATCH * PATCH * 3).astype(np.float32)


def _sample(rows: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    return rows if len(rows) <= count else rows[rng.choice(len(rows), count, replace=False)]


def _nearest(wanted: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Rms distance per value of each wanted row [N] to its nearest found row."""
    square = (found**2).sum(axis=1)
    nearest = [
        np.argmin(square - 2.0 * (chunk @ found.T), axis=1)
        for chunk in np.array_split(wanted, max(1, len(wanted) // 500))
    ]
    # The expanded square only ranks; the distance itself is taken without its cancellation.
    return np.sqrt(((wanted - found[np.concatenate(nearest)]) ** 2).mean(axis=1))


def _projected_quantiles(colours: np.ndarray) -> np.ndarray:
    """Quantile function of the colours [N 3] along every direction, [DIRECTIONS QUANTILES]."""
    ordered = np.sort(_even_directions(DIRECTIONS) @ colours.T.astype(np.float32), axis=1)
    last = len(colours) - 1
    position = (np.arange(QUANTILES) + 0.5) / QUANTILES * len(colours) - 0.5
    position = np.clip(position, 0, last)
    low = np.floor(position).astype(int)
    high = np.minimum(low + 1, last)
    return ordered[:, low] + (position - low) * (ordered[:, high] - ordered[:, low])


def _even_directions(count: int) -> np.ndarray:
    """Unit vectors [count 3] on a spiral over the half sphere; opposites measure the same."""
    height = (np.arange(count) + 0.5) / count
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    ring = np.sqrt(1.0 - height**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1).astype(np.float32)


def _bounding_box(inside: np.ndarray) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def _crop(style: np.ndarray, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """A random piece of the style [*shape 3]; tiled along an axis in which it is too small."""
    for axis, size in enumerate(shape[:2]):
        repeats = 1 if style.shape[axis] >= size else -(-size // style.shape[axis]) + 1
        style = np.concatenate([style] * repeats, axis=axis)
        start = int(rng.integers(style.shape[axis] - size + 1))
        style = np.take(style, np.arange(start, start + size), axis=axis)
    return style


def _window(mask: np.ndarray) -> tuple[np.ndarray, tuple[slice, slice]]:
    """The mask eroded by a pixel and feathered, cut to its bounding box, and that box."""
    inside = np.pad(mask > 0.5, 1)
    depth = ndimage.distance_transform_edt(inside)[1:-1, 1:-1] - 1.0
    depth = depth if depth.max() > 0 else depth + 1.0
    feather = max(1.0, 0.5 * depth.max())
    window = np.sin(0.5 * np.pi * np.clip(depth / feather, 0.0, 1.0)) ** 2
    box = _bounding_box(window > 0)
    return window[box], box


def _radial_power(luminance: np.ndarray, window: np.ndarray) -> np.ndarray:
    """Mean power in rings of equal width; over all frequencies it would average to the variance."""
    mean = (luminance * window).sum() / window.sum()
    size = max(window.shape)  # square, so that a ring is a ring
    spectrum = np.fft.rfft2((luminance - mean) * window, s=(size, size))
    power = np.abs(spectrum) ** 2 / (window**2).sum()
    radius = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :])
    edges = np.linspace(1.0 / min(window.shape), 0.5, RINGS + 1)
    counts, _ = np.histogram(radius, edges)
    sums, _ = np.histogram(radius, edges, weights=power)
    return sums[counts > 0] / counts[counts > 0]

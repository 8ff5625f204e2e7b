"""The measures of style: known good pictures score 1, known bad ones score less."""

import numpy as np
import pytest
from scipy import ndimage

from benchmarks import measures
from benchmarks.display import composite, decode_display, encode_display, mean_colour

SIZE = 96


@pytest.fixture(scope="module")
def style() -> np.ndarray:
    """Hard-edged blobs of four sizes in a small palette, [160 192 3]."""
    rng = np.random.default_rng(0)
    palette = np.array([[0.9, 0.7, 0.1], [0.1, 0.2, 0.6], [0.8, 0.2, 0.2], [0.1, 0.5, 0.4]])
    noise = sum(
        np.sqrt(blur) * ndimage.gaussian_filter(rng.standard_normal((160, 192)), blur, mode="wrap")
        for blur in (1.0, 2.0, 4.0, 8.0)
    )
    return palette[np.digitize(noise, np.quantile(noise, (0.25, 0.5, 0.75)))].astype(np.float32)


@pytest.fixture(scope="module")
def mask() -> np.ndarray:
    """A soft-edged ellipse of smoke, [H W]."""
    y, x = np.mgrid[:SIZE, :SIZE] - SIZE / 2
    return np.clip(3.0 - 3.0 * np.hypot(y / 44, x / 36), 0.0, 1.0).astype(np.float32)


def closures(style: np.ndarray, image: np.ndarray, mask: np.ndarray) -> dict[str, float]:
    return {name: row["mean"] for name, row in measures.score_views(style, [image], [mask]).items()}


def test_the_pasted_style_scores_one_and_flat_colour_zero(
    style: np.ndarray, mask: np.ndarray
) -> None:
    pastes = [measures.paste_style(style, mask, np.random.default_rng(100 + n)) for n in range(4)]
    for name, row in measures.score_views(style, pastes, [mask] * 4).items():
        noise = float(np.mean(row["noise"]))
        assert noise < 0.15 and abs(row["mean"] - 1.0) < 3.0 * noise + 0.01, name
    flat = np.broadcast_to(mean_colour(style), (SIZE, SIZE, 3))
    assert list(closures(style, flat, mask).values()) == pytest.approx(
        [0.0] * len(measures.MEASURES), abs=1e-6
    )


def test_blur_a_wrong_palette_and_noise_score_less(style: np.ndarray, mask: np.ndarray) -> None:
    pasted = measures.paste_style(style, mask, np.random.default_rng(1234))
    right = closures(style, pasted, mask)
    blurred = closures(style, ndimage.gaussian_filter(pasted, (4.0, 4.0, 0)), mask)
    assert blurred["spectrum"] < 0.6 < right["spectrum"] and blurred["colour"] < right["colour"]
    wrong = closures(style, pasted[..., [1, 2, 0]], mask)
    assert wrong["colour"] < right["colour"] - 0.5
    noise = np.random.default_rng(6).uniform(0.0, 1.0, (SIZE, SIZE, 3)).astype(np.float32)
    scores = closures(style, noise, mask)
    assert scores["patch"] < 0.0 and scores["colour"] < 0.7


def test_edges_see_a_blur_of_one_pixel_and_noise(style: np.ndarray, mask: np.ndarray) -> None:
    pasted = measures.paste_style(style, mask, np.random.default_rng(1234))
    assert closures(style, pasted, mask)["edges"] > 0.8
    soft = ndimage.gaussian_filter(pasted, (1.0, 1.0, 0))
    assert closures(style, soft, mask)["edges"] < 0.7
    assert closures(style, ndimage.gaussian_filter(pasted, (3.0, 3.0, 0)), mask)["edges"] < 0.4
    noise = np.random.default_rng(6).uniform(0.0, 1.0, (SIZE, SIZE, 3)).astype(np.float32)
    assert closures(style, noise, mask)["edges"] < 0.4


def test_confetti_is_all_outliers_and_shades_are_none(style: np.ndarray, mask: np.ndarray) -> None:
    crop = style[:SIZE, :SIZE]
    assert measures.outlier_share(style, crop, mask) == 0.0
    assert measures.outlier_share(style, 0.6 * crop, mask) < 0.02
    confetti = np.where(np.random.default_rng(6).random((SIZE, SIZE, 1)) < 0.3, [1, 0, 1], crop)
    assert measures.outlier_share(style, confetti, mask) == pytest.approx(0.3, abs=0.05)


def test_only_pixels_of_the_smoke_are_measured(style: np.ndarray, mask: np.ndarray) -> None:
    pasted = measures.paste_style(style, mask, np.random.default_rng(1234))
    littered = np.where(mask[..., None] > 0.5, pasted, 1.0 - pasted)
    for name, measure in measures.MEASURES.items():
        # blocks and differences reach a pixel or two over the border
        bound = {"patch": 0.01, "edges": 0.002}.get(name, 1e-7)
        expected = measure(style, pasted, mask)
        assert measure(style, littered, mask) == pytest.approx(expected, abs=bound)


def test_flat_colours_are_as_far_apart_as_their_rms_difference(mask: np.ndarray) -> None:
    style = np.full((64, 64, 3), 0.5, dtype=np.float32)
    image = np.full((SIZE, SIZE, 3), 0.5, dtype=np.float32) + np.float32([0.3, 0.0, -0.4])
    expected = np.sqrt((0.3**2 + 0.4**2) / 3)
    assert measures.patch_distance(style, image, mask) == pytest.approx(expected, rel=1e-5)


def test_a_view_whose_flat_colour_is_nearer_than_crops_has_no_part_in_the_mean() -> None:
    """A patch of noise is farther from other noise than from grey; the whole style holds itself."""
    style = np.random.default_rng(0).uniform(0.3, 0.7, (24, 24, 3)).astype(np.float32)
    whole, corner = np.ones((24, 24), np.float32), np.zeros((24, 24), np.float32)
    corner[:9, :9] = 1.0
    both = measures.score_views(style, [style, style], [whole, corner])["patch"]
    alone = measures.score_views(style, [style], [whole])["patch"]
    assert np.isnan(both["closure"]).tolist() == [False, True]
    assert both["mean"] == both["min"] == alone["mean"]
    assert np.isnan(measures.score_views(style, [style], [corner])["patch"]["mean"])


@pytest.mark.parametrize(("image_shape", "level"), [((8, 9, 3), 1.0), ((8, 8, 3), 0.4)])
def test_pictures_that_cannot_be_measured_are_refused(
    style: np.ndarray, image_shape: tuple[int, ...], level: float
) -> None:
    image, mask = np.zeros(image_shape, np.float32), np.full((8, 8), level, np.float32)
    for measure in measures.MEASURES.values():
        with pytest.raises(ValueError, match=r"\[h w 3\]|mask"):
            measure(style, image, mask)
    with pytest.raises(ValueError, match="mask"):
        measures.score_views(style, [style], [])


def test_display_encoding_is_that_of_srgb() -> None:
    linear = np.linspace(0.0, 1.0, 1001)
    assert np.allclose(decode_display(encode_display(linear)), linear, atol=1e-6)
    assert encode_display(np.array(0.2140411)) == pytest.approx(0.5, abs=1e-6)
    fill, alpha = np.array([0.6, 0.3, 0.2], np.float32), np.full((2, 2), 0.4, np.float32)
    picture = composite(decode_display(fill) * alpha[..., None], alpha, fill)
    assert np.allclose(picture, fill, atol=1e-6)

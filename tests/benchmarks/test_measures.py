"""The benchmark's measures of style against closed forms, and against pictures of known quality."""

import itertools

import numpy as np
import pytest
from scipy import ndimage

from benchmarks import measures
from benchmarks.display import composite, decode_display, encode_display, mean_colour

SIZE = 96


def make_style(seed: int = 0) -> np.ndarray:
    """A picture of hard-edged blobs of four sizes in a small palette, [160 192 3]."""
    rng = np.random.default_rng(seed)
    palette = np.array([[0.9, 0.7, 0.1], [0.1, 0.2, 0.6], [0.8, 0.2, 0.2], [0.1, 0.5, 0.4]])
    noise = sum(
        np.sqrt(blur) * ndimage.gaussian_filter(rng.standard_normal((160, 192)), blur, mode="wrap")
        for blur in (1.0, 2.0, 4.0, 8.0)
    )
    places = np.digitize(noise, np.quantile(noise, (0.25, 0.5, 0.75)))
    return palette[places].astype(np.float32)


def make_mask() -> np.ndarray:
    """A soft-edged ellipse of smoke, [H W]."""
    y, x = np.mgrid[:SIZE, :SIZE] - SIZE / 2
    return np.clip(3.0 - 3.0 * np.hypot(y / 44, x / 36), 0.0, 1.0).astype(np.float32)


def blur(image: np.ndarray, sigma: float) -> np.ndarray:
    return ndimage.gaussian_filter(image, (sigma, sigma, 0))


@pytest.fixture(scope="module")
def style() -> np.ndarray:
    return make_style()


@pytest.fixture(scope="module")
def mask() -> np.ndarray:
    return make_mask()


@pytest.fixture(scope="module")
def pasted(style: np.ndarray, mask: np.ndarray) -> np.ndarray:
    return measures.paste_style(style, mask, np.random.default_rng(1234))


def closures(style: np.ndarray, image: np.ndarray, mask: np.ndarray) -> dict[str, float]:
    return {name: row["mean"] for name, row in measures.score_views(style, [image], [mask]).items()}


def test_display_encoding_returns_from_a_round_trip_and_maps_middle_grey():
    linear = np.linspace(0.0, 1.0, 1001)
    assert np.allclose(decode_display(encode_display(linear)), linear, atol=1e-6)
    assert encode_display(np.array(0.2140411)) == pytest.approx(0.5, abs=1e-6)


def test_composite_of_a_constant_colour_over_itself_is_that_colour(mask: np.ndarray):
    fill = np.array([0.6, 0.3, 0.2], dtype=np.float32)
    picture = composite(decode_display(fill) * mask[..., None], mask, fill)
    assert np.allclose(picture, fill, atol=1e-6)


def test_patch_distance_is_zero_when_every_style_patch_is_inside(style: np.ndarray):
    piece = style[:SIZE, :SIZE]  # few enough patches that none is left out
    everywhere = np.ones((SIZE, SIZE), dtype=np.float32)
    assert measures.patch_distance(piece, piece, everywhere) == pytest.approx(0.0, abs=1e-6)


def test_patch_distance_between_two_flat_colours_is_their_rms_difference(mask: np.ndarray):
    style = np.full((64, 64, 3), 0.5, dtype=np.float32)
    image = np.full((SIZE, SIZE, 3), 0.5, dtype=np.float32) + np.float32([0.3, 0.0, -0.4])
    wanted = np.sqrt((0.3**2 + 0.4**2) / 3)
    assert measures.patch_distance(style, image, mask) == pytest.approx(wanted, rel=1e-5)


def test_colour_distance_of_a_shift_is_half_its_length_and_blind_to_pixel_order():
    rng = np.random.default_rng(3)
    style = rng.uniform(0.2, 0.6, (70, 50, 3)).astype(np.float32)
    everywhere = np.ones((70, 50), dtype=np.float32)
    shuffled = rng.permutation(style.reshape(-1, 3)).reshape(style.shape)
    shift = np.float32([0.1, 0.2, -0.2])
    assert measures.colour_distance(style, shuffled, everywhere) < 1e-6
    # 0.5 is the mean of |cosine| over the sphere; 64 directions reach it to a percent or so.
    assert measures.colour_distance(style, style + shift, everywhere) == pytest.approx(
        0.15, rel=0.02
    )


def test_spectrum_distance_of_scaled_noise_is_the_square_of_its_log_power_ratio():
    rng = np.random.default_rng(4)
    noise = 0.1 * rng.standard_normal((256, 256, 1)).repeat(3, axis=2).astype(np.float32)
    everywhere = np.ones((256, 256), dtype=np.float32)
    floor = measures.TEXTURE_FLOOR**2
    wanted = np.log((0.01 / 9 + floor) / (0.01 + floor)) ** 2
    found = measures.spectrum_distance(0.5 + noise, 0.5 + noise / 3, everywhere)
    assert found == pytest.approx(wanted, rel=0.03)


def test_radial_power_of_white_noise_is_its_variance_whatever_the_window(mask: np.ndarray):
    noise = np.random.default_rng(5).normal(0.5, 0.2, mask.shape)
    for window in (np.ones_like(mask), mask):
        assert measures._radial_power(noise, window).mean() == pytest.approx(0.04, rel=0.05)


def test_pixels_outside_the_smoke_do_not_count(
    style: np.ndarray, pasted: np.ndarray, mask: np.ndarray
):
    littered = np.where(mask[..., None] > 0.5, pasted, 1.0 - pasted)
    for name, measure in measures.MEASURES.items():
        # Only blocks of the coarser patch scales reach a pixel or two over the border.
        bound = 0.01 if name == "patch" else 1e-7
        assert measure(style, littered, mask) == pytest.approx(
            measure(style, pasted, mask), abs=bound
        )


def test_the_pasted_style_closes_to_one_within_the_noise_between_crops(
    style: np.ndarray, mask: np.ndarray
):
    pastes = [measures.paste_style(style, mask, np.random.default_rng(100 + n)) for n in range(4)]
    for name, row in measures.score_views(style, pastes, [mask] * 4).items():
        noise = float(np.mean(row["noise"]))
        assert noise < 0.15, name
        assert abs(row["mean"] - 1.0) < 3.0 * noise + 0.01, name


def test_the_tinted_smoke_closes_to_zero(style: np.ndarray, mask: np.ndarray):
    flat = np.broadcast_to(mean_colour(style), (SIZE, SIZE, 3))
    assert all(
        value == pytest.approx(0.0, abs=1e-6) for value in closures(style, flat, mask).values()
    )


def test_blur_lowers_the_spectrum_and_colour_closures_step_by_step(
    style: np.ndarray, pasted: np.ndarray, mask: np.ndarray
):
    steps = [closures(style, blur(pasted, sigma), mask) for sigma in (0.0, 0.5, 1.0, 2.0, 4.0)]
    for name in ("colour", "spectrum", "spectrum_root"):
        values = [step[name] for step in steps]
        assert all(later < earlier for earlier, later in itertools.pairwise(values)), name
    assert steps[-1]["spectrum"] < 0.6


def test_a_wrong_palette_lowers_the_colour_closure_and_leaves_a_grey_spectrum_alone(
    style: np.ndarray, pasted: np.ndarray, mask: np.ndarray
):
    right, wrong = closures(style, pasted, mask), closures(style, pasted[..., [1, 2, 0]], mask)
    assert wrong["colour"] < right["colour"] - 0.5
    grey, turned = (np.repeat(x @ measures.LUMINANCE[:, None], 3, axis=2) for x in (style, pasted))
    assert closures(grey, turned, mask)["spectrum"] > 0.95


def test_white_noise_does_not_pass_for_style(style: np.ndarray, mask: np.ndarray):
    noise = np.random.default_rng(6).uniform(0.0, 1.0, (SIZE, SIZE, 3)).astype(np.float32)
    scores = closures(style, noise, mask)
    assert scores["patch"] < 0.0 and scores["colour"] < 0.7


def test_scores_repeat_to_the_bit_and_name_the_worst_view(
    style: np.ndarray, pasted: np.ndarray, mask: np.ndarray
):
    views = [pasted, blur(pasted, 2.0)]
    first, second = (measures.score_views(style, views, [mask, mask], seed=8) for _ in range(2))
    assert first == second
    assert first["spectrum"]["min"] == first["spectrum"]["closure"][1]


def test_a_style_smaller_than_the_smoke_is_tiled(style: np.ndarray, mask: np.ndarray):
    small = style[:20, :24]
    picture = measures.paste_style(small, np.ones_like(mask), np.random.default_rng(0))
    assert np.allclose(picture[:-20], picture[20:], atol=1e-6)
    assert np.allclose(picture[:, :-24], picture[:, 24:], atol=1e-6)


def test_closure_is_linear_between_its_anchors_and_refuses_equal_ones():
    assert [measures.closure(value, 3.0, 1.0) for value in (3.0, 2.0, 1.0, 0.5)] == [
        0,
        0.5,
        1,
        1.25,
    ]
    with pytest.raises(ValueError, match="take a style with structure"):
        measures.closure(1.0, 2.0, 2.0)


@pytest.mark.parametrize(
    ("image_shape", "mask_value", "message"),
    [
        ((8, 8, 4), 1.0, r"wanted \[h w 3\]"),
        ((8, 9, 3), 1.0, r"wanted \[h w 3\]"),
        ((8, 8, 3), 0.4, "no pixel of the mask is above 0.5"),
    ],
)
def test_pictures_that_cannot_be_measured_are_refused(
    style: np.ndarray, image_shape: tuple[int, ...], mask_value: float, message: str
):
    image, mask = np.zeros(image_shape, np.float32), np.full((8, 8), mask_value, np.float32)
    for measure in measures.MEASURES.values():
        with pytest.raises(ValueError, match=message):
            measure(style, image, mask)


def test_views_without_their_masks_or_too_small_for_a_patch_are_refused(style: np.ndarray):
    with pytest.raises(ValueError, match="a mask for each"):
        measures.score_views(style, [style], [])
    tiny = np.zeros((5, 5, 3), np.float32)
    with pytest.raises(ValueError, match="render the view larger"):
        measures.patch_distance(style, tiny, np.ones((5, 5), np.float32))

"""The look is guarded: a change that blurs, greys or noises the example plume fails here."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy import ndimage

from tests.baselines.look import LIMITS, Picture, differences, make_pictures, read_pictures


def test_the_plume_looks_like_its_golden_pictures() -> None:
    for golden, found in zip(read_pictures(), make_pictures(), strict=True):
        for name, value in differences(golden, found).items():
            assert abs(value) < LIMITS[name], name


def _noised(picture: np.ndarray) -> np.ndarray:
    noise = np.random.default_rng(0).normal(0.0, 0.15, picture.shape)
    return np.clip(picture + noise, 0.0, 1.0).astype(np.float32)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (lambda picture: ndimage.gaussian_filter(picture, (0.5, 0.5, 0)), "detail"),
        (lambda picture: ndimage.gaussian_filter(picture, (0.5, 0.5, 0)), "edges"),
        (_noised, "detail"),
        (lambda picture: picture[..., ::-1], "colours"),
    ],
)
def test_blurred_noised_and_wrongly_coloured_pictures_are_found_out(
    change: Callable[[np.ndarray], np.ndarray], name: str
) -> None:
    for picture, alpha in read_pictures():
        golden: Picture = (picture, alpha)
        assert abs(differences(golden, (change(picture), alpha))[name]) > LIMITS[name]

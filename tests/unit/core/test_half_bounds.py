"""What 16-bit floats cannot hold is refused before a frame is stylized, and only then."""

import dataclasses
from contextlib import nullcontext

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import frame_of, puff
from tests.fixtures.stylize_fixtures import quick_config
from usdsmoke.base.errors import ConfigError
from usdsmoke.base.storage import LARGEST_HALF
from usdsmoke.core.sequence.controls import BRIGHTEST, check_storable
from usdsmoke.core.smoke import srgb


def test_the_bound_on_emission_is_the_light_of_the_brightest_colour() -> None:
    brightest = float(srgb.decode_srgb(torch.tensor([srgb.BRIGHTEST]))[0])
    assert brightest == pytest.approx(BRIGHTEST, rel=0.002)
    assert brightest <= BRIGHTEST


@pytest.mark.parametrize(("share", "refused"), [(0.99, False), (1.01, True)])
def test_what_16_bit_floats_cannot_hold_is_refused(share: float, refused: bool) -> None:
    config = quick_config(grids={"half": True})
    density = frame_of(puff(6)).density
    density = dataclasses.replace(density, values=density.values / np.max(density.values))
    gamma_w = share * LARGEST_HALF / BRIGHTEST
    expected = pytest.raises(ConfigError, match="emission at timeCode 1")
    with expected if refused else nullcontext():
        check_storable(density, 1.0, gamma_w, config)


@pytest.mark.parametrize(
    ("settings", "refused"),
    [
        ({}, True),
        ({"colour": {"target": "albedo"}}, False),  # Cd alone is written
        ({"optimize": {"steps": ["shape"]}}, False),
        ({"layer": {"emission_mode": "perDensity"}}, False),  # no number is as large as E
    ],
)
def test_only_an_emission_that_is_written_counts(
    settings: dict[str, dict[str, object]], refused: bool
) -> None:
    config = quick_config(grids={"half": True}, **settings)
    density = frame_of(puff(6)).density
    density = dataclasses.replace(density, values=1e3 * density.values / density.values.max())
    with pytest.raises(ConfigError, match="emission") if refused else nullcontext():
        check_storable(density, 1.0, 0.1 * LARGEST_HALF / BRIGHTEST, config)

"""What particular renderers want, in closed form: emission per density, albedo, single channels."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from usdsmoke.base.naming import channel_names, colour_names
from usdsmoke.base.volume import DenseField
from usdsmoke.config.run_sections import LayerConfig
from usdsmoke.config.settings import Config
from usdsmoke.vdb.colour_grids import absolute_emission, empty_colour_grids, make_colour_grids

GAMMA_W = 0.37
SETTINGS = st.builds(
    LayerConfig,
    emission_mode=st.sampled_from(["absolute", "perDensity"]),
    scatter_colour=st.lists(st.sampled_from(["Cd", "color"]), unique=True),
    split_rgb=st.booleans(),
)


def grid(
    values: np.ndarray, ijk_min: tuple[int, int, int] = (0, 0, 0), name: str = "density"
) -> DenseField:
    """A grid of floats, or of vectors with three numbers a voxel."""
    is_colour = values.ndim == 4
    return DenseField(
        name,
        values.astype(np.float32),
        ijk_min,
        np.diag([0.5, 0.5, 0.5, 1.0]),
        (0.0, 0.0, 0.0) if is_colour else 0.0,
        "unknown" if is_colour else "fog volume",
    )


def painted(seed: int) -> tuple[DenseField, DenseField, np.ndarray]:
    """Density with holes, emission of a random colour, and the colour."""
    random = np.random.default_rng(seed)
    shape = tuple(random.integers(1, 5, 3).tolist())
    density = random.random(shape) * 10.0 ** random.integers(-6, 4)
    density[random.random(shape) < 0.3] = 0
    colour = random.random((*shape, 3))
    return grid(density), grid(colour * GAMMA_W * density[..., None], name="emission"), colour


def made(
    density: DenseField,
    emission: DenseField,
    layer: LayerConfig,
    gamma_w: float = GAMMA_W,
    stops: float = 0.0,
) -> dict[str, DenseField]:
    grids = make_colour_grids(density, [emission], gamma_w, Config(layer=layer), stops)
    return {field.name: field for field in grids}


ALL = LayerConfig(emission_mode="perDensity", scatter_colour=["Cd", "color"], split_rgb=True)


@given(st.integers(0, 10**6), SETTINGS)
def test_every_grid_follows_from_density_and_emission(seed: int, config: LayerConfig) -> None:
    density, emission, colour = painted(seed)
    before = emission.values.copy()
    grids = made(density, emission, config)
    names = colour_names(config.scatter_colour, config.split_rgb)
    assert tuple(grids) == names
    d, e = density.values.astype(float), emission.values.astype(float)
    smoke = d > 0
    assert set(grids) >= {"emission", *config.scatter_colour}
    if config.emission_mode == "absolute":
        np.testing.assert_array_equal(grids["emission"].values, emission.values)
    else:
        wanted = (e[smoke] / d[smoke][:, None]).astype(np.float32)
        np.testing.assert_array_equal(grids["emission"].values[smoke], wanted)
        np.testing.assert_allclose(wanted, colour[smoke] * GAMMA_W, rtol=3e-7)
    for name in config.scatter_colour:
        wanted = (e[smoke] / (GAMMA_W * d[smoke][:, None])).astype(np.float32)
        np.testing.assert_array_equal(grids[name].values[smoke], np.minimum(wanted, 1))
        np.testing.assert_allclose(grids[name].values[smoke], colour[smoke], rtol=3e-7)
    for field in grids.values():
        assert not field.values[~smoke].any()
        assert field.values.dtype == np.float32 and field.values.flags.c_contiguous
        assert field.ijk_min == density.ijk_min and field.grid_class == "unknown"
        assert field.index_to_world is emission.index_to_world
    if config.split_rgb:
        for vector in ("emission", *config.scatter_colour):
            parts = [grids[name] for name in channel_names(vector)]
            stacked = np.stack([part.values for part in parts], -1)
            np.testing.assert_array_equal(stacked, grids[vector].values)
            assert [part.background for part in parts] == [0.0, 0.0, 0.0]
    np.testing.assert_array_equal(emission.values, before)


def test_without_the_options_the_emission_is_handed_on_as_it_is() -> None:
    density, emission, _ = painted(1)
    (only,) = make_colour_grids(density, [emission], GAMMA_W, Config(), 0.0)
    assert only == emission
    assert only.values is emission.values


@given(st.integers(0, 10**6))
def test_density_times_what_is_per_density_is_the_absolute_emission_again(seed: int) -> None:
    density, emission, _ = painted(seed)
    stored = made(density, emission, ALL)["emission"]
    again = absolute_emission(density, stored, "perDensity")
    np.testing.assert_allclose(again.values, emission.values, rtol=2.0**-22)
    assert absolute_emission(density, emission, "absolute") is emission


def test_boxes_that_differ_are_brought_together_by_their_place() -> None:
    density = grid(np.arange(1.0, 28.0).reshape(3, 3, 3), (5, 0, -1))
    emission = grid(np.ones((3, 2, 4, 3)), (6, 1, -2), "emission")
    result = made(density, emission, ALL, 1.0)["emission"]
    for place in np.ndindex(3, 2, 4):
        at = np.add(place, (6, 1, -2)) - (5, 0, -1)
        inside = (at >= 0).all() and (at < 3).all()
        wanted = 1 / density.values[tuple(at)] if inside else 0
        np.testing.assert_array_equal(result.values[place], np.full(3, wanted, np.float32))
    away = dataclasses.replace(emission, ijk_min=(50, 50, 50))
    assert not made(density, away, ALL)["emission"].values.any()


def test_the_thinnest_smoke_gives_finite_numbers_and_no_albedo_above_one() -> None:
    least = np.nextafter(np.float32(0), np.float32(1))
    density = grid(np.array([least, 1e-40, 1e-38, 1.0, 0.0, -1.0]).reshape(6, 1, 1))
    light = density.values[..., None] * np.float32(1.0000002)
    emission = grid(np.repeat(light, 3, axis=3), name="emission")
    grids = made(density, emission, ALL, 1.0)
    for field in grids.values():
        assert np.isfinite(field.values).all()
        assert not field.values[4:].any()
    assert grids["Cd"].values.max() == 1


@pytest.mark.parametrize("shape", [(0, 0, 0), (0, 0, 0, 3)])
def test_an_empty_emission_gives_empty_grids(shape: tuple[int, ...]) -> None:
    emission = dataclasses.replace(grid(np.zeros((1, 1, 1, 3))), name="emission")
    emission = dataclasses.replace(emission, values=np.zeros(shape, np.float32))
    grids = made(grid(np.zeros((0, 0, 0))), emission, ALL)
    assert tuple(grids) == colour_names(["Cd", "color"], split=True)
    assert all(field.is_empty for field in grids.values())
    assert made(grid(np.ones((2, 2, 2))), emission, ALL).keys() == grids.keys()


def test_no_extinction_gives_no_albedo() -> None:
    density, emission, _ = painted(3)
    assert not made(density, emission, ALL, 0.0)["Cd"].values.any()


def test_the_file_without_colour_has_the_same_grids() -> None:
    matrix = np.diag([2.0, 2.0, 2.0, 1.0])
    density, emission, _ = painted(4)
    for layer in (LayerConfig(), ALL, LayerConfig(split_rgb=True)):
        config = Config(layer=layer)
        full = make_colour_grids(density, [emission], GAMMA_W, config, 0.0)
        empty = empty_colour_grids(matrix, config)
        for one, other in zip(full, empty, strict=True):
            assert (one.name, one.grid_class, one.background) == (
                other.name, other.grid_class, other.background,
            )  # fmt: skip
            assert one.values.ndim == other.values.ndim
            assert other.is_empty and other.index_to_world is matrix


def test_names_are_names_of_usd() -> None:
    from pxr import Sdf

    for name in colour_names(["Cd", "color"], split=True):
        assert Sdf.Path.IsValidIdentifier(name)


@given(st.integers(0, 10**6), st.sampled_from(["albedo", "both"]))
def test_a_painted_albedo_is_the_scattering_over_the_extinction(seed: int, target: str) -> None:
    density, emission, colour = painted(seed)
    scattering = dataclasses.replace(emission, name="scattering", values=emission.values / 2)
    fields = [scattering] if target == "albedo" else [emission, scattering]
    config = Config(colour={"target": target})
    assert config.painted == tuple(field.name for field in fields)
    grids = {g.name: g for g in make_colour_grids(density, fields, GAMMA_W, config, 3.0)}
    assert tuple(grids) == config.colour_grids == (("emission", "Cd")[target == "albedo" :])
    smoke = density.values > 0
    np.testing.assert_allclose(grids["Cd"].values[smoke], colour[smoke] / 2, rtol=3e-7)
    assert "emission" not in grids or grids["emission"] == emission


def test_a_scattering_colour_beside_the_emission_knows_the_exposure() -> None:
    density, emission, colour = painted(5)
    dimmed = dataclasses.replace(emission, values=emission.values / 8)
    found = made(density, dimmed, LayerConfig(scatter_colour=["Cd"]), stops=3.0)["Cd"]
    smoke = density.values > 0
    np.testing.assert_allclose(found.values[smoke], colour[smoke], rtol=3e-7)

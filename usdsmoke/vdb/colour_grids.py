"""The colour grids of a result's files: emission in the configured form, and scattering colours.

With density d, extinction per density gamma_w and emission E = C gamma_w d, a painted colour C

    absolute    E                   radiance per stage unit; a renderer adds it unchanged
    perDensity  E / d = C gamma_w   for renderers that multiply emission by density
    Cd, color   E / (gamma_w d) = C albedo of the light that is scattered, never above 1

Where the albedo is painted (``colour.target``), Cd and color are S / (gamma_w d), with the
scattering S = gamma_w d times the albedo. All are 0 where d is 0. A strength or a mask below 1 is
part of C here: where nothing was painted a scattering colour is black.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from usdsmoke.base.boxes import values_in_box
from usdsmoke.base.naming import (
    COLOUR_CHANNELS,
    EMISSION,
    SCATTER_COLOURS,
    channel_names,
    colour_names,
)
from usdsmoke.base.volume import DenseField
from usdsmoke.config.settings import Config

_PER_DENSITY = "perDensity"


def make_colour_grids(
    density: DenseField, painted: Sequence[DenseField], gamma_w: float, config: Config, stops: float
) -> list[DenseField]:
    """The colour grids of one file, in the order of ``Config.colour_grids``.

    Args:
        density: [i j k].
        painted: by ``Config.painted``, [i j k 3] on the density's lattice, 1/stage unit,
            scene-linear; the box may differ. The emission is absolute.
        gamma_w: extinction per density, 1/stage unit.
        stops: exposure, which the emission is divided by.
    """
    emission, scattering = painted[0], painted[-1]
    if scattering.name == EMISSION:  # of the colours C, which it is not divided by
        scattering, gamma_w = emission, gamma_w * 2.0**-stops
    grids = []
    for name in colour_names(config.scatter_colours, emits=emission.name == EMISSION):
        if name in SCATTER_COLOURS:
            colour = _divided(density, scattering, gamma_w)
            np.minimum(colour.values, 1, out=colour.values)
        elif config.layer.emission_mode == _PER_DENSITY:
            colour = _divided(density, emission)
        else:
            colour = emission
        colour = dataclasses.replace(colour, name=name)
        grids += [colour, *(_split(colour) if config.layer.split_rgb else ())]
    return grids


def absolute_emission(density: DenseField, emission: DenseField, mode: str) -> DenseField:
    """The emission that a renderer adds unchanged, from the grids of a file.

    Args:
        density: [i j k] of the same file.
        emission: [i j k 3] on its lattice.
        mode: ``usdSmoke:emissionMode``, the setting ``layer.emission_mode``.
    """
    if mode != _PER_DENSITY:
        return emission
    values = (
        emission.values
        * values_in_box(density, emission.ijk_min, emission.values.shape[:3])[..., None]
    )
    return dataclasses.replace(emission, values=values)


def empty_colour_grids(index_to_world: np.ndarray, config: Config) -> list[DenseField]:
    """The same grids without a voxel, for a file that shows no colour."""
    grids = []
    for name in config.colour_grids:
        is_float = name in COLOUR_CHANNELS
        grids.append(
            DenseField(
                name=name,
                values=np.zeros((0, 0, 0) if is_float else (0, 0, 0, 3), np.float32),
                ijk_min=(0, 0, 0),
                index_to_world=index_to_world,
                background=0.0 if is_float else (0.0, 0.0, 0.0),
                grid_class="unknown",
            )
        )
    return grids


def _divided(density: DenseField, emission: DenseField, gamma_w: float = 1.0) -> DenseField:
    """emission / (gamma_w density) in double precision, 0 where that is not above 0."""
    if emission.is_empty:
        return dataclasses.replace(emission, values=emission.values.copy())
    extinction = (
        values_in_box(density, emission.ijk_min, emission.values.shape[:3]).astype(np.float64)
        * gamma_w
    )
    values = np.zeros_like(emission.values)
    for channel in range(3):  # one at a time: doubles of all three would be six times the density
        part = emission.values[..., channel]
        np.divide(
            part, extinction, out=values[..., channel], where=extinction > 0, casting="same_kind"
        )
    return dataclasses.replace(emission, values=values)


def _split(colour: DenseField) -> list[DenseField]:
    """Red, green and blue of a colour, [i j k] each."""
    background = np.broadcast_to(np.asarray(colour.background, np.float32), 3).tolist()
    parts = []
    for channel, name in enumerate(channel_names(colour.name)):
        values = np.zeros((0, 0, 0), np.float32)
        if not colour.is_empty:
            values = np.ascontiguousarray(colour.values[..., channel])
        parts.append(
            dataclasses.replace(
                colour, name=name, values=values, background=background[channel], metadata={}
            )
        )
    return parts

"""The grids that a preview draws: their headers, what they hold, and their lattices."""

import numpy as np

from usdsmoke.base.errors import UsdSmokeError
from usdsmoke.base.time_codes import format_time_code
from usdsmoke.base.volume import (
    DenseField,
    FieldSource,
    VolumeFrame,
    is_same_transform,
)
from usdsmoke.config.settings import Config
from usdsmoke.usd.stage import ComposedVolume
from usdsmoke.vdb.header import GridHeader, read_header
from usdsmoke.vdb.read import GridRequest, check_readable, find_grid, read_grids


def share_lattice(
    volume: ComposedVolume, density: DenseField, other: DenseField, source: FieldSource | None
) -> bool:
    """Whether a field of the Volume has the density's voxels."""
    if source is None:
        return False
    pairs = ((density, volume.density), (other, source))
    places = [field.index_to_world @ place.field_to_stage for field, place in pairs]
    return is_same_transform(places[0], places[1])


def grid_request(source: FieldSource, components: int | None) -> GridRequest:
    """To read a field's grid of so many components by; None takes any."""
    where = f"field <{source.prim_path}>, timeCode {format_time_code(source.time_code)}"
    return GridRequest(source.grid_name, source.grid_index, where, components)


def grid_of(source: FieldSource, components: int | None) -> GridHeader:
    """The header of a field's grid.

    Raises:
        GridError: it cannot be read.
    """
    header, request = read_header(source.file_path), grid_request(source, components)
    grid = find_grid(header, request)
    check_readable(header, grid, request)
    return grid


def is_filled(source: FieldSource, components: int | None) -> bool:
    """Whether a field has active voxels, as far as its header tells."""
    try:
        return grid_of(source, components).active_voxels != 0
    except UsdSmokeError:
        return False  # reported when the frame is drawn


def read_density(time_code: float, source: FieldSource, config: Config) -> VolumeFrame:
    """The density of a frame, read from its file."""
    (density,) = read_grids(source.file_path, [grid_request(source, 1)], config.grids)
    return VolumeFrame(time_code, density, source.field_to_stage)


def field_box(
    source: FieldSource, config: Config | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """First and last voxel, and the way from indices to the stage; None without smoke.

    Args:
        config: to read a file whose header does not tell; None leaves such a file out.
    """
    grid = grid_of(source, 1)
    if grid.active_voxels == 0:
        return None
    matrix = np.asarray(grid.index_to_world, float) @ source.field_to_stage
    if grid.bbox_min is not None and grid.bbox_max is not None:
        return np.array(grid.bbox_min), np.array(grid.bbox_max), matrix
    if config is None:
        return None
    density = read_density(source.time_code, source, config).density
    if density.is_empty:
        return None
    low = np.array(density.ijk_min)
    return low, low + np.array(density.values.shape) - 1, matrix

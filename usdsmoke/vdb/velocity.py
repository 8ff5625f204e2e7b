"""The velocity of the smoke, under the names it usually has, brought to voxel centres."""

import dataclasses
import os
from collections.abc import Sequence

import numpy as np

from usdsmoke.base.boxes import union_box, values_in_box
from usdsmoke.base.errors import UnsupportedGrid
from usdsmoke.base.volume import GRID_SEPARATORS, VELOCITY_NAMES, DenseField
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.vdb.header import FileHeader, GridHeader
from usdsmoke.vdb.read import GridRequest, ReadGrids, read_grids


def find_velocity(header: FileHeader, name: str = "") -> tuple[GridHeader, ...]:
    """The grids that hold the velocity: one of vectors, three of numbers, or none.

    Args:
        name: a grid of vectors, or the part of three names before ``.x`` or ``_x``; empty means
            vel, v or velocity, vectors first, and of the value types that can be read.
    """
    names = (name,) if name else VELOCITY_NAMES
    for candidate in names:
        for grid in header.grids:
            if grid.name == candidate and (name or grid.value_type == "vec3s"):
                return (grid,)
    for candidate in names:
        for separator in GRID_SEPARATORS:
            parts = [_first(header, f"{candidate}{separator}{axis}") for axis in "xyz"]
            found = tuple(part for part in parts if part is not None)
            if len(found) == 3 and (name or all(part.value_type == "float" for part in found)):
                return found
    return ()


def read_velocity(
    file_path: str | os.PathLike[str],
    grids: Sequence[GridHeader],
    config: GridsConfig,
    read: ReadGrids = read_grids,
    where: str = "",
) -> DenseField:
    """The velocity at voxel centres, [i j k 3], in whatever unit the file holds.

    A staggered grid is averaged to the centres; three grids of numbers are put together on the box
    that holds all of them.

    Args:
        grids: one of vectors, or three of numbers, x, y, z; see ``find_velocity``.
        where: for messages, such as the prim.

    Raises:
        UnsupportedGrid: not vectors or three grids of numbers, or the three do not fit together.
        GridError: everything else that ``read_grids`` refuses.
    """
    n_each = 3 if len(grids) == 1 else 1
    requests = [GridRequest(grid.name, grid.index, where, components=n_each) for grid in grids]
    found = read(file_path, requests, config)
    if len(found) == 1:
        return centre_staggered(found[0])
    return join_components(found, where or os.fspath(file_path))


def centre_staggered(field: DenseField) -> DenseField:
    """The field with every component at the voxel centre; only staggered fields change.

    In a staggered grid the component along an axis is on the voxel's lower face across that axis,
    so the centre has the mean of index i and i + 1; outside the box it is the background.
    """
    if field.grid_class != "staggered" or field.values.ndim != 4:
        return field
    background = np.broadcast_to(np.asarray(field.background, np.float32), (3,))
    centred = np.empty_like(field.values)
    for axis in range(3):
        lower = field.values[..., axis]
        upper = np.full_like(lower, background[axis])
        inner = [slice(None)] * 3
        outer = [slice(None)] * 3
        inner[axis], outer[axis] = slice(1, None), slice(None, -1)
        upper[tuple(outer)] = lower[tuple(inner)]
        centred[..., axis] = 0.5 * (lower + upper)
    return dataclasses.replace(field, values=centred, grid_class="unknown")


def _first(header: FileHeader, name: str) -> GridHeader | None:
    return next((grid for grid in header.grids if grid.name == name), None)


def join_components(parts: Sequence[DenseField], where: str) -> DenseField:
    """Three grids of numbers, x, y, z, as one of vectors on the box that holds all of them.

    Args:
        parts: [i j k] each, with the same transform; the boxes may differ.
        where: for messages.

    Raises:
        UnsupportedGrid: the transforms differ.
    """
    first = parts[0]
    tolerance = 1e-6 * np.abs(first.index_to_world[:3, :3]).max()
    for part in parts[1:]:
        if not np.allclose(part.index_to_world, first.index_to_world, rtol=0, atol=tolerance):
            raise UnsupportedGrid(
                f'the grids "{first.name}" and "{part.name}" ({where}) have different transforms. '
                "Merge the components of the velocity into one vector grid."
            )
    background = tuple(float(np.asarray(part.background)) for part in parts)
    ijk_min, shape = union_box(parts)
    values = np.stack([values_in_box(part, ijk_min, shape) for part in parts], axis=-1)
    return dataclasses.replace(
        first,
        name=without_axis(first.name),
        values=values,
        ijk_min=ijk_min,
        background=(background[0], background[1], background[2]),
        half=all(part.half for part in parts),
        repaired=sum(part.repaired for part in parts),
    )


def without_axis(name: str, separators: Sequence[str] = GRID_SEPARATORS) -> str:
    """What the names of three components have in common, by that of x: vel for vel.x."""
    ending = next((f"{one}x" for one in separators if name.endswith(f"{one}x")), "")
    return name.removesuffix(ending)


def scale_field(field: DenseField, factor: float) -> DenseField:
    """The field times a number; the field itself for 1."""
    if factor == 1:
        return field
    background = tuple(factor * value for value in np.broadcast_to(field.background, 3).tolist())
    if field.values.ndim == 3:
        background = float(background[0])  # type: ignore[assignment]
    values = field.values * np.float32(factor)
    return dataclasses.replace(field, values=values, background=background)

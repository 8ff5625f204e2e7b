"""VDB grids as dense arrays: found by name and index, and checked."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from usdsmoke.base.errors import (
    BindingMissing,
    DamagedFile,
    GridNotFound,
    NonFiniteError,
    UnsupportedGrid,
    count_text,
)
from usdsmoke.base.volume import DenseField
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.vdb import child
from usdsmoke.vdb.boxes import check_dense_size
from usdsmoke.vdb.child import ChildFailure
from usdsmoke.vdb.header import COMPONENTS, FileHeader, GridHeader, read_header

_LAST_INDEX = 2**30  # either way: OpenVDB crashes near 2^31
_STANDARD_TREE = "5_4_3"
_KEPT_CLASSES = ("fog volume", "staggered")
_DERIVED_KEYS = ("class", "is_saved_as_half_float", "name", "value_type")  # fields carry these
_RESERVE_BYTES = 2**29  # address space of the reading process before it has opened anything
_LARGE_FILE_BYTES = 100 * 2**20  # files above it get the whole time limit,
_SMALL_SHARE = 0.15  # small ones this share of it


@dataclass(frozen=True)
class GridRequest:
    """Which grid of a file to read."""

    name: str  # fieldName; "" takes the grid by its index alone
    index: int | None = None  # fieldIndex among grids of one name; None takes the first
    where: str = ""  # for messages: 'field </shot/plume/density>, timeCode 42'
    components: int | None = None  # 1 for scalars, 3 for vectors, None for either


# ``read_grids`` or a replacement for it.
ReadGrids = Callable[[str | os.PathLike[str], Sequence[GridRequest], GridsConfig], list[DenseField]]


def read_grids(
    file_path: str | os.PathLike[str], requests: Sequence[GridRequest], config: GridsConfig
) -> list[DenseField]:
    """The active boxes of the requested grids, in the order of the requests.

    OpenVDB opens the file in the worker process under ``config``'s memory and time limits. Values
    are returned as stored, negative ones too; a non-zero background fills the box.

    Args:
        file_path: a VDB file.
        requests: which grids; without any, the list is empty and the file is not opened.
        config: the limits (a small file gets a share of the time only), and ``repair_nan`` which
            replaces voxels that are not finite.

    Raises:
        AssetNotResolved: the file is missing or may not be read.
        DamagedFile: no VDB file, truncated, or damaged so that reading fails, hangs or eats memory.
        GridNotFound: no grid of that name and index; lists those the file has.
        UnsupportedGrid: a level set, points, another value type, or a transform that is not linear.
        GridTooLarge: the active box as a dense array does not fit ``memory_limit_gib``.
        NonFiniteError: NaN or infinite voxels, with their count, while ``repair_nan`` is unset.
        BindingMissing: OpenVDB's bindings are missing or do not fit the installed NumPy.
    """
    if not requests:
        return []
    header = read_header(file_path)
    grids = []
    for request in requests:
        grid = find_grid(header, request)
        check_readable(header, grid, request)
        if grid.box_shape is not None:  # else the worker looks at the tree itself
            found = f'grid "{grid.label}" in {_place(header, request)}'
            components = COMPONENTS[grid.value_type]
            check_dense_size(found, grid.box_shape, components, _dense_limit(config))
        grids.append(grid)
    described, arrays = _open(header, grids, requests, config)
    return [
        _dense_field(header, grid, request, entry, values, config)
        for grid, request, entry, values in zip(grids, requests, described, arrays, strict=True)
    ]


def find_grid(header: FileHeader, request: GridRequest) -> GridHeader:
    """The grid that a request means.

    The name must match exactly. The index is the position among the grids of that name in the
    file's order and matters only if there are several; without an index the first grid is taken, as
    in OpenVDB. The index of a request without a name is the position among the nameless grids or,
    if all have names, among all grids of the file.

    Raises:
        GridNotFound: no grid matches; the message lists the file's grids.
    """
    same_name = [grid for grid in header.grids if grid.name == request.name]
    if not same_name and not request.name:
        same_name = list(header.grids)
        if len(same_name) > 1 and request.index is None:
            same_name = []  # any choice would be a guess
    index = request.index or 0
    if len(same_name) == 1 and request.name:
        index = 0
    if 0 <= index < len(same_name):
        return same_name[index]
    labels = ", ".join(_labels(header)) or "no grids at all"
    raise GridNotFound(
        f"{_place(header, request)} has no {_asked_for(request)}; it has {labels}. "
        "Correct the field's fieldName or fieldIndex, or the file."
    )


def check_readable(header: FileHeader, grid: GridHeader, request: GridRequest) -> None:
    """Refuse a grid that smoke cannot be read from. Only the header is needed.

    Raises:
        UnsupportedGrid: a level set, points, another value type, or a transform that is not linear.
    """
    found = f'grid "{grid.label}" in {_place(header, request)}'
    components = COMPONENTS.get(grid.value_type)
    if grid.value_type == "points":
        raise UnsupportedGrid(
            f"{found} holds points, not a fog volume. Rasterize the points into a density grid."
        )
    if components is None or grid.tree_levels != _STANDARD_TREE:
        fitting = [name for name, n in COMPONENTS.items() if request.components in (None, n)]
        kind = grid.value_type + (
            "" if grid.tree_levels == _STANDARD_TREE else f" in a {grid.tree_levels} tree"
        )
        raise UnsupportedGrid(
            f"{found} holds {kind} values. Convert it to {' or '.join(fitting)}, at 16 or 32 bits, "
            "and write the file again."
        )
    if request.components not in (None, components):
        raise UnsupportedGrid(
            f"{found} has {components} component{'s'[: components - 1]} per voxel, not "
            f"{request.components}. Name a grid with {request.components} "
            f"component{'s'[: request.components - 1]}."
        )
    if grid.grid_class == "level set":
        raise UnsupportedGrid(
            f"{found} is a level set, not a fog volume. Convert the surface to fog first."
        )
    if grid.index_to_world is None:
        raise UnsupportedGrid(
            f"{found} has a {grid.transform_type}, which is not linear. Resample the grid with a "
            "transform of scale, rotation, shear and translation."
        )
    if any(abs(index) > _LAST_INDEX for index in (*(grid.bbox_min or ()), *(grid.bbox_max or ()))):
        raise UnsupportedGrid(
            f"{found} has voxels from index {list(grid.bbox_min or ())} to "
            f"{list(grid.bbox_max or ())}, too far out for OpenVDB's 32-bit indices. Move them "
            "towards index 0, and the grid's transform against it."
        )
    if abs(np.linalg.det(grid.index_to_world[:3, :3])) == 0.0:
        raise UnsupportedGrid(
            f"{found} has a transform that flattens space and cannot be inverted. Correct its "
            "voxel size."
        )


def read_binding_version(config: GridsConfig) -> str:
    """Name and version of OpenVDB's bindings, such as ``pyopenvdb 10.0.1``, from the worker.

    Raises:
        BindingMissing: the bindings are missing, do not fit the installed NumPy, or do not load.
    """
    try:
        version, _ = child.run_child({"action": "describe"}, [], config)
    except ChildFailure as failure:
        raise BindingMissing(
            f"the OpenVDB bindings cannot be loaded: {failure}. Install them again, and raise "
            "grids.memory_limit_gib if it is below 1."
        ) from None
    return str(version)


def _open(
    header: FileHeader,
    grids: Sequence[GridHeader],
    requests: Sequence[GridRequest],
    config: GridsConfig,
) -> tuple[list[dict[str, Any]], list[np.ndarray]]:
    request = {
        "action": "read",
        "file_path": os.path.abspath(header.file_path),
        "names": [_name_in_bindings(grid) for grid in grids],
        "dense_limit_bytes": _dense_limit(config),
    }
    limited = config.replace(time_limit_s=_time_limit(header, config))
    try:
        return child.run_child(request, [], limited)
    except ChildFailure as failure:
        error = DamagedFile(
            f"cannot read {_place(header, requests[0])}: {failure}. The file is probably damaged. "
            "Write or copy it again. If it is intact, raise grids.memory_limit_gib or "
            "grids.time_limit_s."
        )
        error.lacks_memory = failure.lacks_memory
        raise error from None


def _time_limit(header: FileHeader, config: GridsConfig) -> float:
    """Seconds for a file of this size: a small file that takes long is damaged."""
    try:
        size = os.path.getsize(header.file_path)
    except OSError:
        return config.time_limit_s  # the worker reports the error
    return config.time_limit_s * min(1.0, _SMALL_SHARE + size / _LARGE_FILE_BYTES)


def _name_in_bindings(grid: GridHeader) -> str:
    """The name by which the bindings find this grid among those of its name."""
    suffix = grid.stored_name[len(grid.name) + 1 :]
    return f"{grid.name}[{suffix}]" if suffix else grid.name


def _dense_limit(config: GridsConfig) -> int:
    """Bytes that one dense array may take: OpenVDB's own copy of the grid needs the same again."""
    return max(0, int((config.memory_limit_gib * 2**30 - _RESERVE_BYTES) / 2))


def _dense_field(
    header: FileHeader,
    grid: GridHeader,
    request: GridRequest,
    entry: dict[str, Any],
    values: np.ndarray,
    config: GridsConfig,
) -> DenseField:
    found = f'grid "{grid.label}" in {_place(header, request)}'
    background = np.asarray(entry["background"], np.float32)
    ijk_min = entry["ijk_min"]
    n_bad = _count_bad(found, values, background, ijk_min, config.repair_nan)
    if config.repair_nan is not None:
        values = np.where(np.isfinite(values), values, np.float32(config.repair_nan))
        background = np.where(np.isfinite(background), background, np.float32(config.repair_nan))
    return DenseField(
        name=grid.name,
        values=values,
        ijk_min=(ijk_min[0], ijk_min[1], ijk_min[2]),
        index_to_world=np.array(grid.index_to_world),
        background=tuple(background.tolist()) if background.ndim else float(background),
        grid_class=grid.grid_class if grid.grid_class in _KEPT_CLASSES else "unknown",
        half=grid.half,
        beside=entry.get("beside", 0.0),
        repaired=n_bad,
        metadata={
            key: value
            for key, value in grid.metadata.items()
            if key not in _DERIVED_KEYS and not key.startswith("file_")
        },
    )


def _count_bad(
    found: str,
    values: np.ndarray,
    background: np.ndarray,
    ijk_min: Sequence[int],
    repair: float | None,
) -> int:
    """Voxels with NaN or infinity, 1 for a background alone; an error if nothing replaces them."""
    if np.isfinite(values).all() and np.isfinite(background).all():
        return 0
    bad = ~np.isfinite(values)
    bad = bad.any(axis=-1) if bad.ndim == 4 else bad
    count = int(bad.sum())
    if repair is not None:
        return max(count, 1)  # a background stands for many
    what = "a background that is NaN or infinite"
    if count:
        first = np.argwhere(bad)[0] + np.asarray(ijk_min)
        what = f"{count_text(count, 'NaN or infinite voxel')}, the first at index {first.tolist()}"
    raise NonFiniteError(
        f"{found} has {what}. Correct the simulation, or set grids.repair_nan (--repair nan=0) to "
        "replace them with a number."
    )


def _place(header: FileHeader, request: GridRequest) -> str:
    name = Path(header.file_path).name
    return f"{name} ({request.where})" if request.where else header.file_path


def _asked_for(request: GridRequest) -> str:
    name = f'grid "{request.name}"' if request.name else "grid without a name"
    return name if request.index is None else f"{name} with fieldIndex {request.index}"


def _labels(header: FileHeader) -> list[str]:
    """Every grid's name, with an index wherever several share it."""
    names = [grid.name for grid in header.grids]
    return [
        f"{grid.name}[{grid.index}]" if names.count(grid.name) > 1 or not grid.name else grid.name
        for grid in header.grids
    ]

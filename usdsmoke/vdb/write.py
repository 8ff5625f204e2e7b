"""Writing the grids of a frame as one VDB file, which is read back before it is published."""

import dataclasses
import math
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from usdsmoke.base.errors import GridError, NonFiniteError, WriteFailed
from usdsmoke.base.publish import publish_file
from usdsmoke.base.storage import LARGEST_HALF, round_to_half
from usdsmoke.base.volume import DenseField
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.vdb import child
from usdsmoke.vdb.boxes import crop_to_active
from usdsmoke.vdb.child import ChildFailure
from usdsmoke.vdb.content_hash import CONTENT_KEY, hash_fields
from usdsmoke.vdb.header import read_header
from usdsmoke.vdb.read import GridRequest, read_grids

_INT64 = 2**63
_VECTOR_TYPES = (
    "invariant",
    "covariant",
    "covariant normalize",
    "contravariant relative",
    "contravariant absolute",
)
_OWN_KEYS = ("class", "is_saved_as_half_float", "name", "value_type", "vector_type")
_TRANSFORM_TOLERANCE = 1e-9  # of the largest scale; OpenVDB makes nearly equal scales equal
_DISK_TRIAL = 1 << 16  # bytes, to test whether the disk is full
_LEAST_SHEAR = 1e-10  # of the largest scale; OpenVDB drops shears around it, depending on the size


def write_frame(
    file_path: str | os.PathLike[str],
    fields: Sequence[DenseField],
    file_metadata: Mapping[str, Any],
    half: bool | Collection[str],
    config: GridsConfig | None = None,
    timed: Callable[[str], AbstractContextManager[Any]] = nullcontext,
) -> str:
    """Write all grids of one frame into one VDB file and verify it.

    Voxels equal to the background become inactive. Names, classes, transforms and the fields'
    metadata are kept; vectors are ``invariant`` (right for colour) unless the metadata says
    otherwise. OpenVDB reports neither a full disk nor a short write. The file is therefore synced
    to the disk, opened again with OpenVDB, and compared number by number before it replaces an
    older one. If it differs, a trial write tells a full disk from other causes.

    Args:
        file_path: path of the file; its folder must exist. An old file is replaced.
        fields: [i j k] or [i j k 3] float32, finite, of different names; a field without voxels, or
            one that is all background, becomes an empty grid. ``DenseField.half`` is ignored.
        file_metadata: strings, numbers, booleans and triples of numbers; others are left out.
            The content hash is added as ``usdsmoke:content_sha256``.
        half: store 16-bit floats, in all grids or in those of these names; values are rounded to
            them.
        timed: a context for each of two parts of the work, ``hashing`` and ``verifying``.

    Returns:
        The content hash, see ``content_hash.hash_fields``, of what the file holds.

    Raises:
        NonFiniteError: a voxel or background is NaN or infinite.
        WriteFailed: a value does not fit 16 bits, two fields share a name, OpenVDB or the operating
            system refused, or the file came back different.
        BindingMissing: OpenVDB's bindings are missing or do not fit the installed NumPy.
    """
    config = (config or GridsConfig()).replace(repair_nan=None)
    target = Path(os.path.abspath(file_path))
    _check_names(target, fields)
    halves = half if not isinstance(half, bool) else [f.name for f in fields] if half else ()
    stored = [crop_to_active(_as_stored(target, f, f.name in halves)) for f in fields]
    with timed("hashing"):
        content = hash_fields(stored)
    request = {
        "action": "write",
        "file_metadata": clean_metadata(file_metadata) | {CONTENT_KEY: content},
        "grids": [_described(field) for field in stored],
    }

    def write(temporary: Path) -> None:
        _write_grids(temporary, target, request, stored, config)

    def check(temporary: Path) -> None:
        with timed("verifying"):
            _check_written(temporary, target, stored, config)

    publish_file(target, write, check)
    return content


def _write_grids(
    temporary: Path,
    target: Path,
    request: Mapping[str, Any],
    stored: Sequence[DenseField],
    config: GridsConfig,
) -> None:
    """Write the grids to the temporary file; errors name the target."""
    temporary.write_bytes(b"")  # raises the system's own error
    try:
        arrays = [field.values for field in stored]
        child.run_child({**request, "file_path": str(temporary)}, arrays, config)
    except WriteFailed as error:
        raise WriteFailed(f"cannot write {target.name}: {error}") from None
    except ChildFailure as failure:
        _try_disk(temporary)
        raise WriteFailed(
            f"cannot write {target.name} in {target.parent}: {failure}. Check the output "
            "folder and its disk, and whether grids.memory_limit_gib is large enough."
        ) from None


def clean_metadata(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """The entries that every version of the bindings writes unchanged.

    Strings, booleans, 64-bit integers, finite numbers, and triples of numbers; NumPy scalars become
    Python's. Everything else is left out.
    """
    cleaned = {}
    for key, value in metadata.items():
        plain = _plain(value)
        if key and plain is not None:
            cleaned[str(key)] = plain
    return cleaned


def _plain(value: Any) -> Any:
    """The value as Python's own type, or None when it cannot be written."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, bool | str):
        return value
    if isinstance(value, int):
        return value if -_INT64 <= value < _INT64 else None
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, tuple | list) and len(value) == 3:
        triple = [_plain(number) for number in value]
        if all(type(number) is int for number in triple):
            return tuple(triple)
        if all(type(number) in (int, float) for number in triple):
            return tuple(float(number) for number in triple)
    return None


def _check_names(target: Path, fields: Sequence[DenseField]) -> None:
    names = [field.name for field in fields]
    if not all(names) or len(set(names)) != len(names):
        raise WriteFailed(
            f"cannot write {target.name}: its grids would be called {', '.join(map(repr, names))}. "
            "Give each grid a name of its own."
        )


def _as_stored(target: Path, field: DenseField, half: bool) -> DenseField:
    """The field exactly as the file stores it: float32, rounded to half if requested."""
    values = np.ascontiguousarray(field.values, np.float32)
    is_vector = values.ndim == 4 or np.ndim(field.background) == 1
    if is_vector and values.ndim == 3:
        values = np.zeros((0, 0, 0, 3), np.float32)  # an empty field has no components of its own
    background = np.asarray(field.background, np.float32)
    if not (np.isfinite(values).all() and np.isfinite(background).all()):
        count = int((~np.isfinite(values)).sum())
        raise NonFiniteError(
            f'cannot write grid "{field.name}" of {target.name}: {count} of its numbers are NaN or '
            "infinite. This is a bug in usdsmoke. Please report it."
        )
    if half:
        largest = max(np.abs(values).max(initial=0.0), np.abs(background).max())
        if largest > LARGEST_HALF:
            raise WriteFailed(
                f'cannot write grid "{field.name}" of {target.name} in 16-bit floats: its largest '
                f"value is {largest:g}, above {LARGEST_HALF:g}. Unset grids.half (--half) and, for "
                "a velocity, layer.compact_velocity."
            )
        values = round_to_half(values)
        background = round_to_half(background)
    if is_vector:
        background = np.broadcast_to(background, (3,))
    return dataclasses.replace(
        field,
        values=values,
        index_to_world=_without_crumbs(field.index_to_world),
        background=tuple(background.tolist()) if is_vector else float(background),
        half=half,
    )


def _without_crumbs(index_to_world: np.ndarray) -> np.ndarray:
    """The transform without rounding errors, such as the cosine of a quarter turn."""
    matrix = np.array(index_to_world, np.float64)
    linear = matrix[:3, :3]
    linear[np.abs(linear) <= _LEAST_SHEAR * np.abs(linear).max()] = 0.0
    return matrix


def _described(field: DenseField) -> dict[str, Any]:
    """The field without its values, as JSON can say it."""
    metadata = {
        key: value
        for key, value in clean_metadata(field.metadata).items()
        if key not in _OWN_KEYS and not key.startswith("file_")
    }
    vector_type = field.metadata.get("vector_type")
    return {
        "name": field.name,
        "is_vector": field.values.ndim == 4,
        "ijk_min": [int(index) for index in field.ijk_min],
        "background": field.background,
        "grid_class": field.grid_class,
        "vector_type": vector_type if vector_type in _VECTOR_TYPES else "invariant",
        "half": field.half,
        "index_to_world": np.asarray(field.index_to_world, np.float64).tolist(),
        "metadata": metadata,
    }


def _check_written(
    temporary: Path, target: Path, stored: Sequence[DenseField], config: GridsConfig
) -> None:
    """Read the file back and compare every grid with what was written."""
    found = "an unreadable file"
    try:
        header = read_header(temporary)
        if sorted(grid.name for grid in header.grids) != sorted(field.name for field in stored):
            found = "other grids"
        else:
            read = read_grids(temporary, [GridRequest(field.name) for field in stored], config)
            different = [a.name for a, b in zip(stored, read, strict=True) if not _is_same(a, b)]
            if not different:
                return
            found = f"other values or places in {', '.join(different)}"
    except GridError as error:
        found = f"an unreadable file ({error})"
    _try_disk(temporary)
    raise WriteFailed(
        f"{target.name} does not read back as it was written (found {found}). Check "
        f"whether the disk of {target.parent} is full, and run again."
    )


def _try_disk(temporary: Path) -> None:
    """Raise the system's own error if the disk is full: OpenVDB does not report it.

    Raises:
        OSError: the disk is full, a quota is used up, or the folder may not be written to.
    """
    with open(temporary, "ab", buffering=0) as stream:
        left = _DISK_TRIAL
        while left > 0:
            left -= stream.write(bytes(left))
        os.fsync(stream.fileno())


def _is_same(written: DenseField, read: DenseField) -> bool:
    """The transform within OpenVDB's rounding, everything else exactly."""
    expected = np.asarray(written.index_to_world, np.float64)
    tolerance = _TRANSFORM_TOLERANCE * np.abs(expected[:3, :3]).max()
    if not np.allclose(read.index_to_world, expected, rtol=1e-15, atol=tolerance):
        return False
    read = crop_to_active(read)
    return (
        (written.name, written.grid_class, written.half, written.ijk_min)
        == (read.name, read.grid_class, read.half, read.ijk_min)
        and np.array_equal(written.background, read.background)
        and np.array_equal(written.values, read.values)
    )

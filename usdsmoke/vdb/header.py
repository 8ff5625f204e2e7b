"""What a VDB file says about itself before any voxel: grids, types, boxes, counts, transforms.

Read by hand, without OpenVDB, because the bindings refuse a whole file for one grid of a type they
do not know, and because a damaged file can make them abort or take all memory. Every length in the
file is checked against what is left of the file before anything is allocated for it.
"""

import math
import os
import re
import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from threading import Lock
from typing import Any, BinaryIO

import numpy as np

from usdsmoke.base.errors import AssetNotResolved, DamagedFile, UnsupportedGrid
from usdsmoke.vdb.boxes import box_extent

_MAX_ITEMS = 65_536  # metadata entries or grids; real files have tens
# numbers in a voxel, by the value types that every version of the bindings knows
COMPONENTS = {"float": 1, "vec3s": 3}
_MAX_TEXT = 65_536  # bytes of a name or type
_MAX_BYTES = 33_554_432  # bytes of all headers together


class ByteReader:
    """Takes bytes from a file after checking that they are there and within the budget.

    Every method raises ``DamagedFile`` for impossible numbers; ``what`` names the part of the file
    in its message.
    """

    def __init__(self, stream: BinaryIO, size: int, where: str) -> None:
        """Start at byte 0 of a file of ``size`` bytes; ``where`` is its path, for messages."""
        self._stream = stream
        self._size = size
        self.position = 0
        self._budget = _MAX_BYTES
        self.where = where

    def damage(self, found: str) -> DamagedFile:
        """The error to raise when ``found`` shows that the file is damaged."""
        return DamagedFile(
            f"{self.where} is not a valid VDB file: {found}. Export or copy it again."
        )

    def seek(self, position: int, what: str) -> None:
        """Go to a byte of the file."""
        if not 0 <= position <= self._size:
            raise self.damage(
                f"{what} should be at byte {position}, but the file has {self._size} bytes"
            )
        self.position = position
        self._stream.seek(position)

    def skip(self, count: int, what: str) -> None:
        """Skip bytes without reading them."""
        self.seek(self.position + count, what)

    def take(self, count: int, what: str) -> bytes:
        """The next bytes."""
        left = self._size - self.position
        if count > left and self.position == 0:
            raise self.damage(f"it has only {left} bytes")
        if count > left:
            raise self.damage(
                f"{what} takes {count} bytes from byte {self.position}, but the file has "
                f"{left} more"
            )
        self._budget -= count
        if self._budget < 0:
            raise self.damage(f"its descriptions take more than {_MAX_BYTES} bytes")
        taken = self._stream.read(count)
        if len(taken) != count:  # the file shrank while it was read
            raise self.damage(f"it ends inside {what}")
        self.position += count
        return taken

    def unpack(self, layout: str, what: str) -> tuple[Any, ...]:
        """The next numbers, by a layout of ``struct``."""
        return struct.unpack(layout, self.take(struct.calcsize(layout), what))

    def text(self, what: str) -> str:
        """The next text, which is stored after its length."""
        (length,) = self.unpack("<I", what)
        if length > _MAX_TEXT:
            raise self.damage(f"{what} claims a length of {length} bytes")
        return self.take(length, what).decode("utf-8", errors="replace")

    def count(self, smallest: int, what: str) -> int:
        """A number of items that follow, each of at least ``smallest`` bytes."""
        (count,) = self.unpack("<I", what)
        left = self._size - self.position
        if count > _MAX_ITEMS or count * smallest > left:
            raise self.damage(f"it claims {count} {what}, with {left} bytes left")
        return int(count)


_MAGIC = b" BDV\0\0\0\0"
_OLDEST = 220  # first public release; older layouts differ
_NEWEST = 299  # above every existing version: a larger number means damage, not a newer format
_MASK_COMPRESSION = 222  # before it, one flag for the file; since then, flags for every grid

_MAX_VALUE = 1_048_576  # bytes of a metadata value that is kept; longer ones are passed over

_SETTLED = 2.0  # seconds: file systems cannot distinguish changes in quick succession
_TURN = Lock()  # UsdValidation runs validators at the same time, and all want the same headers

_SUFFIX = "\x1e"  # OpenVDB distinguishes grids of one name by this and a number
_TREE = re.compile(r"Tree_(?P<value>.+?)_(?P<levels>\d+(?:_\d+)*)(?P<half>_HalfFloat)?")
_POINT_TYPES = ("ptdataidx32", "ptidx32", "ptdataidx64", "ptidx64")

_SCALAR_FORMATS = {"int32": "<i", "int64": "<q", "float": "<f", "double": "<d", "bool": "<?"}
_VECTOR_FORMATS = {
    "vec2i": "<2i", "vec2s": "<2f", "vec2d": "<2d",
    "vec3i": "<3i", "vec3s": "<3f", "vec3d": "<3d",
    "vec4i": "<4i", "vec4s": "<4f", "vec4d": "<4d",
    "mat4s": "<16f", "mat4d": "<16d",
}  # fmt: skip


@dataclass(frozen=True)
class GridHeader:
    """One grid of a VDB file, as its header describes it; not checked against its voxels."""

    name: str  # without the suffix that distinguishes grids of one name
    index: int  # 0, 1, ... among the grids of this name, in the file's order; USD's fieldIndex
    stored_name: str  # as the file keeps it: with a suffix where several grids share the name
    value_type: str  # "float", "vec3s", "int32", "bool", "double", "points", ...
    tree_levels: str = "5_4_3"  # logarithms of the node sizes; the bindings know 5_4_3 only
    half: bool = False  # stored as 16-bit floats
    grid_class: str = "unknown"  # "fog volume", "level set", "staggered", "unknown"
    metadata: Mapping[str, Any] = field(default_factory=dict)
    active_voxels: int | None = None  # None when the file does not say
    bbox_min: tuple[int, int, int] | None = None  # active box, inclusive; None: empty or not said
    bbox_max: tuple[int, int, int] | None = None
    transform_type: str = ""  # OpenVDB's name of the map
    index_to_world: np.ndarray | None = None  # [4 4] row vectors; None when not linear or not known

    @property
    def box_shape(self) -> tuple[int, int, int] | None:
        """Voxels along i, j, k of the active box; None when the file does not say."""
        if self.bbox_min is None or self.bbox_max is None:
            return None
        i, j, k = (high - low + 1 for low, high in zip(self.bbox_min, self.bbox_max, strict=True))
        return (i, j, k)

    @property
    def extent(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Lowest and highest corner of the active box in grid world, [3] each, with whole voxels.

        None where the header does not say.
        """
        if self.bbox_min is None or self.box_shape is None or self.index_to_world is None:
            return None
        return box_extent(self.bbox_min, self.box_shape, self.index_to_world)

    @property
    def label(self) -> str:
        """The grid's name as shown to people, with its index when it is not the first."""
        return f"{self.name}[{self.index}]" if self.index else self.name


@dataclass(frozen=True)
class FileHeader:
    """The header of a VDB file."""

    file_path: str
    version: int  # of the file format
    library_version: tuple[int, int]
    uuid: str  # random with every writing
    metadata: Mapping[str, Any]
    grids: tuple[GridHeader, ...]  # in the file's order


def read_header(file_path: str | os.PathLike[str]) -> FileHeader:
    """The header of a VDB file with any grid types. No voxel is read.

    Takes milliseconds and at most some tens of MiB, whatever the file holds. A file that has not
    changed for two seconds is parsed once per process.

    Raises:
        AssetNotResolved: the file is missing or may not be read.
        DamagedFile: not a VDB file, truncated, or with impossible numbers.
        UnsupportedGrid: a file written as a stream: it has no table of its grids.
    """
    where = os.fspath(file_path)
    try:
        status = os.stat(where)
        identity = (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)
        if time.time() - status.st_mtime > _SETTLED:
            with _TURN:
                return _read_settled(where, identity)
        return _read_now(where)
    except FileNotFoundError:
        raise AssetNotResolved(
            f"no file {where}. Check the field's filePath and that the file was not moved."
        ) from None
    except OSError as error:
        raise AssetNotResolved(
            f"cannot read {where}: {error.strerror or error}. Check the file and its permissions."
        ) from None


def _read_now(where: str) -> FileHeader:
    with open(where, "rb") as stream:
        size = os.fstat(stream.fileno()).st_size
        if not size:
            raise DamagedFile(f"{where} is no VDB file: it has 0 bytes. Export or copy it again.")
        return _read_file_header(ByteReader(stream, size, where))


@lru_cache(maxsize=4096)
def _read_settled(where: str, identity: tuple[int, ...]) -> FileHeader:
    """The header, cached while the file does not change."""
    return _read_now(where)


def _read_file_header(reader: ByteReader) -> FileHeader:
    if reader.take(8, "its first 8 bytes") != _MAGIC:
        raise reader.damage("it starts with the wrong bytes")
    (version,) = reader.unpack("<I", "the format version")
    if not _OLDEST <= version <= _NEWEST:
        raise reader.damage(
            f"it claims format version {version}; this reader takes {_OLDEST} to {_NEWEST}"
        )
    library = reader.unpack("<II", "the library version")
    (has_offsets,) = reader.unpack("<B", "the offsets flag")
    if version < _MASK_COMPRESSION:
        reader.take(1, "the compression flag")
    uuid = reader.take(36, "the identifier").decode("latin-1")
    metadata = _read_metadata(reader)
    n_grids = reader.count(36, "grids")
    if n_grids and not has_offsets:
        raise UnsupportedGrid(
            f"{reader.where} has no table of grids, because it was written as a stream. "
            "Load it and save it again with an OpenVDB tool."
        )
    return FileHeader(
        file_path=reader.where,
        version=version,
        library_version=(library[0], library[1]),
        uuid=uuid,
        metadata=metadata,
        grids=_read_grids(reader, version, n_grids),
    )


def _read_grids(reader: ByteReader, version: int, n_grids: int) -> tuple[GridHeader, ...]:
    """Each grid's entry is followed by the grid itself; its offsets lead to the next entry."""
    grids = []
    n_of_name: dict[str, int] = {}
    for _ in range(n_grids):
        stored_name, grid_type, grid_position, end_position = _read_descriptor(reader)
        name = stored_name.partition(_SUFFIX)[0]
        index = n_of_name.get(name, 0)
        n_of_name[name] = index + 1
        reader.seek(grid_position, f'the description of grid "{name}"')
        if version >= _MASK_COMPRESSION:
            reader.take(4, "a grid's compression flags")
        grids.append(_read_grid(reader, stored_name, index, grid_type))
        reader.seek(end_position, f'the end of grid "{name}"')
    return tuple(grids)


def _read_descriptor(reader: ByteReader) -> tuple[str, str, int, int]:
    """The grid's stored name, its type, where its description starts and where the grid ends."""
    name = reader.text("a grid's name")
    grid_type = reader.text("a grid's type")
    reader.text("the name of a grid's instance parent")
    grid_position, block_position, end_position = reader.unpack("<qqq", "a grid's offsets")
    if not reader.position <= grid_position <= block_position <= end_position:
        raise reader.damage(
            f'the offsets of grid "{name}" are {grid_position}, {block_position}, {end_position}; '
            f"they do not increase from {reader.position}"
        )
    return name, grid_type, grid_position, end_position


def _read_grid(reader: ByteReader, stored_name: str, index: int, grid_type: str) -> GridHeader:
    name = stored_name.partition(_SUFFIX)[0]
    match = _TREE.fullmatch(grid_type)
    if match is None:
        raise reader.damage(f'grid "{name}" is of type {grid_type[:80]!r}, not Tree_...')
    metadata = _read_metadata(reader)
    transform_type, index_to_world = _read_transform(reader, name)
    active_voxels = metadata.get("file_voxel_count")
    box = _active_box(metadata)
    return GridHeader(
        name=name,
        index=index,
        stored_name=stored_name,
        value_type="points" if match["value"] in _POINT_TYPES else match["value"],
        tree_levels=match["levels"],
        half=match["half"] is not None,
        grid_class=str(metadata.get("class", "unknown")),
        metadata=metadata,
        active_voxels=active_voxels if isinstance(active_voxels, int) else None,
        bbox_min=box[0] if box else None,
        bbox_max=box[1] if box else None,
        transform_type=transform_type,
        index_to_world=index_to_world,
    )


def _active_box(metadata: Mapping[str, Any]) -> tuple[tuple[int, int, int], ...] | None:
    low, high = _ijk(metadata, "file_bbox_min"), _ijk(metadata, "file_bbox_max")
    if low is None or high is None or any(a > b for a, b in zip(low, high, strict=True)):
        return None  # an empty grid's box runs from the largest integer to the smallest
    return low, high


def _ijk(metadata: Mapping[str, Any], key: str) -> tuple[int, int, int] | None:
    value = metadata.get(key)
    if not isinstance(value, tuple) or len(value) != 3:
        return None
    i, j, k = value
    return (i, j, k) if all(isinstance(index, int) for index in value) else None


def _read_metadata(reader: ByteReader) -> dict[str, Any]:
    """Names and values; types that are not known, and the delayed-load table, are left out."""
    metadata = {}
    for _ in range(reader.count(12, "metadata entries")):
        name = reader.text("a metadata name")
        type_name = reader.text("a metadata type")
        (size,) = reader.unpack("<I", "a metadata size")
        is_known = type_name in ("string", *_SCALAR_FORMATS, *_VECTOR_FORMATS)
        if size > _MAX_VALUE or not is_known:
            reader.skip(size, f'the metadata "{name}"')
            continue
        metadata[name] = _metadata_value(reader, name, type_name, reader.take(size, "metadata"))
    return metadata


def _metadata_value(reader: ByteReader, name: str, type_name: str, packed: bytes) -> Any:
    if type_name == "string":
        return packed.decode("utf-8", errors="replace")
    layout = _SCALAR_FORMATS.get(type_name) or _VECTOR_FORMATS[type_name]
    if struct.calcsize(layout) != len(packed):
        raise reader.damage(f'the metadata "{name}" of type {type_name} has {len(packed)} bytes')
    values = struct.unpack(layout, packed)
    return values[0] if type_name in _SCALAR_FORMATS else values


def _read_transform(reader: ByteReader, name: str) -> tuple[str, np.ndarray | None]:
    """The map's type and, for a linear one, its matrix.

    Scale maps store the scale, then four vectors derived from it; those with a translation store it
    first. A frustum is not linear and yields no matrix.
    """
    map_type = reader.text("a transform's type")
    index_to_world = np.eye(4)
    if map_type in ("AffineMap", "UnitaryMap"):
        index_to_world = np.array(reader.unpack("<16d", "a transform")).reshape(4, 4)
    elif map_type == "TranslationMap":
        index_to_world[3, :3] = reader.unpack("<3d", "a transform")
    elif map_type in ("ScaleTranslateMap", "UniformScaleTranslateMap"):
        index_to_world[3, :3] = reader.unpack("<3d", "a transform")
        index_to_world[:3, :3] = np.diag(reader.unpack("<3d", "a transform"))
    elif map_type in ("ScaleMap", "UniformScaleMap"):
        index_to_world[:3, :3] = np.diag(reader.unpack("<3d", "a transform"))
    elif map_type == "NonlinearFrustumMap":
        return map_type, None
    else:
        raise reader.damage(f'grid "{name}" has a transform of type {map_type[:80]!r}')
    if not all(math.isfinite(number) for number in index_to_world.flat):
        raise reader.damage(f'the transform of grid "{name}" is not finite')
    return map_type, index_to_world

"""A hash of what grids hold, blind to how a file happens to store it.

VDB files carry a random identifier, so equal grids give different bytes. The hash covers, for every
grid in the order of names: name, class, half or full float, background, transform, and the index
and value of every voxel that differs from the background. Metadata is not covered.
"""

import hashlib
import os
from collections.abc import Sequence

import numpy as np

from usdsmoke.base.volume import DenseField
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.vdb.boxes import active_mask, crop_to_active
from usdsmoke.vdb.header import read_header
from usdsmoke.vdb.read import GridRequest, read_grids

CONTENT_KEY = "usdsmoke:content_sha256"  # file metadata that holds the hash


def hash_fields(fields: Sequence[DenseField]) -> str:
    """SHA-256, 64 hexadecimal digits, of what the fields hold; their order and padding are no part.

    The transform counts with ten decimals of its largest scale: OpenVDB may turn nearly equal
    scales into equal ones.
    """
    digest = hashlib.sha256(b"usdsmoke grids 1\n")
    for field in sorted(fields, key=lambda item: item.name):
        _add_field(digest, crop_to_active(field))
    return digest.hexdigest()


def hash_vdb_file(file_path: str | os.PathLike[str], config: GridsConfig) -> str:
    """``hash_fields`` of every grid of a VDB file.

    Raises:
        GridError: see ``read_grids``; a single grid that cannot be read is enough.
    """
    header = read_header(file_path)
    requests = [GridRequest(grid.name, grid.index) for grid in header.grids]
    return hash_fields(read_grids(file_path, requests, config))


def _add_field(digest: "hashlib._Hash", field: DenseField) -> None:
    """Add one cropped field; every part has a length or is of fixed size, so none can pose as two.

    Adding 0.0 turns -0.0, which compares equal to 0.0, into 0.0.
    """
    for text in (field.name, field.grid_class):
        encoded = text.encode("utf-8", errors="surrogateescape")
        digest.update(len(encoded).to_bytes(8, "little") + encoded)
    digest.update(b"half" if field.half else b"full")
    digest.update(_rounded_transform(field.index_to_world).encode("ascii"))
    background = np.atleast_1d(np.asarray(field.background, "<f4")) + np.float32(0.0)
    mask = active_mask(field)
    place = np.array([*field.ijk_min, *mask.shape], "<i8")
    for array in (background, place, np.packbits(mask), field.values[mask] + np.float32(0.0)):
        digest.update(array.size.to_bytes(8, "little"))
        digest.update(np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes())


def _rounded_transform(matrix: np.ndarray) -> str:
    linear, translation = np.asarray(matrix, np.float64)[:3, :3], np.asarray(matrix)[3, :3]
    largest = np.abs(linear).max() or 1.0
    shares = np.round(linear / largest, 10) + 0.0
    texts = [f"{largest:.9e}", *(f"{share:.10f}" for share in shares.flat)]
    return " ".join(texts + [f"{length + 0.0:.12e}" for length in translation])

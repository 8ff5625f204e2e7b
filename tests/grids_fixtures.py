"""Small fields, files and limits that the tests of the grids share."""

import math
from pathlib import Path

import numpy as np
import pytest

from usdsmoke.base.sections import GridsConfig
from usdsmoke.base.volume import DenseField
from usdsmoke.vdb.binding import find_binding
from usdsmoke.vdb.content_hash import CONTENT_KEY, hash_vdb_file
from usdsmoke.vdb.header import read_header

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

# A test that meets a damaged file must not take the machine with it.
TIGHT = GridsConfig(memory_limit_gib=1.5)


def shared_file(name: str) -> Path:
    """A file of the shared data; the test skips where there is none."""
    file_path = SHARED_DATA / name
    if not file_path.is_file():
        pytest.skip(f"needs {name} in ../shared/data")
    return file_path


def check_content(file_path: str | Path) -> None:
    """What a file of ours holds is what its own metadata says."""
    promised = read_header(file_path).metadata[CONTENT_KEY]
    assert hash_vdb_file(file_path, TIGHT) == promised


def openvdb():
    """OpenVDB's bindings, to make files that usdsmoke itself would never write."""
    return find_binding()


def uniform(size=0.1, translation=(0.0, 0.0, 0.0)):
    matrix = np.diag([size, size, size, 1.0])
    matrix[3, :3] = translation
    return matrix


def rotated(angle=0.3, scale=(0.1, 0.2, 0.05), translation=(1.25, -7.0, 0.1)):
    """Scale, then a turn about z, then a translation: row vectors."""
    cosine, sine = math.cos(angle), math.sin(angle)
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag(scale) @ [[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]
    matrix[3, :3] = translation
    return matrix


def make_field(name="density", shape=(6, 5, 4), ijk_min=(-2, 0, 3), seed=0, **changes):
    """A field of which about a third of the voxels is background."""
    rng = np.random.default_rng(seed)
    values = rng.random(shape, dtype=np.float32)
    empty = rng.random(shape[:3]) < 0.3
    settings = {"index_to_world": uniform(), "background": 0.0, **changes}
    values[empty] = settings["background"]
    return DenseField(name=name, values=values, ijk_min=ijk_min, **settings)


def make_vectors(name="emission", shape=(6, 5, 4), **changes):
    return make_field(
        name, (*shape, 3), **{"background": (0.0, 0.0, 0.0), "grid_class": "unknown", **changes}
    )


def raw_grid(values, name="density", ijk=(0, 0, 0), grid_class="fog volume", matrix=None):
    """A grid made by OpenVDB itself, with every value set one by one, so that NaN stays active."""
    values = np.asarray(values, np.float32)
    binding = openvdb()
    grid = binding.Vec3SGrid() if values.ndim == 4 else binding.FloatGrid()
    accessor = grid.getAccessor()
    for offset in np.ndindex(values.shape[:3]):
        value = values[offset]
        place = tuple(int(a + b) for a, b in zip(ijk, offset, strict=True))
        accessor.setValueOn(place, tuple(value.tolist()) if values.ndim == 4 else float(value))
    grid.name = name
    grid.gridClass = grid_class
    grid.transform = binding.createLinearTransform(
        (uniform() if matrix is None else matrix).tolist()
    )
    return grid


def write_raw(file_path, *grids, metadata=None):
    openvdb().write(str(file_path), grids=list(grids), metadata=metadata or {})
    return file_path

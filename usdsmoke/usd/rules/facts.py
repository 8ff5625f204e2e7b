"""A Volume's fields over time, and the headers of their files."""

import os
import re
from dataclasses import dataclass
from functools import lru_cache
from threading import Lock

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdVol

from usdsmoke.base.errors import GridError, StageError
from usdsmoke.base.sections import StageConfig
from usdsmoke.base.volume import VELOCITY_NAMES
from usdsmoke.usd.asset_paths import vdb_problem
from usdsmoke.usd.field_samples import FieldSample, FieldSamples, usd_time
from usdsmoke.usd.relationships import field_targets, target_prim
from usdsmoke.vdb.header import FileHeader, GridHeader, read_header
from usdsmoke.vdb.read import GridRequest, find_grid

DENSITY = StageConfig().density  # a stage is checked without a run's settings
_VELOCITY = re.compile(rf"({'|'.join(VELOCITY_NAMES)})([_:]?[xyz])?")
_READING = Lock()  # UsdValidation runs validators at the same time, and all want the same headers


@dataclass(frozen=True)
class FieldFacts:
    """A field of a Volume whose relationship leads to an OpenVDBAsset."""

    relationship: str  # without field:
    prim: Usd.Prim
    samples: tuple[FieldSample, ...]  # ascending timeCodes; one entry when nothing is sampled

    @property
    def prim_path(self) -> str:
        """The field prim's path."""
        return str(self.prim.GetPath())

    def at(self, time_code: float | None) -> FieldSample:
        """What the field shows at a time."""
        return FieldSamples(self.prim).at(time_code)


def collect_fields(volume: Usd.Prim, interval: Gf.Interval) -> list[FieldFacts]:
    """The usable fields of a Volume with all that they show in an interval of time."""
    fields = []
    for name, targets in field_targets(volume).items():
        prim = target_prim(volume.GetStage(), targets)
        if prim and prim.IsA(UsdVol.OpenVDBAsset):
            fields.append(FieldFacts(name, prim, FieldSamples(prim).inside(interval)))
    return fields


def is_velocity(relationship: str) -> bool:
    """True for the usual names of a velocity or of one of its components, without ``field:``."""
    return _VELOCITY.fullmatch(relationship) is not None


def header_of(file_path: str) -> FileHeader:
    """The header of a VDB file, read once as long as the file stays as it is.

    Raises:
        GridError, StageError: see ``read_header``.
    """
    try:
        state = os.stat(file_path)
    except OSError:
        return read_header(file_path)
    with _READING:
        return _read_once(file_path, state.st_mtime_ns, state.st_size)


def file_trouble(sample: FieldSample) -> str:
    """Why the file of a field cannot be opened at all; empty when it can, or nothing is shown."""
    if sample.blocked:
        return ""
    problem = vdb_problem(sample.authored_path, sample.file_path)
    path = f"@{sample.authored_path}@" if sample.authored_path else "empty"
    return f"filePath is {path}: {problem}" if problem else ""


def sample_grid(sample: FieldSample) -> GridHeader | None:
    """The grid that is shown, from its file's header; None when there is none to be had."""
    if sample.blocked or file_trouble(sample):
        return None
    try:
        header = header_of(sample.file_path)
        return find_grid(header, GridRequest(sample.grid_name, sample.grid_index))
    except (GridError, StageError):
        return None


def field_to_stage(prim: Usd.Prim, time_code: float | None) -> np.ndarray:
    """Row-vector matrix [4 4] from a field prim's local space to the stage's, at a time."""
    return np.array(UsdGeom.XformCache(usd_time(time_code)).GetLocalToWorldTransform(prim))


@lru_cache(maxsize=4096)
def _read_once(file_path: str, _modified: int, _size: int) -> FileHeader:
    return read_header(file_path)

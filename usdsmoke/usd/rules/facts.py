"""What a Volume's fields show over time, and the headers of the files they name."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from threading import Lock

import numpy as np
from pxr import Usd, UsdGeom, UsdValidation, UsdVol

from usdsmoke.base.errors import GridError, StageError
from usdsmoke.usd.asset_paths import vdb_problem
from usdsmoke.usd.relationships import field_targets
from usdsmoke.vdb.header import FileHeader, GridHeader, read_header
from usdsmoke.vdb.read import GridRequest, find_grid

__all__ = [
    "FieldFacts",
    "Shown",
    "collect_fields",
    "field_to_stage",
    "file_trouble",
    "header_of",
    "held_at",
    "shown_grid",
]

_READING = Lock()  # UsdValidation runs validators at the same time, and all want the same headers


@dataclass(frozen=True)
class Shown:
    """What a field prim shows from one of its timeCodes on."""

    time_code: float | None  # None: nothing is sampled, the default holds
    authored_path: str
    file_path: str  # resolved; "" when it does not resolve
    blocked: bool  # no value: nothing is meant to be shown
    grid_name: str
    grid_index: int | None


@dataclass(frozen=True)
class FieldFacts:
    """A field of a Volume whose relationship leads to an OpenVDBAsset."""

    relationship: str  # without field:
    prim: Usd.Prim
    shown: tuple[Shown, ...]  # ascending timeCodes; one entry when nothing is sampled

    @property
    def prim_path(self) -> str:
        """The field prim's path."""
        return str(self.prim.GetPath())


def collect_fields(
    volume: Usd.Prim, time_range: UsdValidation.ValidationTimeRange
) -> list[FieldFacts]:
    """The usable fields of a Volume with all that they show in a range of time."""
    fields = []
    for name, targets in field_targets(volume).items():
        prim = volume.GetStage().GetPrimAtPath(targets[0]) if len(targets) == 1 else None
        if prim and prim.IsA(UsdVol.OpenVDBAsset):
            fields.append(FieldFacts(name, prim, _collect_shown(prim, time_range)))
    return fields


def held_at(field: FieldFacts, time_code: float | None) -> Shown:
    """What the field shows at a time: its last entry not after it, or its first."""
    held = field.shown[0]
    for shown in field.shown:
        if time_code is None or shown.time_code is None or shown.time_code > time_code:
            break
        held = shown
    return held


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


def file_trouble(shown: Shown) -> str:
    """Why the file of a field cannot be opened at all; empty when it can, or nothing is shown."""
    if shown.blocked:
        return ""
    problem = vdb_problem(shown.authored_path, shown.file_path)
    path = f"@{shown.authored_path}@" if shown.authored_path else "empty"
    return f"filePath is {path}: {problem}" if problem else ""


def shown_grid(shown: Shown) -> GridHeader | None:
    """The grid that is shown, from its file's header; None when there is none to be had."""
    if shown.blocked or file_trouble(shown):
        return None
    try:
        header = header_of(shown.file_path)
        return find_grid(header, GridRequest(shown.grid_name, shown.grid_index))
    except (GridError, StageError):
        return None


def field_to_stage(prim: Usd.Prim, time_code: float | None) -> np.ndarray:
    """Row-vector matrix [4 4] from a field prim's local space to the stage's, at a time."""
    code = Usd.TimeCode.Default() if time_code is None else Usd.TimeCode(time_code)
    return np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(prim))


@lru_cache(maxsize=4096)
def _read_once(file_path: str, _modified: int, _size: int) -> FileHeader:
    return read_header(file_path)


def _collect_shown(
    prim: Usd.Prim, time_range: UsdValidation.ValidationTimeRange
) -> tuple[Shown, ...]:
    names = ("filePath", "fieldName", "fieldIndex")
    attributes = {name: prim.GetAttribute(name) for name in names}
    codes = {code for item in attributes.values() for code in item.GetTimeSamples()}
    inside = sorted(code for code in codes if time_range.GetInterval().Contains(code))
    if not codes or not inside:
        return (_shown(attributes, None if not codes else min(codes)),)
    return tuple(_shown(attributes, code) for code in inside)


def _shown(attributes: Mapping[str, Usd.Attribute], time_code: float | None) -> Shown:
    code = Usd.TimeCode.Default() if time_code is None else Usd.TimeCode(time_code)
    asset = attributes["filePath"].Get(code)
    never = asset is None and not attributes["filePath"].HasAuthoredValue()
    return Shown(
        time_code=time_code,
        authored_path=str(asset.authoredPath) if asset else "",
        file_path=str(asset.resolvedPath) if asset else "",
        blocked=asset is None and not never,
        grid_name=attributes["fieldName"].Get(code) or "",
        grid_index=attributes["fieldIndex"].Get(code),
    )

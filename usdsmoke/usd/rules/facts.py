"""What rules look at, and what they find: a Volume's fields over time, file headers, problems."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdVol

from usdsmoke.base.errors import GridError, StageError
from usdsmoke.base.time_codes import format_time_codes
from usdsmoke.base.volume import FIELD_SEPARATORS, VELOCITY_NAMES
from usdsmoke.config.run_sections import StageConfig
from usdsmoke.usd.field_samples import (
    FieldSample,
    FieldSamples,
    field_targets,
    target_prim,
    usd_time,
)
from usdsmoke.usd.values import vdb_problem
from usdsmoke.vdb.header import GridHeader, read_header
from usdsmoke.vdb.read import GridRequest, find_grid


class Severity(str, Enum):
    """How bad a finding is; only an error says that the stage cannot be used as it is."""

    ERROR = "error"
    WARN = "warn"
    INFO = "info"

    def __str__(self) -> str:
        return str(self.value)


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, and where."""

    severity: Severity
    rule: str  # "GridMissing" for ours, "usdGeomValidators:Name.Error" for others
    prim_path: str  # a property's path where one is meant; "" for a whole layer or stage
    time_code: float | None  # the first one concerned; None when time plays no part
    message: str


@dataclass(frozen=True)
class Problem:
    """A finding as a rule notes it, before USD has carried it."""

    severity: Severity
    prim_path: str
    message: str
    time_code: float | None = None


def grouped(
    severity: Severity, prim_path: str, troubles: Mapping[float | None, str]
) -> list[Problem]:
    """One problem for each different trouble, naming all timeCodes that have it.

    Args:
        troubles: text by timeCode; None stands for a value that has no time samples.
    """
    codes_of: dict[str, list[float]] = {}
    for code, text in troubles.items():
        codes_of.setdefault(text, []).extend([] if code is None else [code])
    problems = []
    for text, codes in codes_of.items():
        others = sorted(codes)[1:]
        noun = "timeCode" if len(others) == 1 else "timeCodes"
        also = f" (also at {noun} {format_time_codes(others)})" if others else ""
        problems.append(Problem(severity, prim_path, text + also, min(codes, default=None)))
    return problems


DENSITY = StageConfig().density  # a stage is checked without a run's settings
_SEPARATOR = "|".join(map(re.escape, FIELD_SEPARATORS))
_VELOCITY = re.compile(rf"({'|'.join(VELOCITY_NAMES)})(({_SEPARATOR})[xyz])?")


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


def file_trouble(sample: FieldSample, prim: Usd.Prim | None = None) -> str:
    """Why the file of a field cannot be opened at all; empty when it can, or nothing is shown."""
    if sample.blocked:
        return ""
    attribute = prim.GetAttribute("filePath") if prim else None
    problem = vdb_problem(sample.authored_path, sample.file_path, attribute)
    path = f"@{sample.authored_path}@" if sample.authored_path else "empty"
    return f"filePath is {path}: {problem}" if problem else ""


def sample_grid(sample: FieldSample) -> GridHeader | None:
    """The grid that is shown, from its file's header; None when there is none to be had."""
    if sample.blocked or file_trouble(sample):
        return None
    try:
        return find_grid(
            read_header(sample.file_path), GridRequest(sample.grid_name, sample.grid_index)
        )
    except (GridError, StageError):
        return None


def field_to_stage(prim: Usd.Prim, time_code: float | None) -> np.ndarray:
    """Row-vector matrix [4 4] from a field prim's local space to the stage's, at a time."""
    return np.array(UsdGeom.XformCache(usd_time(time_code)).GetLocalToWorldTransform(prim))

"""Rules on a single field of a Volume: its target, its file, its grid, its tokens, its timing."""

import os

from pxr import Gf, Usd, UsdVol

from usdsmoke.base.errors import GridError, StageError, UnsupportedGrid
from usdsmoke.base.time_codes import find_holes, format_time_code
from usdsmoke.usd.field_samples import FieldSamples, field_targets, target_prim, usd_time
from usdsmoke.usd.field_tokens import DATA_TYPES, GRID_CLASSES
from usdsmoke.usd.rules.facts import (
    DENSITY,
    FieldFacts,
    Problem,
    Severity,
    collect_fields,
    file_trouble,
    grouped,
    is_velocity,
    sample_grid,
)
from usdsmoke.usd.values import package_of, packed_problem, value_at
from usdsmoke.vdb.header import GridHeader, read_header
from usdsmoke.vdb.read import GridRequest, check_readable, find_grid

_TOKENS = ("fieldDataType", "fieldClass", "vectorDataRoleHint")


def check_targets(volume: Usd.Prim, _interval: Gf.Interval) -> list[Problem]:
    """Every field relationship leads to one field prim."""
    problems = []
    for name, targets in field_targets(volume).items():
        where = f"{volume.GetPath()}.field:{name}"
        listed = ", ".join(f"<{path}>" for path in targets)
        prim, severity = target_prim(volume.GetStage(), targets), Severity.ERROR
        if not targets:
            message = "the relationship has no target. Set it to one OpenVDBAsset prim."
        elif len(targets) > 1:
            message = f"the relationship has {len(targets)} targets ({listed}). Keep one of them."
        elif prim is None:
            message = (
                f"the relationship leads to {listed}, where there is no prim. Correct its target: "
                "one OpenVDBAsset prim."
            )
        elif not prim.IsA(_FIELD_BASE):
            message = (
                f"the relationship leads to {listed}, which is of type "
                f"{prim.GetTypeName() or 'none'} and holds no field. Correct its target: one "
                "OpenVDBAsset prim."
            )
        elif not prim.IsActive():
            message = (
                f"the relationship leads to {listed}, which is inactive: the field is not shown. "
                "Activate it, or remove the relationship."
            )
            severity = Severity.ERROR if name == DENSITY else Severity.WARN
        else:
            continue
        problems.append(Problem(severity, where, message))
    return problems


def check_kinds(volume: Usd.Prim, interval: Gf.Interval) -> list[Problem]:
    """Density and velocity are OpenVDBAssets; other fields may be of any type.

    A density of another type cannot be stylized. A velocity of another type is ignored.
    """
    problems = []
    for name, targets in field_targets(volume).items():
        prim = target_prim(volume.GetStage(), targets)
        if prim is None or not prim.IsA(_FIELD_BASE) or prim.IsA(UsdVol.OpenVDBAsset):
            continue
        found = f"<{prim.GetPath()}> ({_shown(prim, interval)}) is of type {prim.GetTypeName()}"
        where = f"{volume.GetPath()}.field:{name}"
        if name == DENSITY:
            message = (
                f"the density {found}, which cannot be stylized. Convert the file to OpenVDB and "
                "show it with an OpenVDBAsset prim."
            )
            problems.append(Problem(Severity.ERROR, where, message))
        elif is_velocity(name):
            message = (
                f"the velocity {found}, so stylizing ignores it. Convert the file to OpenVDB and "
                "show it with an OpenVDBAsset prim."
            )
            problems.append(Problem(Severity.WARN, where, message))
    return problems


def check_files(volume: Usd.Prim, interval: Gf.Interval) -> list[Problem]:
    """Every file that a field names is there and is a VDB file."""
    problems = []
    packed: dict[str, dict[str, float | None]] = {}  # by package: fields, each with a timeCode
    for field in collect_fields(volume, interval):
        troubles = {}
        for sample in field.samples:
            if package := package_of(sample.file_path):
                packed.setdefault(package, {}).setdefault(field.relationship, sample.time_code)
                continue
            trouble = file_trouble(sample, field.prim)
            if not trouble and not sample.blocked:
                trouble = _header_trouble(sample.file_path)
            if trouble:
                troubles[sample.time_code] = trouble
        problems += grouped(Severity.ERROR, field.prim_path, troubles)
    for package, codes in packed.items():
        message = f"the files of {', '.join(codes)} lie {packed_problem(package)}"
        first = min((code for code in codes.values() if code is not None), default=None)
        problems.append(Problem(Severity.ERROR, str(volume.GetPath()), message, first))
    return problems


def check_grids(volume: Usd.Prim, interval: Gf.Interval) -> list[Problem]:
    """Every file has the grid that its field names."""
    problems = []
    for field in collect_fields(volume, interval):
        troubles = {}
        for sample in field.samples:
            if sample.blocked or file_trouble(sample) or _header_trouble(sample.file_path):
                continue
            try:
                request = GridRequest(sample.grid_name, sample.grid_index)
                find_grid(read_header(sample.file_path), request)
            except GridError as error:
                troubles[sample.time_code] = str(error)
        problems += grouped(Severity.ERROR, field.prim_path, troubles)
    return problems


def check_density(volume: Usd.Prim, interval: Gf.Interval) -> list[Problem]:
    """The density's grids are fog volumes of numbers in linear space, which stylizing can read."""
    problems = []
    for field in collect_fields(volume, interval):
        if field.relationship != DENSITY:
            continue
        troubles = {}
        for sample in field.samples:
            grid = sample_grid(sample)
            if grid is None:
                continue  # ``check_files`` or ``check_grids`` reports it
            request = GridRequest(sample.grid_name, sample.grid_index, components=1)
            try:
                check_readable(read_header(sample.file_path), grid, request)
            except UnsupportedGrid as error:
                troubles[sample.time_code] = str(error)
        problems += grouped(Severity.ERROR, field.prim_path, troubles)
    return problems


def check_types(volume: Usd.Prim, interval: Gf.Interval) -> list[Problem]:
    """``fieldDataType`` describes the grid; USD's documentation says to author it."""
    problems = []
    for field in collect_fields(volume, interval):
        wrong, missing = {}, {}
        for code, grid in _grids(field):
            token = _token(field.prim, "fieldDataType", code)
            fitting = DATA_TYPES.get(grid.value_type, ())
            if not token:
                advice = f"Author {' or '.join(fitting)}." if fitting else "USD has no word for it."
                missing[code] = (
                    f'fieldDataType is not authored; the grid "{grid.label}" is {grid.value_type}. '
                    f"{advice}"
                )
            elif fitting and token not in fitting:
                wrong[code] = (
                    f'fieldDataType is "{token}" but the grid "{grid.label}" holds '
                    f"{grid.value_type}. Author {' or '.join(fitting)}."
                )
        problems += grouped(Severity.ERROR, field.prim_path, wrong)
        problems += grouped(Severity.INFO, field.prim_path, missing)
    return problems


def check_classes(volume: Usd.Prim, interval: Gf.Interval) -> list[Problem]:
    """``fieldClass`` and the grid's own class agree where both say something."""
    problems = []
    for field in collect_fields(volume, interval):
        troubles = {}
        for code, grid in _grids(field):
            meant = GRID_CLASSES.get(_token(field.prim, "fieldClass", code))
            if meant and grid.grid_class in GRID_CLASSES.values() and grid.grid_class != meant:
                troubles[code] = (
                    f'fieldClass means a {meant} but the grid "{grid.label}" is a '
                    f"{grid.grid_class}. Correct one of them."
                )
        problems += grouped(Severity.WARN, field.prim_path, troubles)
    return problems


def check_tokens(volume: Usd.Prim, interval: Gf.Interval) -> list[Problem]:
    """Tokens are among those that the schema allows."""
    problems = []
    for field in collect_fields(volume, interval):
        for name in _TOKENS:
            attribute = field.prim.GetAttribute(name)
            allowed = attribute.GetMetadata("allowedTokens") or ()
            troubles = {
                code: f'{name} is "{token}". Use one of {", ".join(map(str, allowed))}.'
                for code in attribute.GetTimeSamples() or [None]
                if (token := _token(field.prim, name, code)) and token not in allowed
            }
            problems += grouped(Severity.ERROR, f"{field.prim_path}.{name}", troubles)
    return problems


def check_gaps(volume: Usd.Prim, interval: Gf.Interval) -> list[Problem]:
    """The files of a field follow one another at one step, without holes and blocked samples."""
    problems = []
    for field in collect_fields(volume, interval):
        codes = [
            sample.time_code
            for sample in field.samples
            if sample.time_code is not None and not sample.blocked
        ]
        troubles: dict[float | None, str] = {
            before: f"no sample between the timeCodes {format_time_code(before)} and "
            f"{format_time_code(after)}, so the file of {format_time_code(before)} is held. Add "
            "the files, or block the first missing timeCode (its sample is None) if the smoke ends."
            for before, after in find_holes(codes)
        }
        problems += grouped(Severity.WARN, field.prim_path, troubles)
    return problems


def check_absolute_paths(volume: Usd.Prim, interval: Gf.Interval) -> list[Problem]:
    """File paths are relative, so that a folder can be moved or sent."""
    problems = []
    for field in collect_fields(volume, interval):
        paths = {
            sample.time_code: sample.authored_path
            for sample in field.samples
            if os.path.isabs(sample.authored_path) or sample.authored_path[1:3] in (":/", ":\\")
        }
        if not paths:
            continue
        code = min(paths, key=lambda item: -1e300 if item is None else item)
        many = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
        message = f"@{paths[code]}@{many} is absolute. Use a path relative to its layer."
        problems.append(Problem(Severity.WARN, field.prim_path, message, code))
    return problems


_FIELD_BASE = getattr(UsdVol, "VolumeFieldBase", UsdVol.FieldBase)  # renamed after 24.08
_FIELD_ASSET = getattr(UsdVol, "VolumeFieldAsset", UsdVol.FieldAsset)  # renamed with it


def _header_trouble(file_path: str) -> str:
    try:
        read_header(file_path)
    except (GridError, StageError) as error:
        return str(error)
    return ""


def _shown(prim: Usd.Prim, interval: Gf.Interval) -> str:
    """The first file and grid of a field of any type, in words."""
    samples = FieldSamples(prim).inside(interval) if prim.IsA(_FIELD_ASSET) else ()
    first = next((item for item in samples if item.authored_path), None)
    if first is None:
        return "no file"
    return f'@{first.authored_path}@, grid "{first.grid_name}"'


def _grids(field: FieldFacts) -> list[tuple[float | None, GridHeader]]:
    """The grids that a field shows, by timeCode, where they can be had."""
    found = [(sample.time_code, sample_grid(sample)) for sample in field.samples]
    return [(code, grid) for code, grid in found if grid is not None]


def _token(prim: Usd.Prim, name: str, time_code: float | None) -> str:
    """The authored token; schema fallbacks such as the role's None are ignored."""
    attribute = prim.GetAttribute(name)
    if not attribute.HasAuthoredValue():
        return ""
    return str(value_at(attribute, usd_time(time_code)) or "")

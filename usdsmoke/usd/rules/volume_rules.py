"""Rules on a Volume's fields together: bounds, one file, one name, one place in space."""

import os
import re
from collections.abc import Iterator, Sequence

import numpy as np
from pxr import Usd, UsdValidation

from usdsmoke.base.volume import VELOCITY_NAMES
from usdsmoke.usd.rules.facts import (
    FieldFacts,
    Shown,
    collect_fields,
    field_to_stage,
    held_at,
    shown_grid,
)
from usdsmoke.usd.rules.findings import Problem, Severity, grouped

__all__ = ["check_extent", "check_one_file", "check_one_name", "check_one_place"]

_VELOCITY = re.compile(rf"({'|'.join(VELOCITY_NAMES)})([_:]?[xyz])?")
_CLOSE = 1e-6  # of a matrix, relative to its largest element: what single precision can hold


def check_extent(volume: Usd.Prim, _time_range: UsdValidation.ValidationTimeRange) -> list[Problem]:
    """The Volume has an extent; USD cannot work one out, and without it nothing frames it."""
    if volume.GetAttribute("extent").HasAuthoredValue():
        return []
    message = "no extent is authored, so the Volume has empty bounds; author the box of its fields"
    return [Problem(Severity.WARN, str(volume.GetPath()), message)]


def check_one_file(
    volume: Usd.Prim, time_range: UsdValidation.ValidationTimeRange
) -> list[Problem]:
    """At every moment all fields show one file; RenderMan, Arnold and Blender read only one."""
    troubles = {}
    for code, fields in _moments(collect_fields(volume, time_range)):
        files: dict[str, str] = {}
        for field, shown in fields:
            if shown.file_path and not _is_empty(shown):
                files.setdefault(shown.file_path, field.relationship)
        if len(files) > 1:
            listed = ", ".join(
                f"{name} in {os.path.basename(path)}" for path, name in files.items()
            )
            troubles[code] = (
                f"the fields come from {len(files)} files ({listed}), of which several programs "
                "read only one; keep a frame's grids in one file"
            )
    first = dict(list(troubles.items())[:1])  # the file names differ at every timeCode
    problems = grouped(Severity.WARN, str(volume.GetPath()), first)
    if len(troubles) > 1:
        problems = [
            Problem(
                item.severity,
                item.prim_path,
                f"{item.message} (and so at {len(troubles) - 1} more timeCodes)",
                item.time_code,
            )
            for item in problems
        ]
    return problems


def check_one_name(
    volume: Usd.Prim, time_range: UsdValidation.ValidationTimeRange
) -> list[Problem]:
    """Relationship and grid carry one name; renderers look for the one or the other."""
    problems = []
    for field in collect_fields(volume, time_range):
        troubles = {}
        for shown in field.shown:
            grid = shown_grid(shown)
            name = shown.grid_name or (grid.name if grid else "")
            if name and not shown.blocked and _plain(name) != _plain(field.relationship):
                troubles[shown.time_code] = (
                    f'the relationship field:{field.relationship} shows the grid "{name}"; several '
                    "programs expect both to have one name"
                )
        problems += grouped(Severity.WARN, field.prim_path, troubles)
    return problems


def check_one_place(
    volume: Usd.Prim, time_range: UsdValidation.ValidationTimeRange
) -> list[Problem]:
    """All fields but the velocity have equal voxels: grid and field xform taken together."""
    troubles = {}
    for code, fields in _moments(collect_fields(volume, time_range)):
        first: tuple[str, np.ndarray] | None = None
        for field, shown in fields:
            grid = shown_grid(shown)
            if grid is None or grid.index_to_world is None or _is_empty(shown):
                continue
            if _VELOCITY.fullmatch(field.relationship):
                continue  # often coarser than what it moves, and read on its own
            place = grid.index_to_world @ field_to_stage(field.prim, code)
            if first is None:
                first = (field.relationship, place)
            elif np.abs(place - first[1]).max() > _CLOSE * np.abs(first[1]).max():
                troubles[code] = (
                    f"the voxels of {field.relationship} do not lie on those of {first[0]}; "
                    "several programs take one transform for all grids of a Volume"
                )
    return grouped(Severity.WARN, str(volume.GetPath()), troubles)


def _moments(
    fields: Sequence[FieldFacts],
) -> Iterator[tuple[float | None, list[tuple[FieldFacts, Shown]]]]:
    """Every timeCode at which any field changes, with what each of them shows then."""
    codes = {shown.time_code for field in fields for shown in field.shown}
    sampled: list[float | None] = [*sorted(code for code in codes if code is not None)]
    for code in sampled or [None]:
        yield code, [(field, held_at(field, code)) for field in fields]


def _is_empty(shown: Shown) -> bool:
    """A grid without voxels is missed by nobody, wherever it is."""
    grid = shown_grid(shown)
    return grid is not None and grid.active_voxels == 0


def _plain(name: str) -> str:
    """USD names have no dots: field:vel_x may well show vel.x."""
    return name.replace(".", "_").replace(":", "_")

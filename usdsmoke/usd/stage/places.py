"""What programs disagree on about the place of a Volume, as sentences."""

from collections.abc import Collection, Sequence

import numpy as np
from pxr import Usd, UsdGeom

from usdsmoke.base.time_codes import name_time_codes
from usdsmoke.base.volume import FieldSource
from usdsmoke.usd.values import ancestors

_CLOSE = 1e-6  # of a matrix, relative to its largest element: what single precision can hold


def place_notes(
    volume: Usd.Prim, fields: Sequence[FieldSource], instancers: Sequence[Usd.Prim]
) -> tuple[str, ...]:
    """Field prims that stand elsewhere than their Volume, instancers that show the Volume, and when
    it is invisible.

    Args:
        fields: of all selected frames.
        instancers: the stage's PointInstancers.
    """
    notes = []
    elsewhere = {field.prim_path for field in fields if not stands_with(volume, field)}
    for path in sorted(elsewhere):
        notes.append(
            f"the field prim <{path}> stands elsewhere than its Volume <{volume.GetPath()}>. Grids "
            "are placed by the field prim, as UsdVol says; Storm and Blender place them by the "
            "Volume, so they show the smoke elsewhere and from another side. Give both one "
            "transform"
        )
    for instancer in instancers:
        targets = instancer.GetRelationship("prototypes").GetForwardedTargets()
        if any(volume.GetPath().HasPrefix(path) for path in (*targets, instancer.GetPath())):
            notes.append(
                f"the look of the prototype <{volume.GetPath()}> is made for its own place; the "
                f"PointInstancer <{instancer.GetPath()}> shows it in others"
            )
    codes = {field.time_code for field in fields}
    hidden = _hidden_at(volume, codes)
    if hidden and (len(hidden) < len(codes) or _blinks(volume)):  # else somebody named it
        notes.append(
            f"<{volume.GetPath()}> is invisible at {name_time_codes(hidden)} and taken there "
            "like elsewhere. Leave these timeCodes out with --frames to save their time"
        )
    return tuple(notes)


def _hidden_at(volume: Usd.Prim, time_codes: Collection[float]) -> list[float]:
    """The timeCodes at which a Volume is invisible."""
    shown = UsdGeom.Imageable(volume)
    return [
        code
        for code in sorted(time_codes)
        if shown.ComputeVisibility(code) == UsdGeom.Tokens.invisible
    ]


def _blinks(volume: Usd.Prim) -> bool:
    """Whether a Volume's visibility, or that of a prim above it, changes over time."""
    items = map(UsdGeom.Imageable, ancestors(volume))
    return any(item and item.GetVisibilityAttr().ValueMightBeTimeVarying() for item in items)


def is_never_seen(volume: Usd.Prim, time_codes: Collection[float]) -> bool:
    """Whether a Volume is invisible at all of several timeCodes; not where there are none."""
    return 0 < len(time_codes) == len(_hidden_at(volume, time_codes))


def stands_with(volume: Usd.Prim, field: FieldSource) -> bool:
    """Whether a field prim has its Volume's place on the stage at a timeCode."""
    place = UsdGeom.XformCache(field.time_code).GetLocalToWorldTransform(volume)
    matrix = np.array(place, dtype=np.float64)
    return bool(np.abs(matrix - field.field_to_stage).max() <= _CLOSE * np.abs(matrix).max())


def find_instancers(stage: Usd.Stage) -> list[Usd.Prim]:
    """The PointInstancers of a stage."""
    return [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.PointInstancer)]

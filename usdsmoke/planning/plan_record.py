"""A plan as plain values, for JSON and for the run's record."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan

__all__ = ["describe_plan"]


def describe_plan(plan: "Plan") -> dict[str, Any]:
    """Plain values for JSON: volumes, frames, windows, needed, omitted, estimate."""
    return {
        "stage": plan.source.file_path,
        "volumes": [_volume_dict(volume) for volume in plan.volumes],
        "frames": [
            _frame_dict(volume, frame) for volume in plan.volumes for frame in volume.frames
        ],
        "windows": [
            {"volume": volume.source.prim_path, **asdict(window)}
            for volume in plan.volumes
            for window in volume.windows
        ],
        "needed": list(plan.needed),
        "omitted": [asdict(omission) for omission in plan.omitted],
        "estimate": asdict(plan.estimate),
    }


def _volume_dict(volume: "VolumePlan") -> dict[str, Any]:
    first = volume.frames[0]
    fields: Mapping[str, Any] = first.source.fields
    request = volume.source.request
    return {
        "prim_path": volume.source.prim_path,
        "stem": volume.stem,
        "animated": volume.source.animated,
        "fields": sorted(fields),
        "density_prim": fields[volume.source.density].prim_path,
        "grid": first.grid.label,
        "time_codes": [frame.source.time_code for frame in volume.frames],
        "largest_box": list(max((frame.size.box for frame in volume.frames), key=math.prod)),
        "most_active_voxels": max(frame.size.active_voxels for frame in volume.frames),
        "request": {
            "settings": {key: dict(values) for key, values in request.settings.items()},
            "styles": [Path(name).name for name in request.styles],
        },
    }


def _frame_dict(volume: "VolumePlan", frame: "FramePlan") -> dict[str, Any]:
    window = next(
        window.index for window in volume.windows if frame.source.time_code in window.time_codes
    )
    return {
        "volume": volume.source.prim_path,
        "time_code": frame.source.time_code,
        "window": window,
        "source_file": frame.source.fields[volume.source.density].file_path,
        "grid": frame.grid.label,
        "active_voxels": frame.grid.active_voxels,
        "box": list(frame.size.box),
        "velocity": [grid.label for grid in frame.velocity.grids] if frame.velocity else [],
        "mask": frame.mask.grid.label if frame.mask else "",
        "empty": frame.is_empty,
        "output_file": frame.file_name,
    }
